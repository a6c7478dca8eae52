"""Measure all methods on all test sets into docs/results, then write docs/RESULTS.md. Resumable; hours on two cores.

    python scripts/measure_all.py [--people DIR] [--clips DIR] [PROTOCOL ...]

Run it at the root of a checkout, where `ablations/` is. cross-body is measured if --people names rigged characters, and
clips-aniformer if --clips names the folder of the DeepMimic clips. Reports that are there are measured anew.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import write_results

from mimesh.commands.terminal import progress
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.evaluate.run import FOLDERS, evaluate_command
from mimesh.evaluate.tables import TABLES

EVERYWHERE = ("copy", "deformation-transfer-dense", "deformation-transfer-13", "skeleton", "mime", "npt", "npt-maxpool")
SLOW_ON_CLIPS = ("skeleton",)
"""Seconds a frame, and clips have thirty."""


def main() -> None:
    """One report after the other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("protocols", nargs="*", metavar="PROTOCOL", help=", ".join((*PROTOCOLS, *FOLDERS)))
    parser.add_argument("--people", type=Path, help="rigged characters, for cross-body")
    parser.add_argument("--clips", type=Path, help="DeepMimic clips, for clips-aniformer")
    args = parser.parse_args()
    folders = {"cross-body": args.people, "clips-aniformer": args.clips}
    for name in args.protocols or (*PROTOCOLS, *(name for name in FOLDERS if folders[name])):
        out = write_results.RESULTS / f"{name}.json"
        with progress(name, quiet=False) as advance:
            evaluate_command(name, methods(name), out, progress=advance, data=folders.get(name))
        print(f"{name}: measured")
    write_results.main()


def methods(protocol: str) -> list[str]:
    """What is measured on a protocol: every method, and the rows of the papers' tables where these are measured."""
    rows = [row.method for table in TABLES.values() if table.protocol == protocol for row in table.rows]
    left_out = SLOW_ON_CLIPS if protocol == "clips-aniformer" else ()
    return [method for method in dict.fromkeys([*EVERYWHERE, *rows]) if method not in left_out]


if __name__ == "__main__":
    main()
