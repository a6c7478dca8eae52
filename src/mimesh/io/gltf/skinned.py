"""Writes a skinned mesh: joints, a skin with weights of vertices, and animations of rotations and the root's path.

Rotations have the keys that interpolation needs (see `keys`), the root's path has one for each frame: it costs 16 bytes
a frame, and from it readers know the frame rate and the number of frames.

Keys and weights are float32. As normalized 16-bit integers, which glTF allows too, they would take half of the room,
but Assimp and importers that are made with it take such numbers for floats (Assimp issues 3560 and 6130).

Vertices are written at rest, as the source file has them. A skinned mesh ignores the transform of its own node (glTF
2.0, 3.7.3.2 Joint Hierarchy), so skinned nodes are written at the root of the scene, and the transform of the node that
showed the mesh before goes into the inverse bind matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ...core.animated_rig import AnimatedRig, RigAnimation
from ..timing import DEFAULT_FPS
from .animation import AnimationChannel, add_animation
from .build import build_document, stage_transform
from .check import ARRAY_BUFFER
from .draft import Draft
from .edit import GltfSource, PrimitiveGroup, edit_document, with_normals
from .keys import KEY_LIMIT, choose_keys, local_quaternions, played_values, rotation_tolerances, without_costly_times
from .scene import DEFAULT_TRS

PER_SET = 4
"""Joints and weights in each of JOINTS_n and WEIGHTS_n, which are always VEC4 (glTF 2.0, 3.7.3.3)."""
STILL = 1e-7
"""Largest change of a joint's position in the frame of its parent that is not written, in sizes of the mesh: float32
stores positions no better."""


@dataclass(frozen=True, eq=False)
class _ThinnedRotations:
    """The rotations of all joints in their parents' frames, and which of them are written."""

    quat_xyzw: Float[np.ndarray, "J T 4"]
    is_key: Bool[np.ndarray, "J T"]

    @classmethod
    def of(cls, skeleton: AnimatedRig) -> _ThinnedRotations:
        """Choose the keys of a motion. Joints whose own key times would take more room than they save have all keys."""
        quat_xyzw = local_quaternions(skeleton.rotation, skeleton.parents).swapaxes(0, 1)
        limit = KEY_LIMIT * skeleton.size
        rig = skeleton.rig.limited(skeleton.influences)
        tolerance = rotation_tolerances(skeleton.points, rig, skeleton.parents, limit)
        is_key = choose_keys(quat_xyzw, tolerance)
        return cls(quat_xyzw, without_costly_times(is_key))

    def played(self, skeleton: AnimatedRig) -> AnimatedRig:
        """Return the motion that clients interpolate from the keys."""
        from scipy.spatial.transform import Rotation

        quat_xyzw = played_values(self.quat_xyzw, self.is_key)
        rotation = Rotation.from_quat(quat_xyzw.reshape(-1, 4)).as_matrix().reshape(*quat_xyzw.shape[:2], 3, 3)
        positions = skeleton.local_positions().swapaxes(0, 1)
        for j, parent in enumerate(skeleton.parents):
            if parent >= 0:
                positions[j] = positions[parent] + (rotation[parent] @ positions[j, ..., None])[..., 0]
                rotation[j] = rotation[parent] @ rotation[j]
        kept = None if skeleton.positions is None else positions.swapaxes(0, 1)
        return replace(skeleton, rotation=rotation.swapaxes(0, 1), positions=kept)


def write_gltf_skinned(animations: Sequence[RigAnimation], path: Path, animated: bool = True) -> list[AnimatedRig]:
    """Write a mesh with joints and animations of them, as .glb or .gltf by the suffix of `path`.

    A mesh that came from a glTF file keeps all of that file but its skins, animations and morph targets.

    Args:
        animations: of one rig: they have the same mesh, joints, weights and rest pose.
        animated: False writes the rig alone.

    Returns:
        The motions as clients of the file play them.
    """
    skeleton = animations[0].skeleton
    mesh = with_normals(skeleton.mesh)
    if isinstance(mesh.source, GltfSource):
        draft, groups = edit_document(mesh.source, mesh, skinned=True)
    else:
        draft, groups = build_document(mesh, mesh)
    if not draft.gltf.get("scenes"):  # readers show all roots then, but no longer once there is a scene
        children = {child for node in draft.gltf["nodes"] for child in node.get("children", [])}
        draft.gltf["scenes"] = [{"nodes": [n for n in range(len(draft.gltf["nodes"])) if n not in children]}]
    if skeleton.group is not None:  # what no joint moves stays as it is
        groups = [group for group in groups if (skeleton.group[group.vertex_of] >= 0).any()]
    rest = local_quaternions(skeleton.rig.rotation[None], skeleton.parents)[0]
    joint_nodes = _add_joints(draft, skeleton, rest)
    _add_weights(draft, groups, skeleton)
    for node in dict.fromkeys(group.node for group in groups):
        node_groups = [group for group in groups if group.node == node]
        skin = _add_skin(draft, skeleton, joint_nodes, node_groups[0].T_world_local)
        _attach_skinned_mesh(draft, node, skin, node_groups)
    thinned = [_ThinnedRotations.of(animation.skeleton) for animation in animations]
    if animated:
        draft.gltf["animations"] = [
            _joint_animation(draft, animation, rotations, joint_nodes)
            for animation, rotations in zip(animations, thinned, strict=True)
        ]
    draft.save(path)
    return [rotations.played(animation.skeleton) for animation, rotations in zip(animations, thinned, strict=True)]


def write_gltf_rig(skeleton: AnimatedRig, path: Path) -> None:
    """Write a skinned mesh at rest, without an animation."""
    write_gltf_skinned([RigAnimation("rest", skeleton, DEFAULT_FPS)], path, animated=False)


def _add_joints(draft: Draft, skeleton: AnimatedRig, rest: Float[np.ndarray, "J 4"]) -> list[int]:
    """Add a node for each joint, with its rotation at rest, and the root to the scene; returns the nodes' indices."""
    nodes, start = draft.gltf["nodes"], len(draft.gltf["nodes"])
    translations = np.concatenate([skeleton.rig.joints[:1], skeleton.rig.bones(skeleton.parents)])
    for j, name in enumerate(skeleton.names):
        node: dict[str, Any] = {"name": name, "rotation": rest[j].tolist(), "translation": translations[j].tolist()}
        children = [start + c for c, parent in enumerate(skeleton.parents) if parent == j]
        nodes.append(node | ({"children": children} if children else {}))
    axes = stage_transform(skeleton.mesh)
    if axes:  # a skin follows its joints and ignores the mesh's own node, so a change of axes goes above the joints
        nodes.append({"name": "axes", **axes, "children": [start]})
    _default_scene(draft).setdefault("nodes", []).append(len(nodes) - 1 if axes else start)
    return list(range(start, start + len(skeleton.names)))


def _add_weights(draft: Draft, groups: list[PrimitiveGroup], skeleton: AnimatedRig) -> None:
    """Add JOINTS_0 and WEIGHTS_0 to the primitives, and further sets of four where vertices have more weights."""
    joints, weights = skeleton.strongest()
    weights[weights.sum(axis=1) == 0, 0] = 1.0  # vertices without triangles, which no joint moves
    padding = ((0, 0), (0, -joints.shape[1] % PER_SET))
    joints, weights = np.pad(joints, padding), np.pad(weights, padding)
    wide = len(skeleton.names) > 256  # joint indices have 8 bits where these are enough
    for group in groups:
        group_joints, group_weights = joints[group.vertex_of], weights[group.vertex_of].astype("<f4")
        # Joints of weight zero should be 0 (glTF 2.0, 3.7.3.3 Skinned Mesh Attributes).
        group_joints = np.where(group_weights > 0, group_joints, 0).astype("<u2" if wide else "u1")
        attributes = {}
        for number in range(-(-int((group_weights > 0).sum(axis=1).max()) // PER_SET)):
            columns = slice(number * PER_SET, (number + 1) * PER_SET)
            attributes[f"JOINTS_{number}"] = draft.add_array(group_joints[:, columns], "VEC4", ARRAY_BUFFER)
            attributes[f"WEIGHTS_{number}"] = draft.add_floats(group_weights[:, columns], ARRAY_BUFFER)
        for primitive in group.primitives:
            primitive["attributes"] = {**primitive["attributes"], **attributes}


def _add_skin(
    draft: Draft, skeleton: AnimatedRig, joint_nodes: list[int], T_world_local: Float[np.ndarray, "4 4"]
) -> int:
    """Add a skin for a mesh whose vertices are in the frame `T_world_local`; returns its index."""
    T_world_joint = np.tile(np.eye(4), (len(joint_nodes), 1, 1))
    T_world_joint[:, :3, :3], T_world_joint[:, :3, 3] = skeleton.rig.rotation, skeleton.rig.joints
    inverse_bind = draft.add_matrices(np.linalg.inv(T_world_joint) @ T_world_local)
    skin = {"joints": joint_nodes, "skeleton": joint_nodes[0], "inverseBindMatrices": inverse_bind}
    draft.gltf.setdefault("skins", []).append(skin)
    return len(draft.gltf["skins"]) - 1


def _attach_skinned_mesh(draft: Draft, node: int, skin: int, groups: list[PrimitiveGroup]) -> None:
    """Move the skinned primitives of a node to a new node at the root of the scene; lines and points stay with it.

    A node that is there already, with nothing else, gets the skin itself, and loses its own place: skins ignore it.
    """
    old = draft.gltf["nodes"][node]
    mesh = draft.gltf["meshes"][old["mesh"]]
    skinned = [primitive for group in groups for primitive in group.primitives]
    others = [primitive for primitive in mesh["primitives"] if not any(primitive is other for other in skinned)]
    roots = _default_scene(draft).setdefault("nodes", [])
    if node in roots and not others and not old.get("children"):
        for key in ("matrix", *DEFAULT_TRS):
            old.pop(key, None)
        old["skin"] = skin
        return
    new = {"name": old.get("name", "mesh"), "skin": skin, "mesh": old["mesh"]}
    if others:
        draft.gltf["meshes"].append({**mesh, "primitives": skinned})
        new["mesh"] = len(draft.gltf["meshes"]) - 1
        mesh["primitives"] = others
    else:
        del old["mesh"]
    draft.gltf["nodes"].append(new)
    roots.append(len(draft.gltf["nodes"]) - 1)


def _default_scene(draft: Draft) -> dict[str, Any]:
    return draft.gltf["scenes"][draft.gltf.get("scene", 0)]


def _joint_animation(
    draft: Draft,
    animation: RigAnimation,
    rotations: _ThinnedRotations,
    joint_nodes: list[int],
) -> dict[str, Any]:
    """Add an animation: the rotations of all joints, and the translations of those that move, in every frame.

    Joints that stay at rest have a key too: where an animation leaves a joint out, Blender and blending engines keep
    the pose of another animation.
    """
    seconds = np.arange(rotations.is_key.shape[1]) / animation.fps
    channels = [
        AnimationChannel(node, "rotation", seconds[is_key], quat_xyzw[is_key])
        for node, is_key, quat_xyzw in zip(joint_nodes, rotations.is_key, rotations.quat_xyzw, strict=True)
    ]
    for j, path in _moved_joints(animation.skeleton).items():
        channels.append(AnimationChannel(joint_nodes[j], "translation", seconds, path))
    return add_animation(draft, animation.name, channels)


def _moved_joints(skeleton: AnimatedRig) -> dict[int, Float[np.ndarray, "T 3"]]:
    """Find the joints whose position in the frame of their parent changes: joint -> that position in every frame.

    These are the root and, in rigs with an engine's layout, joints whose parent is not that of the original rig.
    """
    if skeleton.positions is None:
        return {0: skeleton.root}
    local, bones = skeleton.local_positions(), skeleton.rig.bones(skeleton.parents)
    change = np.linalg.norm(local[:, 1:] - bones, axis=-1).max(axis=0)
    moved = np.flatnonzero(change > STILL * skeleton.size) + 1
    return {int(j): local[:, j] for j in (0, *moved)}
