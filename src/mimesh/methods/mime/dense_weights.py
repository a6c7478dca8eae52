"""Skinning weights of very dense surfaces: found for fewer points, and interpolated between these along the surface.

Weights change over centimetres. For each vertex on its own they would take most of the time of a transfer, and would
follow each point of the fitted body and each facet, as bumps that a coarser mesh does not resolve (docs/log/speed.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...core.geometry import edges, links, vertex_normals
from ...core.surface_clusters import clusters

DENSE = 100_000
"""Distinct positions from which on weights are interpolated. No mesh of a test set has as many."""
COUNT = 20_000
"""Cells in the area of the surface; two or three times as many points are kept. For a person a side has 9 mm."""
REACH = 2.0
"""Radius within which points count, in sides of a cell; those in it are neighbours of neighbours."""
CHUNK = 50_000
"""Vertices to interpolate at a time."""


@dataclass(frozen=True, eq=False)
class CoarseSurface:
    """The points of a dense surface that get weights, and how these are carried to all of it."""

    points: Float[np.ndarray, "C 3"]
    faces: Int[np.ndarray, "G 3"]
    dense: Float[np.ndarray, "V 3"]
    """All vertices."""
    cluster: Int[np.ndarray, " V"]
    """The point that stands for each vertex."""
    side: float
    """Of a cell of the grid, in the unit of the vertices."""

    @classmethod
    def of(cls, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> CoarseSurface:
        """Keep one vertex of each cell of a grid and octant of normals: sheets that face each other stay apart."""
        octant = (vertex_normals(vertices, faces) > 0) @ np.array([1, 2, 4])
        found = clusters(vertices, faces, COUNT, octant)
        return cls(vertices[found.vertices], found.faces, vertices, found.cluster, found.side)

    def carried(self, weights: Float[np.ndarray, "C J"]) -> Float[np.ndarray, "V J"]:
        """Interpolate weights of the points at all vertices, between neighbours of neighbours along the surface."""
        from scipy.sparse import csr_array, eye_array

        count = len(self.points)
        ring = links(edges(self.faces), count) + eye_array(count)
        near = csr_array(ring @ ring)
        result = np.empty((len(self.dense), weights.shape[1]))
        for start in range(0, len(self.dense), CHUNK):
            chunk = slice(start, start + CHUNK)
            share = near[self.cluster[chunk]]
            rows = np.repeat(np.arange(share.shape[0]), np.diff(share.indptr))
            distance = np.linalg.norm(self.dense[chunk][rows] - self.points[share.indices], axis=1)
            # Falls to zero with zero slope, so points come and go without a step; the own one always counts.
            share.data = np.maximum(1 - (distance / (REACH * self.side)) ** 2, 0.0) ** 2
            share.data += 1e-6 * (share.indices == self.cluster[chunk][rows])
            total = np.bincount(rows, share.data, minlength=share.shape[0])
            result[chunk] = (share @ weights) / total[:, None]
        return result
