"""Match the triangles of two meshes: by vertex index, or by registration from a few marked vertices.

The registration is that of Sumner and Popović (SIGGRAPH 2004): the identity is deformed onto the reference by three
quadratic energies, of the affine maps T of its triangles (3 x 3) and of its vertices v:

    E_S = sum over adjacent triangles i, j of ||T_i - T_j||^2    (smoothness)
    E_I = sum over triangles i of ||T_i - I||^2                  (identity)
    E_C = sum over vertices i of ||v_i - c_i||^2                 (c_i: the closest valid point of the reference)

T is the gradient in the triangle's plane plus one free vector for the image of its normal, which is what the paper's
fourth vertex stands for. Both meshes must have one pose; of the heading, quarter turns are undone by `turn_reference`.

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
from math import fsum
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.canonical_order import canonical_faces, canonical_order
from ..core.errors import InputError
from ..core.geometry import closest_on_mesh, face_normals, face_vectors, factor, gradient_operator, vertex_normals
from ..core.mesh import Mesh

if TYPE_CHECKING:
    from scipy.sparse import csr_array

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


def vertex_pairs(identity: Mesh, reference: Mesh, markers: Int[np.ndarray, "M 2"] | None) -> Int[np.ndarray, "N 2"]:
    """Return corresponding vertices as (identity vertex, reference vertex): the markers, or all vertices without them.

    Raises:
        InputError: without markers, vertex counts or faces differ; with markers, one of them is no vertex, or fewer
            than three positions are marked.
    """
    if markers is not None:
        return _checked_markers(markers, identity, reference)
    if len(identity.vertices) != len(reference.vertices) or not np.array_equal(identity.faces, reference.faces):
        raise InputError(
            f"{reference.name}: expected the vertices and faces of {identity.name} ({len(identity.vertices)} and "
            f"{len(identity.faces)}), found others ({len(reference.vertices)} and {len(reference.faces)}); "
            "give pairs of matching vertices with --markers FILE"
        )
    return np.stack([np.arange(len(identity.vertices))] * 2, axis=1)


def turn_reference(reference: Mesh, identity: Mesh, pairs: Int[np.ndarray, "N 2"]) -> Mesh:
    """Turn the reference about y by the quarter turn that brings its vertices nearest to the identity's.

    The reference comes in the normalisation of the driving's first frame, in which it may have any heading.
    """
    turn = quarter_turn(reference.vertices[pairs[:, 1]], identity.vertices[pairs[:, 0]])
    # + 0.0: no negative zeros, they would sort apart.
    return dataclasses.replace(reference, vertices=reference.vertices @ turn.T + 0.0)


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

    Raises:
        InputError: no triangle is left.
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

    Raises:
        InputError: no triangle is left.
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
    positions = scale_onto(reference.vertices, reference.vertices[marked_reference], identity.vertices[marked])
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


def scale_onto(
    vertices: Float[np.ndarray, "V 3"], markers: Float[np.ndarray, "M 3"], targets: Float[np.ndarray, "M 3"]
) -> Float[np.ndarray, "V 3"]:
    """Scale and shift vertices so that markers have the centroid and the spread of their targets; nothing is turned."""
    centred, centred_targets = markers - markers.mean(axis=0), targets - targets.mean(axis=0)
    scale = np.sqrt(np.square(centred_targets).sum() / np.square(centred).sum())
    return (vertices - markers.mean(axis=0)) * scale + targets.mean(axis=0)


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
    from scipy.spatial import KDTree

    _, nearest = KDTree(target.mean(axis=1)).query(triangles.mean(axis=1), k=count)
    return nearest.reshape(len(triangles), count)


def _normals_of(triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "P 3"]:
    """Return unit normals of triangles given by their corners."""
    return face_normals(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


def _checked_markers(markers: Int[np.ndarray, "M 2"], identity: Mesh, reference: Mesh) -> Int[np.ndarray, "M 2"]:
    """Return the markers, checking that all are vertices and at least three positions are marked on each mesh."""
    for column, mesh in zip(markers.T, (identity, reference), strict=True):
        wrong = column[(column < 0) | (column >= len(mesh.vertices))]
        if wrong.size:
            raise InputError(
                f"--markers: expected vertices of {mesh.name} in 0..{len(mesh.vertices) - 1}, found {wrong[0]}; "
                "rows are (identity vertex, reference vertex), counted from 0"
            )
        distinct = len(np.unique(mesh.vertices[column], axis=0))
        if distinct < 3:
            raise InputError(
                f"--markers: expected 3 or more places on {mesh.name}, found {distinct}; mark head, hands and feet"
            )
    return markers
