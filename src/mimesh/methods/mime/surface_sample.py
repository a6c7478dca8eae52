"""Points of a surface that a body is fitted to, and how far a posed body is from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ...bodies.sampled_body import PosedBody

if TYPE_CHECKING:
    from scipy.spatial import KDTree

NEAR, FAR = 0.03, 0.1
"""Up to NEAR (metres of the body) a distance counts along the normal, because samples of one surface lie some way
apart; beyond it as it is, FAR at most."""


@dataclass(frozen=True, eq=False)
class SurfaceSample:
    """Points of a surface, spread evenly and in random order, so that the first few represent all of it."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    """Unit normals, or zeros where they are unknown."""

    @cached_property
    def tree(self) -> KDTree:
        """Finds the nearest of the points."""
        from scipy.spatial import KDTree

        return KDTree(self.points)

    def outward(self, posed: PosedBody) -> SurfaceSample:
        """Flip all normals if most of them point against those of the nearest points of a posed body."""
        from scipy.spatial import KDTree

        nearest = KDTree(posed.points).query(self.points)[1]
        inward = np.median((posed.normals[nearest] * self.normals).sum(axis=1)) < 0
        return replace(self, normals=-self.normals) if inward else self

    def first(self, count: int) -> SurfaceSample:
        """Reduce to the first `count` points."""
        return SurfaceSample(self.points[:count], self.normals[:count])

    def distance_of(self, points: Float[np.ndarray, "M 3"], size: float) -> Float[np.ndarray, " M"]:
        """Measure how far points are from the surface, in metres of a body of that size."""
        nearest = np.asarray(self.tree.query(points)[1])
        return _distance(points - self.points[nearest], self.normals[nearest], size)

    def nearest_of(
        self, points: Float[np.ndarray, "M 3"], size: float
    ) -> tuple[Int[np.ndarray, " N"], Float[np.ndarray, " N"]]:
        """Find the nearest of some points to each of the surface, and the distance in metres of a body of that size."""
        from scipy.spatial import KDTree

        nearest = np.asarray(KDTree(points).query(self.points)[1])
        return nearest, _distance(self.points - points[nearest], self.normals, size)

    def distance_to_each(self, sets: Float[np.ndarray, "C M 3"], size: float) -> Float[np.ndarray, "C N"]:
        """Measure these distances for several small sets of points, ten times as fast as with a tree each."""
        rows = np.empty((len(sets), len(self.points)))
        for points, row in zip(sets, rows, strict=True):
            # |a - b|^2 without |a|^2, which does not change which is the nearest.
            nearest = (np.square(points).sum(axis=1) - 2 * self.points @ points.T).argmin(axis=1)
            row[:] = _distance(self.points - points[nearest], self.normals, size)
        return rows


def _distance(
    difference: Float[np.ndarray, "M 3"], normals: Float[np.ndarray, "M 3"], size: float
) -> Float[np.ndarray, " M"]:
    """Measure distances as NEAR and FAR say; unknown normals (zeros) count as they are."""
    distance = np.linalg.norm(difference, axis=1) / size
    along = np.where(normals.any(axis=1), np.abs((difference * normals).sum(axis=1)) / size, distance)
    return np.where(distance < NEAR, along, np.minimum(distance, FAR))
