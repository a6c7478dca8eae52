"""Chooses the keys of new animations of the nodes of a glTF file.

Rotations get the fewest keys with which no vertex moves farther than a limit (see `keys`), other values all or one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float

from ...core.mesh import Mesh
from .document import Document
from .edit import GltfSource
from .keys import SHORTEST_REACH, chain_tolerances, choose_keys, without_costly_times
from .scene import node_parents, node_properties, normalized_quaternions
from .skin import rig_on_nodes

ROUNDING = 1e-7
"""Change of a value, over itself or over the mesh's size, that counts as none: float32 stores values no better."""
ROTATION_SHARE = 0.8
"""Share of the limit that thinned rotations may use; the rest is left to scales and to rounding."""
SCALE_SHARE = 0.05
"""Relative change of a scale, over the limit, that counts as none: scales that are computed from matrices in float32
change by up to 5e-6 where bones keep their lengths (measured on a file of Kenney's)."""
Tracks = Mapping[tuple[int, str], Float[np.ndarray, "_ _"]]
"""Values by (node, target path): in every frame, or in one of what does not move."""


def node_keys(source: GltfSource, tracks: Tracks, limit: float) -> dict[tuple[int, str], Bool[np.ndarray, " _"]]:
    """Choose the frames of animated values that become keys; what stays the same has one, in the first frame.

    Args:
        limit: distance, over the mesh's size, by which thinned rotations may move a vertex.
    """
    keys = {}
    for key, values in tracks.items():
        still = rounding(source, key, values)
        if key[1] == "scale":
            still = max(still, SCALE_SHARE * limit * float(np.abs(values).max()))
        moves = np.abs(values - values[0]).max() > still
        keys[key] = np.full(len(values), moves) | (np.arange(len(values)) == 0)
    turning = [key for key, is_key in keys.items() if key[1] == "rotation" and is_key.sum() > 1]
    if not turning:
        return keys
    quaternions = normalized_quaternions(np.stack([tracks[key] for key in turning]))
    tolerance = _tolerances(source, tracks, {node for node, _ in turning}, ROTATION_SHARE * limit)
    chosen = choose_keys(quaternions, np.array([tolerance[node] for node, _ in turning]), rotations=True)
    return keys | dict(zip(turning, without_costly_times(chosen), strict=True))


def rounding(source: GltfSource, key: tuple[int, str], values: Float[np.ndarray, "T C"]) -> float:
    """Return the change of animated values that is no more than rounding, in their unit."""
    node, path = key
    unit = {"rotation": 1.0, "weights": 1.0}.get(path, 0.0)
    if path == "translation" and node < len(source.rest.T_world_node):
        size = float(np.ptp(source.vertices, axis=0).max())
        unit = size / max(_scale_above(source, node_parents(source.document)[node]), 1e-12)
    return ROUNDING * max(float(np.abs(values).max()), unit)


def _scale_above(source: GltfSource, parent: int) -> float:
    """Return by how much the nodes from the scene to a node, which may be none (-1), enlarge what is below it."""
    return 1.0 if parent < 0 else float(np.linalg.norm(source.rest.T_world_node[parent, :3, :3], axis=0).max())


def _tolerances(source: GltfSource, tracks: Tracks, turning: set[int], limit: float) -> dict[int, float]:
    """Compute the error of each turning node's rotation (radians) with which no vertex moves farther than `limit`.

    As `keys.rotation_tolerances`: each node has an equal share of the limit, among those that turn in the longest chain
    through it.
    """
    document, above = source.document, node_parents(source.document)
    skinned = {joint for skin in document.gltf.get("skins", []) for joint in skin["joints"]}
    mesh = Mesh(source.vertices, np.zeros((0, 3), np.int64))
    listed = {node for node, _ in tracks if node < len(above)} | turning | skinned
    rig, nodes = rig_on_nodes(mesh, document, source.rest, listed)
    size = float(np.ptp(source.vertices, axis=0).max())
    reach = np.zeros(len(nodes) + 1)  # the last one is the world
    distance = np.linalg.norm(rig.points - np.pad(rig.joints, ((0, 1), (0, 0)))[rig.joint_of], axis=-1)
    np.maximum.at(reach, rig.joint_of[rig.weights > 0], distance[rig.weights > 0])
    for j in range(len(nodes) - 1, -1, -1):  # children before their parents
        parent = rig.parents[j]
        if parent >= 0 and reach[j] > 0:
            bone = float(np.linalg.norm(rig.joints[j] - rig.joints[parent]))
            bone += _farthest(document, tracks, nodes[j]) * _scale_above(source, above[nodes[j]])
            reach[parent] = max(reach[parent], bone + reach[j])
    turns = np.array([node in turning for node in nodes])
    reaches = np.maximum(reach[:-1], SHORTEST_REACH * size)
    return dict(zip(nodes, chain_tolerances(reaches, rig.parents, limit * size, turns).tolist(), strict=True))


def _farthest(document: Document, tracks: Tracks, node: int) -> float:
    """Return how far an animation moves a node from its place in the frame of its parent."""
    path = tracks.get((node, "translation"))
    if path is None:
        return 0.0
    still = node_properties(document.gltf["nodes"][node])["translation"]
    return float(np.linalg.norm(path - still, axis=1).max())
