"""Many jobs: a table of runs of `mimesh animate` and `mimesh transfer`, done by several processes."""
