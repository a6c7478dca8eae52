"""Points spread evenly over a surface, the same ones of it in every frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .canonical_order import canonical_faces, rank_vertices
from .geometry import face_vectors, sample_surface
from .mesh import Mesh


@dataclass(frozen=True, eq=False)
class Samples:
    """Where on a mesh the points are; of a point cloud they are vertices."""

    corners: Int[np.ndarray, "N 3"]
    shares: Float[np.ndarray, "N 3"]

    @classmethod
    def of(cls, mesh: Mesh, count: int, rng: np.random.Generator) -> Samples:
        """Random points by area, whatever the order of vertices and faces."""
        ranked = rank_vertices(mesh.vertices)
        if len(mesh.faces) == 0:
            many = len(ranked)
            chosen = rng.permutation(many)[:count] if many >= count else rng.integers(many, size=count)
            vertex = ranked.order[ranked.start[chosen]]
            return cls(np.repeat(vertex[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (count, 1)))
        faces = canonical_faces(mesh.faces, ranked.group)
        face, shares = sample_surface(mesh.vertices, faces, count, rng)
        return cls(faces[face], shares)

    def part(self, which: int, of: int) -> Samples:
        """One of so many disjoint parts, as evenly spread as the whole."""
        return Samples(self.corners[which % of :: of], self.shares[which % of :: of])

    def points(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "N 3"]:
        """Where the points are in a frame."""
        return (vertices[self.corners] * self.shares[..., None]).sum(axis=1)

    def normals(self, vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "N 3"]:
        """Unit normals of the surface there, in a frame; zeros without faces."""
        normals = face_vectors(vertices, self.corners)
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
