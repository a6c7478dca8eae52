"""Write src/mimesh/evaluate/frozen_sets.json: role, number of pairs and checksums of every set. Takes some minutes.

    python scripts/freeze_sets.py [--data PROTOCOL=DIR ...]

Sets of protocols that read a folder keep their stored entries if the folder is not given. A changed checksum means that
published figures are no longer those of the set: give the protocol a new version, or undo the change.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

from mimesh.evaluate.frozen_sets import FILE, FrozenSet, freeze, frozen_sets, kinds_of
from mimesh.evaluate.run import FOLDERS, WITHOUT_FOLDER, find_protocol
from mimesh.io.atomic import whole_file

OUTPUT = Path(__file__).parents[1] / "src" / "mimesh" / "evaluate" / FILE


def main() -> None:
    """Generate all sets, print those that changed, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", action="append", default=[], metavar="PROTOCOL=DIR", help="folder of a protocol")
    args = parser.parse_args()
    folders = {name: Path(folder) for name, _, folder in (entry.partition("=") for entry in args.data)}
    stored = frozen_sets() if OUTPUT.exists() else {}
    sets = []
    for name in (*WITHOUT_FOLDER, *FOLDERS):
        # Only some kinds of these two need a folder.
        needs_folder = name in FOLDERS and name not in (*folders, "fingers", "clips-ordered")
        made = [] if needs_folder else freeze_protocol(name, folders.get(name), stored)
        known = {(entry.split, entry.kind) for entry in made}
        # Some kinds of `dressed` need a folder too.
        kept = [entry for (protocol, *key), entry in stored.items() if protocol == name and tuple(key) not in known]
        sets += [*kept, *made]
    with whole_file(OUTPUT) as temporary:
        temporary.write_text(json.dumps([dataclasses.asdict(entry) for entry in sets], indent=1) + "\n")
    print(f"{OUTPUT}: {len(sets)} sets")


def freeze_protocol(name: str, folder: Path | None, stored: dict[tuple[str, str, str], FrozenSet]) -> list[FrozenSet]:
    """Generate the sets of a protocol; say which are new or differ from the stored ones."""
    protocol, sets = find_protocol(name, folder), []
    for split in ("val", "test"):
        protocol.check(split)
        for kind in kinds_of(protocol, split):
            entry = freeze(protocol, split, kind)
            old = stored.get((name, split, kind))
            state = "new" if old is None else "same" if old.checksum == entry.checksum else "CHANGED"
            print(f"{name} {split} {kind}: {entry.role}, {entry.pairs} pairs, {state}", flush=True)
            sets.append(entry)
    return sets


if __name__ == "__main__":
    main()
