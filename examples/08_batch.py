"""Animate all meshes of a folder with all clips of another: resumable, with a table and a picture of all results.

python examples/08_batch.py                             # three shipped characters x two shipped motions
python examples/08_batch.py characters/ motions/ -o out # your own folders; repeat the command to continue

The command `mimesh batch` does the same; docs/api.md describes both.
"""

import argparse
from pathlib import Path
from typing import Any

import mimesh
from mimesh.bodies import character, load_body
from mimesh.io import save_bvh, save_mesh
from mimesh.jobs.table import BatchJob
from mimesh.motions import load_motion


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("identities", nargs="?", type=Path, help="a folder of meshes")
    parser.add_argument("clips", nargs="?", type=Path, help="a folder of clips and motions")
    parser.add_argument("--frames", type=int, default=None, help="number of frames to use of each clip")
    parser.add_argument("--workers", type=int, default=None, help="processes; by default one a core")
    parser.add_argument("-o", "--output", type=Path, default=Path("08_batch"), help="folder")
    args = parser.parse_args(argv)
    if args.clips is None:
        args.identities, args.clips = write_shipped_inputs(args.output / "inputs")

    # Every option of `mimesh animate` may be given, by its name without dashes.
    options: dict[str, Any] = {} if args.frames is None else {"stop": args.frames}
    result = mimesh.batch(
        args.identities,
        args.clips,
        args.output / "{identity}-{driving}.glb",
        options=options,
        workers=args.workers,
        report=print_job,
    )
    for kind, path in result.files.items():
        print(f"wrote {path}: {kind}")
    print(f"{len(result.jobs)} pairs, {result.counts['done before']} of them before, {result.failed} failed")


def print_job(done: int, total: int, job: BatchJob | None, outcome: dict[str, Any]) -> None:
    """Print a line for each job; it is None at the start."""
    if job is not None:
        print(f"{done}/{total} {job.name}: {outcome['error'] or job.output}")


def write_shipped_inputs(folder: Path) -> tuple[Path, Path]:
    """Write three shipped characters and two shipped motions, and return their folders."""
    for name in ("heavy", "dancer", "imp"):
        save_mesh(character(name), folder / "characters" / f"{name}.glb")
    for name in ("jump", "turn"):
        save_bvh(load_motion(name), load_body(), folder / "motions" / f"{name}.bvh")
    return folder / "characters", folder / "motions"


if __name__ == "__main__":
    main()
