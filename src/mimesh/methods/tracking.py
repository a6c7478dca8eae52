"""How the parts of one surface turn from frame to frame, from points that are known in every frame.

Points of a clip stay themselves, so its motion can be measured where a network would have to guess it: for each joint,
the rotation that best fits its points (Kabsch 1976), weighted by how much the joint holds them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

ROUNDS = 5
"""Of reweighting, for a mean."""
STIFF = 1e-3
"""Weight of the parent's rotation where a joint's points say little, in squared units of the surface's size."""


@dataclass(frozen=True, eq=False)
class Parts:
    """Points of a surface at rest, and the joints that hold them."""

    points: Float[np.ndarray, "N 3"]
    shares: Float[np.ndarray, "N J"]
    """Squared skinning weights; their columns sum to 1."""
    stiffness: float
    parents: tuple[int, ...]

    @classmethod
    def of(cls, points: Float[np.ndarray, "N 3"], weights: Float[np.ndarray, "N J"], parents: tuple[int, ...]) -> Parts:
        """Parts of a surface with skinning weights; -1 is the root's parent."""
        centred = points - points.mean(axis=0)
        shares = np.square(weights)
        shares /= np.maximum(shares.sum(axis=0), 1e-9)
        return cls(points, shares, STIFF * np.square(centred).sum(axis=1).mean(), parents)

    def turned(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "J 3 3"]:
        """Rotation of every joint from rest to a frame, in the world."""
        middle, still = self.shares.T @ points, self.shares.T @ self.points
        products = (points[:, :, None] * self.points[:, None]).reshape(len(points), 9)
        moments = (self.shares.T @ products).reshape(-1, 3, 3) - middle[:, :, None] * still[:, None]
        rotation = np.empty_like(moments)
        for j, parent in enumerate(self.parents):
            held = np.zeros((3, 3)) if parent < 0 else self.stiffness * rotation[parent]
            rotation[j] = nearest_rotation(moments[j] + held)
        return rotation


def mean_rotation(rotations: Float[np.ndarray, "K J 3 3"]) -> Float[np.ndarray, "J 3 3"]:
    """Mean of K rotations of each joint that a few wild ones do not move (weights of Geman and McClure 1985)."""
    weights = np.ones(rotations.shape[:2])
    for _ in range(ROUNDS):
        mean = nearest_rotation(np.einsum("kj,kjab->jab", weights, rotations))
        off = np.square(rotations - mean).sum(axis=(2, 3))
        weights = 1 / np.square(1 + off / np.maximum(np.median(off, axis=0), 1e-6))
    return mean


def nearest_rotation(matrix: Float[np.ndarray, "*B 3 3"]) -> Float[np.ndarray, "*B 3 3"]:
    """The rotation nearest to each matrix; of a sum of rotations, their mean."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt
