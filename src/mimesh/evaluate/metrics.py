"""How far a result is from the truth. Shapes are never broadcast; every function says what it divides by."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from ..frame import bbox_centre
from ..geometry import face_vectors


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
