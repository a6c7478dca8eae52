"""New vertex attributes for a primitive whose world positions change: normals, tangents and morph targets follow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.geometry import face_vectors, unit_vectors, weld
from .document import Document
from .scene import normal_matrices, read_morph_delta, read_morphed_attribute, transform_vectors

Arrays = dict[str, Float[np.ndarray, "V C"]]


@dataclass(frozen=True, eq=False)
class DeformedVertices:
    """What a primitive's vertices shall be in the world, and how the surface around each has turned since rest."""

    points: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"] | None
    turns: Float[np.ndarray, "M 3 3"]
    """One rotation for each vertex, or one for all."""


def deformed_attributes(
    document: Document,
    primitive: dict[str, Any],
    matrices: Float[np.ndarray, "M 3 4"],
    weights: list[float],
    T_world_local: Float[np.ndarray, "4 4"],
    wanted: DeformedVertices,
    keep_targets: bool,
) -> tuple[Arrays, list[Arrays]]:
    """POSITION, NORMAL and TANGENT, and the same of each morph target, in the frame of the node that will show them.

    `matrices` took the file's vertices to the world at rest (skin included), under the morph `weights`. A morph delta
    is taken to the world by them, turned with the surface and taken back, so that with `weights` still applied
    the vertices stand exactly at `wanted.points`. A tangent is turned with the surface and made perpendicular to its
    new normal; its w stays.
    """
    linear, back = T_world_local[:3, :3], np.linalg.inv(T_world_local[:3, :3])
    carry = back @ wanted.turns @ matrices[:, :, :3]
    carry_normal = linear.T @ wanted.turns @ normal_matrices(matrices[:, :, :3])
    base: Arrays = {"POSITION": (wanted.points - T_world_local[:3, 3]) @ back.T}
    scale = {"POSITION": np.ones((1, 1))}
    rest_normals = read_morphed_attribute(document, primitive, "NORMAL", weights)
    if rest_normals is not None and wanted.normals is not None:
        base["NORMAL"] = unit_vectors(wanted.normals @ linear)
        scale["NORMAL"] = _inverse_length(transform_vectors(carry_normal, rest_normals))
    tangents = read_morphed_attribute(document, primitive, "TANGENT", weights)
    if tangents is not None:
        along = transform_vectors(carry, tangents[:, :3])
        scale["TANGENT"] = _inverse_length(along)
        base["TANGENT"] = np.concatenate([_orthogonalize(along, base.get("NORMAL")), tangents[:, 3:]], axis=1)
    if not keep_targets:
        return base, []
    push = {"POSITION": carry, "NORMAL": carry_normal, "TANGENT": carry}
    targets = [
        {
            name: scale[name] * transform_vectors(push[name], delta)
            for name in scale
            if (delta := read_morph_delta(document, primitive, number, name)) is not None
        }
        for number in range(len(primitive.get("targets", [])))
    ]
    return _subtract_morphs(base, targets, weights), targets


def surface_rotations(
    vertices: Float[np.ndarray, "V 3"], moved: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "V 3 3"]:
    """The rotation of the surface around each vertex, twist included: the best one for its edges and face normals.

    Kabsch's fit of the one-ring before to the one-ring after, the step that as-rigid-as-possible deformation repeats.
    Vertices at one rest position turn as one, so that split seams stay closed; a vertex without faces does not turn.
    """
    _, index = weld(vertices)
    covariance = np.zeros((index.max(initial=-1) + 1, 3, 3))
    ring = index[faces]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        before, after = (points[faces[:, j]] - points[faces[:, i]] for points in (vertices, moved))
        _add_to_rows(covariance, ring[:, [i, j]], after[:, :, None] * before[:, None])
    normals, turned = (_scaled_face_normals(face_vectors(points, faces)) for points in (vertices, moved))
    _add_to_rows(covariance, ring, turned[:, :, None] * normals[:, None])
    u, _, vt = np.linalg.svd(covariance)
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    rotations = u @ vt
    rotations[~covariance.any(axis=(1, 2))] = np.eye(3)
    return rotations[index]


def needs_rotations(primitive: dict[str, Any]) -> bool:
    """Whether a primitive has anything that needs `surface_rotations`: tangents or morph targets."""
    return "TANGENT" in primitive["attributes"] or bool(primitive.get("targets"))


def _subtract_morphs(base: Arrays, targets: list[Arrays], weights: list[float]) -> Arrays:
    """The base that gives `base` once the weighted targets are added; of a direction it gives the direction only."""
    result = dict(base)
    for name in base if any(weights) else ():
        added = sum(weight * target[name] for weight, target in zip(weights, targets, strict=False) if name in target)
        vectors = (
            base[name][:, :3] * (1.0 if name == "POSITION" else _length_for_unit(base[name][:, :3], added)) - added
        )
        result[name] = np.concatenate([vectors, base[name][:, 3:]], axis=1)
    return result


def _length_for_unit(directions: Float[np.ndarray, "V 3"], added: Float[np.ndarray, "V 3"] | int) -> np.ndarray:
    """How long `directions` must be for unit vectors to be left when `added` is taken away: |s n - d| = 1 for s."""
    along = (directions * added).sum(-1, keepdims=True)
    square = 1.0 + along**2 - np.square(np.broadcast_to(added, directions.shape)).sum(-1, keepdims=True)
    return along + np.sqrt(np.maximum(square, 0.0))


def _orthogonalize(
    along: Float[np.ndarray, "V 3"], normals: Float[np.ndarray, "V 3"] | None
) -> Float[np.ndarray, "V 3"]:
    if normals is None:
        return unit_vectors(along)
    return unit_vectors(along - normals * (along * normals).sum(-1, keepdims=True))


def _inverse_length(vectors: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 1"]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return 1.0 / np.where(length > 0, length, 1.0)


def _scaled_face_normals(vectors: Float[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """Face normals as long as the root of twice the area, so that they weigh as much as the edges."""
    return vectors * np.sqrt(_inverse_length(vectors))


def _add_to_rows(
    total: Float[np.ndarray, "W 3 3"], rows: Int[np.ndarray, "F K"], values: Float[np.ndarray, "F 3 3"]
) -> None:
    """Add the value of each face to each of its rows of `total`, in place (`np.add.at` is ten times slower)."""
    index = rows.ravel()
    for i in range(3):
        for j in range(3):
            spread = np.repeat(values[:, i, j], rows.shape[1])
            total[:, i, j] += np.bincount(index, spread, minlength=len(total))
