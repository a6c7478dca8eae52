"""Write synthetic motions in the format of DeepMimic: JSON with 44 numbers per frame."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from mimesh.motions.deepmimic import CLIPS

QUATERNIONS = (4, 8, 12, 16, 21, 25, 30, 35, 39)
"""Index in a frame of the first number of each quaternion.

Root, chest, neck; right hip, ankle and shoulder; left hip, ankle and shoulder.
"""
HINGES = (20, 29, 34, 43)
"""Index in a frame of each hinge angle: right knee and elbow, left knee and elbow."""
STANDING = 0.421546 + 0.40987 + 0.05
"""Height of the root (m) above the floor of a person who stands upright."""


def still_rows(frames: int = 3, duration: float = 1 / 30) -> np.ndarray:
    """Make frames of a person who stands with lowered arms, facing x."""
    rows = np.zeros((frames, 44))
    rows[:, 0], rows[:, 2] = duration, STANDING
    rows[:, QUATERNIONS] = 1.0
    return rows


def swaying_rows(seed: int, frames: int = 40, duration: float = 1 / 30) -> np.ndarray:
    """Make frames in which all joints rotate smoothly and the root moves forward; another motion for every seed."""
    rng, at = np.random.default_rng(seed), np.arange(frames) * duration
    rows = still_rows(frames, duration)
    rows[:, 1] = at
    for first in QUATERNIONS:
        axis = rng.normal(size=3)
        half = 0.3 * np.sin(2 * np.pi * at + rng.uniform(0, 6)) + rng.uniform(-0.2, 0.2)
        rows[:, first] = np.cos(half)
        rows[:, first + 1 : first + 4] = np.sin(half)[:, None] * axis / np.linalg.norm(axis)
    for column in HINGES:
        rows[:, column] = rng.uniform(0.2, 0.8) * (1 + np.sin(3 * at)) * (-1 if column in (20, 34) else 1)
    return rows


def write_rows(path: Path, rows) -> Path:
    """Write a file of these frames."""
    path.parent.mkdir(parents=True, exist_ok=True)
    frames = rows.tolist() if isinstance(rows, np.ndarray) else rows
    path.write_text(json.dumps({"Loop": "none", "Frames": frames}))
    return path


def write_folder(folder: Path) -> Path:
    """Write all 20 files of pybullet_data/data/motions, at 16, 30 and 60 frames per second, one below a second."""
    for k, file in enumerate(CLIPS.values()):
        rate = (30, 60, 16)[k % 3]
        seconds = 0.7 if file.endswith("_run.txt") else 1.6
        write_rows(folder / file, swaying_rows(k, round(seconds * rate), 1 / rate))
    return folder
