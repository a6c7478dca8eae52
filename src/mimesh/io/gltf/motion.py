"""Reads animated joints of a glTF file without a mesh, and plays them on the shipped body.

Joints are the nodes that an animation moves or a skin lists, and those between them. Their rest pose is the bind pose
of the largest skin, where its inverse bind matrices define one, else the nodes' transforms in the file: exporters often
leave these in some frame of an animation. Rotations are world rotations, so node scales and mirrored joints cancel out.
Animated scales are not played, because a body has a fixed size: joints that a file scales up from zero are there from
the first frame.

In a VRM animation (.vrma) joints are the humanoid bones that its extension lists, under the names of our joints, and
rest is what its nodes are in the file.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ...core.geometry import nearest_rotation
from ...core.normalization import ROTATIONS
from ...core.rig import local_rotations
from ...motions.bvh import Bvh
from ..timing import DEFAULT_FPS
from .animation import AnimationChannel, animated_nodes, frame_rate, frame_times, sample_nodes, select_channels
from .check import damaged
from .document import Document
from .scene import joint_matrices, node_parents, scene_nodes, sort_parents_first, world_matrices
from .vrm import is_vrm_animation, vrm_bones

PLAYED_PATHS = ("translation", "rotation")
"""Target paths of the channels that are played."""
WORLD_NODE = -1
"""Index of an added root joint in files with several roots. It never moves; as an index it is the last node."""
NEGLIGIBLE = 1e-6
"""Relative size below which the scale of a bind matrix or the change of a bone counts as zero."""
SAME_ROTATION_COSINE = np.cos(np.radians(1.0))
"""Cosine of the largest angle between the rotations from bind space of joints that are in their bind pose."""
SAME_UP_COSINE = 0.7
"""Cosine of the largest angle (about 45 degrees) between two up axes that count as the same."""


def is_motion(document: Document) -> bool:
    """Return whether a file has animations, and no mesh in its default scene."""
    nodes = document.gltf.get("nodes", [])
    return bool(document.gltf.get("animations")) and not any("mesh" in nodes[n] for n in scene_nodes(document))


def gltf_joints(document: Document) -> int:
    """Return the number of joints of such a file."""
    return len([node for node in _find_joints(document)[0] if node != WORLD_NODE])


def read_skeleton(document: Document, fps: float | None = None, animation: str | None = None) -> Bvh:
    """Read the joints and an animation of them, in the file's axes and unit; arguments as in `read_gltf_clip`.

    Joints that do not keep their distance from their parent get their translations in `Bvh.moved`.

    Raises:
        InputError: no such animation, a damaged one, or one with NaN or infinity.
    """
    channels = [channel for channel in select_channels(document, animation) if channel.path in PLAYED_PATHS]
    fps = fps or frame_rate(channels) or DEFAULT_FPS
    nodes, parents = _find_joints(document)
    humanoid = _animated_bones(document)
    at_rest = world_matrices(document) if humanoid else rest_matrices(document)
    T_world_rest = _append_world(at_rest)[nodes]
    times = frame_times(document, channels, fps)
    rotation, position = _joint_motion(document, channels, times, nodes, T_world_rest)
    parent = np.maximum(parents, 0)
    rest = T_world_rest[:, :3, 3]
    offsets = rest - np.where(np.array(parents)[:, None] >= 0, rest[parent], 0.0)
    # Offsets from the parent joint, in its frame, per frame: equal to `offsets` where a bone keeps its length.
    bones = (np.swapaxes(rotation[:, parent], -1, -2) @ (position - position[:, parent])[..., None])[..., 0]
    stretches = np.abs(bones - offsets).max(axis=(0, 2)) > NEGLIGIBLE * np.ptp(rest, axis=0).max()
    moved = {j: bones[:, j] for j in np.flatnonzero(stretches).tolist() if j > 0}
    names = tuple("world" if n == WORLD_NODE else _joint_name(document, n, humanoid) for n in nodes)
    local = local_rotations(rotation, parents)
    return Bvh(document.path.stem, names, parents, offsets, {}, local, position[:, 0], float(fps), moved)


def rest_matrices(document: Document) -> Float[np.ndarray, "N 4 4"]:
    """Return the world transforms of all nodes in the bind pose of the largest skin; the first of `bind_poses`."""
    return next(bind_poses(document))


def bind_poses(document: Document) -> Iterator[Float[np.ndarray, "N 4 4"]]:
    """Yield the world transforms of all nodes in the bind pose of the largest skin, in the likeliest orientation first.

    World from bind space, through joint j in the file's pose, is node j times its inverse bind matrix. Undoing it takes
    a node from that pose into bind space; an orientation and the median scale take bind space back to the world.
    Nodes that the skin does not list follow the nearest joint above them.

    Without usable inverse bind matrices, these are the nodes' transforms in the file.

    Raises:
        InputError: the inverse bind matrices have NaN or infinity.
    """
    T_world_node, skins = world_matrices(document), document.gltf.get("skins", [])
    bound_skins = [number for number, skin in enumerate(skins) if "inverseBindMatrices" in skin]
    if not bound_skins:
        yield T_world_node
        return
    largest = max(bound_skins, key=lambda number: len(skins[number]["joints"]))
    T_world_bind = joint_matrices(document, largest, T_world_node)
    if not np.isfinite(T_world_bind).all():
        raise damaged(document.path, f"finite joint transforms in skin {largest}", "NaN or infinity")
    scale = np.cbrt(np.abs(np.linalg.det(T_world_bind[:, :3, :3])))
    invertible = np.flatnonzero(scale > NEGLIGIBLE * scale.max(initial=0.0)).tolist()
    if not invertible:
        yield T_world_node
        return
    joint_of_node = {skins[largest]["joints"][joint]: joint for joint in invertible}
    parent, nearest_joint = node_parents(document), {WORLD_NODE: invertible[0]}
    order = sort_parents_first(document, parent)
    above_joints = parent[next(node for node in order if node in joint_of_node)]
    for orientation in _bind_orientations(T_world_bind[invertible], _append_world(T_world_node)[above_joints]):
        T_rest_bind = np.eye(4)
        T_rest_bind[:3, :3] = orientation * np.median(scale[invertible])
        T_rest_node = np.empty_like(T_world_node)
        for node in order:
            nearest_joint[node] = joint_of_node.get(node, nearest_joint[parent[node]])
            T_rest_node[node] = T_rest_bind @ np.linalg.inv(T_world_bind[nearest_joint[node]]) @ T_world_node[node]
        yield T_rest_node


def _bind_orientations(
    T_world_bind: Float[np.ndarray, "J 4 4"], T_world_above: Float[np.ndarray, "4 4"]
) -> list[Float[np.ndarray, "3 3"]]:
    """List axis-aligned rotations from bind space to the world, the likeliest first.

    Where the file's pose is the bind pose, all joints have one rotation, and the nearest axis-aligned one to it is the
    likeliest. Else candidates are, in the order that exporters use them, the rotation of the node above the joints, and
    the identity: the first one with about the same up axis as the mean rotation of the joints. What remains is the
    joints' pose. If none fits, it is the axis-aligned rotation nearest to that mean.
    """
    rotations = nearest_rotation(T_world_bind[:, :3, :3])
    mean = nearest_rotation(rotations.sum(axis=0))
    candidates = [_nearest_axis_rotation(nearest_rotation(T_world_above[:3, :3])), np.eye(3)]
    posed = np.einsum("jkl,kl->j", rotations, mean).min() < 1 + 2 * SAME_ROTATION_COSINE  # the trace of a rotation
    likely = [candidate for candidate in candidates if posed and (mean @ candidate.T)[1, 1] > SAME_UP_COSINE]
    first = (likely or [_nearest_axis_rotation(mean)])[0]
    return [first, *(candidate for candidate in candidates if not np.array_equal(candidate, first))]


def _nearest_axis_rotation(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the axis-aligned rotation with the smallest angle to a rotation, which has the largest trace(R^T A)."""
    return ROTATIONS[np.einsum("rkl,kl->r", ROTATIONS, rotation).argmax()]


def _find_joints(document: Document) -> tuple[list[int], tuple[int, ...]]:
    """Find the nodes that are joints, each after its parent, and the parent joint of each; the one root has -1."""
    node_parent = node_parents(document)
    order = sort_parents_first(document, node_parent)
    joints = set(_animated_bones(document).values())
    if not joints:
        joints = {node for skin in document.gltf.get("skins", []) for node in skin["joints"]}
        joints |= animated_nodes(document, PLAYED_PATHS)
    for node in tuple(joints):  # add the nodes between a joint and the next joint above it
        between, node = [], node_parent[node]
        while node >= 0 and node not in joints:
            between.append(node)
            node = node_parent[node]
        joints.update(between if node >= 0 else ())
    nodes = [node for node in order if node in joints]
    if sum(node_parent[node] not in joints for node in nodes) != 1:
        nodes.insert(0, WORLD_NODE)
    index = {node: j for j, node in enumerate(nodes)}
    root = index.get(WORLD_NODE, -1)
    parents = (index.get(node_parent[node], root) if node != WORLD_NODE else -1 for node in nodes)
    return nodes, tuple(parents)


def _animated_bones(document: Document) -> dict[str, int]:
    """Return the node of each joint of a VRM animation; empty for other files."""
    return vrm_bones(document) if is_vrm_animation(document) else {}


def _joint_name(document: Document, node: int, bones: dict[str, int]) -> str:
    """Return the name of a node; in a VRM animation that of our joint, or one that stands for none."""
    if bones:
        return next((name for name, number in bones.items() if number == node), f"node{node}")
    return str(document.gltf["nodes"][node].get("name", f"node{node}"))


def _joint_motion(
    document: Document,
    channels: list[AnimationChannel],
    times: Float[np.ndarray, " T"],
    nodes: list[int],
    T_world_rest: Float[np.ndarray, "J 4 4"],
) -> tuple[Float[np.ndarray, "T J 3 3"], Float[np.ndarray, "T J 3"]]:
    """Return the world rotation of each joint since rest, and its world position, in every frame."""
    rotation, position = np.empty((len(times), len(nodes), 3, 3)), np.empty((len(times), len(nodes), 3))
    # A joint whose scale is zero at rest has no inverse; with the pseudo-inverse it does not rotate.
    rest_inverse = np.linalg.pinv(T_world_rest[:, :3, :3])
    done = 0
    for _, T_world_node in sample_nodes(document, channels, times):
        T_world_joint = _append_world(T_world_node)[:, nodes]
        if not np.isfinite(T_world_joint).all():
            frame = done + int(np.flatnonzero(~np.isfinite(T_world_joint).all(axis=(1, 2, 3)))[0])
            raise damaged(document.path, "finite numbers", f"NaN or infinity in frame {frame}")
        block = slice(done, done + len(T_world_joint))
        rotation[block] = nearest_rotation(T_world_joint[..., :3, :3] @ rest_inverse)
        position[block] = T_world_joint[..., :3, 3]
        done += len(T_world_joint)
    return rotation, position


def _append_world(T_world_node: Float[np.ndarray, "*T N 4 4"]) -> Float[np.ndarray, "*T M 4 4"]:
    """Append an identity transform for `WORLD_NODE` after the last node (M = N + 1)."""
    world = np.broadcast_to(np.eye(4), (*T_world_node.shape[:-3], 1, 4, 4))
    return np.concatenate([T_world_node, world], axis=-3)
