"""Remeshings of the body's surface, complete and damaged: each new vertex is a point on a triangle of the body.

A remeshing is made once on one shape and pose and can be evaluated on all others, so that a driving mesh and its
reference get the same vertices and triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int

from ..bodies import RiggedBody, load_body
from ..core.geometry import closest_on_mesh, edges, face_vectors, nearest_points
from ..core.surface_points import at_barycentric, sample_surface


@dataclass(frozen=True, eq=False)
class Remesh:
    """N points on the body's surface and triangles between them (no triangles: a point cloud)."""

    faces: Int[np.ndarray, "G 3"]
    """Triangles of point indices."""
    corners: Int[np.ndarray, "N 3"]
    """The three body vertices that each point lies between."""
    barycentric: Float[np.ndarray, "N 3"]
    """Barycentric coordinates of each point among its corners."""

    def positions(self, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "N 3"]:
        """Return the positions of the points on the body with these vertices."""
        return at_barycentric(vertices, self.corners, np.arange(len(self.corners)), self.barycentric)

    def nearest(self, vertices: Float[np.ndarray, "V 3"], selected: Int[np.ndarray, " M"]) -> Int[np.ndarray, " M"]:
        """Return the index of the point nearest to each of the selected body vertices."""
        return nearest_points(self.positions(vertices), vertices[selected])[1]


@cache
def decimated() -> Remesh:
    """Decimate the body to a fifth of its triangles by quadric simplification."""
    body = load_body()
    return simplified(body, len(body.faces) // 5)


def simplified(body: RiggedBody, count: int) -> Remesh:
    """Decimate a body to about `count` triangles of its own by quadric simplification."""
    return _projected(body, *_simplify(body.vertices, body.faces, count))


@cache
def subdivided() -> Remesh:
    """Divide each triangle of the body into four; gives 27,554 vertices, the count of the MG-dataset."""
    body = load_body()
    pairs = edges(body.faces)
    corners = np.concatenate([np.repeat(np.arange(len(body.vertices))[:, None], 3, axis=1), pairs[:, [0, 1, 1]]])
    at_vertex, at_edge = np.tile([1.0, 0, 0], (len(body.vertices), 1)), np.tile([0.5, 0.5, 0], (len(pairs), 1))
    return Remesh(split_faces(body.faces, pairs, len(body.vertices)), corners, np.concatenate([at_vertex, at_edge]))


@cache
def retriangulated() -> Remesh:
    """Remesh the body with as many triangles but other vertices: subdivided, then simplified to the old count."""
    body, fine = load_body(), subdivided()
    return _projected(body, *_simplify(fine.positions(body.vertices), fine.faces, len(body.faces)))


def points(body: RiggedBody, count: int, rng: np.random.Generator) -> Remesh:
    """Sample a point cloud of `count` points from the body, uniform by area on the mean shape."""
    chosen, barycentric = sample_surface(body.vertices, body.faces, count, rng)
    return Remesh(np.zeros((0, 3), int), body.faces[chosen], barycentric)


def holes(body: RiggedBody, rng: np.random.Generator) -> Remesh:
    """Cut 12 round holes into the body around random vertices, with a radius of 6 cm on the mean shape at rest."""
    centres = body.vertices[rng.choice(len(body.vertices), 12, replace=False)]
    inside = (np.linalg.norm(body.vertices[:, None] - centres, axis=-1) < 0.06).any(axis=1)
    return _without(body, inside)


def cropped(body: RiggedBody, rng: np.random.Generator) -> Remesh:
    """Remove a random limb from the body: a forearm with its hand, or a lower leg with its foot."""
    name = ("LeftForeArm", "RightForeArm", "LeftLeg", "RightLeg")[rng.integers(4)]
    removed = [body.joint(name)]
    for j, parent in enumerate(body.parents):
        if parent in removed:
            removed.append(j)
    # A vertex goes with the limb that has more than half of its skinning weight.
    return _without(body, body.weights[:, removed].sum(axis=1) > 0.5)


def half(body: RiggedBody, vertices: Float[np.ndarray, "V 3"], rng: np.random.Generator) -> Remesh:
    """Keep the half of the surface that faces a random horizontal direction, similar to a scan from one side.

    Selection is by face normals only: surface that a limb occludes is kept.
    """
    angle = rng.uniform(0, 2 * np.pi)
    facing = face_vectors(vertices, body.faces) @ np.array([np.sin(angle), 0.0, np.cos(angle)]) > 0
    removed = np.ones(len(vertices), bool)
    removed[body.faces[facing]] = False
    return _without(body, removed, facing)


def _without(body: RiggedBody, removed: Bool[np.ndarray, " V"], faces: Bool[np.ndarray, " F"] | None = None) -> Remesh:
    """Remove vertices from the body, with all triangles that lose a corner; `faces` selects triangles to keep."""
    remaining = np.flatnonzero(~removed)
    rank = np.cumsum(~removed) - 1
    complete = ~removed[body.faces].any(axis=1) & (True if faces is None else faces)
    barycentric = np.tile([1.0, 0, 0], (len(remaining), 1))
    return Remesh(rank[body.faces[complete]], np.repeat(remaining[:, None], 3, axis=1), barycentric)


def _simplify(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int):
    import fast_simplification

    return fast_simplification.simplify(vertices, faces.astype(np.int32), target_count=count)


def _projected(body: RiggedBody, vertices: np.ndarray, faces: np.ndarray) -> Remesh:
    """Project the vertices of a mesh that is close to the body's mean shape onto that shape."""
    face, barycentric, _ = closest_on_mesh(vertices.astype(np.float64), body.vertices, body.faces)
    return Remesh(faces.astype(np.int64), body.faces[face], barycentric)


def split_faces(faces: Int[np.ndarray, "F 3"], pairs: Int[np.ndarray, "E 2"], count: int) -> Int[np.ndarray, "4*F 3"]:
    """Divide each triangle into four: one at each corner, and one between the midpoints of its edges.

    `pairs` are the sorted edges, `count` is the number of vertices; the midpoint of edge e is vertex `count` + e.
    """
    # An edge (a, b), a < b, is found by its key a * count + b in the sorted keys of all edges.
    key = pairs[:, 0] * count + pairs[:, 1]
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=-1)
    ab, bc, ca = count + np.searchsorted(key, sides[..., 0] * count + sides[..., 1]).T
    a, b, c = faces.T
    return np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
