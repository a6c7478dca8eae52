"""Reads the joints of a glTF file at rest, and the joints and weights of each vertex of its Mesh.

Several skins over one set of nodes (a character in pieces), several sets of influences, and unskinned meshes below a
joint become one form: every vertex has K influences, each with a joint, a weight, and the position to which that joint
alone would take the vertex at rest. These positions contain the inverse bind matrices, node scales (100 is common) and
z-up roots: the vertex is their weighted mean, and a pose moves each of them rigidly with its joint.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ...bodies.skinned_character import SkinnedCharacter
from ...core.mesh import Mesh
from .document import Document, read_floats
from .read import RestScene, VertexRange, get_primitive
from .scene import (
    joint_matrices,
    node_parents,
    read_influences,
    read_morph_weights,
    read_morphed_attribute,
    sort_parents_first,
    transform_points,
)


@dataclass(frozen=True, eq=False)
class _JointTree:
    """The joints of a document among its nodes."""

    nodes: list[int]
    """Node of each joint."""
    node_parent: list[int]
    """Parent of every node, -1 for roots."""
    joint_of_node: dict[int, int]
    """Index of the joint that each joint node is."""

    def nearest_joint(self, node: int) -> int:
        """Return the joint that a node is, or the nearest one above it; -1 where there is none."""
        while node >= 0 and node not in self.joint_of_node:
            node = self.node_parent[node]
        return self.joint_of_node.get(node, -1)


def skin_joints(document: Document, rest: RestScene) -> set[int]:
    """List the nodes that are joints of the shown skins."""
    skins = {skin for span in rest.vertex_ranges if (skin := _find_skin(document, span)) is not None}
    return {node for skin in skins for node in document.gltf["skins"][skin]["joints"]}


def rig_on_nodes(
    mesh: Mesh, document: Document, rest: RestScene, joint_nodes: Collection[int]
) -> tuple[SkinnedCharacter, list[int]]:
    """Read the influences on the vertices of a scene with given joints, and the node of each joint of the rig.

    The mesh is left as it is: its vertices are those of `rest` only where the mesh was read with it.
    """
    # One tree for all skins of the scene, so that their joints have one numbering.
    node_parent = node_parents(document)
    nodes = [node for node in sort_parents_first(document, node_parent) if node in joint_nodes]
    tree = _JointTree(nodes, node_parent, {node: j for j, node in enumerate(nodes)})
    parts = [_read_range_influences(document, rest, span, tree) for span in rest.vertex_ranges]
    columns = max(weights.shape[1] for _, weights, _ in parts)
    joint_of, weights, points = (
        np.concatenate([_pad_influences(part[k], columns) for part in parts]) for k in range(3)
    )
    names = tuple(str(document.gltf["nodes"][node].get("name", f"node{node}")) for node in nodes)
    parents = tuple(tree.nearest_joint(node_parent[node]) for node in nodes)
    return SkinnedCharacter(mesh, names, parents, rest.T_world_node[nodes], joint_of, weights, points), nodes


def unweighted_vertices(document: Document, rest: RestScene) -> int:
    """Count the skinned vertices without finite weights, which follow the first joint (see `read_influences`)."""
    count = 0
    for span in rest.vertex_ranges:
        if _find_skin(document, span) is None:
            continue
        primitive = get_primitive(document, (span.node, span.primitives[0]))
        sets = [name for name in primitive["attributes"] if name.startswith("WEIGHTS_")]
        total = np.asarray(sum(read_floats(document, primitive["attributes"][name]).sum(axis=1) for name in sets))
        count += int((~((total > 0) & np.isfinite(total))).sum())
    return count


def _find_skin(document: Document, span: VertexRange) -> int | None:
    """Return the skin of a range's vertices; None where they are unskinned, by the same rule as `vertex_matrices`."""
    skinned = "JOINTS_0" in get_primitive(document, (span.node, span.primitives[0]))["attributes"]
    return document.gltf["nodes"][span.node].get("skin") if skinned else None


def _read_range_influences(
    document: Document, rest: RestScene, span: VertexRange, tree: _JointTree
) -> tuple[Int[np.ndarray, "N K"], Float[np.ndarray, "N K"], Float[np.ndarray, "N K 3"]]:
    """Read the joints, weights and world positions of all influences on the vertices of one range.

    Unskinned vertices have one influence: the nearest joint above their node, else the world (joint index J).
    """
    primitive = get_primitive(document, (span.node, span.primitives[0]))
    positions = read_morphed_attribute(document, primitive, "POSITION", read_morph_weights(document, span.node))
    assert positions is not None
    skin = _find_skin(document, span)
    if skin is None:
        nearest = tree.nearest_joint(span.node) % (len(tree.nodes) + 1)  # -1, no joint, becomes J, the world
        joint_of = np.full((len(positions), 1), nearest)
        world = transform_points(rest.T_world_node[span.node, None, :3], positions)
        return joint_of, np.ones(joint_of.shape), world[:, None]
    skin_joints, weights = read_influences(document, primitive)
    T_world_bind = joint_matrices(document, skin, rest.T_world_node)
    points = [transform_points(T_world_bind[column, :3], positions) for column in skin_joints.T]
    # Skins list the same nodes in different orders: count joints by node.
    joint_of_skin = np.array([tree.joint_of_node[node] for node in document.gltf["skins"][skin]["joints"]])
    return joint_of_skin[skin_joints], weights, np.stack(points, axis=1)


def _pad_influences(values: np.ndarray, columns: int) -> np.ndarray:
    """Pad influences to `columns` with zeros; with weight zero, it does not matter that their joint is 0."""
    return np.pad(values, [(0, 0), (0, columns - values.shape[1]), *[(0, 0)] * (values.ndim - 2)])
