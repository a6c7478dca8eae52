"""Repair predicted skinning weights: steps, where limbs touch, pieces, tails, corrected limbs and dense surfaces.

Between neighbouring vertices predicted weights may change so much that the surface tears there when it bends. Only
there they are averaged over neighbours: everywhere, that would soften the bends that a maker wants.

A network predicts the weights of a vertex from its position, so a hand that rests on a knee is weighted to the leg. On
the surface, however, the hand is connected to the forearm, and no forearm borders on a knee. Edges between vertices of
joints that far apart in the skeleton are cut; the connected components that this separates from the largest one of
their surface are wrong, and are inpainted from the vertices around them.

Swords, hats, shin guards and the blocks of block figures are pieces of their own, not connected to the rest, which one
joint moves. Predicted weights of such a piece vary over it, which would bend it: it gets the joint of most of it. What
reaches far from the body, such as a sword, gets the joint where it is nearest to the body. A box that stands for a
whole arm or leg has no vertices to bend at: it gets the first joint of this limb. A solid piece, closed and convex as
blocks and buttons are, is a part of one limb, of the trunk or of the head: what the others have of its weight is given
back.

The lower part of a long tail gets the weights of the nearer hind leg, its left half those of the left one. On the
surface no left shin borders on a right one: where they do, that is a tail. It is the part around its tip up to where
the surface is held by joints of the tail, and gets their weights.

Where the network puts a knee on the other leg, it also weights the skin there to the other leg. The body that was
fitted to corrected joints knows better: each vertex gets the weights of the nearest points of the body.

Weights change over centimetres. For each vertex of a very dense surface on its own they would take most of the time of
a transfer, and would follow each point of the fitted body and each facet, as bumps that a coarser mesh does not resolve
(docs/log/speed.md). So they are found for fewer points, and interpolated between these along the surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float, Int

from ..bodies.anatomy import QUADRUPED
from ..bodies.character_limbs import SIDES
from ..bodies.sampled_body import PosedBody
from ..core.geometry import (
    border_edges,
    component_labels,
    edges,
    face_vectors,
    factor,
    links,
    nearest_points,
    vertex_areas,
    vertex_normals,
)
from ..core.rig import descendants
from ..core.surface_clusters import clusters
from ..rigs.confidence import limb_joints
from .body_fit import NearestBody, sampled_body

RIGID_SHARE, SMALL_SHARE, SMALL_AREA, BODY_SHARE = 0.65, 0.5, 0.01, 0.3
"""A piece moves rigidly if one joint has more than the first share of its weight, or the second of a piece with less
than SMALL_AREA of the surface; BODY_SHARE of what counts are the fitted body's weights. Chosen on 1,875 pieces of
characters (docs/log/mime.md, "Pieces")."""
FAR, ATTACHED = 0.05, 0.1
"""A piece also moves rigidly if its vertices are farther from the fitted body than this (median, metres of the body);
its joint is that of the share of its vertices that is nearest to the body. Of 412 garments and other pieces that bend,
in the pool's `train` and `val` characters, the median is below 0.04 (docs/log/mime.md)."""
BLOCK_VERTICES, BLOCK_AREA, LIMB_SHARE = 24, 0.02, 0.9
"""A piece of at most so many vertices and more than this share of the surface moves rigidly too (of 17 such pieces of
the pool's characters 16 do); its joint is the last one whose subtree has LIMB_SHARE of its weight to its limb."""
SOLID_AREA, SOLID, OTHER_LIMB = 0.01, 0.75, 0.6
"""A closed piece of more than the first share of the surface that fills more than the second of its convex hull is
solid, unless a second arm or leg has more than the third share of the votes of the first one. Of 307 solid pieces of
the pool's `train` and `val` characters 301 are of one limb; the votes for it are right for 300 (docs/log/mime.md,
"Weights alone")."""
LEAST_LIMB, NARROW = 0.02, 0.7
"""Share of the surface that a limb has at least, and ratio of its votes to the most from which on it narrowly lost.
Blocks that are clearly another's stay, as joints of lost limbs are rarely where these begin."""
STEEP, STEEP_EXPONENT, SMOOTHED = 40.0, 4, 3
"""Change of weights (L1) over the square root of the surface's area from which on they are averaged, how fast that
sets in, and how many times: 29 per metre of a person of 1.7 m. An elbow has 20 to 30."""
LARGEST_PART = 0.5
"""Share of the surface from which on a piece is the figure itself, neither a block of it nor something it holds."""
MAX_BONES = 5
"""Bones between two joints from which on neighbouring vertices cannot be weighted to both; the two hips are 4 apart."""
TAIL = "Tail1"
"""First joint of a tail."""
LARGEST_TAIL = 0.06
"""Share of the surface that the part of a tail has at most: that of the shipped animals' tails is below 0.05."""
SMALLEST_LEG = 0.005
"""Share of the surface that each hind leg below its knee has beside it at least."""
NEAREST = 32
"""Points of the body among which the nearest ones are looked for."""
NORMAL_DISTANCE, BLUR = 0.1, 0.03
"""Distance (metres of the body) that opposite normals count as, twice; and scale over which weights are averaged."""
MOVED = 0.03
"""Displacement (metres of the body) of a joint from which on the weights of its bones are those of the body."""
DENSE = 100_000
"""Distinct positions from which on weights are interpolated. No mesh of a test set has as many."""
COUNT = 20_000
"""Cells in the area of the surface; two or three times as many points are kept. For a person a side has 9 mm."""
REACH = 2.0
"""Radius within which points count, in sides of a cell; those in it are neighbours of neighbours."""
CHUNK = 50_000
"""Vertices to interpolate at a time."""


def clean_weights(
    weights: Float[np.ndarray, "V J"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    parents: tuple[int, ...],
    nearest: NearestBody | None = None,
    counts: Mapping[int, int] = MappingProxyType({}),
) -> Float[np.ndarray, "V J"]:
    """Return weights without influences far from each vertex's strongest joint, wrong components being inpainted.

    Args:
        counts: see `bone_distances`.
        nearest: of each vertex, on the body that was fitted to the surface; None if there is none.

    Point clouds have no connectivity: their weights are returned as they are.
    """
    if len(faces) == 0:
        return weights
    distance, pairs = bone_distances(parents, counts), edges(faces)
    strongest = weights.argmax(axis=1)
    cut = distance[strongest[pairs[:, 0]], strongest[pairs[:, 1]]] >= MAX_BONES
    # Components of the mesh as it was (eyes, shoes) are surfaces of their own, each with its own largest component.
    surface, component = (component_labels(uncut, len(vertices)) for uncut in (pairs, pairs[~cut]))
    area, largest = np.bincount(component, vertex_areas(vertices, faces)), np.zeros(surface.max() + 1)
    np.maximum.at(largest, surface, area[component])
    wrong = area[component] < largest[surface]
    # Far influences are removed first: they would spread from the border into the components that are inpainted.
    near = np.where(distance[strongest] < MAX_BONES, weights, 0.0)
    near /= near.sum(axis=1, keepdims=True)
    whole = inpainted(near, wrong, pairs) if wrong.any() else near
    pieces = _Pieces.of(vertices, faces, pairs)
    if nearest is not None:
        # Of a block that is held by head and hand, far influences were removed by chance: it votes with all it had.
        whole = _of_one_limb(whole, weights, pieces, vertices, faces, nearest)
    return _rigid_pieces(whole, pieces, nearest)


def without_steps(
    weights: Float[np.ndarray, "V J"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    known: float = 0.0,
) -> Float[np.ndarray, "V J"]:
    """Average weights over neighbours where they change within so short a way that the surface would tear.

    A vertex moves by half the share g^n / (g^n + STEEP^n) to the mean of its neighbours, SMOOTHED times; g is the
    largest change along its edges, over their length. Point clouds have no neighbours: their weights stay.

    Args:
        known: share of the weights that is not predicted but a body's own, and stays as it is.
    """
    if len(faces) == 0:
        return weights
    pairs, side = edges(faces), np.sqrt(vertex_areas(vertices, faces).sum())
    first, second = pairs.T
    length = np.linalg.norm(vertices[first] - vertices[second], axis=1)
    change = side * np.abs(weights[first] - weights[second]).sum(axis=1) / np.maximum(length, 1e-9 * side)
    steepest = np.zeros(len(weights))
    for end in (first, second):
        np.maximum.at(steepest, end, change)
    steep = np.flatnonzero(steepest > STEEP / 4)
    share = (1 - known) / 2 / (1 + (STEEP / steepest[steep, None]) ** STEEP_EXPONENT)
    adjacency = links(pairs, len(weights))[steep]
    mean = adjacency / adjacency.sum(axis=1)[:, None]
    weights = weights.copy()
    for _ in range(SMOOTHED):
        weights[steep] += share * (mean @ weights - weights[steep])
    return weights


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Connected pieces of a surface."""

    piece: Int[np.ndarray, " V"]
    """Of each vertex."""
    vertex_area: Float[np.ndarray, " V"]
    area: Float[np.ndarray, " P"]

    @classmethod
    def of(
        cls, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], pairs: Int[np.ndarray, "E 2"]
    ) -> _Pieces:
        """Find the pieces of a surface with some edges."""
        piece = component_labels(pairs, len(vertices))
        vertex_area = vertex_areas(vertices, faces)
        return cls(piece, vertex_area, np.bincount(piece, vertex_area))

    @property
    def parts(self) -> Bool[np.ndarray, " P"]:
        """Which pieces have an area, and are not the figure itself."""
        return (self.area > 0) & (self.area < LARGEST_PART * self.area.sum())

    def summed(self, weights: Float[np.ndarray, "V J"]) -> Float[np.ndarray, "P J"]:
        """Add up weights over each piece, by area."""
        return np.stack([np.bincount(self.piece, column * self.vertex_area) for column in weights.T], axis=1)


def _of_one_limb(
    weights: Float[np.ndarray, "V J"],
    predicted: Float[np.ndarray, "V J"],
    pieces: _Pieces,
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    nearest: NearestBody,
) -> Float[np.ndarray, "V J"]:
    """Give solid pieces to the joints of the one limb, or of the trunk, that most of them is predicted for."""
    from scipy.spatial import ConvexHull, QhullError

    # Solid pieces are closed and convex; flat ones are not.
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]  # corners that share a position have no volume
    solid = pieces.parts & (pieces.area > SOLID_AREA * pieces.area.sum())
    solid[pieces.piece[border_edges(faces).ravel()]] = False
    # Six times the signed volumes of the tetrahedra from the origin to each face: of a closed piece, all that counts.
    signed = (face_vectors(vertices, faces) * vertices[faces[:, 0]]).sum(axis=1) / 6
    volume = np.abs(np.bincount(pieces.piece[faces[:, 0]], signed, minlength=len(solid)))
    for k in np.flatnonzero(solid):
        try:
            solid[k] = volume[k] > SOLID * ConvexHull(vertices[pieces.piece == k]).volume
        except QhullError:
            solid[k] = False
    if not solid.any():
        return weights
    mixed = (1 - BODY_SHARE) * predicted + BODY_SHARE * nearest.weights
    summed, limbs = pieces.summed(mixed), _limbs(nearest.body)
    votes = np.stack([summed[:, joints].sum(axis=1) for joints in limbs], axis=1)
    limb = votes.argmax(axis=1)
    solid &= np.sort(votes[:, 2:], axis=1)[:, -2] < OTHER_LIMB * votes.max(axis=1)  # trousers may be closed
    rest = pieces.summed(weights)[~solid].sum(axis=0)
    held = np.array([rest[joints].sum() for joints in limbs])
    held += np.bincount(limb[solid], pieces.area[solid], minlength=len(limbs))
    # Figures have all limbs: one that hardly any of the surface is of gets the solid piece that it narrowly lost.
    for lost in np.flatnonzero(held < LEAST_LIMB * pieces.area.sum()):
        best = int(np.where(solid, votes[:, lost], 0.0).argmax())
        if votes[best, lost] > NARROW * votes[best].max():
            limb[best] = lost
    of_limb = np.stack([np.isin(np.arange(weights.shape[1]), joints) for joints in limbs])
    summed = np.where(of_limb[limb], summed, 0.0)
    summed /= np.maximum(summed.sum(axis=1, keepdims=True), 1e-30)
    rows = np.flatnonzero(solid[pieces.piece])
    piece = pieces.piece[rows]
    kept = np.where(of_limb[limb[piece]], predicted[rows], 0.0)
    weights = weights.copy()
    weights[rows] = kept + (1 - kept.sum(axis=1, keepdims=True)) * summed[piece]
    return weights


def _rigid_pieces(
    weights: Float[np.ndarray, "V J"], pieces: _Pieces, nearest: NearestBody | None
) -> Float[np.ndarray, "V J"]:
    """Give pieces of the surface that one joint moves to this joint alone."""
    piece, area = pieces.piece, pieces.area
    mixed = weights if nearest is None else (1 - BODY_SHARE) * weights + BODY_SHARE * nearest.weights
    summed = pieces.summed(mixed)
    joint, share = summed.argmax(axis=1), summed.max(axis=1) / np.maximum(area, 1e-30)
    small = area < SMALL_AREA * area.sum()
    rigid = (area > 0) & ((share > RIGID_SHARE) | (small & (share > SMALL_SHARE)))
    if nearest is not None:
        parts = ~rigid & pieces.parts
        size = np.bincount(piece)
        blocks = parts & (size <= BLOCK_VERTICES) & (area > BLOCK_AREA * area.sum())
        for k in np.flatnonzero(blocks):
            joint[k], rigid[k] = _block_joint(summed[k], nearest.body), True
        members = np.split(np.argsort(piece, kind="stable"), np.cumsum(size)[:-1])
        for k in np.flatnonzero(parts & ~blocks):
            away = nearest.distance[members[k]]
            if np.median(away) > FAR:
                near = members[k][np.argsort(away)[: max(3, int(ATTACHED * len(away)))]]
                joint[k], rigid[k] = int(mixed[near].sum(axis=0).argmax()), True
    if not rigid.any():
        return weights
    moved_by_one = np.flatnonzero(rigid[piece])
    weights = weights.copy()
    weights[moved_by_one] = np.eye(weights.shape[1])[joint[piece[moved_by_one]]]
    return weights


def _block_joint(weights: Float[np.ndarray, " J"], body: str) -> int:
    limb = max(_limbs(body), key=lambda joints: weights[joints].sum())
    parents, total = sampled_body(body).parents, weights[limb].sum()
    shares = {j: weights[np.intersect1d(limb, descendants([int(j)], parents))].sum() for j in limb}
    return int(max(j for j, share in shares.items() if share >= LIMB_SHARE * total))  # children come after parents


@cache
def _limbs(name: str) -> list[Int[np.ndarray, " L"]]:
    body = sampled_body(name)
    limbs = [np.array(joints) for joints in limb_joints(body.names, body.parents).values()]
    return [np.setdiff1d(np.arange(len(body.parents)), np.concatenate(limbs)), *limbs]


def bone_distances(
    parents: tuple[int, ...], counts: Mapping[int, int] = MappingProxyType({})
) -> Int[np.ndarray, "J J"]:
    """Count the bones on the path between each two joints.

    Args:
        parents: of each joint; the root's is -1.
        counts: joint -> as how many bones that from its parent counts, where that is not one.
    """
    distance = np.zeros((len(parents), len(parents)), np.int64)
    for j, parent in enumerate(parents):
        if parent >= 0:  # parents come before their children: all distances of the parent are known
            distance[j, :j] = distance[:j, j] = distance[parent, :j] + counts.get(j, 1)
    return distance


def inpainted(
    weights: Float[np.ndarray, "V J"], wrong: Bool[np.ndarray, " V"], pairs: Int[np.ndarray, "E 2"]
) -> Float[np.ndarray, "V J"]:
    """Replace wrong weights by the solution of Laplace's equation, the weights of all other vertices being fixed.

    Each replaced weight is then the mean of those of its neighbours: n w_i = sum of w_j over the n neighbours j. With
    the unknown neighbours on the left and the known ones on the right this is one sparse linear system.
    """
    from scipy.sparse import csr_array, diags_array

    adjacency = links(pairs, len(weights))[wrong]
    laplacian = diags_array(adjacency.sum(axis=1)) - adjacency[:, wrong]
    inpainted = weights.copy()
    inpainted[wrong] = factor(csr_array(laplacian)).solve(adjacency[:, ~wrong] @ weights[~wrong])
    return inpainted


def with_whole_tail(
    weights: Float[np.ndarray, "V J"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    names: tuple[str, ...],
    parents: tuple[int, ...],
) -> Float[np.ndarray, "V J"]:
    """Return weights in which no tail is held by hind legs; the same where there is none, and of other bodies."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    if TAIL not in names or len(faces) == 0:
        return weights
    strongest, pairs = weights.argmax(axis=1), edges(faces)
    knees = {leg[0].removesuffix("Thigh"): leg[1] for leg in QUADRUPED.legs if leg[0].endswith("Thigh")}
    left, right = (np.isin(strongest, descendants([names.index(knees[side])], parents)) for side in SIDES)
    tail = np.isin(strongest, descendants([names.index(TAIL)], parents))
    first, second = pairs.T
    border = pairs[(left[first] & right[second]) | (right[first] & left[second])]
    if len(border) == 0 or not tail.any():
        return weights
    low = left | right
    part = component_labels(pairs[low[first] & low[second]], len(vertices))
    both = np.isin(part, part[border[:, 0]]) & low
    # Along the surface, the tip is farthest from what is known as tail; what is nearer to it than that is tail, too.
    length = np.linalg.norm(vertices[first] - vertices[second], axis=1)
    surface = coo_array((np.maximum(length, 1e-9), (first, second)), shape=2 * (len(vertices),)).tocsr()
    from_tail = dijkstra(surface, directed=False, indices=np.flatnonzero(tail), min_only=True)
    reached = both & np.isfinite(from_tail)  # a separate piece that two legs hold is no tail's
    tip = int(np.where(reached, from_tail, -1.0).argmax())
    from_tip = dijkstra(surface, directed=False, indices=tip)
    found = from_tip < from_tip[tail].min()
    area = vertex_areas(vertices, faces)
    whole = min(area[of_leg & ~found].sum() for of_leg in (left, right)) > SMALLEST_LEG * area.sum()
    if not (found.any() and reached[tip] and whole and area[found].sum() < LARGEST_TAIL * area.sum()):
        return weights
    return inpainted(weights, found, pairs)


def corrected_weights(
    weights: Float[np.ndarray, "N J"],
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    displacement: Float[np.ndarray, "J 3"],
    posed: PosedBody,
) -> Float[np.ndarray, "N J"]:
    """Replace predicted weights by those of the fitted body, around the joints that are not where they were predicted.

    Args:
        weights: predicted for the points.
        points: of the surface.
        normals: of the surface, zero where they are not known.
        displacement: of the joints from where they were predicted.
        posed: the fitted body.
    """
    far = np.linalg.norm(displacement, axis=1) > MOVED * posed.state.size
    # A joint turns the bones below it: those of the parent of a displaced joint have changed, too.
    changed = far.copy()
    changed[[posed.body.parents[j] for j in np.flatnonzero(far) if j > 0]] = True
    # The mean weights of the points of the body that are nearest to each point, and whose normals agree.
    distance, nearest = nearest_points(posed.points, points, NEAREST)
    agreement = np.einsum("nkc,nc->nk", posed.normals[nearest], normals)
    cost = distance + NORMAL_DISTANCE * posed.state.size * (1 - agreement)
    near = np.exp(-np.square((cost - cost.min(axis=1, keepdims=True)) / (BLUR * posed.state.size)))
    of_body = np.einsum("nk,nkj->nj", near / near.sum(axis=1, keepdims=True), posed.body.weights[nearest])
    share = np.maximum(weights[:, changed].sum(axis=1), of_body[:, changed].sum(axis=1))[:, None].clip(0, 1)
    return (1 - share) * weights + share * of_body


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
    def of(cls, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int) -> CoarseSurface:
        """Keep one vertex of each cell of a grid and octant of normals: sheets that face each other stay apart.

        Args:
            count: of cells in the area of the surface; two or three times as many points are kept.
        """
        octant = (vertex_normals(vertices, faces) > 0) @ np.array([1, 2, 4])
        found = clusters(vertices, faces, count, octant)
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
