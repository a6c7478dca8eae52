"""Reads animated joints of a glTF file without a mesh, and plays them on the shipped body.

Joints are the nodes that an animation moves or a skin lists, and those between them; without a skin, all that have a
root in common with a moving one. Their rest pose is the bind pose
of the largest skin, where its inverse bind matrices define one, else the nodes' transforms in the file: exporters often
leave these in some frame of an animation. Scales of nodes are kept: a head may have been enlarged since it was bound.
Rotations are world rotations, so node scales and mirrored joints cancel out.
Animated scales are not played, because a body has a fixed size: joints that a file scales up from zero are there from
the first frame.

In a VRM animation (.vrma) joints are the humanoid bones that its extension lists, under the names of our joints, and
rest is what its nodes are in the file.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ...bodies.joint_names import ancestors
from ...core.errors import damaged
from ...core.geometry import MIRROR, nearest_rotation, rotation_between
from ...core.normalization import ORIENTATIONS, ROTATIONS, axis_name
from ...core.rig import local_rotations
from ...motions.bvh import Bvh
from ...motions.rest_calibration import nearest_axes
from ..timing import DEFAULT_FPS
from .animation import animated_nodes, frame_rate, frame_times, sample_nodes, select_channels
from .document import Document
from .scene import joint_matrices, node_name, node_parents, scene_nodes, sort_parents_first, used_skins, world_matrices
from .vrm import is_vrm_animation, vrm_bones

PLAYED_PATHS = ("translation", "rotation")
"""Target paths of the channels that are played."""
FBX_PIVOT = "_$AssimpFbx$_"
"""In the names of nodes that assimp writes above an FBX joint for its pivots and other rotations: no joints."""
WORLD_NODE = -1
"""Index of an added root joint in files with several roots. It never moves; as an index it is the last node."""
NEGLIGIBLE = 1e-6
"""Relative size below which the scale of a bind matrix or the change of a bone counts as zero."""
ENLARGED = 1e-3
"""Relative change of a joint's scale since its mesh was bound from which on it counts as one, and is kept."""
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
    """
    channels = [channel for channel in select_channels(document, animation) if channel.path in PLAYED_PATHS]
    fps = fps or frame_rate(channels) or DEFAULT_FPS
    nodes, parents = _find_joints(document)
    humanoid = vrm_bones(document) if is_vrm_animation(document) else {}
    at_rest = world_matrices(document) if humanoid else rest_matrices(document)
    T_world_rest = _append_world(at_rest)[nodes]
    times = frame_times(document, channels, fps)
    blocks = sample_nodes(document, channels, times)
    T_world_joint = np.concatenate([_append_world(T_world_node)[:, nodes] for _, T_world_node in blocks])
    broken = ~np.isfinite(T_world_joint).all(axis=(1, 2, 3))
    if broken.any():
        raise damaged(document.path, "finite numbers", f"NaN or infinity in frame {broken.argmax()}")
    # A joint whose scale is zero at rest has no inverse; with the pseudo-inverse it does not rotate.
    rotation = nearest_rotation(T_world_joint[..., :3, :3] @ np.linalg.pinv(T_world_rest[:, :3, :3]))
    position = T_world_joint[..., :3, 3]
    parent = np.maximum(parents, 0)
    rest = T_world_rest[:, :3, 3]
    offsets = rest - np.where(np.array(parents)[:, None] >= 0, rest[parent], 0.0)
    # Offsets from the parent joint, in its frame, per frame: equal to `offsets` where a bone keeps its length.
    bones = (np.swapaxes(rotation[:, parent], -1, -2) @ (position - position[:, parent])[..., None])[..., 0]
    stretches = np.abs(bones - offsets).max(axis=(0, 2)) > NEGLIGIBLE * np.ptp(rest, axis=0).max()
    moved = {j: bones[:, j] for j in np.flatnonzero(stretches).tolist() if j > 0}
    # In a VRM animation a node has the name of our joint, or one that stands for none.
    ours = {node: name for name, node in reversed(humanoid.items())}
    known = {n: ours.get(n, f"node{n}") if humanoid else node_name(document, n) for n in nodes if n != WORLD_NODE}
    names = tuple(known.get(node, "world") for node in nodes)
    local = local_rotations(rotation, parents)
    return Bvh(document.path.stem, names, parents, offsets, {}, local, position[:, 0], float(fps), moved)


def rest_matrices(document: Document) -> Float[np.ndarray, "N 4 4"]:
    """Return the world transforms of all nodes in the bind pose of the largest skin; the first of `bind_poses`."""
    return next(bind_poses(document))


def bind_poses(document: Document) -> Iterator[Float[np.ndarray, "N 4 4"]]:
    """Yield the world transforms of all nodes in the bind pose of the largest skin, in the likeliest orientation first.

    World from bind space, through joint j in the file's pose, is node j times its inverse bind matrix. Undoing it takes
    a node from that pose into bind space; an orientation and the median scale take bind space back to the world, where
    each joint gets the scale that its node has in the file. Nodes that the skin does not list follow the nearest joint
    above them. Below a node that mirrors, the bind pose is mirrored, too, as the file shows it.

    Without usable inverse bind matrices, these are the nodes' transforms in the file. Skins without them have vertices
    in the frame of their joints (glTF 2.0, 3.7.3.1), which says nothing about a pose.
    """
    T_world_node, skins = world_matrices(document), document.gltf.get("skins", [])
    largest = _largest_skin(document)
    if largest is None:
        yield T_world_node
        return
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
    own_scale = _kept_scales(T_world_bind, scale, invertible)
    mirror = _mirror(T_world_bind[invertible])
    bound, above = mirror @ T_world_bind[invertible, :3, :3], mirror @ _append_world(T_world_node)[above_joints, :3, :3]
    for orientation in _bind_orientations(bound, above):
        T_rest_bind = np.eye(4)
        T_rest_bind[:3, :3] = mirror @ orientation * own_scale[invertible[0]]
        T_bound_node = np.empty_like(T_world_node)
        for node in order:
            nearest_joint[node] = joint_of_node.get(node, nearest_joint[parent[node]])
            T_bound_node[node] = T_rest_bind @ np.linalg.inv(T_world_bind[nearest_joint[node]]) @ T_world_node[node]
        yield _enlarged(T_bound_node, own_scale[[nearest_joint[node] for node in range(len(parent))]], order, parent)


def _mirror(T_world_bind: Float[np.ndarray, "J 4 4"]) -> Float[np.ndarray, "3 3"]:
    """Return the reflection at x = 0 where most joints mirror what they are bound to, else the identity."""
    mirrors = np.median(np.sign(np.linalg.det(T_world_bind[:, :3, :3]))) < 0
    return np.diag(MIRROR) if mirrors else np.eye(3)


def _largest_skin(document: Document) -> int | None:
    """Return the number of the used skin with the most joints; None where that has no inverse bind matrices."""
    skins = document.gltf.get("skins", [])
    sizes = {number: (len(skins[number]["joints"]), "inverseBindMatrices" in skins[number])
             for number in used_skins(document)}  # fmt: skip
    largest = max(sizes, key=lambda number: sizes[number], default=None)
    return None if largest is None or not sizes[largest][1] else largest


def _kept_scales(
    T_world_bind: Float[np.ndarray, "J 4 4"], scale: Float[np.ndarray, " J"], invertible: list[int]
) -> Float[np.ndarray, " J"]:
    """Return the scale of each joint since it was bound; the median for joints that are scaled unequally or alike."""
    usual = np.median(scale[invertible])
    own = np.full(len(scale), usual)
    for joint in invertible:
        axes = T_world_bind[joint, :3, :3] / scale[joint]
        equal = np.abs(axes.T @ axes - np.eye(3)).max() <= ENLARGED
        if equal and abs(scale[joint] - usual) > ENLARGED * usual:
            own[joint] = scale[joint]
    return own


def _enlarged(
    T_bound_node: Float[np.ndarray, "N 4 4"], scale: Float[np.ndarray, " N"], order: list[int], parent: list[int]
) -> Float[np.ndarray, "N 4 4"]:
    """Give nodes their scales since they were bound, each about its own place, with all that is below."""
    if np.ptp(scale) == 0:
        return T_bound_node
    T_rest_node = T_bound_node.copy()
    for node in order:
        above = parent[node]
        if above >= 0:
            T_rest_node[node] = T_rest_node[above] @ np.linalg.pinv(T_bound_node[above]) @ T_bound_node[node]
            T_rest_node[node, :3, :3] *= scale[node] / scale[above]
    return T_rest_node


def front_before_placing(document: Document, T_rest_node: Float[np.ndarray, "N 4 4"], front: str) -> str:
    """Return the front of a person at rest without the turn of nodes above the joints about the vertical.

    A person who faces +z where the mesh was bound and stands turned in the scene has that heading in every frame.
    Others are turned to face +z, or face another way by their maker's habit: their front stays.
    """
    largest = _largest_skin(document)
    if largest is None:
        return front
    T_joint_bind = joint_matrices(document, largest, T_rest_node)
    T_rest_bind = nearest_rotation(_mirror(T_joint_bind) @ T_joint_bind[:, :3, :3]).sum(axis=0)
    orientation = nearest_axes(nearest_rotation(T_rest_bind))
    up = orientation.T @ [0.0, 1.0, 0.0]
    if up[1] < 0:  # upside down: which way it was turned cannot be told
        return front
    upright = rotation_between(up, np.array([0.0, 1.0, 0.0]))
    placed = orientation @ upright.T
    return (
        "+z" if axis_name(placed.T @ ROTATIONS[[axes[1] for axes in ORIENTATIONS].index(front)][2]) == "+z" else front
    )


def _bind_orientations(
    T_world_bind: Float[np.ndarray, "J 3 3"], T_world_above: Float[np.ndarray, "3 3"]
) -> list[Float[np.ndarray, "3 3"]]:
    """List axis-aligned rotations from bind space to the world, the likeliest first.

    Where the file's pose is the bind pose, all joints have one rotation, and the nearest axis-aligned one to it is the
    likeliest. Else candidates are, in the order that exporters use them, the rotation of the node above the joints, and
    the identity: the first one with about the same up axis as the mean rotation of the joints. What remains is the
    joints' pose. If none fits, it is the axis-aligned rotation nearest to that mean.
    """
    rotations = nearest_rotation(T_world_bind)
    mean = nearest_rotation(rotations.sum(axis=0))
    candidates = [nearest_axes(nearest_rotation(T_world_above)), np.eye(3)]
    posed = np.einsum("jkl,kl->j", rotations, mean).min() < 1 + 2 * SAME_ROTATION_COSINE  # the trace of a rotation
    likely = [candidate for candidate in candidates if posed and (mean @ candidate.T)[1, 1] > SAME_UP_COSINE]
    first = (likely or [nearest_axes(mean)])[0]
    return [first, *(candidate for candidate in candidates if not np.array_equal(candidate, first))]


def _find_joints(document: Document) -> tuple[list[int], tuple[int, ...]]:
    """Find the nodes that are joints, each after its parent, and the parent joint of each; the one root has -1."""
    node_parent = node_parents(document)
    order = sort_parents_first(document, node_parent)
    pivots = {node for node in order if FBX_PIVOT in str(document.gltf["nodes"][node].get("name", ""))}
    for node in order:
        while node_parent[node] in pivots:
            node_parent[node] = node_parent[node_parent[node]]
    order = [node for node in order if node not in pivots]
    joints = set(vrm_bones(document).values()) if is_vrm_animation(document) else set()
    if not joints:
        joints = {node for skin in document.gltf.get("skins", []) for node in skin["joints"]}
        moving = animated_nodes(document, PLAYED_PATHS)
        # Without a skin, joints that rest in all animations are known by the hierarchy alone.
        roots = set() if joints else {ancestors(node_parent, node)[-1] for node in moving}
        joints |= moving | {node for node in order if ancestors(node_parent, node)[-1] in roots}
        joints &= {*order}
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


def _append_world(T_world_node: Float[np.ndarray, "*T N 4 4"]) -> Float[np.ndarray, "*T M 4 4"]:
    """Append an identity transform for `WORLD_NODE` after the last node (M = N + 1)."""
    world = np.broadcast_to(np.eye(4), (*T_world_node.shape[:-3], 1, 4, 4))
    return np.concatenate([T_world_node, world], axis=-3)
