"""Measure all methods on all test sets into docs/results, then write docs/RESULTS.md. Resumable; hours on two cores.

    python scripts/measure_all.py [--data DIR] [PROTOCOL ...]

cross-body is measured if --data names a folder of rigged characters. Reports that are there are measured anew.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import write_results

from mimesh.commands.terminal import progress
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.evaluate.run import evaluate_command
from mimesh.methods import ROWS

GIVEN_MUCH = ("copy", "deformation-transfer-dense", "deformation-transfer-13")


def main() -> None:
    """One report after the other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("protocols", nargs="*", metavar="PROTOCOL", help=", ".join((*PROTOCOLS, "cross-body")))
    parser.add_argument("--data", type=Path)
    args = parser.parse_args()
    for name in args.protocols or (*PROTOCOLS, *(("cross-body",) if args.data else ())):
        methods = [
            *GIVEN_MUCH,
            "skeleton",
            "npt",
            "npt-maxpool",
            *(("deformation-transfer-5", *ROWS) if name == "human-npt" else ()),
        ]
        with progress(name, quiet=False) as advance:
            evaluate_command(name, methods, write_results.RESULTS / f"{name}.json", progress=advance, data=args.data)
        print(f"{name}: measured")
    write_results.main()


if __name__ == "__main__":
    main()
