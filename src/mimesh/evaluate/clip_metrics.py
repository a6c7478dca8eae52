"""How far a result in motion is from the truth: shape, path, and what the eye sees between frames.

Lengths are in metres and are given for a 1.7 m person; `height` is the identity person's at rest.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from .metrics import pmd_of_pair

FLOOR = 0.03
"""What is nearer to the floor than this (metres of a 1.7 m person) may stand on it."""
STILL = 0.1
"""What moves more slowly than this (metres a second of a 1.7 m person) stands."""


def clip_pmd(result: Float[np.ndarray, "T V 3"], truth: Float[np.ndarray, "S W 3"]) -> float:
    """AniFormer Eq. 7: mean over frames of the PMD, each frame centred and in the unit sphere of the truth's frame.

    Divides by T and by V. Where the whole stands does not count here; see `path_error_mm`.

    Raises:
        ValueError: shapes differ; neither frames nor vertices are broadcast.
    """
    _same_shape(result, truth)
    return float(np.mean([pmd_of_pair(*frames) for frames in zip(result, truth, strict=True)]))


def path_error_mm(result: Float[np.ndarray, "T V 3"], truth: Float[np.ndarray, "S W 3"], height: float) -> float:
    """Mean distance (mm) between the two paths of the vertex centroid, both from their place in frame 0.

    A mesh has no root joint, so its centroid stands for it. Frame 0 counts, with 0.
    """
    _same_shape(result, truth)
    ours, theirs = (clip.mean(axis=1) - clip[0].mean(axis=0) for clip in (result, truth))
    return float(np.linalg.norm(ours - theirs, axis=1).mean() * 1.7 / height * 1e3)


def jitter(
    result: Float[np.ndarray, "T V 3"], truth: Float[np.ndarray, "S W 3"], height: float, fps: float
) -> float | None:
    """Mean length (m/s²) of the difference of the vertices' accelerations, by second differences.

    Blind to what is wrong in all frames alike. None for fewer than three frames.
    """
    _same_shape(result, truth)
    if len(truth) < 3:
        return None
    return float(np.linalg.norm(np.diff(result - truth, 2, axis=0), axis=-1).mean() * fps**2 * 1.7 / height)


def liveliness(result: Float[np.ndarray, "T V 3"], truth: Float[np.ndarray, "S W 3"]) -> float | None:
    """Mean length of the result's accelerations over that of the truth's: above 1, more is going on than should.

    None for fewer than three frames, and where the truth moves evenly.
    """
    _same_shape(result, truth)
    ours, theirs = (np.linalg.norm(np.diff(clip, 2, axis=0), axis=-1) for clip in (result, truth))
    return float(ours.mean() / theirs.mean()) if theirs.any() else None


def unrest_mm(result: Float[np.ndarray, "T V 3"], height: float) -> float:
    """Farthest that any vertex goes from one frame to the next (mm): 0 is right where the driving clip stands still."""
    return float(np.linalg.norm(np.diff(result, axis=0), axis=-1).max(initial=0.0) * 1.7 / height * 1e3)


def foot_skate(
    result: Float[np.ndarray, "T V 3"], truth: Float[np.ndarray, "S W 3"], height: float, fps: float
) -> float | None:
    """Mean speed along the ground (cm/s) of vertices that the truth keeps still on the floor, from frame to frame.

    The floor is where the truth's lowest vertex of the clip is; hands and knees may stand on it too. None where
    nothing ever stands.
    """
    _same_shape(result, truth)
    size = 1.7 / height
    above = (truth[..., 1] - truth[..., 1].min()) * size
    speed = np.linalg.norm(np.diff(truth, axis=0), axis=-1) * fps * size
    stands = (above[1:] < FLOOR) & (above[:-1] < FLOOR) & (speed < STILL)
    if not stands.any():
        return None
    slip = np.linalg.norm(np.diff(result, axis=0)[..., [0, 2]], axis=-1)
    return float(slip[stands].mean() * fps * size * 100)


def _same_shape(result: np.ndarray, truth: np.ndarray) -> None:
    if result.shape != truth.shape:
        raise ValueError(f"result and truth must have one shape, got {result.shape} and {truth.shape}")
