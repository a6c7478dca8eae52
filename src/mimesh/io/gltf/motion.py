"""Animations of a glTF file that shows no mesh: its joints in motion, played by the shipped body.

Joints are the nodes that an animation moves or a skin lists, and those between them. They rest as the largest skin was
bound, where its inverse bind matrices say so, else as the nodes stand in the file: exporters often leave these in the
first frame of something. Node scales and mirrored joints are spent on the way: rotations are those of the world.
Animated scales are not played, because a body has its size: what pops up out of nothing stands there at once.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...core.errors import InputError
from ...core.frame_buffer import Progress
from ...core.geometry import nearest_rotation
from ...core.mesh import Clip, Mesh
from ...core.normalization import ROTATIONS
from ...motions.bvh import Bvh
from ...motions.on_body import first_frame, on_body, played
from ...motions.retarget import to_local
from ..timing import DEFAULT_FPS
from .animation import AnimationChannel, frame_rate, read_channels, select_channels
from .bake import frame_times, sample_nodes
from .document import Document
from .scene import joint_matrices, local_matrices, node_parents, scene_nodes, sort_parents_first, world_matrices

PLAYED_PATHS = ("translation", "rotation")
WORLD_NODE = -1
"""Holds the joints of a file with several roots; counted as a node, it is the last one and never moves."""
NEGLIGIBLE = 1e-6
"""Of the largest: bind matrices that shrink more than this say nothing."""
SAME_UP_COSINE = 0.7
"""Cosine of the angle (45 degrees) up to which two ways up are one."""


def is_motion(document: Document) -> bool:
    """Whether a file has animations and its default scene no mesh."""
    nodes = document.gltf.get("nodes", [])
    return bool(document.gltf.get("animations")) and not any("mesh" in nodes[n] for n in scene_nodes(document))


def gltf_joints(document: Document) -> int:
    """How many joints such a file has."""
    return len([node for node in _find_joints(document)[0] if node != WORLD_NODE])


def read_motion_clip(
    document: Document, fps: float | None, animation: str | None, progress: Progress | None = None
) -> Clip:
    """An animation on the shipped body; see `gltf.read_gltf_clip` for the arguments and `motions.on_body` for the body.

    Raises:
        InputError: no such animation, a damaged one, or joints that do not fit a person by name.
    """
    return played(on_body(read_skeleton(document, fps, animation), document.path), progress)


def read_motion_mesh(document: Document) -> Mesh:
    """The shipped body in the first frame of what `read_motion_clip` plays by default."""
    return first_frame(on_body(read_skeleton(document), document.path))


def read_skeleton(document: Document, fps: float | None = None, animation: str | None = None) -> Bvh:
    """The joints and an animation of them, in the world's axes and unit; joints that stretch do so in `Bvh.moved`.

    Raises:
        InputError: no such animation, a damaged one, or one that is not of finite numbers.
    """
    channels = [channel for channel in select_channels(document, animation) if channel.path in PLAYED_PATHS]
    fps = fps or frame_rate(channels) or DEFAULT_FPS
    nodes, parents = _find_joints(document)
    T_world_rest = _append_world(rest_matrices(document))[nodes]
    rotation, place = _joint_motion(document, channels, frame_times(document, channels, fps), nodes, T_world_rest)
    above = np.maximum(parents, 0)
    rest = T_world_rest[:, :3, 3]
    offsets = rest - np.where(np.array(parents)[:, None] >= 0, rest[above], 0.0)
    bones = (np.swapaxes(rotation[:, above], -1, -2) @ (place - place[:, above])[..., None])[..., 0]
    stretch = np.abs(bones - offsets).max(axis=(0, 2)) > NEGLIGIBLE * np.ptp(rest, axis=0).max()
    moved = {j: bones[:, j] for j in np.flatnonzero(stretch).tolist() if j > 0}
    names = tuple("world" if n == WORLD_NODE else str(document.gltf["nodes"][n].get("name", f"node{n}")) for n in nodes)
    local = to_local(rotation, parents)
    return Bvh(document.path.stem, names, parents, offsets, {}, local, place[:, 0], float(fps), moved)


def rest_matrices(document: Document) -> Float[np.ndarray, "N 4 4"]:
    """World transforms of all nodes where the largest skin was bound; as the nodes stand if none says how.

    Bind matrices lead to the space in which the mesh was made; `_bind_orientation` says how that stands in the world. Nodes that
    the skin does not list keep their place on the nearest one above that it does list.
    """
    T_world_node, skins = world_matrices(document, local_matrices(document)), document.gltf.get("skins", [])
    telling = [number for number, skin in enumerate(skins) if "inverseBindMatrices" in skin]
    if not telling:
        return T_world_node
    largest = max(telling, key=lambda number: len(skins[number]["joints"]))
    T_world_bind = joint_matrices(document, largest, T_world_node)
    if not np.isfinite(T_world_bind).all():
        raise InputError(
            f"{document.path}: expected finite joint transforms in skin {largest}, found NaN or infinity; "
            "export it again"
        )
    size = np.cbrt(np.abs(np.linalg.det(T_world_bind[:, :3, :3])))
    sound = np.flatnonzero(size > NEGLIGIBLE * size.max(initial=0.0)).tolist()
    if not sound:
        return T_world_node
    own = {skins[largest]["joints"][joint]: joint for joint in sound}
    parent, held = node_parents(document), {WORLD_NODE: sound[0]}
    order = sort_parents_first(document, parent)
    above = parent[next(node for node in order if node in own)]
    T_stood_bind = np.eye(4)
    T_stood_bind[:3, :3] = _bind_orientation(T_world_bind[sound], _append_world(T_world_node)[above]) * np.median(
        size[sound]
    )
    T_stood_node = np.empty_like(T_world_node)
    for node in order:
        held[node] = own.get(node, held[parent[node]])
        T_stood_node[node] = T_stood_bind @ np.linalg.inv(T_world_bind[held[node]]) @ T_world_node[node]
    return T_stood_node


def _bind_orientation(
    T_world_bind: Float[np.ndarray, "J 4 4"], T_world_above: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "3 3"]:
    """The axis rotation by which the space of a skin stands in the world, from where each joint's node puts that space.

    It is that of the node above the joints, or none, as exporters have it, unless the nodes of the joints have another
    way up. By how much they are turned or leant beyond that is their pose.
    """
    mean = nearest_rotation(nearest_rotation(T_world_bind[:, :3, :3]).sum(axis=0))
    for way in (_nearest_axis_rotation(nearest_rotation(T_world_above[:3, :3])), np.eye(3)):
        if (mean @ way.T)[1, 1] > SAME_UP_COSINE:
            return way
    return _nearest_axis_rotation(mean)


def _nearest_axis_rotation(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    return ROTATIONS[np.einsum("rkl,kl->r", ROTATIONS, rotation).argmax()]


def _find_joints(document: Document) -> tuple[list[int], tuple[int, ...]]:
    """The nodes that are joints, each after its parent, and which joint that is: one root, -1."""
    above = node_parents(document)
    order = sort_parents_first(document, above)
    joints = {node for skin in document.gltf.get("skins", []) for node in skin["joints"]}
    for number in range(len(document.gltf["animations"])):
        joints |= {channel.node for channel in read_channels(document, number) if channel.path in PLAYED_PATHS}
    for node in tuple(joints):
        between, node = [], above[node]
        while node >= 0 and node not in joints:
            between.append(node)
            node = above[node]
        joints.update(between if node >= 0 else ())
    nodes = [node for node in order if node in joints]
    if sum(above[node] not in joints for node in nodes) != 1:
        nodes.insert(0, WORLD_NODE)
    number = {node: j for j, node in enumerate(nodes)}
    parents = (number.get(above[node], number.get(WORLD_NODE, -1)) if node != WORLD_NODE else -1 for node in nodes)
    return nodes, tuple(parents)


def _joint_motion(
    document: Document,
    channels: list[AnimationChannel],
    times: Float[np.ndarray, " T"],
    nodes: list[int],
    T_world_rest: Float[np.ndarray, "J 4 4"],
) -> tuple[Float[np.ndarray, "T J 3 3"], Float[np.ndarray, "T J 3"]]:
    """How joints have turned in the world since rest, and where they are."""
    rotation, place = np.empty((len(times), len(nodes), 3, 3)), np.empty((len(times), len(nodes), 3))
    # A joint whose scale is zero at rest has no inverse; it stays as it is.
    back = np.linalg.pinv(T_world_rest[:, :3, :3])
    done = 0
    for _, T_world_node in sample_nodes(document, channels, times):
        now = _append_world(T_world_node)[:, nodes]
        if not np.isfinite(now).all():
            bad = done + int(np.flatnonzero(~np.isfinite(now).all(axis=(1, 2, 3)))[0])
            raise InputError(
                f"{document.path}: expected finite numbers, found NaN or infinity in frame {bad}; export it again"
            )
        some = slice(done, done + len(now))
        rotation[some], place[some] = nearest_rotation(now[..., :3, :3] @ back), now[..., :3, 3]
        done += len(now)
    return rotation, place


def _append_world(T_world_node: Float[np.ndarray, "*T N 4 4"]) -> Float[np.ndarray, "*T M 4 4"]:
    """The same with the world itself behind the last node."""
    world = np.broadcast_to(np.eye(4), (*T_world_node.shape[:-3], 1, 4, 4))
    return np.concatenate([T_world_node, world], axis=-3)
