"""Canonical vertex order and count, for models that pair driving point i with identity vertex i.

Both meshes are welded and their vertices ranked by position; then the driving ranks are shuffled by a seed. So
permuting the vertices of the identity permutes the result, and permuting those of the driving mesh changes nothing,
both exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .geometry import weld

TOLERANCE = 1e-6
"""Positions are rounded to multiples of this (normalised length) before they are compared.

Differences in the last bits must not change the order.
"""


def rank_order(points: Float[np.ndarray, "N 3"]) -> Int[np.ndarray, " N"]:
    """Sort points by rounded x, then y, then z; points with equal rounded positions by their exact ones."""
    rounded = np.round(points / TOLERANCE)
    return np.lexsort((*points.T[::-1], *rounded.T[::-1]))


@dataclass(frozen=True, eq=False)
class CanonicalOrder:
    """Sorted distinct positions of a mesh, and the maps between these ranks and its vertices."""

    group: Int[np.ndarray, " V"]
    """Rank of the position of each vertex. Vertices along a seam share a rank, so the seam stays closed."""
    order: Int[np.ndarray, " V"]
    """Vertices sorted by rank."""
    start: Int[np.ndarray, " W"]
    """Index in `order` of the first vertex of each rank."""

    def __len__(self) -> int:
        return len(self.start)

    def merge(self, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "W 3"]:
        """Merge the vertices of each rank to one point, in the ranked or any other frame.

        Where the vertices of a rank differ in this frame, the point is the centre of their bounding box: unlike a mean
        it does not depend on their order, and it is exact where they agree.
        """
        sorted_vertices = vertices[self.order]
        low = np.minimum.reduceat(sorted_vertices, self.start, axis=0)
        high = np.maximum.reduceat(sorted_vertices, self.start, axis=0)
        return (low + high) / 2


def canonical_order(vertices: Float[np.ndarray, "V 3"]) -> CanonicalOrder:
    """Weld vertices at exactly equal positions and rank the welded ones (`rank_order`)."""
    merged, index = weld(vertices)
    rank = np.empty(len(merged), np.int64)
    # The order of `rank_order`, in half its time: welded positions are sorted already, and lexsort is stable.
    ranked = np.lexsort(np.round(merged.T[::-1] / TOLERANCE))
    # Invert the permutation: from the sorted position to its rank.
    rank[ranked] = np.arange(len(merged))
    group = rank[index]
    count = np.bincount(group, minlength=len(merged))
    return CanonicalOrder(group, np.argsort(group, kind="stable"), np.cumsum(count) - count)


def file_order(count: int) -> CanonicalOrder:
    """Rank so many vertices as they are numbered, and weld none."""
    index = np.arange(count)
    return CanonicalOrder(index, index, index)


def canonical_faces(faces: Int[np.ndarray, "F 3"], *ranks: Int[np.ndarray, " V"]) -> Int[np.ndarray, "F 3"]:
    """Rotate each face to begin at its corner of lowest rank, and sort the faces by the ranks of their corners.

    Ties are broken by the later arrays of `ranks`.
    """
    # Rotation keeps the winding, so normals do not flip.
    first = ranks[0][faces].argmin(axis=1)[:, None]
    rotated = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    keys = np.concatenate([rank[rotated] for rank in ranks], axis=1)
    return rotated[np.lexsort(keys.T[::-1])]
