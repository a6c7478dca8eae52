"""Other meshings of one body's surface, and damaged ones: each vertex a point of one of the body's triangles.

Made once on a body and replayed on any shape and pose of it, so that a driving mesh and its reference stay alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int

from ..bodies import RiggedBody, load_body
from ..core.geometry import closest_on_mesh, edges, face_vectors, spatial_order
from ..core.surface_points import at_barycentric, sample_surface


@dataclass(frozen=True, eq=False)
class Remesh:
    """N points of a body's surface and triangles between them (none: a point cloud)."""

    faces: Int[np.ndarray, "G 3"]
    corners: Int[np.ndarray, "N 3"]
    """Body vertices around each point."""
    weights: Float[np.ndarray, "N 3"]

    def at(self, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "N 3"]:
        """Where the points are on the body with these vertices."""
        return at_barycentric(vertices, self.corners, np.arange(len(self.corners)), self.weights)

    def nearest(self, vertices: Float[np.ndarray, "V 3"], wanted: Int[np.ndarray, " M"]) -> Int[np.ndarray, " M"]:
        """Index of the point nearest to each of some body vertices."""
        from scipy.spatial import KDTree

        return np.asarray(KDTree(self.at(vertices)).query(vertices[wanted])[1])


@cache
def decimated() -> Remesh:
    """The human body with a fifth of its triangles, by quadric simplification."""
    body = load_body()
    return _projected(body, *_simplify(body.vertices, body.faces, len(body.faces) // 5))


@cache
def template(count: int = 2100) -> Remesh:
    """As many of the human body's own vertices as LIMP's meshes have, spread evenly, and triangles between them.

    Every vertex of the body belongs to the nearest chosen one along its edges; three that meet in a triangle of the
    body are a triangle here.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    body = load_body()
    size, pairs = len(body.vertices), edges(body.faces)
    cells = np.array_split(spatial_order(body.vertices), count)
    chosen = np.array([cell[len(cell) // 2] for cell in cells])
    lengths = np.linalg.norm(np.diff(body.vertices[pairs], axis=1)[:, 0], axis=1)
    graph = coo_matrix((lengths, pairs.T), (size, size))
    nearest = dijkstra(graph, directed=False, indices=chosen, return_predecessors=True, min_only=True)[2]
    rank = np.full(size, -1)
    rank[chosen] = np.arange(count)
    corners = rank[nearest[body.faces]]
    apart = (corners != np.roll(corners, 1, axis=1)).all(axis=1) & (corners >= 0).all(axis=1)
    first = np.unique(np.sort(corners[apart], axis=1), axis=0, return_index=True)[1]
    return Remesh(corners[apart][first], np.repeat(chosen[:, None], 3, axis=1), np.tile([1.0, 0, 0], (count, 1)))


@cache
def subdivided() -> Remesh:
    """Each triangle in four: 27,554 vertices on the human body, the count of the MG-dataset."""
    body = load_body()
    pairs = edges(body.faces)
    corners = np.concatenate([np.repeat(np.arange(len(body.vertices))[:, None], 3, axis=1), pairs[:, [0, 1, 1]]])
    weights = np.concatenate([np.tile([1.0, 0, 0], (len(body.vertices), 1)), np.tile([0.5, 0.5, 0], (len(pairs), 1))])
    return Remesh(split_faces(body.faces, pairs, len(body.vertices)), corners, weights)


@cache
def retriangulated() -> Remesh:
    """As many triangles as the human body, with other vertices: subdivided, then simplified to the old count."""
    body, fine = load_body(), subdivided()
    return _projected(body, *_simplify(fine.at(body.vertices), fine.faces, len(body.faces)))


def points(body: RiggedBody, count: int, rng: np.random.Generator) -> Remesh:
    """Random points, uniform by area on the mean shape, without triangles."""
    chosen, weights = sample_surface(body.vertices, body.faces, count, rng)
    return Remesh(np.zeros((0, 3), int), body.faces[chosen], weights)


def holes(body: RiggedBody, rng: np.random.Generator, count: int = 12, radius: float = 0.06) -> Remesh:
    """The body with round holes (metres, on the mean shape at rest) around random vertices."""
    middles = body.vertices[rng.choice(len(body.vertices), count, replace=False)]
    near = (np.linalg.norm(body.vertices[:, None] - middles, axis=-1) < radius).any(axis=1)
    return _without(body, near)


def cropped(body: RiggedBody, rng: np.random.Generator) -> Remesh:
    """The body without one arm from the elbow on, or one leg from the knee on."""
    name = ("LeftForeArm", "RightForeArm", "LeftLeg", "RightLeg")[rng.integers(4)]
    gone = [body.joint(name)]
    for j, parent in enumerate(body.parents):
        if parent in gone:
            gone.append(j)
    return _without(body, body.weights[:, gone].sum(axis=1) > 0.5)


def half(body: RiggedBody, vertices: Float[np.ndarray, "V 3"], rng: np.random.Generator) -> Remesh:
    """The half of the surface that faces a random horizontal direction, as one scan from there would see, roughly.

    What a limb hides is kept: facing decides, not visibility.
    """
    angle = rng.uniform(0, 2 * np.pi)
    seen = face_vectors(vertices, body.faces) @ np.array([np.sin(angle), 0.0, np.cos(angle)]) > 0
    gone = np.ones(len(vertices), bool)
    gone[body.faces[seen]] = False
    return _without(body, gone, seen)


def _without(body: RiggedBody, gone: Bool[np.ndarray, " V"], faces: Bool[np.ndarray, " F"] | None = None) -> Remesh:
    """What is left when vertices go (and every triangle that loses a corner, or is not among the `faces` to keep)."""
    kept = np.flatnonzero(~gone)
    rank = np.cumsum(~gone) - 1
    whole = ~gone[body.faces].any(axis=1) & (True if faces is None else faces)
    weights = np.tile([1.0, 0, 0], (len(kept), 1))
    return Remesh(rank[body.faces[whole]], np.repeat(kept[:, None], 3, axis=1), weights)


def _simplify(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int):
    import fast_simplification

    return fast_simplification.simplify(vertices, faces.astype(np.int32), target_count=count)


def _projected(body: RiggedBody, vertices: np.ndarray, faces: np.ndarray) -> Remesh:
    """A mesh that lies close to the body's mean shape, laid onto it."""
    face, weights, _ = closest_on_mesh(vertices.astype(np.float64), body.vertices, body.faces)
    return Remesh(faces.astype(np.int64), body.faces[face], weights)


def split_faces(faces: Int[np.ndarray, "F 3"], pairs: Int[np.ndarray, "E 2"], count: int) -> Int[np.ndarray, "4*F 3"]:
    """Four triangles for each: three at the corners and the one between the edges' middles (numbered from `count`)."""
    key = pairs[:, 0] * count + pairs[:, 1]
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=-1)
    ab, bc, ca = count + np.searchsorted(key, sides[..., 0] * count + sides[..., 1]).T
    a, b, c = faces.T
    return np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
