"""What every set of pairs may be used for, and checksums that show whether a set is still the same.

`frozen_sets.json` is written by `scripts/freeze_sets.py`. Coordinates are rounded to 0.01 mm before they are hashed, so
the last digits of other machines and libraries do not matter.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from jaxtyping import Float

from ..bodies.sampling import rotvec_to_rotmat
from ..core.mesh import Clip, Mesh
from ..motions import mirror
from ..motions.clips import split_windows
from ..motions.motion import turned_to_front
from .characters import PosedCharacter
from .clip_protocols import CLIPS_ANIFORMER, ClipsAniformer
from .pairs import Pair, human
from .protocols import Protocol, split_pose_bank

FILE = "frozen_sets.json"
ROUNDING = 1e-5
"""Coordinates are hashed as integers of this unit (metres)."""
FIRST = 3
"""Number of pairs whose own checksums are stored, to check a large set in little time."""
DEVELOPMENT = {
    (
        "cross-body",
        "",
    ): "the people of the folder, of whom four are in the pairs, were measured between trainings, and led to changes",
    ("noise", "holes"): "measured between trainings, and led to changes",
    ("noise", "cropped"): "measured between trainings, and led to changes",
    ("noise", "half"): "measured between trainings, and led to changes",
}
"""Protocol and kind (empty: all kinds) of sets of `test` that were looked at during development, and how."""
NOTES = {
    ("human-wide", "clips"): "later seconds of takes whose earlier seconds are training data, not whole takes",
    **{
        ("dressed", kind): "the garments are those of the training; people and poses are new"
        for kind in ("identity", "driving", "both")
    },
    ("clips-aniformer", "seen"): "motions that the rows of the tables are trained on, by new people",
    ("clips-aniformer", "held-out"): "10 seconds of one boxing capture, 20 clips by an animator",
    ("clips-aniformer", "stress"): "13 clips of DeepMimic, which were looked at during development",
    ("clips-ordered", "seen"): "motions and driving people that the rows of the tables are trained on",
    ("clips-ordered", "unseen"): "later seconds of the takes of the training, by driving people of the training",
    ("clips-ordered", "held-out"): "the motions of clips-aniformer, by driving people of the training",
    ("animals", "clips"): "five animals of one maker; their rigs were looked at when rigs were first read",
}
"""Protocol and kind (empty: all kinds) of other sets of `test` with something that a reader must know."""
INEXACT = {"contact": "poses are solved to a tolerance, so coordinates depend on the libraries: no checksum"}
"""Protocols without checksums, and why."""


@dataclass(frozen=True)
class FrozenSet:
    """The pairs of one kind of a protocol's split."""

    protocol: str
    version: int
    split: str
    kind: str
    role: str
    """`test`: measured when weights are shipped, and not chosen by. `development`: was looked at, may be chosen by.
    `stress`: beyond what methods are made for; looked at, and never averaged with others."""
    pairs: int
    checksum: str | None = None
    """SHA-256 over the checksums of all pairs; None without checksums."""
    first: tuple[str, ...] = ()
    """Checksums of the first pairs."""
    degrees_to_training: tuple[float, float] | None = None
    """Smallest and median angle from a frame to the nearest training frame, for sets made of motions."""
    note: str = ""

    def compare(self, checksums: Sequence[str]) -> str:
        """Compare pairs, from the first one on, with this set by their checksums.

        Returns `same`; `part` for fewer pairs of which the stored first ones agree; `other`; or `unknown` for a set
        without checksums.
        """
        if self.checksum is None:
            return "unknown"
        if len(checksums) == self.pairs:
            return "same" if set_checksum(checksums) == self.checksum else "other"
        known = min(len(checksums), len(self.first))
        agree = 0 < len(checksums) < self.pairs and tuple(checksums[:known]) == self.first[:known]
        return "part" if agree else "other"


def pair_checksum(pair: Pair) -> str:
    """Return the first 8 hex digits of a SHA-256 over all arrays of a pair: what methods get, and the truth.

    `ClipPair.place` is left out: it follows from the order of the vertices.
    """
    digest = hashlib.sha256()
    for field in dataclasses.fields(pair):
        if field.name == "place":
            continue
        for name, array in _arrays(field.name, getattr(pair, field.name)):
            whole = np.rint(array / ROUNDING) if array.dtype.kind == "f" else array
            digest.update(f"{name} {array.shape}".encode())
            digest.update(np.ascontiguousarray(whole, "<i8").tobytes())
    return digest.hexdigest()[:8]


def set_checksum(checksums: Iterable[str]) -> str:
    """Return the SHA-256 (hex) of a set of pairs, from the pairs' checksums in order."""
    return hashlib.sha256(" ".join(checksums).encode()).hexdigest()


def role(protocol: str, split: str, kind: str) -> str:
    """Return what a set may be used for; see `FrozenSet.role`."""
    if kind.startswith("stress"):
        return "stress"
    looked_at = {(protocol, ""), (protocol, kind)} & DEVELOPMENT.keys()
    return "test" if split == "test" and not looked_at else "development"


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


def kinds_of(protocol: Protocol, split: str) -> tuple[str, ...]:
    """Return the kinds of pairs of a split, and those that only checkpoints are chosen by."""
    return tuple(dict.fromkeys((*protocol.kinds, *(protocol.validation_kinds if split == "val" else ()))))


@cache
def frozen_sets() -> dict[tuple[str, str, str], FrozenSet]:
    """Read the stored sets, by protocol, split and kind."""
    entries = json.loads((resources.files("mimesh.evaluate") / FILE).read_text())
    return {(entry["protocol"], entry["split"], entry["kind"]): _from_json(entry) for entry in entries}


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


def _arrays(name: str, value: Any) -> list[tuple[str, np.ndarray]]:
    """List the arrays of a field of a pair with names; fields without arrays have none."""
    if isinstance(value, PosedCharacter):
        # Not in the mesh, but what limbs are measured by.
        limbs = [(f"{name}.{key}", np.stack([limb.start, limb.end])) for key, limb in value.limbs.items()]
        joints = (f"{name}.joints", np.array([limb.joint for limb in value.limbs.values()]))
        return [*limbs, joints, (f"{name}.joint_of", value.rig.joint_of), (f"{name}.weights", value.rig.weights)]
    if isinstance(value, Mesh):
        return [(f"{name}.vertices", value.vertices), (f"{name}.faces", value.faces)]
    if isinstance(value, Clip):
        return [(f"{name}.vertices", np.asarray(value.vertices))]
    return [(name, value)] if isinstance(value, np.ndarray) else []


def _from_json(entry: dict[str, Any]) -> FrozenSet:
    angles = entry.get("degrees_to_training")
    return FrozenSet(**{**entry, "first": tuple(entry["first"]), "degrees_to_training": angles and tuple(angles)})
