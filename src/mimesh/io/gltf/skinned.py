"""Writes a skinned mesh: joints, a skin with four weights a vertex, and an animation of rotations and the root's path.

Vertices are written at rest, as the source file has them. A skinned mesh ignores the transform of its own node (glTF
2.0, 3.7.3.2 Joint Hierarchy), so skinned nodes are written at the root of the scene, and the transform of the node that
showed the mesh before goes into the inverse bind matrices.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.animated_rig import AnimatedRig, local_rotations
from .build import build_document, stage_transform
from .draft import ARRAY_BUFFER, Draft
from .edit import GltfSource, edit_document, with_normals
from .primitives import PrimitiveGroup

UNSIGNED_BYTE, FLOAT = 5121, 5126
"""Component types (glTF 2.0, 3.6.2.2 Accessor Data Types)."""
STILL = 1e-7
"""Largest change of a joint's position in the frame of its parent that is not written, in sizes of the mesh: float32
stores positions no better."""


def write_gltf_skinned(skeleton: AnimatedRig, fps: float, path: Path) -> None:
    """Write the mesh, joints and animation of a rig, as .glb or .gltf by the suffix of `path`.

    A mesh that came from a glTF file keeps all of that file but its skins, animations and morph targets.
    """
    mesh = with_normals(skeleton.mesh)
    if isinstance(mesh.source, GltfSource):
        draft, groups = edit_document(mesh.source, mesh, keep_targets=False)
    else:
        draft, groups = build_document(mesh, mesh)
    joint_nodes = _add_joints(draft, skeleton)
    _add_weights(draft, groups, skeleton)
    for node in dict.fromkeys(group.node for group in groups):
        node_groups = [group for group in groups if group.node == node]
        skin = _add_skin(draft, skeleton, joint_nodes, node_groups[0].T_world_local)
        _attach_skinned_mesh(draft, node, skin, node_groups)
    draft.gltf["animations"] = [_joint_animation(draft, skeleton, joint_nodes, fps)]
    draft.save(path)


def _add_joints(draft: Draft, skeleton: AnimatedRig) -> list[int]:
    """Add a node for each joint, in the rest pose, and the root to the scene; returns the nodes' indices."""
    nodes, start = draft.gltf["nodes"], len(draft.gltf["nodes"])
    rotations = local_quaternions(skeleton, skeleton.rig.rotation[None])[0]
    translations = np.concatenate([skeleton.rig.joints[:1], skeleton.rig.bones(skeleton.parents)])
    for j, name in enumerate(skeleton.names):
        node: dict[str, Any] = {
            "name": name,
            "rotation": rotations[j].tolist(),
            "translation": translations[j].tolist(),
        }
        children = [start + c for c, parent in enumerate(skeleton.parents) if parent == j]
        nodes.append(node | ({"children": children} if children else {}))
    axes = stage_transform(skeleton.mesh)
    if axes:  # a skin follows its joints and ignores the mesh's own node, so a change of axes goes above the joints
        nodes.append({"name": "axes", **axes, "children": [start]})
    _default_scene(draft)["nodes"].append(len(nodes) - 1 if axes else start)
    return list(range(start, start + len(skeleton.names)))


def _add_weights(draft: Draft, groups: list[PrimitiveGroup], skeleton: AnimatedRig) -> None:
    """Add JOINTS_0 and WEIGHTS_0 to the primitives: the strongest four weights of each vertex."""
    joints, weights = skeleton.strongest()
    padding = ((0, 0), (0, 4 - joints.shape[1]))  # JOINTS_0 and WEIGHTS_0 are always VEC4
    joints, weights = np.pad(joints, padding), np.pad(weights, padding)
    for group in groups:
        group_joints, group_weights = joints[group.vertex_of], weights[group.vertex_of].astype("<f4")
        # Joints of weight zero should be 0 (glTF 2.0, 3.7.3.3 Skinned Mesh Attributes).
        group_joints = np.where(group_weights > 0, group_joints, 0).astype("u1")
        accessor = {"bufferView": draft.add_view(group_joints, target=ARRAY_BUFFER), "componentType": UNSIGNED_BYTE}
        accessor |= {"count": len(group_joints), "type": "VEC4"}
        joints_0 = draft.add_accessor(accessor)
        attributes = {"JOINTS_0": joints_0, "WEIGHTS_0": draft.add_floats(group_weights, ARRAY_BUFFER)}
        for primitive in group.primitives:
            primitive["attributes"] = {**primitive["attributes"], **attributes}


def _add_skin(
    draft: Draft, skeleton: AnimatedRig, joint_nodes: list[int], T_world_local: Float[np.ndarray, "4 4"]
) -> int:
    """Add a skin for a mesh whose vertices are in the frame `T_world_local`; returns its index."""
    T_world_joint = np.tile(np.eye(4), (len(joint_nodes), 1, 1))
    T_world_joint[:, :3, :3], T_world_joint[:, :3, 3] = skeleton.rig.rotation, skeleton.rig.joints
    inverse_bind = np.linalg.inv(T_world_joint) @ T_world_local
    inverse_bind[:, 3] = [0, 0, 0, 1]  # exactly, as 3.7.3.1 demands, in spite of rounding
    view = draft.add_view(inverse_bind.swapaxes(-1, -2).reshape(-1, 16).astype("<f4"))  # column-major
    accessor = {"bufferView": view, "componentType": FLOAT, "count": len(joint_nodes), "type": "MAT4"}
    skin = {"joints": joint_nodes, "skeleton": joint_nodes[0], "inverseBindMatrices": draft.add_accessor(accessor)}
    draft.gltf.setdefault("skins", []).append(skin)
    return len(draft.gltf["skins"]) - 1


def _attach_skinned_mesh(draft: Draft, node: int, skin: int, groups: list[PrimitiveGroup]) -> None:
    """Move the skinned primitives of a node to a new node at the root of the scene; lines and points stay with it."""
    old = draft.gltf["nodes"][node]
    mesh = draft.gltf["meshes"][old["mesh"]]
    skinned = [primitive for group in groups for primitive in group.primitives]
    others = [primitive for primitive in mesh["primitives"] if not any(primitive is other for other in skinned)]
    new = {"name": old.get("name", "mesh"), "skin": skin, "mesh": old["mesh"]}
    if others:
        draft.gltf["meshes"].append({**mesh, "primitives": skinned})
        new["mesh"] = len(draft.gltf["meshes"]) - 1
        mesh["primitives"] = others
    else:
        del old["mesh"]
    draft.gltf["nodes"].append(new)
    _default_scene(draft)["nodes"].append(len(draft.gltf["nodes"]) - 1)


def _default_scene(draft: Draft) -> dict[str, Any]:
    return draft.gltf["scenes"][draft.gltf.get("scene", 0)]


def _joint_animation(draft: Draft, skeleton: AnimatedRig, joint_nodes: list[int], fps: float) -> dict[str, Any]:
    """Return an animation with one key a frame: the rotation of every joint and the translation of the root."""
    times = draft.add_floats(np.arange(len(skeleton.root))[:, None] / fps, bounds=True)
    rotations = local_quaternions(skeleton, skeleton.rotation)
    outputs = [(j, "rotation", rotations[:, j]) for j in range(len(joint_nodes))]
    outputs += [(j, "translation", path) for j, path in _moved_joints(skeleton).items()]
    samplers = [
        {"input": times, "interpolation": "LINEAR", "output": draft.add_floats(values)} for _, _, values in outputs
    ]
    channels = [
        {"sampler": number, "target": {"node": joint_nodes[joint], "path": path}}
        for number, (joint, path, _) in enumerate(outputs)
    ]
    return {"name": skeleton.mesh.name, "samplers": samplers, "channels": channels}


def _moved_joints(skeleton: AnimatedRig) -> dict[int, Float[np.ndarray, "T 3"]]:
    """Find the joints whose position in the frame of their parent changes: joint -> that position in every frame.

    These are the root and, in rigs with an engine's layout, joints whose parent is not that of the original rig.
    """
    if skeleton.positions is None:
        return {0: skeleton.root}
    local, bones = skeleton.local_positions(), skeleton.rig.bones(skeleton.parents)
    change = np.linalg.norm(local[:, 1:] - bones, axis=-1).max(axis=0)
    moved = np.flatnonzero(change > STILL * np.ptp(skeleton.mesh.vertices, axis=0).max()) + 1
    return {int(j): local[:, j] for j in (0, *moved)}


def local_quaternions(skeleton: AnimatedRig, rotation: Float[np.ndarray, "T J 3 3"]) -> Float[np.ndarray, "T J 4"]:
    """Return each joint's rotation in the frame of its parent, from world rotations, as quaternions (x, y, z, w).

    Signs are chosen so that each quaternion is near that of the frame before: then clients that interpolate without
    taking the shorter arc are right too.
    """
    from scipy.spatial.transform import Rotation

    local = local_rotations(rotation, skeleton.parents)
    quat_xyzw = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_quat().reshape(*local.shape[:2], 4)
    flipped = (quat_xyzw[1:] * quat_xyzw[:-1]).sum(axis=-1) < 0
    sign = np.cumprod(np.where(flipped, -1.0, 1.0), axis=0)
    quat_xyzw[1:] *= sign[..., None]
    return quat_xyzw
