"""Write the meshes of an FBX scene into a glTF draft: vertices split at seams, skins, and blend shapes.

FBX has one normal, texture coordinate and colour for each polygon corner; glTF has one for each vertex. Corners of one
position that agree in all of them become one vertex; vertices keep the order of the positions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..gltf.draft import ARRAY_BUFFER, Draft, accessor_bounds
from ..polygons import fan_corners
from .elements import array, items, matrix, own

INFLUENCES = 4
"""Influences of a vertex in one pair of attributes JOINTS_n and WEIGHTS_n (glTF 2.0, 3.7.3.1)."""


@dataclass(frozen=True, eq=False)
class SeamSplit:
    """A mesh of FBX with vertices of glTF, of which there are N at P positions."""

    position_of: Int[np.ndarray, " N"]
    """Position that each vertex has."""
    corner_of: Int[np.ndarray, " N"]
    """A polygon corner that each vertex is."""
    triangles: Int[np.ndarray, "F 3"]
    polygon: Int[np.ndarray, " F"]
    """Polygon that each triangle is a part of."""


@dataclass(frozen=True, eq=False)
class MorphShape:
    """A blend shape that is written as a morph target."""

    name: str
    offsets: Float[np.ndarray, "P 3"]
    channel: int
    """Index of the channel that drives it among those of its mesh."""


@dataclass(frozen=True, eq=False)
class MorphChannels:
    """The channels of a mesh, which drive one shape each, or several in a row (in-between shapes)."""

    channels: list[Any]
    knots: list[Float[np.ndarray, " K"]]
    """Weights of each channel at which its shapes have their full effect."""
    shapes: list[MorphShape]

    def target_weights(self, channel_weights: Float[np.ndarray, "T C"]) -> Float[np.ndarray, "T S"]:
        """Return the weight of each morph target for weights of the channels."""
        columns = [
            piecewise_weights(weights, knots) for weights, knots in zip(channel_weights.T, self.knots, strict=True)
        ]
        return np.concatenate([np.zeros((len(channel_weights), 0)), *columns], axis=1)


def piecewise_weights(weights: Float[np.ndarray, " T"], knots: Float[np.ndarray, " K"]) -> Float[np.ndarray, "T K"]:
    """Return the weights of the shapes of a channel: the result is linear between zero and the shapes, and beyond.

    At weight `knots[k]` shape k has weight 1 and all others 0; at weight 0 all have 0.
    """
    order = np.argsort(np.append(knots, 0.0), kind="stable")
    places = np.append(knots, 0.0)[order]
    upper = np.clip(np.searchsorted(places, weights, side="right"), 1, len(knots))
    length = places[upper] - places[upper - 1]
    share = np.where(length > 0, (weights - places[upper - 1]) / np.where(length > 0, length, 1.0), 0.0)
    result = np.zeros((len(weights), len(places)))
    rows = np.arange(len(weights))
    result[rows, order[upper - 1]] = 1 - share
    result[rows, order[upper]] = share
    return result[:, :-1]  # the last one is the zero, which has no shape


def split_mesh(mesh: Any) -> SeamSplit | None:
    """Split a mesh at the seams of its attributes; None where it has no triangle."""
    position = array(own(mesh.vertex_indices)).astype(np.int64)
    sizes = array(mesh.faces, 2)[:, 1].astype(np.int64)
    corners, polygon = fan_corners(sizes)
    if not len(corners):
        return None
    key = position
    for values in _corner_attributes(mesh):
        # Equal values get one number: exporters write the same normal once for each corner.
        number = np.unique(array(values.values).astype(np.float32), axis=0, return_inverse=True)[1].reshape(-1)
        of_corner = number[array(values.indices)]
        # Numbering the pairs keeps the order of positions and the keys small.
        key = np.unique(key * (number.max() + 1) + of_corner, return_inverse=True)[1]
    drawn = np.unique(corners)
    _, first, element = np.unique(key[drawn], return_index=True, return_inverse=True)
    corner_of = drawn[first]
    vertex_of_corner = np.full(len(position), -1)
    vertex_of_corner[drawn] = element
    return SeamSplit(position[corner_of], corner_of, vertex_of_corner[corners], polygon)


def _corner_attributes(mesh: Any) -> list[Any]:
    """List the attributes that split vertices: normals, all sets of texture coordinates, all sets of colours."""
    values = [own(mesh.vertex_normal)]
    values += [own(entry.vertex_uv) for entry in items(mesh.uv_sets)]
    values += [own(entry.vertex_color) for entry in items(mesh.color_sets)]
    return [value for value in values if value.exists and len(own(value.values))]


def bind_matrix(mesh: Any) -> Float[np.ndarray, "4 4"]:
    """Return the transform from a mesh to the world in its bind pose; the identity for a mesh without a skin.

    A skinned mesh of glTF ignores the transform of its node (3.7.3.3), so its vertices may have any frame. In that of
    the world they are the character at rest, upright and in its size, which a bind pose in FBX knows and in glTF not.
    """
    for deformer in items(mesh.skin_deformers):
        for cluster in items(deformer.clusters):
            T_world_mesh = matrix(cluster.bind_to_world) @ matrix(cluster.geometry_to_bone)
            if np.isfinite(T_world_mesh).all() and np.linalg.det(T_world_mesh) > 0:
                return T_world_mesh
    return np.eye(4)


def add_attributes(draft: Draft, mesh: Any, split: SeamSplit, T_world_mesh: Float[np.ndarray, "4 4"]) -> dict[str, int]:
    """Add positions, normals, texture coordinates and colours of a mesh; returns the accessors by attribute name."""

    def at_vertices(values: Any, columns: int) -> np.ndarray:
        return array(values.values, columns)[array(values.indices)[split.corner_of]]

    linear = T_world_mesh[:3, :3]
    positions = (array(mesh.vertices, 3) @ linear.T + T_world_mesh[:3, 3])[split.position_of]
    attributes = {"POSITION": draft.add_floats(positions, ARRAY_BUFFER, bounds=True)}
    normals = own(mesh.vertex_normal)
    if normals.exists:
        # Normals turn with the inverse transpose; only their direction counts.
        turned = at_vertices(normals, 3) @ np.linalg.inv(linear)
        lengths = np.linalg.norm(turned, axis=1, keepdims=True)
        turned = np.where(lengths > 0, turned / np.where(lengths > 0, lengths, 1.0), [0.0, 1.0, 0.0])
        attributes["NORMAL"] = draft.add_floats(turned, ARRAY_BUFFER)
    for number, entry in enumerate(items(mesh.uv_sets)):
        values = own(entry.vertex_uv)
        if values.exists and len(own(values.values)):
            # glTF has v down (3.8.3 Images: the origin is the upper left corner), FBX has v up.
            uv = at_vertices(values, 2) * [1.0, -1.0] + [0.0, 1.0]
            attributes[f"TEXCOORD_{number}"] = draft.add_floats(uv, ARRAY_BUFFER)
    for number, entry in enumerate(items(mesh.color_sets)):
        values = own(entry.vertex_color)
        if values.exists and len(own(values.values)):
            colors = np.clip(at_vertices(values, 4), 0.0, 1.0)
            attributes[f"COLOR_{number}"] = draft.add_floats(colors, ARRAY_BUFFER)
    return attributes


def add_skin(
    draft: Draft, mesh: Any, split: SeamSplit, T_world_mesh: Float[np.ndarray, "4 4"], mesh_node: int
) -> tuple[dict[str, int], int] | None:
    """Add the skin of a mesh: the accessors of its joints and weights, and the index of the skin; None without one.

    All influences are kept. Vertices without any follow the node of their mesh, which becomes a joint for them.
    """
    deformers = [deformer for deformer in items(mesh.skin_deformers) if len(own(deformer.clusters))]
    if not deformers:
        return None
    clusters = items(deformers[0].clusters)
    joint_of, joints, matrices = _joints(clusters)
    chosen, weights = _influences(deformers[0], joint_of, len(array(mesh.vertices, 3)))
    loose = weights.sum(axis=1) <= 0
    if loose[split.position_of].any():
        chosen[loose, 0], weights[loose, 0] = len(joints), 1.0
        joints, matrices = [*joints, mesh_node], [*matrices, np.eye(4)]
    if not joints:
        return None
    matrices = np.stack(matrices) @ np.linalg.inv(T_world_mesh)
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    attributes = {}
    kind, component = ("<u1", 5121) if len(joints) < 256 else ("<u2", 5123)
    for number in range(chosen.shape[1] // INFLUENCES):
        columns = slice(number * INFLUENCES, (number + 1) * INFLUENCES)
        index = np.ascontiguousarray(chosen[split.position_of, columns].astype(kind))
        accessor = {"componentType": component, "count": len(index), "type": "VEC4"}
        view = draft.add_view(index, target=ARRAY_BUFFER)
        attributes[f"JOINTS_{number}"] = draft.add_accessor({"bufferView": view, **accessor})
        attributes[f"WEIGHTS_{number}"] = draft.add_floats(weights[split.position_of, columns], ARRAY_BUFFER)
    skins = draft.gltf.setdefault("skins", [])
    skins.append({"inverseBindMatrices": draft.add_matrices(matrices), "joints": joints})
    return attributes, len(skins) - 1


def _joints(clusters: list[Any]) -> tuple[Int[np.ndarray, " C"], list[int], list[Float[np.ndarray, "4 4"]]]:
    """Return the joint of each cluster (-1 for none), the node of each joint, and its inverse bind matrix."""
    joint_of, joints, matrices = np.full(len(clusters), -1), [], []
    for number, cluster in enumerate(clusters):
        bone = own(cluster.bone_node)
        if bone is None:
            continue
        node = bone.typed_id - 1
        if node not in joints:  # joints of a skin are unique (5.28 Skin)
            joints.append(node)
            matrices.append(matrix(cluster.geometry_to_bone))
        joint_of[number] = joints.index(node)
    return joint_of, joints, matrices


def _influences(
    deformer: Any, joint_of: Int[np.ndarray, " C"], count: int
) -> tuple[Int[np.ndarray, "P K"], Float[np.ndarray, "P K"]]:
    """Return joints and weights of all influences of each position, largest first, K a multiple of four."""
    of_vertex, pairs = array(deformer.vertices, 3)[:count], array(deformer.weights, 2)
    numbers = of_vertex[:, 1].astype(np.int64)
    columns = np.arange(-(-max(int(numbers.max(initial=0)), 1) // INFLUENCES) * INFLUENCES)
    index = of_vertex[:, :1].astype(np.int64) + columns
    used = columns < numbers[:, None]
    rows = pairs[np.where(used, index, 0)] if len(pairs) else np.zeros((*index.shape, 2))
    joints = np.where(used, joint_of[rows[..., 0].astype(np.int64)], -1)
    weights = np.where(used & (joints >= 0) & np.isfinite(rows[..., 1]), np.maximum(rows[..., 1], 0.0), 0.0)
    # A joint without weight is 0 (3.7.3.1: unused joint values should be zero).
    padding = [(0, count - len(joints)), (0, 0)]
    return np.pad(np.where(weights > 0, joints, 0), padding), np.pad(weights, padding)


def read_morphs(mesh: Any) -> MorphChannels:
    """Read the blend shapes of a mesh: one morph target for each shape, in-between shapes included."""
    channels, knots, shapes = [], [], []
    count = len(array(mesh.vertices, 3))
    for deformer in items(mesh.blend_deformers):
        for channel in items(deformer.channels):
            keys = [key for key in items(channel.keyframes) if key.target_weight != 0]
            if not keys:
                continue
            # Maya names channels "deformer.shape".
            name = channel.name.removeprefix(f"{deformer.name}.") or own(keys[-1].shape).name
            for key in keys:
                shape = own(key.shape)
                offsets = np.zeros((count, 3))
                index = array(shape.offset_vertices).astype(np.int64)
                inside = index < count
                offsets[index[inside]] = array(shape.position_offsets, 3)[inside]
                full_name = name if key is keys[-1] else f"{name} {key.target_weight:g}"
                shapes.append(MorphShape(full_name, offsets, len(channels)))
            knots.append(np.array([float(key.target_weight) for key in keys]))
            channels.append(channel)
    return MorphChannels(channels, knots, shapes)


def add_targets(
    draft: Draft, morphs: MorphChannels, split: SeamSplit, T_world_mesh: Float[np.ndarray, "4 4"]
) -> list[dict[str, int]]:
    """Add the morph targets of a mesh; returns their accessors by attribute name."""
    offsets = (shape.offsets[split.position_of] @ T_world_mesh[:3, :3].T for shape in morphs.shapes)
    return [{"POSITION": _add_sparse(draft, offset)} for offset in offsets]


def _add_sparse(draft: Draft, offsets: Float[np.ndarray, "N 3"]) -> int:
    """Append an accessor of which only the elements that are not zero are stored (3.6.2.3 Sparse Accessors)."""
    values = offsets.astype("<f4")
    moved = np.flatnonzero(values.any(axis=1))
    # The bounds are those of all elements (3.6.2.5).
    accessor = {"componentType": 5126, "count": len(values), "type": "VEC3", **accessor_bounds(values)}
    if len(moved):
        indices = {"bufferView": draft.add_view(moved.astype("<u4")), "componentType": 5125}
        stored = {"bufferView": draft.add_view(np.ascontiguousarray(values[moved]))}
        accessor["sparse"] = {"count": len(moved), "indices": indices, "values": stored}
    return draft.add_accessor(accessor)
