"""Where the vertices of a glTF file are: node tree, skins and morph targets, evaluated in float64.

Matrices act on columns, `T_world_node @ [x, y, z, 1]`. Everything takes the node transforms as an argument, so the
same functions serve the file's rest state and any frame of its animations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from .document import Document, read_accessor, read_floats

DEFAULT_TRS = {"translation": (0, 0, 0), "rotation": (0, 0, 0, 1), "scale": (1, 1, 1)}


def local_matrices(document: Document) -> Float[np.ndarray, "N 4 4"]:
    """Each node's own transform, parent from node, out of its matrix or its translation, rotation and scale."""
    return np.array([_local_matrix(node) for node in document.gltf.get("nodes", [])], np.float64).reshape(-1, 4, 4)


def animated_matrices(
    document: Document, moved: Mapping[tuple[int, str], Float[np.ndarray, "T C"]], frames: int
) -> Float[np.ndarray, "T N 4 4"]:
    """The same in each frame, where `moved` gives the translation, rotation or scale of nodes by number and name."""
    T_parent_node = np.tile(local_matrices(document), (frames, 1, 1, 1))
    changes: dict[int, dict[str, Any]] = {}
    for (node, path), values in moved.items():
        changes.setdefault(node, {})[path] = values
    for node, values in changes.items():
        T_parent_node[:, node] = _local_matrix({**document.gltf["nodes"][node], **values})
    return T_parent_node


def world_matrices(document: Document, T_parent_node: Float[np.ndarray, "*T N 4 4"]) -> Float[np.ndarray, "*T N 4 4"]:
    """Each node's transform to the world: the product of the transforms from its root down.

    Raises:
        InputError: the node tree has a loop, or a node with two parents.
    """
    T_world_node = T_parent_node.copy()
    parent = node_parents(document)
    for node in sort_parents_first(document, parent):
        if parent[node] >= 0:
            T_world_node[..., node, :, :] = T_world_node[..., parent[node], :, :] @ T_parent_node[..., node, :, :]
    return T_world_node


def scene_nodes(document: Document) -> list[int]:
    """The nodes of the default scene (else of scene 0, else all), depth first: the scene order."""
    gltf = document.gltf
    scenes = gltf.get("scenes")
    roots = scenes[gltf.get("scene", 0)].get("nodes", []) if scenes else _roots(node_parents(document))
    order: dict[int, None] = {}
    stack = list(reversed(roots))
    while stack:
        node = stack.pop()
        if node not in order:
            order[node] = None
            stack.extend(reversed(gltf["nodes"][node].get("children", [])))
    return list(order)


def read_attribute(document: Document, primitive: dict[str, Any], name: str) -> Float[np.ndarray, "V C"] | None:
    """A vertex attribute in float64, or None where the primitive has none."""
    index = primitive["attributes"].get(name)
    return None if index is None else read_floats(document, index)


def read_indices(document: Document, primitive: dict[str, Any]) -> np.ndarray:
    """The vertex numbers a primitive draws, in order; all of them where it has no index buffer.

    Raises:
        InputError: an index points past the last vertex.
    """
    count = document.gltf["accessors"][primitive["attributes"]["POSITION"]]["count"]
    if "indices" not in primitive:
        return np.arange(count)
    values = read_accessor(document, primitive["indices"]).ravel()
    if values.max(initial=0) >= count:
        raise InputError(
            f"{document.path}: expected face indices below {count}, found {values.max()}; "
            "the file is damaged, export it again"
        )
    return values.astype(np.int64)


def read_morph_delta(
    document: Document, primitive: dict[str, Any], target: int, name: str
) -> Float[np.ndarray, "V 3"] | None:
    """What morph target number `target` adds to an attribute at weight 1, or None where it leaves it alone."""
    index = primitive["targets"][target].get(name)
    return None if index is None else read_floats(document, index)


def read_morphed_attribute(
    document: Document, primitive: dict[str, Any], name: str, weights: list[float]
) -> Float[np.ndarray, "V C"] | None:
    """A vertex attribute with its weighted morph targets added (w of a tangent has none)."""
    values = read_attribute(document, primitive, name)
    for target, weight in enumerate(weights[: len(primitive.get("targets", []))]):
        delta = read_morph_delta(document, primitive, target, name) if weight and values is not None else None
        if delta is not None and values is not None:
            values[:, :3] += weight * delta
    return values


def read_morph_weights(document: Document, node: int) -> list[float]:
    """The morph weights of a node at rest: its own, else its mesh's."""
    owner = document.gltf["nodes"][node]
    weights = owner.get("weights") or document.gltf["meshes"][owner["mesh"]].get("weights") or []
    return [float(weight) for weight in weights]


@dataclass(frozen=True, eq=False)
class SkinBinding:
    """Which nodes hold the vertices of a primitive, and how: all that a skin says, in no particular pose."""

    nodes: Int[np.ndarray, " J"]
    """The joints of the skin."""
    T_joint_bind: Float[np.ndarray, "J 4 4"] | None
    """Inverse bind matrices; None where the skin has none, that is where they do nothing."""
    joints: Int[np.ndarray, "V K"]
    weights: Float[np.ndarray, "V K"]
    """Rows sum to 1."""

    def matrices(self, T_world_node: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "V 3 4"]:
        """The blend of the joints' transforms that takes each vertex to the world."""
        T_world_bind = T_world_node[self.nodes]
        T_world_bind = T_world_bind if self.T_joint_bind is None else T_world_bind @ self.T_joint_bind
        blend = np.zeros((len(self.joints), 3, 4))
        for joint, weight in zip(self.joints.T, self.weights.T, strict=True):
            blend += weight[:, None, None] * T_world_bind[joint, :3]
        return blend


def read_skin_binding(document: Document, node: int, primitive: dict[str, Any]) -> SkinBinding | None:
    """How the skin of a node holds the vertices of a primitive; None where they follow the node itself.

    Weights are divided by their sum; a vertex without any weight follows its first joint, as in three.js.
    """
    skin = document.gltf["nodes"][node].get("skin")
    if skin is None or "JOINTS_0" not in primitive["attributes"]:
        return None
    joints, weights = read_influences(document, primitive)
    nodes, T_joint_bind = np.array(document.gltf["skins"][skin]["joints"], np.int64), _inverse_binds(document, skin)
    if joints.min(initial=0) < 0 or joints.max(initial=0) >= len(nodes):
        raise InputError(
            f"{document.path}: expected joints below {len(nodes)} in skin {skin}, found {joints.max()}; "
            "the file is damaged, export it again"
        )
    return SkinBinding(nodes, T_joint_bind, joints, weights)


def vertex_matrices(
    document: Document, node: int, primitive: dict[str, Any], T_world_node: Float[np.ndarray, "N 4 4"]
) -> Float[np.ndarray, "M 3 4"]:
    """What takes each vertex of a primitive to the world: its joints' blend, or one matrix for all without a skin.

    A skinned vertex ignores the transform of the node that shows it, as glTF has it.
    """
    binding = read_skin_binding(document, node, primitive)
    return T_world_node[node][None, :3] if binding is None else binding.matrices(T_world_node)


def joint_matrices(
    document: Document, skin: int, T_world_node: Float[np.ndarray, "N 4 4"]
) -> Float[np.ndarray, "J 4 4"]:
    """World from bind space for each joint of a skin: its node's transform times its inverse bind matrix."""
    T_world_joint, T_joint_bind = T_world_node[document.gltf["skins"][skin]["joints"]], _inverse_binds(document, skin)
    return T_world_joint if T_joint_bind is None else T_world_joint @ T_joint_bind


def _inverse_binds(document: Document, skin: int) -> Float[np.ndarray, "J 4 4"] | None:
    entry = document.gltf["skins"][skin]
    if "inverseBindMatrices" not in entry:
        return None
    count, columns = len(entry["joints"]), read_floats(document, entry["inverseBindMatrices"])
    if columns.shape[1] != 16 or len(columns) < count:
        raise InputError(
            f"{document.path}: expected {count} inverse bind matrices in skin {skin}, found "
            f"{len(columns)} x {columns.shape[1]} numbers; export it again"
        )
    return columns[:count].reshape(-1, 4, 4).transpose(0, 2, 1)


def transform_points(
    matrices: Float[np.ndarray, "M 3 4"], points: Float[np.ndarray, "V 3"]
) -> Float[np.ndarray, "V 3"]:
    """Points taken by their own matrix each, or all by one."""
    return transform_vectors(matrices[:, :, :3], points) + matrices[:, :, 3]


def transform_vectors(
    matrices: Float[np.ndarray, "M 3 3"], vectors: Float[np.ndarray, "V 3"]
) -> Float[np.ndarray, "V 3"]:
    """Vectors taken by their own 3x3 matrix each, or all by one."""
    return (matrices @ vectors[:, :, None])[:, :, 0]


def normal_matrices(linear: Float[np.ndarray, "M 3 3"]) -> Float[np.ndarray, "M 3 3"]:
    """Inverse transposes up to a positive factor, through cofactors, so that flattening matrices have one too."""
    a, b, c = linear[:, :, 0], linear[:, :, 1], linear[:, :, 2]
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    return cofactors * np.where(np.linalg.det(linear) < 0, -1.0, 1.0)[:, None, None]


def inner_products(a: Float[np.ndarray, "*N C"], b: Float[np.ndarray, "*N C"]) -> Float[np.ndarray, "*N 1"]:
    """The inner product of each pair of rows."""
    return (a[..., None, :] @ b[..., :, None])[..., 0]


def normalized_quaternions(quat_xyzw: Float[np.ndarray, "*N 4"]) -> Float[np.ndarray, "*N 4"]:
    """Quaternions at length one; zeros stay."""
    length = np.sqrt(inner_products(quat_xyzw, quat_xyzw))
    return quat_xyzw / np.where(length > 0, length, 1.0)


def _local_matrix(node: dict[str, Any]) -> Float[np.ndarray, "*T 4 4"]:
    """Of one node, whose translation, rotation and scale may have leading axes."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    values = {path: np.array(node.get(path, rest), np.float64) for path, rest in DEFAULT_TRS.items()}
    matrix = np.zeros((*np.broadcast_shapes(*(value.shape[:-1] for value in values.values())), 4, 4))
    matrix[..., :3, :3] = _rotation_matrix(values["rotation"]) * values["scale"][..., None, :]
    matrix[..., :3, 3] = values["translation"]
    matrix[..., 3, 3] = 1.0
    return matrix


def _rotation_matrix(quat_xyzw: Float[np.ndarray, "*T 4"]) -> Float[np.ndarray, "*T 3 3"]:
    x, y, z, w = np.moveaxis(normalized_quaternions(quat_xyzw), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def node_parents(document: Document) -> list[int]:
    """The parent of each node, -1 for roots."""
    nodes = document.gltf.get("nodes", [])
    parent = [-1] * len(nodes)
    for index, node in enumerate(nodes):
        for child in node.get("children", []):
            if parent[child] >= 0:
                raise InputError(f"{document.path}: expected one parent for node {child}, found two; export it again")
            parent[child] = index
    return parent


def _roots(parent: list[int]) -> list[int]:
    return [node for node, above in enumerate(parent) if above < 0]


def sort_parents_first(document: Document, parent: list[int]) -> list[int]:
    """All nodes, each after its parent."""
    order = _roots(parent)
    for node in order:  # grows while it is walked
        order.extend(document.gltf["nodes"][node].get("children", []))
    if len(order) < len(parent):
        lost = min(set(range(len(parent))) - set(order))
        raise InputError(f"{document.path}: expected a tree of nodes, found node {lost} below itself; export it again")
    return order


def read_influences(document: Document, primitive: dict[str, Any]) -> tuple[np.ndarray, Float[np.ndarray, "V K"]]:
    """Joint numbers and weights of each vertex from all sets; joints of no weight are 0, whatever the file says."""
    joints, weights, number = [], [], 0
    while f"JOINTS_{number}" in primitive["attributes"]:
        joints.append(read_attribute(document, primitive, f"JOINTS_{number}"))
        weights.append(read_attribute(document, primitive, f"WEIGHTS_{number}"))
        number += 1
    if any(part is None for part in weights):
        raise InputError(f"{document.path}: expected WEIGHTS for each set of JOINTS, found none; export it again")
    joint, weight = np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)
    total = weight.sum(axis=1, keepdims=True)
    weight = np.where(total > 0, weight / np.where(total > 0, total, 1.0), np.eye(1, weight.shape[1]))
    return np.where(weight == 0, 0, joint).astype(np.int64), weight
