"""Computes the vertex attributes of a primitive for new world positions: normals, tangents and morph targets follow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.geometry import face_vectors, unit_vectors, weld
from .document import Document
from .scene import normal_matrices, read_morph_delta, read_morphed_attribute, transform_vectors

AttributeArrays = dict[str, Float[np.ndarray, "V C"]]
"""Values of vertex attributes (or their morph deltas, C = 3) by attribute name."""


@dataclass(frozen=True, eq=False)
class DeformedVertices:
    """New positions, normals and surface rotations of a primitive's vertices, in world coordinates."""

    positions: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"] | None
    """None where the primitive shall have no normals."""
    rotations: Float[np.ndarray, "M 3 3"]
    """Rotation of the surface since rest at each vertex (M = V), or one for all (M = 1)."""


def deformed_attributes(
    document: Document,
    primitive: dict[str, Any],
    matrices: Float[np.ndarray, "M 3 4"],
    weights: list[float],
    T_world_local: Float[np.ndarray, "4 4"],
    deformed: DeformedVertices,
    keep_targets: bool,
) -> tuple[AttributeArrays, list[AttributeArrays]]:
    """Return POSITION, NORMAL and TANGENT of a primitive, and the deltas of its morph targets, in a node's frame.

    A morph delta is taken to the world by `matrices`, rotated with the surface and taken to the node's frame. With
    `weights` applied, vertices are then exactly at `deformed.positions`. A tangent is rotated with the surface and made
    perpendicular to its new normal; its w (handedness) stays.

    Args:
        matrices: world from file coordinates of each vertex at rest (skin or node), or one matrix for all.
        weights: morph weights at rest.
        T_world_local: world transform of the node that will show the primitive.
        keep_targets: False drops the morph targets.
    """
    linear, inverse = T_world_local[:3, :3], np.linalg.inv(T_world_local[:3, :3])
    vector_matrices = inverse @ deformed.rotations @ matrices[:, :, :3]
    # Normals transform by inverse transposes: from the world to the node's frame that is the transpose of `linear`.
    normals_to_local = linear.T @ deformed.rotations @ normal_matrices(matrices[:, :, :3])
    base: AttributeArrays = {"POSITION": (deformed.positions - T_world_local[:3, 3]) @ inverse.T}
    # Directions are scaled to unit length after the transform, and their deltas by the same factor.
    scale = {"POSITION": np.ones((1, 1))}
    rest_normals = read_morphed_attribute(document, primitive, "NORMAL", weights)
    if rest_normals is not None and deformed.normals is not None:
        base["NORMAL"] = unit_vectors(deformed.normals @ linear)
        scale["NORMAL"] = _inverse_length(transform_vectors(normals_to_local, rest_normals))
    tangents = read_morphed_attribute(document, primitive, "TANGENT", weights)
    if tangents is not None:
        local_tangents = transform_vectors(vector_matrices, tangents[:, :3])
        scale["TANGENT"] = _inverse_length(local_tangents)
        base["TANGENT"] = np.concatenate([_orthogonalize(local_tangents, base.get("NORMAL")), tangents[:, 3:]], axis=1)
    if not keep_targets:
        return base, []
    delta_matrices = {"POSITION": vector_matrices, "NORMAL": normals_to_local, "TANGENT": vector_matrices}
    targets = [
        {
            name: scale[name] * transform_vectors(delta_matrices[name], delta)
            for name in scale
            if (delta := read_morph_delta(document, primitive, number, name)) is not None
        }
        for number in range(len(primitive.get("targets", [])))
    ]
    return _subtract_morphs(base, targets, weights), targets


def surface_rotations(
    vertices: Float[np.ndarray, "V 3"], moved: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "V 3 3"]:
    """Fit the rotation of the surface around each vertex from `vertices` to `moved`.

    Kabsch's algorithm on the edges and face normals around the vertex: the local step of as-rigid-as-possible
    deformation (Sorkine and Alexa 2007). Vertices at one rest position get one rotation, so that split seams stay
    closed; a vertex without faces gets the identity.
    """
    _, index = weld(vertices)
    covariance = np.zeros((index.max(initial=-1) + 1, 3, 3))
    welded_faces = index[faces]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        before, after = (points[faces[:, j]] - points[faces[:, i]] for points in (vertices, moved))
        _add_to_rows(covariance, welded_faces[:, [i, j]], after[:, :, None] * before[:, None])
    # The edges around a vertex of a flat surface span two directions; face normals add the third one.
    normals, moved_normals = (_scaled_face_normals(face_vectors(points, faces)) for points in (vertices, moved))
    _add_to_rows(covariance, welded_faces, moved_normals[:, :, None] * normals[:, None])
    u, _, vt = np.linalg.svd(covariance)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]  # a rotation, not a reflection
    rotations = u @ vt
    rotations[~covariance.any(axis=(1, 2))] = np.eye(3)
    return rotations[index]


def needs_rotations(primitive: dict[str, Any]) -> bool:
    """Return whether a primitive has tangents or morph targets, which need `surface_rotations`."""
    return "TANGENT" in primitive["attributes"] or bool(primitive.get("targets"))


def _subtract_morphs(base: AttributeArrays, targets: list[AttributeArrays], weights: list[float]) -> AttributeArrays:
    """Return the attributes that become `base` when the weighted targets are added.

    Positions are exact; the sums for normals and tangents are parallel to those of `base`, but not of unit length.
    """
    result = dict(base)
    for name in base if any(weights) else ():
        added = sum(weight * target[name] for weight, target in zip(weights, targets, strict=False) if name in target)
        vectors = (
            base[name][:, :3] * (1.0 if name == "POSITION" else _length_for_unit(base[name][:, :3], added)) - added
        )
        result[name] = np.concatenate([vectors, base[name][:, 3:]], axis=1)
    return result


def _length_for_unit(directions: Float[np.ndarray, "V 3"], added: Float[np.ndarray, "V 3"] | int) -> np.ndarray:
    """Solve |s n - d| = 1 for s, with unit `directions` n and `added` d: s n - d then is a unit vector to store."""
    along = (directions * added).sum(-1, keepdims=True)
    square = 1.0 + along**2 - np.square(np.broadcast_to(added, directions.shape)).sum(-1, keepdims=True)
    return along + np.sqrt(np.maximum(square, 0.0))


def _orthogonalize(
    tangents: Float[np.ndarray, "V 3"], normals: Float[np.ndarray, "V 3"] | None
) -> Float[np.ndarray, "V 3"]:
    """Return unit tangents, perpendicular to the normals where there are any (Gram-Schmidt)."""
    if normals is None:
        return unit_vectors(tangents)
    return unit_vectors(tangents - normals * (tangents * normals).sum(-1, keepdims=True))


def _inverse_length(vectors: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 1"]:
    """Return 1 / length of each vector, 1 for zero vectors."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return 1.0 / np.where(length > 0, length, 1.0)


def _scaled_face_normals(vectors: Float[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """Scale face vectors (of length twice the area) to the root of their length, comparable to edge lengths."""
    return vectors * np.sqrt(_inverse_length(vectors))


def _add_to_rows(
    total: Float[np.ndarray, "W 3 3"], rows: Int[np.ndarray, "F K"], values: Float[np.ndarray, "F 3 3"]
) -> None:
    """Add the matrix of each face to all of its K rows of `total`, in place.

    One `np.bincount` for each matrix entry, because `np.add.at` is ten times slower.
    """
    index = rows.ravel()
    for i in range(3):
        for j in range(3):
            spread = np.repeat(values[:, i, j], rows.shape[1])
            total[:, i, j] += np.bincount(index, spread, minlength=len(total))
