"""How far a result is from the truth. Shapes are never broadcast; every function says what it divides by."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


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


def mean_error_mm(result: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "V 3"], height: float) -> float:
    """Mean distance in millimetres, scaled to a 1.7 m person; `height` is this person's at rest, in the meshes' unit.

    Both meshes are centred on their vertex centroids first.
    """
    difference = (result - result.mean(axis=0)) - (truth - truth.mean(axis=0))
    return float(np.linalg.norm(difference, axis=-1).mean() * 1.7 / height * 1e3)
