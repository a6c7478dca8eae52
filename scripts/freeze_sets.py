"""Write src/mimesh/evaluate/frozen_sets.json: role, number of pairs and checksums of every set. Takes some minutes.

    python scripts/freeze_sets.py [--data PROTOCOL=DIR ...]

Sets of protocols that read a folder keep their stored entries if the folder is not given. A changed checksum means that
published figures are no longer those of the set: give the protocol a new version, or undo the change.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.evaluate.clip_protocols import CLIPS_ANIFORMER, ClipsAniformer
from mimesh.evaluate.frozen_sets import (
    DEVELOPMENT,
    FILE,
    FIRST,
    FrozenSet,
    frozen_sets,
    pair_checksum,
    role,
    set_checksum,
)
from mimesh.evaluate.pairs import human
from mimesh.evaluate.protocols import Protocol, split_pose_bank
from mimesh.evaluate.run import FOLDERS, WITHOUT_FOLDER, find_protocol
from mimesh.io.atomic import whole_file
from mimesh.motions import mirror
from mimesh.motions.clips import split_windows
from mimesh.motions.motion import turned_to_front

OUTPUT = Path(__file__).parents[1] / "src" / "mimesh" / "evaluate" / FILE
NOTES = {
    ("human-wide", "clips"): "later seconds of takes whose earlier seconds are training data, not whole takes",
    ("clips-aniformer", "seen"): "motions that the rows of the tables are trained on, by new people",
    ("clips-aniformer", "unseen"): "later seconds of the takes of the training, by new people",
    ("clips-ordered", "seen"): "motions and driving people that the rows of the tables are trained on",
    ("clips-ordered", "unseen"): "later seconds of the takes of the training, by driving people of the training",
}
"""Protocol and kind (empty: all kinds) of other sets of `test` with something that a reader must know."""
INEXACT = {"contact": "poses are solved to a tolerance, so coordinates depend on the libraries: no checksum"}
"""Protocols without checksums, and why."""


def main() -> None:
    """Generate all sets, print those that changed, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", action="append", default=[], metavar="PROTOCOL=DIR", help="folder of a protocol")
    args = parser.parse_args()
    folders = {name: Path(folder) for name, _, folder in (entry.partition("=") for entry in args.data)}
    stored = frozen_sets() if OUTPUT.exists() else {}
    sets = []
    for name in (*WITHOUT_FOLDER, *FOLDERS):
        if name in FOLDERS and name not in folders:
            sets += [entry for (protocol, *_), entry in stored.items() if protocol == name]
        else:
            sets += freeze_protocol(name, folders.get(name), stored)
    with whole_file(OUTPUT) as temporary:
        temporary.write_text(json.dumps([dataclasses.asdict(entry) for entry in sets], indent=1) + "\n")
    print(f"{OUTPUT}: {len(sets)} sets")


def freeze_protocol(name: str, folder: Path | None, stored: dict[tuple[str, str, str], FrozenSet]) -> list[FrozenSet]:
    """Generate the sets of a protocol; say which are new or differ from the stored ones."""
    protocol, sets = find_protocol(name, folder), []
    for split in ("val", "test"):
        protocol.check(split)
        for kind in protocol.kinds:
            entry = freeze(protocol, split, kind)
            old = stored.get((name, split, kind))
            state = "new" if old is None else "same" if old.checksum == entry.checksum else "CHANGED"
            print(f"{name} {split} {kind}: {entry.role}, {entry.pairs} pairs, {state}", flush=True)
            sets.append(entry)
    return sets


def freeze(protocol: Protocol, split: str, kind: str) -> FrozenSet:
    """Generate all pairs of a set and return their checksums. Takes milliseconds a pair, about 0.3 s a clip."""
    name, count = protocol.name, protocol.count(kind, 0, split)
    checksums = () if name in INEXACT else [pair_checksum(protocol.pair(split, kind, i)) for i in range(count)]
    poses = _motion_poses(protocol, split, kind)
    angles = None if poses is None else degrees_to_training(poses)
    notes = [table.get((name, key)) for table in (DEVELOPMENT, NOTES) for key in ("", kind)] if split == "test" else []
    return FrozenSet(
        protocol=name,
        version=protocol.version,
        split=split,
        kind=kind,
        role=role(name, split, kind),
        pairs=count,
        checksum=set_checksum(checksums) if checksums else None,
        first=tuple(checksums[:FIRST]),
        degrees_to_training=angles
        if angles is None
        else (round(float(angles.min()), 1), round(float(np.median(angles)), 1)),
        note="; ".join(filter(None, [*notes, INEXACT.get(name)])),
    )


def training_poses() -> Float[np.ndarray, "N J 3 3"]:
    """Return all captured and table poses that training uses, facing +z.

    They are the frames of the training windows of the takes, their mirror images, and the 80 seen motions of
    `clips-aniformer`. Random poses of joint limits and Table 6 are not among them.
    """
    takes = [motion.rotmat for take in split_windows("train") for motion in (take, mirror(take))]
    return turned_to_front(np.concatenate([*takes, *CLIPS_ANIFORMER.train_motions(human())]))


def degrees_to_training(
    poses: Float[np.ndarray, "N J 3 3"], training: Float[np.ndarray, "M J 3 3"] | None = None
) -> Float[np.ndarray, " N"]:
    """Measure the angle from each pose to the nearest training pose: degrees, mean over the joints, any heading."""
    bank = (_all_training_poses() if training is None else turned_to_front(training)).astype(np.float32)
    nearest = []
    for pose in turned_to_front(poses).astype(np.float32):
        # The trace of A^T B is 1 + 2 cos(angle) for rotations A and B.
        trace = np.einsum("mjab,jab->mj", bank, pose)
        nearest.append(np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1))).mean(axis=1).min())
    return np.array(nearest)


@cache
def _all_training_poses() -> Float[np.ndarray, "N J 3 3"]:
    return training_poses()


def _motion_poses(protocol: Protocol, split: str, kind: str) -> Float[np.ndarray, "N J 3 3"] | None:
    """Return the driving poses of a set that is made of motions; None for other sets."""
    if isinstance(protocol, ClipsAniformer):
        count = protocol.count(kind, 0, split)
        return np.concatenate([protocol.motion(split, kind, i).rotmat for i in range(count)])
    if (protocol.name, kind) == ("human-wide", "clips") and split in ("val", "test"):
        return rotvec_to_rotmat(split_pose_bank(split).astype(np.float64))
    return None


if __name__ == "__main__":
    main()
