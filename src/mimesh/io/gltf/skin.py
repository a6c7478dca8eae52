"""The skeleton of a glTF file: its joints at rest, and which of them hold each vertex of its Mesh, and where.

Several skins over one set of nodes (a character in pieces), several sets of influences, and meshes that hang unskinned
on a bone become one thing: every vertex has K influences, each a joint, a weight, and the place to which that joint
alone would take the vertex at rest. Inverse bind matrices, node scales of 100 and z-up roots are spent on these places:
the vertex is their weighted mean, and posing is moving each place rigidly with its joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ...bodies.skinned_character import SkinnedCharacter
from ...core.errors import InputError
from .. import load_mesh
from .document import Document
from .edit import GltfSource
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
    above: list[int]
    """Parent of every node, -1 for roots."""
    joint: dict[int, int]
    """Index of the joint that each joint node is."""

    def nearest_joint(self, node: int) -> int:
        """The joint that a node is or hangs on; -1 where there is none."""
        while node >= 0 and node not in self.joint:
            node = self.above[node]
        return self.joint.get(node, -1)


def read_skin(path: str | Path) -> SkinnedCharacter:
    """Read a .glb, .vrm or .gltf character with its skeleton: all joints of the skins that its default scene shows.

    Morph targets stay at their default weights. Animations are not read.

    Raises:
        InputError: as `load_mesh`; another format; or a scene without a skinned mesh.
    """
    mesh = load_mesh(path)
    source = mesh.source
    if not isinstance(source, GltfSource):
        raise InputError(
            f"{path}: expected a rigged mesh in a .glb, .gltf or .vrm, found none in this {Path(path).suffix}; "
            "export the mesh and its armature together as glTF"
        )
    tree = _find_joints(source.document, source.rest)
    if not tree.nodes:
        raise InputError(f"{path}: expected a mesh with a skin, found none; export it together with its armature")
    vertex_ranges = [
        _read_range_influences(source.document, source.rest, span, tree) for span in source.rest.vertex_ranges
    ]
    most = max(weights.shape[1] for _, weights, _ in vertex_ranges)
    joint_of, weights, points = (
        np.concatenate([_pad_influences(span[k], most) for span in vertex_ranges]) for k in range(3)
    )
    names = [source.document.gltf["nodes"][node].get("name", f"node{node}") for node in tree.nodes]
    parents = tuple(tree.nearest_joint(tree.above[node]) for node in tree.nodes)
    return SkinnedCharacter(
        mesh, tuple(names), parents, source.rest.T_world_node[tree.nodes], joint_of, weights, points
    )


def _find_joints(document: Document, rest: RestScene) -> _JointTree:
    """The joints of the shown skins, each after its parent."""
    gltf = document.gltf
    skins = {skin for span in rest.vertex_ranges if (skin := _find_skin(document, span)) is not None}
    wanted = {node for skin in skins for node in gltf["skins"][skin]["joints"]}
    above = node_parents(document)
    nodes = [node for node in sort_parents_first(document, above) if node in wanted]
    return _JointTree(nodes, above, {node: j for j, node in enumerate(nodes)})


def _find_skin(document: Document, span: VertexRange) -> int | None:
    """The skin that holds a run's vertices; None where they follow their node, as `vertex_matrices` has it."""
    skinned = "JOINTS_0" in get_primitive(document, (span.node, span.primitives[0]))["attributes"]
    return document.gltf["nodes"][span.node].get("skin") if skinned else None


def _read_range_influences(
    document: Document, rest: RestScene, span: VertexRange, tree: _JointTree
) -> tuple[Int[np.ndarray, "N K"], Float[np.ndarray, "N K"], Float[np.ndarray, "N K 3"]]:
    """Joints, weights and places of the vertices of one run."""
    primitive = get_primitive(document, (span.node, span.primitives[0]))
    positions = read_morphed_attribute(document, primitive, "POSITION", read_morph_weights(document, span.node))
    assert positions is not None
    skin = _find_skin(document, span)
    if skin is None:
        one = np.full(
            (len(positions), 1), tree.nearest_joint(span.node) % (len(tree.nodes) + 1)
        )  # -1: the world, the last
        return (
            one,
            np.ones(one.shape),
            transform_points(rest.T_world_node[span.node, None, :3], positions)[:, None],
        )
    number, weights = read_influences(document, primitive)
    T_world_bind = joint_matrices(document, skin, rest.T_world_node)
    points = [transform_points(T_world_bind[column, :3], positions) for column in number.T]
    joint = np.array([tree.joint[node] for node in document.gltf["skins"][skin]["joints"]])
    return joint[number], weights, np.stack(points, axis=1)


def _pad_influences(columns: np.ndarray, most: int) -> np.ndarray:
    """Influences padded to `most` columns with zeros: weights of zero, so it does not matter whose."""
    return np.pad(columns, [(0, 0), (0, most - columns.shape[1]), *[(0, 0)] * (columns.ndim - 2)])
