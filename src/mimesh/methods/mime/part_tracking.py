"""How the parts of one surface turn from frame to frame, from points that are known in every frame.

Points of a clip stay themselves, so its motion can be measured where a network would have to guess it. Skinning is
linear in what each joint does: the least squares of all joints together, with weak ties along the skeleton, is one
matrix that is made once and multiplied by the points of each frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.geometry import nearest_rotation

MEETING, BENDING = 3e-2, 1e-5
"""Weights of the ties: joint and parent agree where the joint is; joint and parent turn alike."""
FLAT = 1e-4
"""Of the surface's size (squared): added to the extent of each part, for parts that are flat or thin."""
ROUNDS = 5
"""Of reweighting, for a mean."""


@dataclass(frozen=True, eq=False)
class PartTracker:
    """Points of a surface at rest as its joints hold them."""

    blend: Float[np.ndarray, "N K"]
    """Maps what each joint does, (3 x 4) transposed, K = 4 J rows, to points: linear blend skinning."""
    solve: Float[np.ndarray, "K N"]
    """Maps points to what each joint does."""
    joints: Float[np.ndarray, "J 3"]
    middle: Float[np.ndarray, "J 3"]
    extent: Float[np.ndarray, "J 3 3"]
    """Mean and second moments of what a joint holds."""

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "N 3"],
        weights: Float[np.ndarray, "N J"],
        joints: Float[np.ndarray, "J 3"],
        parents: tuple[int, ...],
    ) -> PartTracker:
        """Parts of a surface with skinning weights and joints; -1 is the root's parent."""
        count, held = weights.shape
        size = np.square(points - points.mean(axis=0)).sum(axis=1).mean()
        blend = (weights[:, :, None] * _homogeneous(points)[:, None]).reshape(count, 4 * held)
        ties = _ties(joints, parents, np.sqrt(MEETING * count), np.sqrt(BENDING * count * size))
        # The ties leave nothing open but what no point tells; a last bit keeps that at rest.
        normal = blend.T @ blend + ties.T @ ties
        solve = np.linalg.solve(normal + 1e-14 * np.trace(normal) * np.eye(4 * held), blend.T)
        shares = np.square(weights) / np.maximum(np.square(weights).sum(axis=0), 1e-9)
        middle = shares.T @ points
        products = (points[:, :, None] * points[:, None]).reshape(count, 9)
        extent = (shares.T @ products).reshape(held, 3, 3) - middle[:, :, None] * middle[:, None]
        return cls(blend, solve, joints, middle, extent + FLAT * size * np.eye(3))

    def follow(self, points: Float[np.ndarray, "N 3"]) -> tuple[Float[np.ndarray, "J 3 3"], Float[np.ndarray, "J 3"]]:
        """Rotation of every joint from rest to a frame, in the world, and where it is in that frame."""
        centre = points.mean(axis=0)
        points = points - centre
        done = self.solve @ points
        # Once more from there: what the ties then hold back is only what is left to do.
        done = self._rigid(done)
        done = done + self.solve @ (points - self.blend @ done)
        return self._rotations(done), _applied(done, self.joints) + centre

    def _rotations(self, done: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "J 3 3"]:
        """The rotation nearest to what each joint does to its part."""
        return nearest_rotation(done.reshape(-1, 4, 3)[:, :3].swapaxes(-1, -2) @ self.extent)

    def _rigid(self, done: Float[np.ndarray, "K 3"]) -> Float[np.ndarray, "K 3"]:
        """The same without stretch and shear; the middle of each part goes where it went."""
        rotation = self._rotations(done)
        offset = _applied(done, self.middle) - (rotation @ self.middle[..., None])[..., 0]
        return np.concatenate([rotation.swapaxes(-1, -2), offset[:, None]], axis=1).reshape(-1, 3)


def _applied(done: Float[np.ndarray, "K 3"], places: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "J 3"]:
    """Where what each joint does takes its own place."""
    return (_homogeneous(places)[:, None] @ done.reshape(-1, 4, 3))[:, 0]


def _homogeneous(points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 4"]:
    return np.concatenate([points, np.ones((len(points), 1))], axis=1)


def _ties(
    joints: Float[np.ndarray, "J 3"], parents: tuple[int, ...], meeting: float, bending: float
) -> Float[np.ndarray, "R K"]:
    """Rows that are zero where every joint does what its parent does."""
    child, parent = np.arange(1, len(parents)), np.array(parents[1:], int)
    rows = np.zeros((len(child), 4, len(joints), 4))
    rows[child - 1, 0, child] = meeting * _homogeneous(joints[child])
    rows[child - 1, 0, parent] = -meeting * _homogeneous(joints[child])
    for k in range(3):
        rows[child - 1, 1 + k, child, k], rows[child - 1, 1 + k, parent, k] = bending, -bending
    return rows.reshape(-1, 4 * len(joints))


def mean_rotation(rotations: Float[np.ndarray, "K J 3 3"]) -> Float[np.ndarray, "J 3 3"]:
    """Mean of K rotations of each joint that a few wild ones do not move (weights of Geman and McClure 1985)."""
    weights = np.ones(rotations.shape[:2])
    for _ in range(ROUNDS):
        mean = nearest_rotation(np.einsum("kj,kjab->jab", weights, rotations))
        off = np.square(rotations - mean).sum(axis=(2, 3))
        weights = 1 / np.square(1 + off / np.maximum(np.median(off, axis=0), 1e-6))
    return mean
