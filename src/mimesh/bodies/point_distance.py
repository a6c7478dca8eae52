"""Point clouds that a body is fitted to: nearest points, and the Chamfer distance that forgives sliding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

if TYPE_CHECKING:
    from scipy.spatial import KDTree


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points to fit to, and the planes that they lie in."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    """Of the surface, either side; zero where distances count alike in all directions."""
    slide: float
    """Weight of the squared distance as such; its part along the normal has the rest of 1."""
    tree: KDTree

    def matches(self, others: Float[np.ndarray, "V 3"]) -> tuple[Int[np.ndarray, " V"], Int[np.ndarray, " N"]]:
        """The nearest point of each of the others, and the nearest other of each point."""
        from scipy.spatial import KDTree

        return np.asarray(self.tree.query(others)[1]), np.asarray(KDTree(others).query(self.points)[1])


def cloud_of(points: Float[np.ndarray, "N 3"], slide: float = 1.0, neighbours: int = 16) -> Cloud:
    """A cloud; where `slide` is below 1, with the normals of planes through each point's nearest neighbours."""
    from scipy.spatial import KDTree

    tree, normals = KDTree(points), np.zeros_like(points)
    if slide < 1:
        near = points[tree.query(points, k=min(neighbours, len(points)))[1].reshape(len(points), -1)]
        near = near - near.mean(axis=1, keepdims=True)
        normals = np.linalg.eigh(near.transpose(0, 2, 1) @ near)[1][:, :, 0]
    return Cloud(points, normals, slide, tree)


def chamfer(
    cloud: Cloud, others: Float[np.ndarray, "V 3"], matches: tuple[Int[np.ndarray, " V"], Int[np.ndarray, " N"]]
) -> tuple[float, Float[np.ndarray, "V 3"]]:
    """Mean squared distance of the others to their matches and of the cloud to its, and the gradient by the others."""
    near, back = matches
    error, gradient = 0.0, np.zeros_like(others)
    for mine, theirs in ((near, slice(None)), (slice(None), back)):
        normals, away = cloud.normals[mine], others[theirs] - cloud.points[mine]
        pull = cloud.slide * away + (1 - cloud.slide) * (away * normals).sum(-1, keepdims=True) * normals
        error += float((away * pull).sum()) / len(away)
        if isinstance(theirs, slice):
            gradient += 2 / len(away) * pull
        else:
            gradient += 2 / len(away) * np.stack([np.bincount(theirs, p, len(others)) for p in pull.T], axis=1)
    return error, gradient
