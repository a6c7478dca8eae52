"""Writes joints: with a skinned mesh or alone, in the hierarchy of the skeleton, and animations of them.

Joints that turn have a key in every frame, and so has the root's path: from it readers know the frame rate and the
number of frames.

Keys and weights are float32. As normalized 16-bit integers, which glTF allows too, they would take half of the room,
but Assimp and importers that are made with it take such numbers for floats (Assimp issues 3560 and 6130).

Vertices are written at rest, as the source file has them. A skinned mesh ignores the transform of its own node (glTF
2.0, 3.7.3.2 Joint Hierarchy), so skinned nodes are written at the root of the scene, and the transform of the node that
showed the mesh before goes into the inverse bind matrices.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.animated_rig import AnimatedRig, RigAnimation
from ...core.rig import homogeneous
from ..timing import DEFAULT_FPS
from .animation import AnimationChannel, add_animation, local_quaternions, rotation_channels
from .draft import PER_SET, Draft
from .edit import PrimitiveGroup, build_document, stage_transform, with_normals
from .scene import DEFAULT_TRS

STILL = 1e-7
"""Largest change of a joint's position in the frame of its parent that is not written, in sizes of the mesh: float32
stores positions no better."""


def write_gltf_skinned(animations: Sequence[RigAnimation], path: Path, animated: bool = True) -> None:
    """Write a mesh with joints and animations of them, as .glb or .gltf by the suffix of `path`.

    A mesh that came from a glTF file keeps all of that file but its skins, animations and morph targets.

    Args:
        animations: of one rig: they have the same mesh, joints, weights and rest pose.
        animated: False writes the rig alone.
    """
    skeleton = animations[0].skeleton
    mesh = with_normals(skeleton.mesh)
    draft, groups = build_document(mesh, mesh, skinned=True)
    if not draft.gltf.get("scenes"):  # readers show all roots then, but no longer once there is a scene
        children = {child for node in draft.gltf["nodes"] for child in node.get("children", [])}
        draft.gltf["scenes"] = [{"nodes": [n for n in range(len(draft.gltf["nodes"])) if n not in children]}]
    if skeleton.group is not None:  # what no joint moves stays as it is
        groups = [group for group in groups if (skeleton.group[group.vertex_of] >= 0).any()]
    rest = local_quaternions(skeleton.rig.rotation[None], skeleton.parents)[0]
    joint_nodes = _add_joints(draft, skeleton, rest)
    _add_weights(draft, groups, skeleton)
    skins: dict[bytes, int] = {}
    for node in dict.fromkeys(group.node for group in groups):
        node_groups = [group for group in groups if group.node == node]
        place = node_groups[0].T_world_local
        if place.tobytes() not in skins:
            skins[place.tobytes()] = _add_skin(draft, skeleton, joint_nodes, place)
        _attach_skinned_mesh(draft, node, skins[place.tobytes()], node_groups)
    if animated:
        draft.gltf["animations"] = []
        for animation in animations:
            moved, fps = animation.skeleton, animation.fps
            channels = rotation_channels(joint_nodes, moved.rotation, moved.parents, fps)
            for j, way in _moved_joints(moved).items():
                channels.append(AnimationChannel(joint_nodes[j], "translation", np.arange(len(way)) / fps, way))
            draft.gltf["animations"].append(add_animation(draft, animation.name, channels, fps))
    draft.save(path)


def write_gltf_rig(skeleton: AnimatedRig, path: Path) -> None:
    """Write a skinned mesh at rest, without an animation."""
    write_gltf_skinned([RigAnimation("rest", skeleton, DEFAULT_FPS)], path, animated=False)


def _add_joints(draft: Draft, skeleton: AnimatedRig, rest: Float[np.ndarray, "J 4"]) -> list[int]:
    """Add a node for each joint, with its rotation at rest, and the root to the scene; returns the nodes' indices."""
    nodes, start = draft.gltf["nodes"], len(draft.gltf["nodes"])
    translations = np.concatenate([skeleton.rig.joints[:1], skeleton.rig.bones(skeleton.parents)])
    nodes += _joint_nodes(skeleton.names, skeleton.parents, {"rotation": rest, "translation": translations}, start)
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
        used = -(-int((group_weights > 0).sum(axis=1).max()) // PER_SET) * PER_SET
        attributes = draft.add_influences(group_joints[:, :used], group_weights[:, :used])
        for primitive in group.primitives:
            primitive["attributes"] = {**primitive["attributes"], **attributes}


def _add_skin(
    draft: Draft, skeleton: AnimatedRig, joint_nodes: list[int], T_world_local: Float[np.ndarray, "4 4"]
) -> int:
    """Add a skin for a mesh whose vertices are in the frame `T_world_local`; returns its index."""
    T_world_joint = homogeneous(skeleton.rig.rotation, skeleton.rig.joints)
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


def write_gltf_joints(
    name: str,
    names: tuple[str, ...],
    parents: tuple[int, ...],
    rest: Float[np.ndarray, "J 3"],
    rotation: Float[np.ndarray, "T J 3 3"],
    root: Float[np.ndarray, "T 3"],
    fps: float,
    path: Path,
) -> None:
    """Write one motion of joints as .glb or .gltf by the suffix of `path`; arguments as in `joints_draft` and below.

    A skin that no mesh uses lists the joints: Blender makes an armature of it, and three.js bones.
    """
    draft = joints_draft(names, parents, rest)
    bind = homogeneous(np.tile(np.eye(3), (len(rest), 1, 1)), -rest)
    skin = {"joints": list(range(len(names))), "skeleton": 0, "inverseBindMatrices": draft.add_matrices(bind)}
    draft.gltf["skins"] = [skin]
    draft.gltf["animations"] = [joint_animation(draft, name, parents, rotation, root, fps)]
    draft.save(path)


def joints_draft(names: Sequence[str], parents: tuple[int, ...], rest: Float[np.ndarray, "J 3"]) -> Draft:
    """Build a document of joints alone, none of which is rotated at rest; the root comes first, with parent -1."""
    steps = rest - np.where(np.array(parents)[:, None] >= 0, rest[list(parents)], 0.0)
    asset = {"version": "2.0", "generator": "mimesh"}
    nodes = _joint_nodes(names, parents, {"translation": steps})
    return Draft({"asset": asset, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes})


def joint_animation(
    draft: Draft,
    name: str,
    parents: tuple[int, ...],
    rotation: Float[np.ndarray, "T J 3 3"],
    root: Float[np.ndarray, "T 3"],
    fps: float,
) -> dict[str, Any]:
    """Add an animation of all joints: world rotations since rest, and the path of the root in every frame."""
    path = AnimationChannel(0, "translation", np.arange(len(root)) / fps, root)
    return add_animation(draft, name, [path, *rotation_channels(range(len(parents)), rotation, parents, fps)], fps)


def _joint_nodes(
    names: Sequence[str], parents: tuple[int, ...], properties: dict[str, np.ndarray], start: int = 0
) -> list[dict[str, Any]]:
    """Return a node for each joint, with given properties at rest; the first one gets the index `start`."""
    nodes: list[dict[str, Any]] = []
    for j, name in enumerate(names):
        children = [start + child for child, parent in enumerate(parents) if parent == j]
        own = {key: values[j].tolist() for key, values in properties.items()}
        nodes.append({"name": name, **own} | ({"children": children} if children else {}))
    return nodes
