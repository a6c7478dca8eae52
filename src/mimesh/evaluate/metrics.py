"""How far a result is from the truth. Shapes are never broadcast; every function says what it divides by."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from ..core.geometry import face_vectors
from ..core.normalization import bbox_centre


def pmd(
    result: Float[np.ndarray, "*B V 3"], truth: Float[np.ndarray, "*C W 3"]
) -> Float[np.ndarray, "*B"] | np.float64:
    """Point-wise mesh Euclidean distance: mean over vertices of the squared distance (NPT Eq. 7, AniFormer Eq. 7).

    Divides by V, not by 3 V as the public evaluators do. In the square of the inputs' unit; papers print it x1e4.

    Raises:
        ValueError: shapes differ; vertex counts are never broadcast.
    """
    if result.shape != truth.shape:
        raise ValueError(
            f"result and truth must have one shape, got {result.shape} and {truth.shape}; resample one of them first"
        )
    return np.square(result - truth).sum(-1).mean(-1)


def in_unit_sphere_of(
    truth: Float[np.ndarray, "V 3"], *meshes: Float[np.ndarray, "V 3"]
) -> tuple[Float[np.ndarray, "V 3"], ...]:
    """Each mesh centred on its own vertex centroid and divided by the truth's radius: the scale the papers print in."""
    radius = np.linalg.norm(truth - truth.mean(axis=0), axis=1).max()
    return tuple((m - m.mean(axis=0)) / radius for m in meshes)


def resized(mesh: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "W 3"]) -> Float[np.ndarray, "V 3"]:
    """The mesh centred and given the truth's radius, as if both had been put into the unit sphere."""
    return in_unit_sphere_of(mesh, mesh)[0] * np.linalg.norm(truth - truth.mean(axis=0), axis=1).max()


def pmd_of_pair(result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"]) -> float:
    """PMD of two meshes in metres, both put into the truth's unit sphere first."""
    return float(pmd(*in_unit_sphere_of(truth, result, truth)))


def pmd_public(result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"]) -> float:
    """What the papers' public evaluators print: mean over V and xyz, each mesh centred on its own bounding box.

    That is (Eq. 7 + d^2) / 3, with d the difference of the two meshes' offsets between vertex centroid and middle of
    the box. So it is never less than a third of Eq. 7; in docs/results it is 0.35 to 0.60 of it in 246 of 255 rows.
    In the truth's unit sphere (those evaluators leave the metres in).
    """
    result, truth = in_unit_sphere_of(truth, result, truth)
    return float(np.square((result - bbox_centre(result)) - (truth - bbox_centre(truth))).mean())


def mean_error_mm(result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"], height: float) -> float:
    """Mean distance in millimetres, scaled to a 1.7 m person; `height` is this person's at rest, in the meshes' unit.

    Both meshes are centred on their vertex centroids first.
    """
    difference = (result - result.mean(axis=0)) - (truth - truth.mean(axis=0))
    return float(np.linalg.norm(difference, axis=-1).mean() * 1.7 / height * 1e3)


def edge_score(
    result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"], edges: Int[np.ndarray, "E 2"]
) -> float:
    """Mean over edges of |length / true length - 1|: how rough or stretched the surface is. 0 is perfect.

    Edges without a true length are left out; a point cloud scores 0.
    """
    new, old = (np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1) for points in (result, truth))
    real = old > 0
    return float(np.abs(new[real] / old[real] - 1.0).mean()) if real.any() else 0.0


def largest_stretch(
    result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"], edges: Int[np.ndarray, "E 2"]
) -> float:
    """How many times too long the worst edge is, among edges of at least a tenth of the mean length; 1 is perfect."""
    new, old = (np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1) for points in (result, truth))
    real = old >= 0.1 * old.mean() if len(old) else np.zeros(0, bool)
    return float((new[real] / old[real]).max(initial=1.0))


def flipped(result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> float:
    """Share of triangles that face away from where the truth's do (more than 90 degrees)."""
    if len(faces) == 0:
        return 0.0
    return float(((face_vectors(result, faces) * face_vectors(truth, faces)).sum(axis=1) < 0).mean())


def chamfer(result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "W 3"]) -> float:
    """Mean squared distance to the nearest vertex of the other set, both ways added; any vertex counts.

    In the square of the inputs' unit. Vertices, not surfaces: two meshings of one surface do not score 0.
    """
    from scipy.spatial import KDTree

    there, back = KDTree(truth).query(result)[0], KDTree(result).query(truth)[0]
    return float(np.square(there).mean() + np.square(back).mean())


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
