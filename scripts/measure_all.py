"""Measure all methods on all test sets, write docs/results and the tables of the docs. Resumable; hours on two cores.

    python scripts/measure_all.py [--characters DIR] [--people DIR] [--methods mime,mime-network] [PROTOCOL ...]

Run it in the root of a checkout, which contains `ablations/`. characters are measured if --characters is a pool of
rigged characters, cross-body if --people is a folder of them. Of existing reports the rows of these methods are
replaced.
Several of these can run at the same time, on different protocols.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import write_results

from mimesh.commands.terminal import progress
from mimesh.evaluate.run import FOLDERS, WITHOUT_FOLDER, evaluate_command
from mimesh.evaluate.tables import TABLES
from mimesh.methods.find import weights_path

METHODS = (
    *("identity", "copy", "mime", "mime-network", "npt", "npt-maxpool"),
    *("deformation-transfer-dense", "deformation-transfer-13"),
)
"""Methods that are measured on every protocol."""
ANIMAL_METHODS = ("identity", "copy", "mime-quadruped", "deformation-transfer-13")
"""Methods that are measured on four-legged animals: the others know only people."""


def main() -> None:
    """Measure one protocol after the other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("protocols", nargs="*", metavar="PROTOCOL", help=", ".join((*WITHOUT_FOLDER, *FOLDERS)))
    parser.add_argument("--characters", type=Path, help="pool of rigged characters, for characters")
    parser.add_argument("--people", type=Path, help="rigged characters, for cross-body")
    parser.add_argument("--methods", default="", help="only these of the usual ones, such as mime,mime-network")
    args = parser.parse_args()
    chosen = set(args.methods.split(",")) if args.methods else None
    folders = {"characters": args.characters, "cross-body": args.people}
    for name in args.protocols or (*WITHOUT_FOLDER, *(name for name in FOLDERS if folders[name])):
        out = write_results.RESULTS / f"{name}.json"
        measured = [method for method in methods(name) if chosen is None or method in chosen]
        if not measured:
            continue
        with progress(name, quiet=False) as advance:
            evaluate_command(name, measured, out, progress=advance, data=folders.get(name))
        print(f"{name}: measured")
    write_results.main([])


def methods(protocol: str) -> list[str]:
    """Return the methods to measure on a protocol: METHODS, and the rows of the papers' tables that use it."""
    rows = [row.method for table in TABLES.values() if table.protocol == protocol for row in table.rows]
    if protocol == "quadruped":
        trained = [row for row in rows if weights_path(row).is_file()]  # these are not in the repository
        return list(dict.fromkeys([*ANIMAL_METHODS, *trained]))
    return list(dict.fromkeys([*METHODS, *rows]))


if __name__ == "__main__":
    main()
