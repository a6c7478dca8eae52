"""Track the rotation and position of every joint of a surface, from points whose positions are known in every frame.

A clip gives the motion of each of its points, so the motion of the joints is measured and not predicted. Linear blend
skinning is linear in the affine maps of the joints: finding all of them at once is a linear least-squares problem whose
matrix is the same in every frame. It is factored once and then multiplied with the points of each frame.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.geometry import nearest_rotation

JOINT_WEIGHT, ROTATION_WEIGHT = 3e-2, 1e-5
"""Weights of the regularizer, where all points together have 1: a joint's map and its parent's map agree at the joint,
and agree in their linear part. Measured on poses of NPT's Table 6 (docs/log/mime.md, "Clips")."""
MIN_EXTENT = 1e-4
"""Share of the surface's mean squared radius that is added to the extent of each part, for parts without thickness."""
MEAN_ROUNDS = 5
"""Rounds of reweighting for a robust mean."""


@dataclass(frozen=True, eq=False)
class PartTracker:
    """Skinned points at rest, and the linear operators that give the motion of their joints.

    The affine map of a joint is 4 rows of `maps`, (K, 3) with K = 4 J: the linear part (3 x 3, transposed), the offset.
    Surfaces with as many points and joints as each other (two hands) can be tracked at once, along leading axes, and
    several frames along axes before those.
    """

    blend: Float[np.ndarray, "*B N K"]
    """Linear blend skinning: from maps to points."""
    solve: Float[np.ndarray, "*B K N"]
    """Regularized least squares: from points to maps."""
    joints: Float[np.ndarray, "*B J 3"]
    """Positions of the joints at rest."""
    mean: Float[np.ndarray, "*B J 3"]
    """Mean of each joint's points at rest, weighted by the square of their skinning weights."""
    covariance: Float[np.ndarray, "*B J 3 3"]
    """Covariance of each joint's points, weighted alike."""

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "N 3"],
        weights: Float[np.ndarray, "N J"],
        joints: Float[np.ndarray, "J 3"],
        parents: tuple[int, ...],
    ) -> PartTracker:
        """Factor the least squares for points with skinning weights; -1 is the root's parent.

        The unknowns are the 4 J rows of `maps`, three columns (x, y, z) with one matrix. There is one equation a point
        (its blended map gives its position in the frame), and four a bone (see `_regularizer`).
        """
        count, joint_count = weights.shape
        size = np.square(points - points.mean(axis=0)).sum(axis=1).mean()
        blend = (weights[:, :, None] * _homogeneous(points)[:, None]).reshape(count, 4 * joint_count)
        # Rows are scaled by the root of their weight, times that of the number of points that they stand against.
        rows = _regularizer(joints, parents, np.sqrt(JOINT_WEIGHT * count), np.sqrt(ROTATION_WEIGHT * count * size))
        # Only what neither a point nor a bone determines is left singular; the last term sets it to zero.
        normal = blend.T @ blend + rows.T @ rows
        solve = np.linalg.solve(normal + 1e-14 * np.trace(normal) * np.eye(4 * joint_count), blend.T)
        point_shares = np.square(weights) / np.maximum(np.square(weights).sum(axis=0), 1e-9)
        mean = point_shares.T @ points
        products = (points[:, :, None] * points[:, None]).reshape(count, 9)
        covariance = (point_shares.T @ products).reshape(joint_count, 3, 3) - mean[:, :, None] * mean[:, None]
        return cls(blend, solve, joints, mean, covariance + MIN_EXTENT * size * np.eye(3))

    @classmethod
    def stacked(cls, trackers: Iterable[PartTracker]) -> PartTracker:
        """Stack trackers of surfaces with as many points and joints: in every frame one call instead of several."""
        fields = [field.name for field in dataclasses.fields(cls)]
        trackers = list(trackers)
        return cls(**{name: np.stack([getattr(tracker, name) for tracker in trackers]) for name in fields})

    def follow(
        self, points: Float[np.ndarray, "*B N 3"]
    ) -> tuple[Float[np.ndarray, "*B J 3 3"], Float[np.ndarray, "*B J 3"]]:
        """Return the rotation of every joint from rest to each frame, in the world, and its position there.

        It is solved twice. The regularizer draws each joint's map towards its parent's, which makes every bend too
        small. So the maps of the first solve are made rigid, and the second solve finds only the correction that they
        lack: what is regularized then is that small correction, not the whole motion. (docs/log/mime.md)
        """
        centre = points.mean(axis=-2, keepdims=True)
        points = points - centre
        maps = self.solve @ points
        # Without stretch and shear; the mean of each joint's points is moved as before.
        rotation = self._rotations(maps)
        offset = _apply(maps, self.mean) - (rotation @ self.mean[..., None])[..., 0]
        maps = np.concatenate([rotation.swapaxes(-1, -2), offset[..., None, :]], axis=-2).reshape(maps.shape)
        maps = maps + self.solve @ (points - self.blend @ maps)
        return self._rotations(maps), _apply(maps, self.joints) + centre

    def _rotations(self, maps: Float[np.ndarray, "*B K 3"]) -> Float[np.ndarray, "*B J 3 3"]:
        """Return the rotation that moves each joint's points nearest to where its map moves them (Kabsch 1976)."""
        return nearest_rotation(_by_joint(maps)[..., :3, :].swapaxes(-1, -2) @ self.covariance)


def mean_rotation(rotations: Float[np.ndarray, "K J 3 3"]) -> Float[np.ndarray, "J 3 3"]:
    """Return the robust mean of K rotations of each joint, which a few outliers do not move.

    Iteratively reweighted least squares with the weights of Geman and McClure (1985), whose scale is the median of the
    squared distances from the mean so far.
    """
    weights, mean = np.ones(rotations.shape[:2]), rotations[0]
    for _ in range(MEAN_ROUNDS):
        mean = nearest_rotation(np.einsum("kj,kjab->jab", weights, rotations))
        squared = np.square(rotations - mean).sum(axis=(2, 3))
        weights = 1 / np.square(1 + squared / np.maximum(np.median(squared, axis=0), 1e-6))
    return mean


def _regularizer(
    joints: Float[np.ndarray, "J 3"], parents: tuple[int, ...], joint_weight: float, rotation_weight: float
) -> Float[np.ndarray, "R K"]:
    """Return rows whose product with `maps` is zero where every joint has the map of its parent; four for each bone.

    The first row is the difference of both maps at the joint, the others are the difference of their linear parts.
    """
    child, parent = np.arange(1, len(parents)), np.array(parents[1:], int)
    rows = np.zeros((len(child), 4, len(joints), 4))
    rows[child - 1, 0, child] = joint_weight * _homogeneous(joints[child])
    rows[child - 1, 0, parent] = -joint_weight * _homogeneous(joints[child])
    for k in range(3):
        rows[child - 1, 1 + k, child, k], rows[child - 1, 1 + k, parent, k] = rotation_weight, -rotation_weight
    return rows.reshape(-1, 4 * len(joints))


def _by_joint(maps: Float[np.ndarray, "*B K 3"]) -> Float[np.ndarray, "*B J 4 3"]:
    return maps.reshape(*maps.shape[:-2], -1, 4, 3)


def _apply(maps: Float[np.ndarray, "*B K 3"], points: Float[np.ndarray, "*#B J 3"]) -> Float[np.ndarray, "*B J 3"]:
    return (_homogeneous(points)[..., None, :] @ _by_joint(maps))[..., 0, :]


def _homogeneous(points: Float[np.ndarray, "*B N 3"]) -> Float[np.ndarray, "*B N 4"]:
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
