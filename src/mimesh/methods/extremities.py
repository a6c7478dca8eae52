"""Find corresponding vertices of two meshes by the ends of their limbs, for deformation transfer without marks.

Ends are vertices whose mean geodesic distance from the surface is largest in their surroundings (the average geodesic
distance of Hilaga et al., Topology Matching, SIGGRAPH 2001). Distances are shortest paths along edges. The ends of two
meshes are assigned one to one by place and by that mean, and kept where each is the best of the other. More marks are
put on the paths between them. The confidence falls where distances between ends, or left and right, do not agree.
Meshes are normalised: y up, +z front, the left side is +x.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from ..core.geometry import edges, weld
from ..core.mesh import Mesh
from .deformation_transfer import component_ties

SAMPLES = 80
"""Vertices, spread over the surface, from which distances are computed."""
MOST = 10
"""Most ends of a mesh."""
SURROUNDING = 0.3
"""Distance, over the largest one of the mesh, within which an end has no other end."""
STICKS_OUT = 1.12
"""Mean distance of an end, over the median of the surface, from which on it counts as one."""
STEPS = (0.25, 0.5, 0.75)
"""Places of the marks on the path between two ends."""
UNLIKE = 0.6
"""Cost from which on two ends do not correspond."""


@dataclass(frozen=True, eq=False)
class Ends:
    """The ends of the limbs of a mesh."""

    vertices: Int[np.ndarray, " E"]
    places: Float[np.ndarray, "E 3"]
    """Normalised."""
    means: Float[np.ndarray, " E"]
    """Mean distance of each from the surface, over the median of all vertices."""
    apart: Float[np.ndarray, "E E"]
    """Distances of the ends from each other, over the largest one of the mesh."""
    paths: Float[np.ndarray, "E V"]
    """Distance of each end from all vertices, over the same."""
    points: Float[np.ndarray, "V 3"]
    """All vertices, normalised."""


@dataclass(frozen=True, eq=False)
class FoundMarks:
    """Pairs (identity vertex, driving vertex), and how sure they are."""

    pairs: Int[np.ndarray, "M 2"]
    ends: int
    """Number of ends among them."""
    confidence: float
    """From 0 to 1: the share of the ends that correspond, times the agreement of distances, and of left and right."""
    distance: float = 0.0
    """Mean distance of the pairs, normalised: smallest where both meshes have about one pose."""


def find_ends(mesh: Mesh) -> Ends:
    """Find the ends of the limbs of a normalised mesh."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    points, group = weld(mesh.vertices)
    faces = group[mesh.faces]
    pairs = edges(faces)
    pairs = np.concatenate([pairs, component_ties(points, faces)])
    length = np.maximum(np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1), 1e-9)
    graph = csr_array((length, pairs.T), shape=(len(points), len(points)))

    def distances(sources) -> np.ndarray:
        return dijkstra(graph, directed=False, indices=sources)

    samples, nearest = [int(np.linalg.norm(points - points.mean(axis=0), axis=1).argmax())], None
    rows = []
    for _ in range(min(SAMPLES, len(points))):  # farthest points, so that no part is missed
        row = distances(samples[-1])
        rows.append(row)
        nearest = row if nearest is None else np.minimum(nearest, row)
        samples.append(int(nearest.argmax()))
    from_samples = np.stack(rows)
    largest, mean = float(from_samples.max()), from_samples.mean(axis=0)
    found: list[int] = []
    away = np.full(len(points), np.inf)
    for vertex in np.argsort(-mean, kind="stable"):
        if len(found) == MOST or mean[vertex] < STICKS_OUT * np.median(mean):
            break
        if away[vertex] > SURROUNDING * largest:
            found.append(int(vertex))
            away = np.minimum(away, distances(vertex))
    paths = distances(found).reshape(len(found), len(points)) / largest
    first = np.unique(group, return_index=True)[1]
    return Ends(
        first[found], points[found], mean[found] / np.median(mean), paths[:, found], paths[:, group], points[group]
    )


def match_ends(mine: Ends, theirs: Ends) -> FoundMarks:
    """Match the ends of an identity and of a driving in about one pose."""
    from scipy.optimize import linear_sum_assignment

    if min(len(mine.vertices), len(theirs.vertices)) < 2:
        return FoundMarks(np.zeros((0, 2), np.int64), 0, 0.0)
    costs = np.linalg.norm(mine.places[:, None] - theirs.places, axis=-1) / 2
    costs = costs + np.abs(mine.means[:, None] - theirs.means)
    rows, columns = linear_sum_assignment(np.minimum(costs, UNLIKE))
    # There and back: each is the best of the other, too.
    same = (costs[rows].argmin(axis=1) == columns) & (costs[:, columns].argmin(axis=0) == rows)
    kept = same & (costs[rows, columns] < UNLIKE)
    rows, columns = rows[kept], columns[kept]
    if len(rows) < 3:
        return FoundMarks(np.zeros((0, 2), np.int64), len(rows), 0.0)
    share = 2 * len(rows) / (len(mine.vertices) + len(theirs.vertices))
    apart = [ends.apart[np.ix_(k, k)] for ends, k in ((mine, rows), (theirs, columns))]
    upper = np.triu_indices(len(rows), 1)
    distortion = float(np.abs(apart[0] - apart[1])[upper].mean() / np.mean([a[upper] for a in apart]))
    sided = _sides(mine, rows, theirs, columns)
    confidence = share * max(1 - 2 * distortion, 0.0) * sided
    pairs = [(mine.vertices[u], theirs.vertices[v]) for u, v in zip(rows, columns, strict=True)]
    matched = zip(rows.tolist(), columns.tolist(), strict=True)
    for (u, v), (w, x) in combinations(matched, 2):
        pairs += [(_between(mine.paths, u, w, step), _between(theirs.paths, v, x, step)) for step in STEPS]
    marks = np.array(pairs, np.int64)
    distance = np.linalg.norm(mine.points[marks[:, 0]] - theirs.points[marks[:, 1]], axis=1).mean()
    return FoundMarks(marks, len(rows), float(confidence), float(distance))


def _between(paths: Float[np.ndarray, "E V"], one: int, two: int, step: float) -> int:
    """Find the vertex on the path between two ends that is at a share of its length."""
    to_one, to_two = paths[one], paths[two]
    length = to_one[np.flatnonzero(to_two == 0)[0]]
    off = np.abs(to_one - step * length) + np.abs(to_two - (1 - step) * length)
    return int(off.argmin())


def _sides(mine: Ends, rows: Int[np.ndarray, " N"], theirs: Ends, columns: Int[np.ndarray, " N"]) -> float:
    """Return the share of matched ends whose mirror images match as they do."""
    images = [_images(ends.places) for ends in (mine, theirs)]
    other = dict(zip(rows.tolist(), columns.tolist(), strict=True))
    fits = [images[1][v] == other.get(int(images[0][u])) for u, v in other.items()]
    return float(np.mean(fits))


def _images(places: Float[np.ndarray, "E 3"]) -> Int[np.ndarray, " E"]:
    """Find the end that is nearest to the mirror image of each one."""
    mirrored = places * [-1, 1, 1]
    return np.linalg.norm(mirrored[:, None] - places, axis=-1).argmin(axis=1)
