"""The shipped motions: two takes of the CMU motion capture database on the skeleton of the shipped body.

Also defines named segments of the takes, and which parts of them are training, validation and test data. Built by
`research/recipes/build_motions.py`.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32

from ..bodies.sampling import rotvec_to_rotmat
from ..core.errors import InputError
from .motion import Motion, mirror, rotmat_to_rotvec, turned_to_front, window

TAKES = ("cmu_01_01", "cmu_01_03")
"""Subject 01 of the database, trials 01 and 03."""
SEGMENTS = {
    "jump": ("cmu_01_01", 1.0, 3.0),
    "turn": ("cmu_01_01", 8.2, 10.2),
    "jump-away": ("cmu_01_01", 12.0, 14.0),
    "walk-climb": ("cmu_01_03", 1.0, 4.0),
    "climb-over": ("cmu_01_03", 9.5, 12.5),
    "swing": ("cmu_01_03", 13.5, 18.0),
    "walk": ("cmu_01_03", 18.4, 20.6),
}
"""Named segments: take, start and stop in seconds."""
DEMO = "jump"
"""The motion of the demo."""
SPLITS = {
    "train": (("cmu_01_01", 0.5, 17.0), ("cmu_01_03", 0.5, 27.5)),
    "val": (("cmu_01_01", 17.0, 20.0), ("cmu_01_03", 27.5, 32.0)),
    "test": (("cmu_01_01", 20.0, 22.5), ("cmu_01_03", 32.0, 37.5)),
}
"""Windows of the takes for each split, disjoint in time: take, start, stop (s). The T-pose at the start is left out."""
QUANTUM = np.pi / 32767
"""Quantisation step of the stored rotation vectors (radians): 16-bit integers cover -pi to pi."""


def motion_names() -> tuple[str, ...]:
    """List the names of all shipped motions: whole takes, then segments."""
    return (*TAKES, *SEGMENTS)


def load_motion(name: str) -> Motion:
    """Load a shipped motion, at 30 frames per second.

    Raises:
        InputError: no such motion.
    """
    if name in SEGMENTS:
        take, start, stop = SEGMENTS[name]
        return window(_take(take), start, stop, name)
    if name not in TAKES:
        raise InputError(
            f"{name}: expected a shipped motion ({', '.join(motion_names())}), found another; check the name"
        )
    return _take(name)


def split_windows(split: Literal["train", "val", "test"]) -> list[Motion]:
    """Load the motions of a split, in order."""
    return [window(_take(take), start, stop, f"{take}@{start:g}") for take, start, stop in SPLITS[split]]


def pose_bank(split: Literal["train", "val", "test"]) -> Float32[np.ndarray, "N J 3"]:
    """Load the poses of a split as rotation vectors: every third frame and its mirror image, rotated to face +z.

    The heading is the horizontal direction of the hips' front; tilts are kept.
    """
    motions = [m for clip in split_windows(split) for m in (clip, mirror(clip))]
    rotmat = np.concatenate([m.rotmat[::3] for m in motions])
    return rotmat_to_rotvec(turned_to_front(rotmat)).astype(np.float32)


@cache
def _take(name: str) -> Motion:
    with np.load(str(resources.files("mimesh.motions") / "cmu.npz")) as data:
        rotvec = data[f"{name}_rotvec"].astype(np.float64) * QUANTUM
        root: Float[np.ndarray, "T 3"] = data[f"{name}_root"].astype(np.float64)
        return Motion(name, tuple(data["joint_names"].tolist()), rotvec_to_rotmat(rotvec), root, 30.0)
