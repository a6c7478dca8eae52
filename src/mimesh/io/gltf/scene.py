"""Evaluates glTF nodes, skins and morph targets in float64: the world transform of each node, joint and vertex.

Matrices act on column vectors, `T_world_node @ [x, y, z, 1]`. Functions take the node transforms as an argument, so the
same code serves the file's rest state and every frame of its animations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import damaged
from ...core.geometry import finite_or_zero, nearest_rotation
from .document import Document, read_accessor, read_floats

if TYPE_CHECKING:
    from scipy.sparse import csr_array

APPEARANCE = ("NORMAL", "TANGENT", "TEXCOORD_", "COLOR_")
"""First characters of the names of attributes that only say how a surface looks."""
DEFAULT_TRS = {"translation": (0, 0, 0), "rotation": (0, 0, 0, 1), "scale": (1, 1, 1)}
"""Values of the properties that a node does not have (glTF 2.0, 3.5.3 Transformations); rotations are xyzw."""


def local_matrices(document: Document) -> Float[np.ndarray, "N 4 4"]:
    """Return each node's local transform (parent from node), from its matrix or its translation, rotation, scale."""
    return np.array([local_matrix(node) for node in document.gltf.get("nodes", [])], np.float64).reshape(-1, 4, 4)


def animated_matrices(
    document: Document, animated: Mapping[tuple[int, str], Float[np.ndarray, "T _"]], frames: int
) -> Float[np.ndarray, "T N 4 4"]:
    """Return each node's local transform in T frames.

    `animated` has the values of animated properties by (node, target path); other properties keep those of the file.
    A node with a matrix is decomposed first: written files must not animate it otherwise (glTF 2.0, 3.5.3).
    """
    T_parent_node = np.tile(local_matrices(document), (frames, 1, 1, 1))
    properties: dict[int, dict[str, Any]] = {}
    for (node, path), values in animated.items():
        if path in DEFAULT_TRS:
            properties.setdefault(node, {})[path] = values
    for node, values in properties.items():
        T_parent_node[:, node] = local_matrix({**node_properties(document.gltf["nodes"][node]), **values})
    return T_parent_node


def node_properties(entry: Mapping[str, Any]) -> dict[str, Float[np.ndarray, " _"]]:
    """Return translation, rotation (xyzw) and scale of a node, those of its matrix if it has one."""
    from scipy.spatial.transform import Rotation

    if "matrix" not in entry:
        return {key: np.array(entry.get(key, default), float) for key, default in DEFAULT_TRS.items()}
    matrix = np.array(entry["matrix"], float).reshape(4, 4).T
    scale = np.linalg.norm(matrix[:3, :3], axis=0) * (-1.0 if np.linalg.det(matrix[:3, :3]) < 0 else 1.0)
    rotation = nearest_rotation(matrix[:3, :3] / np.where(scale == 0, 1.0, scale))
    return {"translation": matrix[:3, 3], "rotation": Rotation.from_matrix(rotation).as_quat(), "scale": scale}


def world_matrices(
    document: Document, T_parent_node: Float[np.ndarray, "*T N 4 4"] | None = None
) -> Float[np.ndarray, "*T N 4 4"]:
    """Return each node's global transform: the product of the local transforms from its root down."""
    if T_parent_node is None:
        T_parent_node = local_matrices(document)
    T_world_node = T_parent_node.copy()
    parent = node_parents(document)
    for node in sort_parents_first(document, parent):
        if parent[node] >= 0:
            T_world_node[..., node, :, :] = T_world_node[..., parent[node], :, :] @ T_parent_node[..., node, :, :]
    return T_world_node


def node_name(document: Document, node: int) -> str:
    """Return the name of a node, or one that tells its number."""
    return str(document.gltf["nodes"][node].get("name", f"node{node}"))


def scene_nodes(document: Document) -> list[int]:
    """List the nodes of the default scene (else of scene 0, else of the file), depth first: the scene order."""
    gltf = document.gltf
    scenes = gltf.get("scenes")
    if scenes:
        roots = scenes[gltf.get("scene", 0)].get("nodes", [])
    else:
        roots = [node for node, parent in enumerate(node_parents(document)) if parent < 0]
    order: dict[int, None] = {}
    stack = list(reversed(roots))
    while stack:
        node = stack.pop()
        if node not in order:
            order[node] = None
            stack.extend(reversed(gltf["nodes"][node].get("children", [])))
    return list(order)


def used_skins(document: Document) -> list[int]:
    """List the skins with which the default scene shows its meshes; all skins with joints where it shows no mesh."""
    nodes, skins = document.gltf.get("nodes", []), document.gltf.get("skins", [])
    shown = [nodes[node] for node in scene_nodes(document) if "mesh" in nodes[node]]
    used = sorted({node["skin"] for node in shown if "skin" in node}) if shown else range(len(skins))
    return [skin for skin in used if skins[skin]["joints"]]


def read_attribute(document: Document, primitive: dict[str, Any], name: str) -> Float[np.ndarray, "V C"] | None:
    """Read a vertex attribute in float64; None where the primitive does not have it.

    Elements of the appearance with NaN or infinity become zeros.
    """
    index = primitive["attributes"].get(name)
    if index is None:
        return None
    values = read_floats(document, index)
    return finite_or_zero(values) if name.startswith(APPEARANCE) else values


def read_indices(document: Document, primitive: dict[str, Any]) -> np.ndarray:
    """Read the vertex indices that a primitive draws, in order; all vertices where it has no index accessor."""
    count = document.gltf["accessors"][primitive["attributes"]["POSITION"]]["count"]
    if "indices" not in primitive:
        return np.arange(count)
    values = read_accessor(document, primitive["indices"]).ravel()
    if values.max(initial=0) >= count:
        raise damaged(document.path, f"face indices below {count}", values.max())
    return values.astype(np.int64)


def read_morphed_attribute(
    document: Document, primitive: dict[str, Any], name: str, weights: list[float]
) -> Float[np.ndarray, "V C"] | None:
    """Read a vertex attribute plus its weighted morph targets (glTF 2.0, 3.7.2.2 Morph Targets).

    The w component of a tangent is its handedness and has no delta.
    """
    values = read_attribute(document, primitive, name)
    for target, weight in zip(primitive.get("targets", []), weights, strict=False):
        if weight and name in target and values is not None:
            values[:, :3] += weight * read_floats(document, target[name])
    return values


def target_count(document: Document, node: int) -> int:
    """Return the number of morph targets of a node's mesh."""
    mesh = document.gltf["nodes"][node].get("mesh")
    primitives = [] if mesh is None else document.gltf["meshes"][mesh]["primitives"]
    return max((len(primitive.get("targets", [])) for primitive in primitives), default=0)


def read_morph_weights(document: Document, node: int) -> list[float]:
    """Read the weight of each morph target of a node at rest: its own, else its mesh's (glTF 2.0, 3.7.4), else 0."""
    count = target_count(document, node)
    if not count:
        return []
    entry = document.gltf["nodes"][node]
    weights = entry.get("weights") or document.gltf["meshes"][entry["mesh"]].get("weights") or []
    return [*(float(weight) for weight in weights), *[0.0] * count][:count]


@dataclass(frozen=True, eq=False)
class SkinBinding:
    """Joints, inverse bind matrices and weights of a primitive's vertices, independent of any pose."""

    nodes: Int[np.ndarray, " J"]
    """Node of each joint of the skin."""
    T_joint_bind: Float[np.ndarray, "J 4 4"]
    """Inverse bind matrices."""
    joints: Int[np.ndarray, "V K"]
    """Joint of each influence, an index into `nodes`."""
    weights: Float[np.ndarray, "V K"]
    """Weight of each influence; rows sum to 1."""

    def matrices(self, T_world_node: Float[np.ndarray, "N 4 4"]) -> Float[np.ndarray, "V 3 4"]:
        """Return each vertex's skinning matrix to the world: the weighted sum of its joints' transforms.

        Linear blend skinning (glTF 2.0, 3.7.3.3 Skinned Mesh Attributes).
        """
        T_world_bind = T_world_node[self.nodes] @ self.T_joint_bind
        return (self._weights @ T_world_bind[:, :3].reshape(-1, 12)).reshape(-1, 3, 4)

    @cached_property
    def _weights(self) -> csr_array:
        """The weights by vertex and joint. One product takes a third of the time of a loop over influences."""
        from scipy.sparse import csr_array

        count = np.arange(0, self.joints.size + 1, self.joints.shape[1])
        return csr_array((self.weights.ravel(), self.joints.ravel(), count), (len(self.joints), len(self.nodes)))


def read_skin_binding(document: Document, node: int, primitive: dict[str, Any]) -> SkinBinding | None:
    """Read the joints and weights of a primitive's vertices; None where node or primitive have no skinning."""
    skin = document.gltf["nodes"][node].get("skin")
    if skin is None or "JOINTS_0" not in primitive["attributes"]:
        return None
    joints, weights = read_influences(document, primitive)
    nodes = np.array(document.gltf["skins"][skin]["joints"], np.int64)
    T_joint_bind = read_inverse_bind_matrices(document, skin)
    if joints.min(initial=0) < 0 or joints.max(initial=0) >= len(nodes):
        raise damaged(document.path, f"joints below {len(nodes)} in skin {skin}", joints.max())
    return SkinBinding(nodes, T_joint_bind, joints, weights)


def vertex_matrices(
    document: Document, node: int, primitive: dict[str, Any], T_world_node: Float[np.ndarray, "N 4 4"]
) -> Float[np.ndarray, "M 3 4"]:
    """Return the matrix that takes each vertex of a primitive to the world; without a skin, one matrix for all.

    A skinned vertex ignores the transform of the node of its mesh (glTF 2.0, 3.7.3.2 Joint Hierarchy).
    """
    binding = read_skin_binding(document, node, primitive)
    return T_world_node[node][None, :3] if binding is None else binding.matrices(T_world_node)


def joint_matrices(
    document: Document, skin: int, T_world_node: Float[np.ndarray, "N 4 4"]
) -> Float[np.ndarray, "J 4 4"]:
    """Return world from bind space for each joint of a skin: its node's transform times its inverse bind matrix."""
    return T_world_node[document.gltf["skins"][skin]["joints"]] @ read_inverse_bind_matrices(document, skin)


def read_inverse_bind_matrices(document: Document, skin: int) -> Float[np.ndarray, "J 4 4"]:
    """Read the inverse bind matrices of a skin; one that has none has identity matrices (3.7.3.1).

    Those of `unbound_joints` are such that the nodes, as they are in the file, are the bind pose.
    """
    matrices = _stored_bind_matrices(document, skin)
    if unbound := unbound_joints(document, skin):
        nodes = np.array(document.gltf["skins"][skin]["joints"])[unbound]
        matrices[unbound] = np.linalg.pinv(world_matrices(document)[nodes])
    return matrices


def unbound_joints(document: Document, skin: int) -> list[int]:
    """List the joints of a skin with an inverse bind matrix of zeros, or one of NaN that no vertex is bound to."""
    matrices = _stored_bind_matrices(document, skin)
    broken = np.logical_not(np.isfinite(matrices).all(axis=(1, 2)))
    for node in document.gltf["nodes"] if broken.any() else ():
        if node.get("skin") == skin and "mesh" in node:
            for primitive in document.gltf["meshes"][node["mesh"]]["primitives"]:
                if "JOINTS_0" in primitive["attributes"]:
                    joints, weights = read_influences(document, primitive)
                    broken[joints[(weights > 0) & (joints < len(broken))]] = False
    return np.flatnonzero(broken | ~matrices[:, :3].any(axis=(1, 2))).tolist()


def _stored_bind_matrices(document: Document, skin: int) -> Float[np.ndarray, "J 4 4"]:
    entry = document.gltf["skins"][skin]
    count = len(entry["joints"])
    if "inverseBindMatrices" not in entry:
        return np.tile(np.eye(4), (count, 1, 1))
    columns = read_floats(document, entry["inverseBindMatrices"])
    if columns.shape[1] != 16 or len(columns) < count:
        found = f"{len(columns)} x {columns.shape[1]} numbers"
        raise damaged(document.path, f"{count} inverse bind matrices in skin {skin}", found)
    # Accessors of matrices are column-major (glTF 2.0, 3.6.2.4 Data Alignment).
    return with_last_row(columns[:count].reshape(-1, 4, 4).transpose(0, 2, 1))


def transform_points(
    matrices: Float[np.ndarray, "M 3 4"], points: Float[np.ndarray, "V 3"]
) -> Float[np.ndarray, "V 3"]:
    """Transform points by one affine matrix each (M = V), or all by one (M = 1)."""
    return transform_vectors(matrices[:, :, :3], points) + matrices[:, :, 3]


def transform_vectors(
    matrices: Float[np.ndarray, "M 3 3"], vectors: Float[np.ndarray, "V 3"]
) -> Float[np.ndarray, "V 3"]:
    """Transform vectors by one matrix each (M = V), or all by one (M = 1)."""
    return (matrices @ vectors[:, :, None])[:, :, 0]


def normal_matrices(linear: Float[np.ndarray, "M 3 3"]) -> Float[np.ndarray, "M 3 3"]:
    """Return the matrices that transform normals: inverse transposes up to a positive factor.

    Computed as cofactor matrices, which exist for singular (flattening) matrices too.
    """
    a, b, c = linear[:, :, 0], linear[:, :, 1], linear[:, :, 2]
    # Matrices with NaN come from damaged skins, whose vertices are refused with a message.
    with np.errstate(invalid="ignore", over="ignore"):
        cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
        mirrored = np.linalg.det(linear) < 0
    return cofactors * np.where(mirrored, -1.0, 1.0)[:, None, None]


def inner_products(a: Float[np.ndarray, "*N C"], b: Float[np.ndarray, "*N C"]) -> Float[np.ndarray, "*N 1"]:
    """Return the inner product of each pair of rows."""
    return np.einsum("...c,...c->...", a, b)[..., None]


def normalized_quaternions(quat_xyzw: Float[np.ndarray, "*N 4"]) -> Float[np.ndarray, "*N 4"]:
    """Scale quaternions to length 1; zeros stay zero."""
    length = np.sqrt(inner_products(quat_xyzw, quat_xyzw))
    return quat_xyzw / np.where(length > 0, length, 1.0)


def local_matrix(node: dict[str, Any]) -> Float[np.ndarray, "*T 4 4"]:
    """Return the local transform of a node, T * R * S; its translation, rotation and scale may have leading axes."""
    if "matrix" in node:
        return with_last_row(np.array(node["matrix"], np.float64).reshape(4, 4).T)
    values = {path: np.array(node.get(path, default), np.float64) for path, default in DEFAULT_TRS.items()}
    x, y, z, w = np.moveaxis(normalized_quaternions(values["rotation"]), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    rotation = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    matrix = np.zeros((*np.broadcast_shapes(*(value.shape[:-1] for value in values.values())), 4, 4))
    matrix[..., :3, :3] = rotation * values["scale"][..., None, :]
    matrix[..., :3, 3] = values["translation"]
    matrix[..., 3, 3] = 1.0
    return matrix


def with_last_row(matrices: Float[np.ndarray, "*N 4 4"]) -> Float[np.ndarray, "*N 4 4"]:
    """Return matrices with 0 0 0 1 as their fourth row, which they must have (3.5.3, 3.7.3.1).

    Damaged files have others, and with them matrices that have no inverse.
    """
    result = matrices.copy()
    result[..., 3, :] = [0.0, 0.0, 0.0, 1.0]
    return result


def node_parents(document: Document) -> list[int]:
    """Return the parent of each node, -1 for roots."""
    nodes = document.gltf.get("nodes", [])
    parent = [-1] * len(nodes)
    for index, node in enumerate(nodes):
        for child in node.get("children", []):
            if parent[child] >= 0:
                raise damaged(document.path, f"one parent for node {child}", "two")
            parent[child] = index
    return parent


def sort_parents_first(document: Document, parent: list[int]) -> list[int]:
    """List all nodes, each after its parent."""
    order = [node for node, above in enumerate(parent) if above < 0]
    for node in order:  # breadth first: the list grows while it is iterated
        order.extend(document.gltf["nodes"][node].get("children", []))
    if len(order) < len(parent):
        unreached = min(set(range(len(parent))) - set(order))
        raise damaged(document.path, "a tree of nodes", f"node {unreached} below itself")
    return order


def read_influences(document: Document, primitive: dict[str, Any]) -> tuple[np.ndarray, Float[np.ndarray, "V K"]]:
    """Read the joint indices and weights of each vertex from all sets JOINTS_n and WEIGHTS_n, as (V, K) arrays.

    Weights are divided by their sum; a vertex without any finite weight follows its first joint, as in three.js.
    Joints of weight zero become 0, because files may hold any number there (glTF 2.0, 3.7.3.3, only recommends zero).
    """
    joints, weights, number = [], [], 0
    while f"JOINTS_{number}" in primitive["attributes"]:
        joints.append(read_attribute(document, primitive, f"JOINTS_{number}"))
        weights.append(read_attribute(document, primitive, f"WEIGHTS_{number}"))
        number += 1
    if any(part is None for part in weights):
        raise damaged(document.path, "WEIGHTS for each set of JOINTS", "none")
    joint, weight = np.concatenate(joints, axis=1), np.concatenate(weights, axis=1)
    total = weight.sum(axis=1, keepdims=True)
    usable = (total > 0) & np.isfinite(total)
    weight = np.where(usable, weight / np.where(usable, total, 1.0), np.eye(1, weight.shape[1]))
    return np.where(weight == 0, 0, joint).astype(np.int64), weight
