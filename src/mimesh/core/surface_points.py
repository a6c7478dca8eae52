"""Points on a surface that are the same points of it in every frame: random ones, or vertices and random ones.

Which points are chosen depends neither on the order of vertices and faces nor on the last bits of positions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .canonical_order import TOLERANCE, CanonicalOrder, canonical_faces, canonical_order, rank_order
from .geometry import face_areas, face_vectors
from .mesh import Mesh


def sample_surface(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int, rng: np.random.Generator
) -> tuple[Int[np.ndarray, " N"], Float[np.ndarray, "N 3"]]:
    """Draw random points of a surface, uniform by area, as (face index, barycentric coordinates).

    They are the same points of the surface in every frame of a clip: see `at_barycentric`.
    """
    areas = face_areas(vertices, faces)
    chosen = np.searchsorted(np.cumsum(areas), rng.random(count) * areas.sum()).clip(max=len(faces) - 1)
    u, v = rng.random((2, count))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    return chosen, np.stack([1 - u - v, u, v], axis=1)


def at_barycentric(
    vertices: Float[np.ndarray, "*T V 3"],
    faces: Int[np.ndarray, "F 3"],
    chosen: Int[np.ndarray, " N"],
    weights: Float[np.ndarray, "N 3"],
) -> Float[np.ndarray, "*T N 3"]:
    """Interpolate positions (or other values of vertices) at points given as (face index, barycentric coordinates)."""
    corners = np.take(vertices, faces[chosen], axis=-2)
    return (corners * weights[:, :, None]).sum(axis=-2)


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Random points of a mesh; of a point cloud they are vertices."""

    corners: Int[np.ndarray, "N 3"]
    """Vertices of the triangle that each point lies in (point clouds: one vertex three times)."""
    barycentric: Float[np.ndarray, "N 3"]

    @classmethod
    def of(cls, mesh: Mesh, count: int, rng: np.random.Generator) -> SurfacePoints:
        """Draw points uniformly by area, whatever the order of vertices and faces."""
        ranked = canonical_order(mesh.vertices)
        if len(mesh.faces) == 0:
            many = len(ranked)
            chosen = rng.permutation(many)[:count] if many >= count else rng.integers(many, size=count)
            vertex = ranked.order[ranked.start[chosen]]
            return cls(np.repeat(vertex[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (count, 1)))
        faces = canonical_faces(mesh.faces, ranked.group)
        face, barycentric = sample_surface(mesh.vertices, faces, count, rng)
        return cls(faces[face], barycentric)

    def part(self, which: int, of: int) -> SurfacePoints:
        """One of so many disjoint parts, as evenly spread as the whole."""
        return SurfacePoints(self.corners[which % of :: of], self.barycentric[which % of :: of])

    def points(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "N 3"]:
        """Positions in a frame."""
        return (vertices[self.corners] * self.barycentric[..., None]).sum(axis=1)

    def normals(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "N 3"]:
        """Unit normals of the surface at the points in a frame; zeros without faces."""
        normals = face_vectors(vertices, self.corners)
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


@dataclass(frozen=True, eq=False)
class PaddedVertices:
    """All welded vertices of a driving mesh, and random points of its surface: the same points in every frame."""

    ranked: CanonicalOrder
    corners: Int[np.ndarray, "N 3"]
    """Vertices of the triangle that each added point lies in (point clouds: one vertex three times)."""
    weights: Float[np.ndarray, "N 3"]

    def __len__(self) -> int:
        return len(self.ranked) + len(self.corners)

    def at(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "P 3"]:
        """Positions in a frame: the welded vertices by rank, then the added points."""
        added = at_barycentric(vertices, self.corners, np.arange(len(self.corners)), self.weights)
        return np.concatenate([self.ranked.merge(vertices), added])


def padded_vertices(mesh: Mesh, count: int, rng: np.random.Generator) -> PaddedVertices:
    """Take all vertices of a mesh, and as many random points of its surface as are missing to `count`.

    Added points are uniform by area over faces ordered by centroid; a point cloud repeats random vertices.
    """
    ranked = canonical_order(mesh.vertices)
    missing = max(count - len(ranked), 0)
    if len(mesh.faces) == 0:
        first_of_rank = ranked.order[ranked.start]
        corners = np.repeat(first_of_rank[rng.integers(len(ranked), size=missing)][:, None], 3, axis=1)
        return PaddedVertices(ranked, corners, np.tile([1.0, 0.0, 0.0], (missing, 1)))
    faces = mesh.faces[rank_order(mesh.vertices[mesh.faces].mean(axis=1))]
    chosen, weights = sample_surface(mesh.vertices, faces, missing, rng)
    return PaddedVertices(ranked, faces[chosen], weights)


def surface_sampler(
    mesh: Mesh, count: int, rng: np.random.Generator
) -> Callable[[Float[np.ndarray, "V 3"]], Float[np.ndarray, "N 3"]]:
    """Choose `count` points of a mesh, and return the function that gives their positions in a frame.

    Points are uniform by area; of a point cloud they are some or all of its vertices.

    Neither the order of vertices or faces, nor the last bits of positions, matter.
    """
    ranked = canonical_order(mesh.vertices)
    if len(mesh.faces) == 0:
        chosen = rng.permutation(len(ranked))[:count]
        return lambda vertices: rounded(ranked.merge(vertices)[chosen])
    faces = np.unique(np.sort(ranked.group[mesh.faces], axis=1), axis=0)
    triangles, weights = sample_surface(rounded(ranked.merge(mesh.vertices)), faces, count, rng)
    return lambda vertices: rounded(at_barycentric(ranked.merge(vertices), faces, triangles, weights))


def rounded(points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
    """Round to TOLERANCE: a nearest-neighbour search would turn a difference in the last bit into another match."""
    return np.round(points / TOLERANCE) * TOLERANCE
