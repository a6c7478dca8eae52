"""Many jobs: a table of runs of `mimesh animate`, `transfer`, `rig` and `capture`, done by several processes."""
