"""Notice a first frame that does not belong to the motion, as the T-pose before many captured ones."""

from __future__ import annotations

import numpy as np

from ..core.mesh import Clip

LONE_FRAMES = 12
"""First frames of a clip that are compared to tell whether frame 0 belongs to the motion."""
LONE_VERTICES = 200
"""Vertices, evenly spread over their indices, by which they are compared."""
LONE_STEP = 0.05
"""Mean distance of a vertex from frame 0 to frame 1, over the size, from which on frame 0 may be a pose of its own. In
two captures of CMU, which begin with a T-pose, it was 0.17 and 0.25, and at most 0.003 between the frames after it."""
LONE_RATIO = 10.0
"""That distance over the largest one between two later frames; in 17 animations of a game character at most 3."""


def first_frame_note(clip: Clip, start: int, name: str) -> tuple[str, ...]:
    """Return a note on a first frame far from all others, as the T-pose before many captured motions.

    Args:
        clip: the whole clip.
        start: first frame that is taken.
        name: that of its file.
    """
    if start > 0 or len(clip) < LONE_FRAMES:
        return ()
    every = max(1, len(clip.mesh.vertices) // LONE_VERTICES)
    frames = np.asarray(clip.vertices[:LONE_FRAMES, ::every], np.float64)
    steps = np.linalg.norm(np.diff(frames - frames.mean(axis=1, keepdims=True), axis=0), axis=-1).mean(axis=1)
    size = np.ptp(frames[0], axis=0).max()
    if steps[0] < LONE_STEP * size or steps[0] < LONE_RATIO * steps[1:].max():
        return ()
    return (f"{name}: frame 0 differs from the others (a calibration pose?): --start 1 leaves it out",)
