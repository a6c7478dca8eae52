"""Sample points on a surface, stored as triangle corners and barycentric coordinates, so that they follow its motion.

The samplers of meshes (all but `sample_surface`) depend neither on the order of vertices and faces nor on the last bits
of positions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int

from .canonical_order import CanonicalOrder, canonical_faces, canonical_order, rank_order
from .geometry import face_areas, face_centroids, face_vectors
from .mesh import Mesh


def sample_surface(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int, rng: np.random.Generator
) -> tuple[Int[np.ndarray, " N"], Float[np.ndarray, "N 3"]]:
    """Draw random points of a surface, uniform by area, as (face index, barycentric coordinates).

    `at_barycentric` gives their positions in any frame of a clip.
    """
    areas = face_areas(vertices, faces)
    # Inverse transform sampling: a uniform number in the accumulated areas selects the face.
    chosen = np.searchsorted(np.cumsum(areas), rng.random(count) * areas.sum()).clip(max=len(faces) - 1)
    u, v = rng.random((2, count))
    flip = u + v > 1  # outside the triangle: reflect to the other half of the parallelogram
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    return chosen, np.stack([1 - u - v, u, v], axis=1)


def interpolate(
    values: Float[np.ndarray, "*T V C"], corners: Int[np.ndarray, "N 3"], barycentric: Float[np.ndarray, "N 3"]
) -> Float[np.ndarray, "*T N C"]:
    """Interpolate values of vertices (positions, skinning weights) at points of triangles given by their corners."""
    # A product and a sum over the corners give the same bits and take three times as long.
    return np.einsum("...nkc,nk->...nc", np.take(values, corners, axis=-2), barycentric)


def at_barycentric(
    values: Float[np.ndarray, "*T V C"],
    faces: Int[np.ndarray, "F 3"],
    chosen: Int[np.ndarray, " N"],
    barycentric: Float[np.ndarray, "N 3"],
) -> Float[np.ndarray, "*T N C"]:
    """Interpolate values of vertices at points given as (face index, barycentric coordinates)."""
    return interpolate(values, faces[chosen], barycentric)


def batch_of_one(points: Float[np.ndarray, "*T N 3"]) -> Float32[np.ndarray, "1 *T N 3"]:
    """Convert points to a network's input: float32, with a batch dimension of 1."""
    return np.ascontiguousarray(points[None], np.float32)


def generator(seed: int, stream: int) -> np.random.Generator:
    """Return a random generator for one purpose (stream) of a seed, independent of those of other streams."""
    return np.random.default_rng(np.random.SeedSequence([seed, stream]))


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Random points of a mesh, or random vertices of a point cloud."""

    corners: Int[np.ndarray, "N 3"]
    """Vertex indices of the triangle that contains each point (point clouds: one vertex three times)."""
    barycentric: Float[np.ndarray, "N 3"]
    """Weights of the corners, rows sum to 1."""

    @classmethod
    def of(
        cls, mesh: Mesh, count: int, rng: np.random.Generator, ranked: CanonicalOrder | None = None
    ) -> SurfacePoints:
        """Draw `count` points, uniform by area; the order of vertices and faces has no influence.

        `ranked` is the canonical order of the vertices where it is known, which saves a third of the time.
        """
        ranked = canonical_order(mesh.vertices) if ranked is None else ranked
        if len(mesh.faces) == 0:
            available = len(ranked)
            enough = available >= count
            chosen = rng.permutation(available)[:count] if enough else rng.integers(available, size=count)
            vertex = ranked.order[ranked.start[chosen]]
            return cls(np.repeat(vertex[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (count, 1)))
        faces = canonical_faces(mesh.faces, ranked.group)
        face, barycentric = sample_surface(mesh.vertices, faces, count, rng)
        return cls(faces[face], barycentric)

    @classmethod
    def of_vertices(cls, count: int) -> SurfacePoints:
        """Take the vertices of a mesh themselves."""
        return cls(np.repeat(np.arange(count)[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (count, 1)))

    def part(self, which: int, of: int) -> SurfacePoints:
        """Select part `which` of `of` disjoint parts; each is as evenly spread as the whole."""
        return SurfacePoints(self.corners[which % of :: of], self.barycentric[which % of :: of])

    def points(self, vertices: Float[np.ndarray, "*T U 3"]) -> Float[np.ndarray, "*T N 3"]:
        """Compute the positions of the points in a frame."""
        return interpolate(vertices, self.corners, self.barycentric)

    def normals(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "N 3"]:
        """Compute unit normals of the triangles at the points in a frame; zeros for a point cloud."""
        normals = face_vectors(vertices, self.corners)
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


@dataclass(frozen=True, eq=False)
class PaddedVertices:
    """All welded vertices of a driving mesh and random points of its surface; the same points in every frame."""

    ranked: CanonicalOrder
    """Welded vertices."""
    added: SurfacePoints

    def __len__(self) -> int:
        return len(self.ranked) + len(self.added.corners)

    def at(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "P 3"]:
        """Compute positions in a frame: the welded vertices by rank, then the added points."""
        return np.concatenate([self.ranked.merge(vertices), self.added.points(vertices)])


def padded_vertices(mesh: Mesh, count: int, rng: np.random.Generator) -> PaddedVertices:
    """Take all welded vertices of a mesh, and random points of its surface up to `count` points in total.

    Added points are uniform by area over faces ordered by centroid; a point cloud repeats random vertices.
    """
    ranked = canonical_order(mesh.vertices)
    missing = max(count - len(ranked), 0)
    if len(mesh.faces) == 0:
        first_of_rank = ranked.order[ranked.start]
        corners = np.repeat(first_of_rank[rng.integers(len(ranked), size=missing)][:, None], 3, axis=1)
        return PaddedVertices(ranked, SurfacePoints(corners, np.tile([1.0, 0.0, 0.0], (missing, 1))))
    faces = mesh.faces[rank_order(face_centroids(mesh.vertices, mesh.faces))]
    chosen, barycentric = sample_surface(mesh.vertices, faces, missing, rng)
    return PaddedVertices(ranked, SurfacePoints(faces[chosen], barycentric))
