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

from ..core.mesh import Clip, Mesh
from .characters import PosedCharacter
from .pairs import Pair

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


@dataclass(frozen=True)
class FrozenSet:
    """The pairs of one kind of a protocol's split."""

    protocol: str
    version: int
    split: str
    kind: str
    role: str
    """`test`: measured when weights are shipped, and not chosen by. `development`: was looked at, may be chosen by."""
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
    looked_at = {(protocol, ""), (protocol, kind)} & DEVELOPMENT.keys()
    return "test" if split == "test" and not looked_at else "development"


@cache
def frozen_sets() -> dict[tuple[str, str, str], FrozenSet]:
    """Read the stored sets, by protocol, split and kind."""
    entries = json.loads((resources.files("mimesh.evaluate") / FILE).read_text())
    lists = [{key: tuple(value) for key, value in entry.items() if isinstance(value, list)} for entry in entries]
    sets = (FrozenSet(**entry | tuples) for entry, tuples in zip(entries, lists, strict=True))
    return {(stored.protocol, stored.split, stored.kind): stored for stored in sets}


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
