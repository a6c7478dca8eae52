"""Which triangles of two meshes belong together: by vertex index, or from a few marked vertices.

From marks: the non-rigid registration of Sumner and Popović (SIGGRAPH 2004). The identity is deformed onto the
reference by three energies. Of the affine map T of each triangle (3 x 3): maps of neighbours agree (smoothness), and
stay near the identity matrix. Of each vertex: it comes near the closest valid point of the reference. T is the gradient
in the triangle's plane plus one free vector for the image of its normal, which is what the paper's fourth vertex stands
for. Both meshes must stand alike (one pose; of the heading, quarter turns are undone by `turned_alike`).

Departures from the paper:

* Its target (our identity) is deformed onto its source (our reference), where the paper deforms source onto target.
* Marks are held softly (HOLD), where the paper makes constraints of them.
* A small term (REST) keeps vertices where they start, so that parts without a mark have a place.
* The closest valid point is the nearest on the surface of the few triangles whose centroids are nearest.
* One solve with marks alone, then one for each of PULLS (the paper's range in steps of ours), with points found anew.
* n triangles at one edge are compared in n - 1 pairs, not each with each.
* A match is the nearest centroid, among NEAREST, that faces the same way. The paper's threshold (FAR) is asked only of
  those that a reference triangle looks for: each identity triangle has one of its own at any distance.
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

THIN = 1e-4
"""Triangles lower than this share of their longest edge have no reliable gradient and are left out."""
STAY = 1e-3
"""Weight of the maps' distance to the identity matrix, where that of the agreement of neighbours is 1 (the paper's)."""
PULLS = (1, 1, 10, 10, 100, 100, 1000, 1000, 5000, 5000)
"""Weights of the closest points, one solve each (the paper's range, 1 to 5000; squared unit-sphere lengths)."""
HOLD = 1e6
"""Weight of a marked vertex."""
REST = 1e-4
"""Weight of a vertex's distance from its start: decides only where parts stand that nothing holds yet."""
NEAREST = 30
"""Triangles looked at for one that faces the same way."""
FAR = 0.05
"""Farthest centroids (unit-sphere lengths) of a reference triangle and of the identity triangle that it adds to."""


def vertex_pairs(identity: Mesh, reference: Mesh, markers: Int[np.ndarray, "M 2"] | None) -> Int[np.ndarray, "N 2"]:
    """What is known to correspond, as (identity vertex, reference vertex): the markers, or all vertices without them.

    Raises:
        InputError: without markers, vertex counts or faces differ; a marked vertex that does not exist, or fewer than
            three marks apart.
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


def turned_alike(reference: Mesh, identity: Mesh, pairs: Int[np.ndarray, "N 2"]) -> Mesh:
    """The reference turned about y by the quarter turn at which its vertices stand most like the identity's.

    The frame that it comes in is that of the driving's first frame, which may face any other way.
    """
    turn = quarter_turn(reference.vertices[pairs[:, 1]], identity.vertices[pairs[:, 0]])
    # + 0.0: no negative zeros, they would sort apart.
    return dataclasses.replace(reference, vertices=reference.vertices @ turn.T + 0.0)


def quarter_turn(points: Float[np.ndarray, "N 3"], places: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "3 3"]:
    """The turn about y by a multiple of 90 degrees that brings points nearest to places in the mean square.

    Centroids are laid on each other; of sizes nothing depends. Where turns are equally good the smaller wins, and the
    sums are exact to the last bit, so that the order of the points cannot matter.
    """
    (x, _, z), (to_x, _, to_z) = (columns - [[fsum(c) / len(c)] for c in columns] for columns in (points.T, places.T))
    along, across = fsum(x * to_x + z * to_z), fsum(z * to_x - x * to_z)
    gains = np.array([along, across, -across, -along])  # of 0, 90, 270 and 180 degrees
    best = int(np.argmax(gains >= gains.max() - 1e-9 * np.abs(gains).max()))
    cosine, sine = ((1, 0), (0, 1), (0, -1), (-1, 0))[best]
    return np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]], float)


def match_by_index(identity: Mesh, reference: Mesh, driving: Mesh) -> tuple[Corners, Corners]:
    """Corners of matching triangles in the identity and in the reference, where both share one topology.

    In an order that does not depend on that of vertices and faces. A thin triangle of the reference is replaced by the
    nearest one that is not.

    Raises:
        InputError: no triangle is left.
    """
    ranks = [canonical_order(mesh.vertices).group for mesh in (identity, reference, driving)]
    own = canonical_faces(sound_faces(identity), *ranks)
    source = canonical_faces(sound_faces(reference), *ranks)
    thin = ~_sound(reference.vertices, own)
    theirs = own.copy()
    theirs[thin] = source[_nearest_centroid(reference.vertices[own[thin]], reference.vertices[source], 1)[:, 0]]
    return own, theirs


def match_by_markers(
    identity: Mesh, reference: Mesh, driving: Mesh, markers: Int[np.ndarray, "M 2"]
) -> tuple[Corners, Corners]:
    """The same for any two meshes, from pairs (identity vertex, reference vertex).

    Triangles of both meshes with their best match in the other: first all of the identity's, then those of the
    reference that face it and lie within FAR. A triangle with several matches is later given the mean of their
    gradients.

    Raises:
        InputError: no triangle is left.
    """
    ranked = canonical_order(identity.vertices)
    theirs_rank = canonical_order(reference.vertices).group
    own = canonical_faces(sound_faces(identity), ranked.group)
    theirs = canonical_faces(sound_faces(reference), theirs_rank, canonical_order(driving.vertices).group)
    order = np.lexsort((theirs_rank[markers[:, 1]], ranked.group[markers[:, 0]]))
    marked, seen = markers[order].T
    still, faces = ranked.merge(identity.vertices), ranked.group[own]
    places = resized_onto(reference.vertices, reference.vertices[seen], identity.vertices[marked])
    target = places[theirs]
    fitted = register(still, faces, target, ranked.group[marked], places[seen])[faces]
    there, _ = matching_triangles(fitted, target)
    back, alike = matching_triangles(target, fitted)
    near = alike & (np.linalg.norm(target.mean(axis=1) - fitted[back].mean(axis=1), axis=1) <= FAR)
    return np.concatenate([own, own[back[near]]]), np.concatenate([theirs[there], theirs[near]])


def register(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    target: Float[np.ndarray, "G 3 3"],
    marked: Int[np.ndarray, " M"],
    places: Float[np.ndarray, "M 3"],
) -> Float[np.ndarray, "V 3"]:
    """Deform a mesh smoothly onto target triangles, marked vertices to their places.

    In unit-sphere lengths; every triangle must have an area. Solves for the way from the start, where smoothness and
    the distance of the maps to the identity matrix are both exactly zero: their entries (one over a triangle's height,
    squared) are so large beside REST that the rounding of positions would move parts that no mark holds.

    Each of the eleven solves factors V + F unknowns anew: on one core 0.3 s for 7,000 vertices and 8 s for 110,000, so
    about three minutes and 2 GB in all for 200,000.
    """
    from scipy.sparse import diags_array

    smooth, stay = registration_terms(vertices, faces)
    count, unknowns = len(vertices), len(vertices) + len(faces)
    quadratic = smooth.T @ smooth + STAY * (stay.T @ stay)
    held = np.zeros((unknowns, 3))
    np.add.at(held, marked, HOLD * (places - vertices[marked]))
    weights = REST * (np.arange(unknowns) < count) + HOLD * np.bincount(marked, minlength=unknowns)
    shift = factor(quadratic + diags_array(weights)).solve(held)[:count]
    for pull in PULLS:
        points, valid = closest_valid(vertices + shift, faces, target)
        pulled = np.zeros(unknowns)
        pulled[:count] = pull * valid
        right = held.copy()
        right[:count] += pulled[:count, None] * (points - vertices)
        shift = factor(quadratic + diags_array(weights + pulled)).solve(right)[:count]
    return vertices + shift


def registration_terms(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[csr_array, csr_array]:
    """Sparse (3 S, V + F) and (3 F, V + F): differences of the maps of triangles at one edge, and the maps themselves.

    Unknowns are the vertices, then the images of the triangles' unit normals. Rows 3 f to 3 f + 2 of the second times
    the unknowns are the transpose of T_f.
    """
    from scipy.sparse import csr_array, hstack, kron

    normals, count = face_normals(vertices, faces), len(faces)
    spread = csr_array((normals.ravel(), (np.arange(3 * count), np.repeat(np.arange(count), 3))))
    maps = csr_array(hstack([gradient_operator(vertices, faces), spread]))
    pairs = faces_at_edges(faces)
    rows = np.repeat(np.arange(len(pairs)), 2)
    difference = csr_array((np.tile([1.0, -1.0], len(pairs)), (rows, pairs.ravel())), shape=(len(pairs), count))
    return csr_array(kron(difference, np.eye(3)) @ maps), maps


def faces_at_edges(faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "S 2"]:
    """Pairs of faces that share an edge; n faces at one edge give n - 1 pairs."""
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort((sides[:, 1], sides[:, 0]))
    shared = (sides[order][1:] == sides[order][:-1]).all(axis=1)
    face = order // 3
    return np.stack([face[:-1][shared], face[1:][shared]], axis=1)


def closest_valid(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], target: Float[np.ndarray, "G 3 3"]
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, " V"]]:
    """Closest target point of each vertex that faces the same way (within 90 degrees), and whether there is one."""
    corners = np.arange(3 * len(target)).reshape(-1, 3)
    face, weights, distance = closest_on_mesh(
        vertices, target.reshape(-1, 3), corners, normals=vertex_normals(vertices, faces)
    )
    return np.einsum("vk,vkc->vc", weights, target[face]), np.isfinite(distance).astype(np.int64)


def matching_triangles(
    triangles: Float[np.ndarray, "P 3 3"], target: Float[np.ndarray, "G 3 3"]
) -> tuple[Int[np.ndarray, " P"], Bool[np.ndarray, " P"]]:
    """For each triangle the nearest target by centroid among those facing the same way, and whether there is one.

    Looks at NEAREST; where none of them faces the same way the nearest is given.
    """
    near = _nearest_centroid(triangles, target, min(NEAREST, len(target)))
    normals, theirs = _normals_of(triangles), _normals_of(target)
    match, found = near[:, 0].copy(), np.zeros(len(near), bool)
    for column in near.T:
        left = np.flatnonzero(~found)
        found[left] = np.einsum("pc,pc->p", theirs[column[left]], normals[left]) > 0
        match[left[found[left]]] = column[left[found[left]]]
    return match, found


def resized_onto(
    vertices: Float[np.ndarray, "V 3"], marks: Float[np.ndarray, "M 3"], places: Float[np.ndarray, "M 3"]
) -> Float[np.ndarray, "V 3"]:
    """Vertices scaled and shifted so that the marks come as near to their places as they can; nothing is turned."""
    centred = marks - marks.mean(axis=0), places - places.mean(axis=0)
    scale = np.sqrt(np.square(centred[1]).sum() / np.square(centred[0]).sum())
    return (vertices - marks.mean(axis=0)) * scale + places.mean(axis=0)


def sound_faces(mesh: Mesh) -> Int[np.ndarray, "F 3"]:
    """The faces whose gradient can be trusted (see THIN).

    Raises:
        InputError: there is none.
    """
    sound = mesh.faces[_sound(mesh.vertices, mesh.faces)]
    if len(sound) == 0:
        raise InputError(
            f"{mesh.name}: expected triangles with area for model deformation-transfer, found none; give a surface mesh"
        )
    return sound


def _sound(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Bool[np.ndarray, " F"]:
    sides = vertices[faces] - vertices[np.roll(faces, 1, axis=1)]
    longest = np.square(sides).sum(-1).max(axis=1, initial=0.0)
    return np.linalg.norm(face_vectors(vertices, faces), axis=1) > THIN * longest


def _nearest_centroid(
    triangles: Float[np.ndarray, "P 3 3"], target: Float[np.ndarray, "G 3 3"], count: int
) -> Int[np.ndarray, "P K"]:
    from scipy.spatial import KDTree

    _, near = KDTree(target.mean(axis=1)).query(triangles.mean(axis=1), k=count)
    return near.reshape(len(triangles), count)


def _normals_of(triangles: Float[np.ndarray, "P 3 3"]) -> Float[np.ndarray, "P 3"]:
    return face_normals(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


def _checked_markers(markers: Int[np.ndarray, "M 2"], identity: Mesh, reference: Mesh) -> Int[np.ndarray, "M 2"]:
    for column, mesh in zip(markers.T, (identity, reference), strict=True):
        wrong = column[(column < 0) | (column >= len(mesh.vertices))]
        if wrong.size:
            raise InputError(
                f"--markers: expected vertices of {mesh.name} in 0..{len(mesh.vertices) - 1}, found {wrong[0]}; "
                "rows are (identity vertex, reference vertex), counted from 0"
            )
        apart = len(np.unique(mesh.vertices[column], axis=0))
        if apart < 3:
            raise InputError(
                f"--markers: expected 3 or more places on {mesh.name}, found {apart}; mark head, hands and feet"
            )
    return markers
