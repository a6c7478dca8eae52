"""Canonical vertex order and count, for models that pair driving point i with identity vertex i.

Both meshes are welded and ranked by position, then the driving ranks are shuffled by a seed. So permuting the identity
permutes the result, permuting the driving changes nothing, and both hold to the last bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .geometry import weld

TOLERANCE = 1e-6
"""Positions are compared in units of this (normalised frame): rounding of the last bits must not reorder anything."""


def rank_order(points: Float[np.ndarray, "N 3"]) -> Int[np.ndarray, " N"]:
    """Indices that sort points by x, then y, then z, rounded; points that round alike by their exact position."""
    rounded = np.round(points / TOLERANCE)
    return np.lexsort((*points.T[::-1], *rounded.T[::-1]))


@dataclass(frozen=True, eq=False)
class CanonicalOrder:
    """Distinct positions of a mesh, sorted, and the way to and from its vertices."""

    group: Int[np.ndarray, " V"]
    """Rank of the position of each vertex; vertices along a seam share one, so a seam cannot tear."""
    order: Int[np.ndarray, " V"]
    """Vertices sorted by rank."""
    start: Int[np.ndarray, " W"]
    """Where each rank begins in `order`."""

    def __len__(self) -> int:
        return len(self.start)

    def merge(self, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "W 3"]:
        """One point a rank, for this or any later frame.

        Vertices that met in the first frame and came apart give the middle of their extent: unlike a mean it does not
        depend on their order, and it is exact where they agree.
        """
        sorted_vertices = vertices[self.order]
        low = np.minimum.reduceat(sorted_vertices, self.start, axis=0)
        high = np.maximum.reduceat(sorted_vertices, self.start, axis=0)
        return (low + high) / 2


def canonical_order(vertices: Float[np.ndarray, "V 3"]) -> CanonicalOrder:
    """Weld by exact position and rank."""
    merged, index = weld(vertices)
    rank = np.empty(len(merged), np.int64)
    rank[rank_order(merged)] = np.arange(len(merged))
    group = rank[index]
    order = np.argsort(group, kind="stable")
    return CanonicalOrder(group, order, np.searchsorted(group[order], np.arange(len(merged))))


def canonical_faces(faces: Int[np.ndarray, "F 3"], *ranks: Int[np.ndarray, " V"]) -> Int[np.ndarray, "F 3"]:
    """Faces turned to begin at the corner of lowest rank and sorted by the ranks; later ranks break ties."""
    first = ranks[0][faces].argmin(axis=1)[:, None]
    turned = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    keys = np.concatenate([rank[turned] for rank in ranks], axis=1)
    return turned[np.lexsort(keys.T[::-1])]
