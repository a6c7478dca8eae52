"""Deformation transfer (Sumner and Popović, SIGGRAPH 2004): the baseline without learning in NPT's Table 1.

It needs what no other method here does: a third mesh, the driving subject in the identity's pose (the reference), and
matches of triangles. Every driving triangle has an affine map from the reference to each frame, whose linear part is
the deformation gradient S = V' V^-1 (3 x 3). The columns of V, and of V' in the frame, are two edges of
the triangle and the offset to a fourth vertex along its normal (`triangle_frames`). Each identity triangle takes the S
of its match, and the vertices follow by least squares: its own gradients T minimise the sum of ||T - S||^2.

The fourth vertex that the paper adds to an identity triangle is in no other triangle, so it meets its S exactly and
drops out: only vertices are solved for. Departures from the paper:

* Triangles are weighted by area, not alike (PMD on validation people with true correspondence 2.0e-4 against 2.1e-4 for
  unseen poses, 3.1e-4 against 3.4e-4 for seen ones), and one with several matches takes the mean of their S.
* Connected components are tied to each other, by the driving triangles around them; the paper's meshes have only one.
* Thin triangles are left out of the identity, and replaced by their neighbours in the reference.
* Gradients leave the position open: each frame is centred where the driving's is (`with_root_motion`), where the paper
  constrains the position of a vertex.
* The reference is turned to the identity's heading, so that the result heads as the driving's first frame does.

Triangles are matched by vertex index, or by the paper's registration from a few marked vertices: the identity is
deformed onto the reference by three quadratic energies, of the affine maps T of its triangles (3 x 3) and of its
vertices v:

    E_S = sum over adjacent triangles i, j of ||T_i - T_j||^2    (smoothness)
    E_I = sum over triangles i of ||T_i - I||^2                  (identity)
    E_C = sum over vertices i of ||v_i - c_i||^2                 (c_i: the closest valid point of the reference)

T is the gradient in the triangle's plane plus one free vector for the image of its normal, which is what the paper's
fourth vertex stands for. Both meshes must have one pose; of the heading, quarter turns are undone (`quarter_turn`).
Departures from the paper:

* Its target (our identity) is deformed onto its source (our reference), where the paper deforms source onto target.
* Markers are quadratic terms of a large weight (MARKER_WEIGHT), where the paper makes constraints of them.
* A small term (REST_WEIGHT) keeps vertices near their start, so that parts without a marker have a position.
* The closest valid point is the nearest on the surface of the few triangles whose centroids are nearest.
* One solve with markers alone, then one for each of CLOSEST_WEIGHTS (the paper's range), each with new closest points.
* n triangles at one edge are compared in n - 1 pairs, not each with each.
* A match is the nearest centroid, among CANDIDATES, that faces the same way. The paper's threshold (MAX_DISTANCE) holds
  only for matches that reference triangles look for: each identity triangle gets a match at any distance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import fsum
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.canonical_order import canonical_faces, canonical_order
from ..core.errors import InputError, option
from ..core.geometry import (
    closest_on_mesh,
    component_labels,
    edges,
    face_areas,
    face_normals,
    face_vectors,
    factor,
    gradient_operator,
    nearest_points,
    vertex_normals,
)
from ..core.mesh import Clip, Mesh
from .base import Drive, with_root_motion

if TYPE_CHECKING:
    from scipy.sparse import csr_array

TIE_WEIGHT = 1e-4
"""Weight of a tie between connected components, where an edge of the mesh has about 1."""
TIE_NEIGHBOURS = 8
"""Nearest points of a vertex among which those of other components are tied to it."""
MAX_SIZE_RATIO = 10.0
"""Ratio of the reference's size to the driving mesh's from which on it is refused: it must be in another unit."""
Corners = Int[np.ndarray, "P 3"]
"""Vertex indices of P triangles; row k of two such arrays is one match."""
MIN_HEIGHT = 1e-4
"""Smallest height of a triangle, as a share of its longest edge. Thinner ones have no reliable gradient."""
IDENTITY_WEIGHT = 1e-3
"""Weight of E_I, where E_S has 1 (the paper's)."""
CLOSEST_WEIGHTS = (1, 1, 10, 10, 100, 100, 1000, 1000, 5000, 5000)
"""Weights of E_C, one solve each (the paper's range, 1 to 5000), for lengths in the unit sphere."""
MARKER_WEIGHT = 1e6
"""Weight of the squared distance of a marked vertex from its target."""
REST_WEIGHT = 1e-4
"""Weight of a vertex's squared distance from its start: decides only what no other term determines."""
CANDIDATES = 30
"""Nearest triangles among which one that faces the same way is searched."""
MAX_DISTANCE = 0.05
"""Largest distance (unit-sphere lengths) between the centroids of a reference triangle and the match it looks for."""


@dataclass(frozen=True, eq=False)
class DeformationTransfer:
    """The method `deformation-transfer`, for one driving subject."""

    reference: Mesh | None
    """The driving subject in the identity's pose, with the driving's vertices, faces and normalisation; any heading."""
    markers: Int[np.ndarray, "M 2"] | None = None
    """Pairs (identity vertex, reference vertex) that correspond; without them vertex i of both corresponds."""
    rough: ClassVar[bool] = False
    name: str = "deformation-transfer"

    def prepare(self, identity: Mesh, driving: Clip) -> Drive:
        """Match triangles and factor the identity's system, once for all frames.

        Raises:
            InputError: no reference, one of another topology or unit than the driving mesh, or nothing to match by.
        """
        reference = _checked(self.reference, driving.mesh)
        pairs = vertex_pairs(identity, reference, self.markers)
        # The reference comes in the normalisation of the driving's first frame, in which it may have any heading.
        turn = quarter_turn(reference.vertices[pairs[:, 1]], identity.vertices[pairs[:, 0]])
        # + 0.0: no negative zeros, they would sort apart.
        reference = dataclasses.replace(reference, vertices=reference.vertices @ turn.T + 0.0)
        if self.markers is None:
            identity_corners, driving_corners = match_by_index(identity, reference, driving.mesh)
        else:
            identity_corners, driving_corners = match_by_markers(identity, reference, driving.mesh, self.markers)
        ranked = canonical_order(identity.vertices)
        rest = reference.vertices[driving_corners]
        solve = deformation_solver(ranked.merge(identity.vertices), ranked.group[identity_corners], rest)

        def pose(vertices: Float[np.ndarray, "U 3"]) -> Float[np.ndarray, "V 3"]:
            return solve(vertices[driving_corners])[ranked.group]

        return lambda frames: with_root_motion(frames, partial(map, pose), driving.mesh.name)


def _checked(reference: Mesh | None, driving: Mesh) -> Mesh:
    if reference is None:
        raise InputError(
            f"{driving.name}: expected the same subject in the identity's pose beside it for model "
            f"deformation-transfer, found none; give that mesh with {option('reference', ...)}"
        )
    if len(reference.vertices) != len(driving.vertices) or not np.array_equal(reference.faces, driving.faces):
        raise InputError(
            f"{reference.name}: expected the vertices and faces of {driving.name} ({len(driving.vertices)} and "
            f"{len(driving.faces)}), found others ({len(reference.vertices)} and {len(reference.faces)}); "
            "export both poses from one file"
        )
    size, reference_size = (
        (
            float(
                np.linalg.norm(mesh.vertices[mesh.faces] - mesh.vertices[np.roll(mesh.faces, 1, axis=1)], axis=-1).sum()
            )
        )
        for mesh in (driving, reference)
    )
    if not size / MAX_SIZE_RATIO <= reference_size <= size * MAX_SIZE_RATIO:
        raise InputError(
            f"{option('reference')}: expected the size of {driving.name}, found {reference_size / size:.3g} times "
            "the driving's "
            "size; export both poses from one file, in one unit"
        )
    return reference


def vertex_pairs(identity: Mesh, reference: Mesh, markers: Int[np.ndarray, "M 2"] | None) -> Int[np.ndarray, "N 2"]:
    """Return corresponding vertices as (identity vertex, reference vertex): the markers, or all vertices without them.

    Raises:
        InputError: without markers, vertex counts or faces differ; with markers, one of them is no vertex, or fewer
            than three positions are marked.
    """
    if markers is None:
        if len(identity.vertices) != len(reference.vertices) or not np.array_equal(identity.faces, reference.faces):
            raise InputError(
                f"{reference.name}: expected the vertices and faces of {identity.name} ({len(identity.vertices)} and "
                f"{len(identity.faces)}), found others ({len(reference.vertices)} and {len(reference.faces)}); "
                f"give pairs of matching vertices with {option('markers', ...)}"
            )
        return np.stack([np.arange(len(identity.vertices))] * 2, axis=1)
    for column, mesh in zip(markers.T, (identity, reference), strict=True):
        wrong = column[(column < 0) | (column >= len(mesh.vertices))]
        if wrong.size:
            raise InputError(
                f"{option('markers')}: expected vertices of {mesh.name} in 0..{len(mesh.vertices) - 1}, found "
                f"{wrong[0]}; "
                "rows are (identity vertex, reference vertex), counted from 0"
            )
        distinct = len(np.unique(mesh.vertices[column], axis=0))
        if distinct < 3:
            raise InputError(
                f"{option('markers')}: expected 3 or more places on {mesh.name}, found {distinct}; mark head, hands "
                "and feet"
            )
    return markers


def triangle_frames(triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "P 3 3"]:
    """Return the matrices V of triangles: columns are two edges and the normal over the square root of its length.

    The root makes the third column scale as the edges do (the paper's fourth vertex). Zero where there is no area.
    """
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    third = normal / np.sqrt(np.where(length > 0, length, 1.0))
    return np.stack([triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0], third], axis=-1)


def deformation_solver(
    vertices: Float[np.ndarray, "W 3"], faces: Int[np.ndarray, "P 3"], rest: Float[np.ndarray, "P 3 3"]
) -> Callable[[Float[np.ndarray, "P 3 3"]], Float[np.ndarray, "W 3"]]:
    """Return a function from deformed driving triangles, one a face, to the vertices whose gradients match theirs best.

    `rest` are the same triangles in the reference. The position of the result as a whole is arbitrary. A face that
    occurs several times follows the mean gradient of its triangles. Ties (see `component_ties`) fix the offsets between
    connected components; their weight is too small to deform any.

    With G the gradient operator, A the areas and B the differences at the ties, the vertices x minimise
    ||G x - S||^2 weighted by A, plus TIE_WEIGHT ||B x - offsets||^2. The normal equations are
    (G^T A G + TIE_WEIGHT B^T B) x = G^T A S + TIE_WEIGHT B^T offsets. The matrix is the same in every frame.
    """
    from scipy.sparse import csr_array

    gradient = gradient_operator(vertices, faces)
    # One over the number of times that each face occurs: the shares of a face add up to one.
    _, index, count = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    share = 1.0 / count[index.reshape(-1)]
    divergence = csr_array(gradient.T.multiply(np.repeat(share * face_areas(vertices, faces), 3)))
    ties = component_ties(vertices, faces)
    offsets = tie_offsets(vertices, faces, share, rest, ties)
    rows = np.repeat(np.arange(len(ties)), 2)
    difference = csr_array((np.tile([1.0, -1.0], len(ties)), (rows, ties.ravel())), shape=(len(ties), len(vertices)))
    # The first vertex is fixed at the origin, which makes the matrix invertible: gradients leave the position open.
    system = factor(csr_array(divergence @ gradient + TIE_WEIGHT * (difference.T @ difference))[1:, 1:])
    rest_inverse = np.linalg.inv(triangle_frames(rest))

    def solve(triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "W 3"]:
        gradients = triangle_frames(triangles) @ rest_inverse  # S of each triangle
        tie_side = difference.T @ offsets(gradients, triangles)
        right_side = divergence @ gradients.transpose(0, 2, 1).reshape(-1, 3) + TIE_WEIGHT * tie_side
        return np.concatenate([np.zeros((1, 3)), system.solve(right_side[1:])])

    return solve


def tie_offsets(
    vertices: Float[np.ndarray, "W 3"],
    faces: Int[np.ndarray, "P 3"],
    share: Float[np.ndarray, " P"],
    rest: Float[np.ndarray, "P 3 3"],
    ties: Int[np.ndarray, "T 2"],
) -> Callable[[Float[np.ndarray, "P 3 3"], Float[np.ndarray, "P 3 3"]], Float[np.ndarray, "T 3"]]:
    """Return a function from gradients and driving triangles to the offset of each tie, from second to first end.

    The position of each end is predicted by the driving triangles around it, scaled to the identity's size. What this
    does not explain of the offset at rest is turned and stretched by the mean gradient there. So a shoe moves with its
    foot, and a hand that touches the hip can leave it.
    """
    from scipy.sparse import csr_array

    first, second = ties.T
    shape = (len(vertices), len(faces))
    at = csr_array((np.repeat(share, 3), (faces.ravel(), np.repeat(np.arange(len(faces)), 3))), shape=shape)
    count = np.asarray(at.sum(axis=1))[:, None]
    tie_count, known = count[first] + count[second], (count[first] > 0) & (count[second] > 0)
    weight = share * face_areas(vertices, faces)
    identity_radius, reference_radius = (_rms_radius(triangles, weight) for triangles in (vertices[faces], rest))
    # Where all triangles are at one point there is no size to compare.
    scale = identity_radius / reference_radius if reference_radius > 1e-9 else 1.0
    # Of each vertex, from the mean centroid of its triangles.
    from_centroid = vertices - (at @ vertices[faces].mean(axis=1)) / np.maximum(count, 1)

    def predicted(triangles: Float[np.ndarray, "P 3 3"], total: Float[np.ndarray, "W 9"]) -> Float[np.ndarray, "T 3"]:
        """Offset of the ends as the triangles have them; `total` is the sum of the gradients at each vertex."""
        deformed = np.einsum("wkl,wl->wk", total.reshape(-1, 3, 3), from_centroid)
        positions = (scale * (at @ triangles.mean(axis=1)) + deformed) / np.maximum(count, 1)
        return (positions[first] - positions[second]) * known

    unexplained = vertices[first] - vertices[second] - predicted(rest, count * np.eye(3).ravel())

    def offsets(
        gradients: Float[np.ndarray, "P 3 3"], triangles: Float[np.ndarray, "P 3 3"]
    ) -> Float[np.ndarray, "T 3"]:
        total = at @ gradients.reshape(-1, 9)
        mean = (total[first] + total[second]) / np.maximum(tie_count, 1)
        mean = np.where(tie_count > 0, mean, np.eye(3).ravel()).reshape(-1, 3, 3)
        return np.einsum("tkl,tl->tk", mean, unexplained) + predicted(triangles, total)

    return offsets


def component_ties(points: Float[np.ndarray, "W 3"], faces: Int[np.ndarray, "P 3"]) -> Int[np.ndarray, "T 2"]:
    """Return pairs of points of different connected components: near neighbours, and a spanning tree for the rest."""
    joined = edges(faces)
    label, count = component_labels(joined, len(points)), min(TIE_NEIGHBOURS + 1, len(points))
    near = nearest_points(points, points, count)[1]
    pairs = np.stack([np.repeat(np.arange(len(points)), count), near.ravel()], axis=1)
    pairs = np.unique(np.sort(pairs[label[pairs[:, 0]] != label[pairs[:, 1]]], axis=1), axis=0)
    return np.concatenate([pairs, spanning_ties(points, np.concatenate([joined, pairs]))])


def spanning_ties(points: Float[np.ndarray, "W 3"], joined: Int[np.ndarray, "L 2"]) -> Int[np.ndarray, "T 2"]:
    """Return pairs of nearest points that join all components of a graph: a minimum spanning tree (Borůvka's).

    C components give C - 1 pairs. In each round every component but the largest is joined to its nearest one.
    """
    label, ties = component_labels(joined, len(points)), np.zeros((0, 2), np.int64)
    while label.any():
        source = np.flatnonzero(label != np.bincount(label).argmax())
        # Of each point the nearest of another label. Labels that differ do so in some bit: for each bit, it is searched
        # among the points with the other value. So L labels need about 2 log2 L k-d trees, not L.
        best, nearest = np.full(len(source), np.inf), np.zeros(len(source), np.int64)
        for bit in range(int(label.max()).bit_length()):
            side = label >> bit & 1
            for value in (0, 1):
                queries, others = (np.flatnonzero(mask) for mask in (side[source] == value, side != value))
                distance, index = nearest_points(points[others], points[source[queries]])
                closer = distance < best[queries]
                best[queries[closer]], nearest[queries[closer]] = distance[closer], others[index[closer]]
        distance = best
        order = np.lexsort((source, distance))
        order = order[np.unique(label[source[order]], return_index=True)[1]]  # the shortest pair of each component
        pairs = np.stack([source[order], nearest[order]], axis=1)
        ties = np.concatenate([ties, without_cycles(pairs, distance[order], label)])
        label = component_labels(np.concatenate([joined, ties]), len(points))
    return ties


def without_cycles(
    pairs: Int[np.ndarray, "T 2"], distance: Float[np.ndarray, " T"], label: Int[np.ndarray, " W"]
) -> Int[np.ndarray, "S 2"]:
    """Return the pairs that join labels into trees: two labels once, and of a cycle of equal distances not the last."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import minimum_spanning_tree

    pairs = pairs[np.lexsort((pairs[:, 0], distance))]
    sides, first = np.unique(np.sort(label[pairs], axis=1), axis=0, return_index=True)
    count = int(label.max()) + 1
    tree = minimum_spanning_tree(csr_array((first + 1.0, sides.T), shape=(count, count)))
    return pairs[tree.data.astype(np.int64) - 1]


def _rms_radius(triangles: Float[np.ndarray, "P 3 3"], weight: Float[np.ndarray, " P"]) -> float:
    """Return the weighted root mean square distance of triangles from their centroid, whatever their number."""
    points, weight = triangles.mean(axis=1), weight / weight.sum()
    return float(np.sqrt(weight @ np.square(points - weight @ points).sum(axis=1)))


def quarter_turn(points: Float[np.ndarray, "N 3"], targets: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the rotation about y by a multiple of 90 degrees that brings points nearest to targets in the mean square.

    Position and size do not matter. Where turns are equally good the smaller wins. Sums are exact to the last bit, so
    that the order of the points does not matter either.
    """
    (x, _, z), (to_x, _, to_z) = (columns - [[fsum(c) / len(c)] for c in columns] for columns in (points.T, targets.T))
    # A turn by an angle a changes the squared distances by -2 (dot cos a + cross sin a): the largest gain is the best.
    dot, cross = fsum(x * to_x + z * to_z), fsum(z * to_x - x * to_z)
    gains = np.array([dot, cross, -cross, -dot])  # of 0, 90, 270 and 180 degrees
    best = int(np.argmax(gains >= gains.max() - 1e-9 * np.abs(gains).max()))
    cosine, sine = ((1, 0), (0, 1), (0, -1), (-1, 0))[best]
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]], float)


def match_by_index(identity: Mesh, reference: Mesh, driving: Mesh) -> tuple[Corners, Corners]:
    """Match the triangles of meshes with one topology; return the corners in the identity and in the reference.

    The order of the matches does not depend on the order of vertices and faces. A thin triangle of the reference is
    replaced by the nearest one that is not thin.
    """
    ranks = [canonical_order(mesh.vertices).group for mesh in (identity, reference, driving)]
    identity_corners = canonical_faces(well_shaped_faces(identity), *ranks)
    candidates = canonical_faces(well_shaped_faces(reference), *ranks)
    thin = ~_well_shaped(reference.vertices, identity_corners)
    reference_corners = identity_corners.copy()
    thin_triangles = reference.vertices[identity_corners[thin]]
    nearest = _nearest_centroid(thin_triangles, reference.vertices[candidates], 1)[:, 0]
    reference_corners[thin] = candidates[nearest]
    return identity_corners, reference_corners


def match_by_markers(
    identity: Mesh, reference: Mesh, driving: Mesh, markers: Int[np.ndarray, "M 2"]
) -> tuple[Corners, Corners]:
    """Match the triangles of any two meshes, from pairs (identity vertex, reference vertex).

    The identity is registered onto the reference; then each identity triangle gets its best match in the reference, and
    each reference triangle that faces one of the identity within MAX_DISTANCE is added with that one. So an identity
    triangle may have several matches.
    """
    ranked = canonical_order(identity.vertices)
    reference_rank = canonical_order(reference.vertices).group
    identity_corners = canonical_faces(well_shaped_faces(identity), ranked.group)
    reference_corners = canonical_faces(
        well_shaped_faces(reference), reference_rank, canonical_order(driving.vertices).group
    )
    # All sums below run in an order that does not depend on that of vertices, faces or markers.
    order = np.lexsort((reference_rank[markers[:, 1]], ranked.group[markers[:, 0]]))
    marked, marked_reference = markers[order].T
    vertices, faces = ranked.merge(identity.vertices), ranked.group[identity_corners]
    # The reference, scaled and shifted so that markers have the centroid and the spread of their targets.
    targets, places = identity.vertices[marked], reference.vertices[marked_reference]
    spread = [np.square(points - points.mean(axis=0)).sum() for points in (targets, places)]
    positions = (reference.vertices - places.mean(axis=0)) * np.sqrt(spread[0] / spread[1]) + targets.mean(axis=0)
    target = positions[reference_corners]
    registered = register(vertices, faces, target, ranked.group[marked], positions[marked_reference])[faces]
    to_reference, _ = matching_triangles(registered, target)
    to_identity, same_facing = matching_triangles(target, registered)
    distance = np.linalg.norm(target.mean(axis=1) - registered[to_identity].mean(axis=1), axis=1)
    near = same_facing & (distance <= MAX_DISTANCE)
    return (
        np.concatenate([identity_corners, identity_corners[to_identity[near]]]),
        np.concatenate([reference_corners[to_reference], reference_corners[near]]),
    )


def register(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    target: Float[np.ndarray, "G 3 3"],
    marked: Int[np.ndarray, " M"],
    marker_targets: Float[np.ndarray, "M 3"],
) -> Float[np.ndarray, "V 3"]:
    """Deform a mesh smoothly onto target triangles, marked vertices onto their targets.

    Lengths are in the unit sphere; every triangle must have an area. Each of the eleven solves factors V + F unknowns:
    on one core 0.3 s for 7,000 vertices and 8 s for 110,000, so about three minutes and 2 GB in all for 200,000.
    """
    from scipy.sparse import diags_array

    # The unknowns are displacements, for which E_S and E_I are exactly zero at the start. Their entries (one over a
    # triangle's height, squared) are so large beside REST_WEIGHT that with positions as unknowns rounding errors would
    # move parts without a marker.
    smoothness, maps = registration_terms(vertices, faces)
    count, unknowns = len(vertices), len(vertices) + len(faces)
    quadratic = smoothness.T @ smoothness + IDENTITY_WEIGHT * (maps.T @ maps)
    marker_side = np.zeros((unknowns, 3))
    np.add.at(marker_side, marked, MARKER_WEIGHT * (marker_targets - vertices[marked]))
    diagonal = REST_WEIGHT * (np.arange(unknowns) < count) + MARKER_WEIGHT * np.bincount(marked, minlength=unknowns)
    displacement = factor(quadratic + diags_array(diagonal)).solve(marker_side)[:count]
    for weight in CLOSEST_WEIGHTS:
        points, valid = closest_valid(vertices + displacement, faces, target)
        closest_weight = np.zeros(unknowns)
        closest_weight[:count] = weight * valid
        right_side = marker_side.copy()
        right_side[:count] += closest_weight[:count, None] * (points - vertices)
        displacement = factor(quadratic + diags_array(diagonal + closest_weight)).solve(right_side)[:count]
    return vertices + displacement


def registration_terms(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[csr_array, csr_array]:
    """Return the sparse matrices of E_S, (3 S, V + F), and of E_I, (3 F, V + F).

    Unknowns are the vertices, then the images of the triangles' unit normals. Rows 3 f to 3 f + 2 of the second times
    the unknowns are the transpose of T_f; the first gives the differences of T for the S pairs of adjacent triangles.
    """
    from scipy.sparse import csr_array, hstack, kron

    normals, count = face_normals(vertices, faces), len(faces)
    normal_images = csr_array((normals.ravel(), (np.arange(3 * count), np.repeat(np.arange(count), 3))))
    maps = csr_array(hstack([gradient_operator(vertices, faces), normal_images]))
    pairs = faces_at_edges(faces)
    rows = np.repeat(np.arange(len(pairs)), 2)
    difference = csr_array((np.tile([1.0, -1.0], len(pairs)), (rows, pairs.ravel())), shape=(len(pairs), count))
    return csr_array(kron(difference, np.eye(3)) @ maps), maps


def faces_at_edges(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "S 2"]:
    """Return pairs of faces that share an edge; n faces at one edge give n - 1 pairs."""
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort((sides[:, 1], sides[:, 0]))
    shared = (sides[order][1:] == sides[order][:-1]).all(axis=1)
    face = order // 3
    return np.stack([face[:-1][shared], face[1:][shared]], axis=1)


def closest_valid(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], target: Float[np.ndarray, "G 3 3"]
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, " V"]]:
    """Find the closest target point of each vertex that faces the same way (within 90 degrees), and if there is one."""
    corners = np.arange(3 * len(target)).reshape(-1, 3)
    face, barycentric, distance = closest_on_mesh(
        vertices, target.reshape(-1, 3), corners, normals=vertex_normals(vertices, faces)
    )
    return np.einsum("vk,vkc->vc", barycentric, target[face]), np.isfinite(distance).astype(np.int64)


def matching_triangles(
    triangles: Float[np.ndarray, "P 3 3"], target: Float[np.ndarray, "G 3 3"]
) -> tuple[Int[np.ndarray, " P"], Bool[np.ndarray, " P"]]:
    """Find the nearest target by centroid, among CANDIDATES, that faces the same way, and whether there is one.

    Where none of them faces the same way the nearest is returned.
    """
    candidates = _nearest_centroid(triangles, target, min(CANDIDATES, len(target)))
    normals, target_normals = _normals_of(triangles), _normals_of(target)
    match, found = candidates[:, 0].copy(), np.zeros(len(candidates), bool)
    for column in candidates.T:
        remaining = np.flatnonzero(~found)
        found[remaining] = np.einsum("pc,pc->p", target_normals[column[remaining]], normals[remaining]) > 0
        match[remaining[found[remaining]]] = column[remaining[found[remaining]]]
    return match, found


def well_shaped_faces(mesh: Mesh) -> Int[np.ndarray, "F 3"]:
    """Return the faces whose gradient is reliable (see MIN_HEIGHT).

    Raises:
        InputError: there is none.
    """
    faces = mesh.faces[_well_shaped(mesh.vertices, mesh.faces)]
    if len(faces) == 0:
        raise InputError(
            f"{mesh.name}: expected triangles with area for model deformation-transfer, found none; give a surface mesh"
        )
    return faces


def _well_shaped(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Bool[np.ndarray, " F"]:
    """Whether each face is higher than MIN_HEIGHT times its longest edge; twice the area is height times edge."""
    sides = vertices[faces] - vertices[np.roll(faces, 1, axis=1)]
    longest = np.square(sides).sum(-1).max(axis=1, initial=0.0)
    return np.linalg.norm(face_vectors(vertices, faces), axis=1) > MIN_HEIGHT * longest


def _nearest_centroid(
    triangles: Float[np.ndarray, "P 3 3"], target: Float[np.ndarray, "G 3 3"], count: int
) -> Int[np.ndarray, "P K"]:
    """Return the `count` targets whose centroids are nearest to each triangle's, nearest first."""
    nearest = nearest_points(target.mean(axis=1), triangles.mean(axis=1), count)[1]
    return nearest.reshape(len(triangles), count)


def _normals_of(triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "P 3"]:
    return face_normals(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
