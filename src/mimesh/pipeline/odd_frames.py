"""Notice frames that do not belong to the motion: the T-pose before many captured ones, and single frames far away."""

from __future__ import annotations

import numpy as np

from ..core.errors import option
from ..core.frame_buffer import vertices_of_all
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

FAR_VERTICES = 24
"""Vertices, evenly spread over their indices, in which frames of a clip are compared: few, as these may be on disk."""
FAR_STEP = 0.5
"""Mean distance of a vertex from the middle of the frames before and after, over the size, from which on a frame is a
fault. In 324 animations of games and captures it is at most 0.07 in frames that are twice as far from that middle as
those two from each other, 0.36 where every fourth frame is taken, and 0.54 where every eighth is (docs/log/rigs.md,
2026-11-26)."""
FAR_SHARE = 0.05
"""Largest share of the frames that are taken for faults; more are a fast motion, of which few frames were taken."""


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
    return (f"{name}: frame 0 differs from the others (a calibration pose?): {option('start', '1')} leaves it out",)


def far_frames_note(clip: Clip, name: str) -> tuple[str, ...]:
    """Return a note on single frames far from those before and after them, as faults of a tracker or a simulation.

    Args:
        clip: the frames that are taken.
        name: that of the clip.
    """
    if len(clip) * FAR_SHARE < 1:
        return ()
    every = max(1, len(clip.mesh.vertices) // FAR_VERTICES)
    frames = vertices_of_all(clip.vertices, np.arange(0, len(clip.mesh.vertices), every)).astype(np.float64)
    size = np.median(np.ptp(frames, axis=1).max(axis=-1))
    before, after = frames[:-2], frames[2:]
    away = np.linalg.norm(frames[1:-1] - (before + after) / 2, axis=-1).mean(axis=-1)
    apart = np.linalg.norm(after - before, axis=-1).mean(axis=-1)
    far = 1 + np.flatnonzero((away > FAR_STEP * size) & (away > 2 * apart))
    if not 0 < len(far) <= FAR_SHARE * len(clip):
        return ()
    listed = ", ".join(map(str, far[:3])) + (", ..." if len(far) > 3 else "")
    which = f"frame {listed} is" if len(far) == 1 else f"frames {listed} are"
    return (f"{name}: {which} far from the frames before and after, counted from 0 in those taken; a fault, perhaps",)
