"""A mesh with joints: skin, four weights a vertex, and an animation of rotations, with the root's path.

The mesh stands in the file as it stood; joints carry it from there. What a skin shows does not depend on the node of
its mesh, so meshes hang at the root of the scene, and what their old nodes did to them is in the inverse bind matrices.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ...core.animated_rig import AnimatedRig
from .build import build_document, stage_transform
from .draft import ARRAY_BUFFER, Draft
from .edit import GltfSource, edit_document, with_normals
from .primitives import PrimitiveGroup

UNSIGNED_BYTE, FLOAT = 5121, 5126


def write_gltf_skinned(skeleton: AnimatedRig, fps: float, path: Path) -> None:
    """Write the mesh of a skeleton, its joints and what they do, as .glb or .gltf by the suffix.

    A mesh that came from a glTF file keeps all of it but skins, animations and morph targets of its own.
    """
    mesh = with_normals(skeleton.mesh)
    if isinstance(mesh.source, GltfSource):
        draft, written = edit_document(mesh.source, mesh, keep_targets=False)
    else:
        draft, written = build_document(mesh, mesh)
    bones = _add_joints(draft, skeleton)
    _add_weights(draft, written, skeleton)
    for node in dict.fromkeys(one.node for one in written):
        here = [one for one in written if one.node == node]
        _attach_skinned_mesh(draft, node, _add_skin(draft, skeleton, bones, here[0].T_world_local), here)
    draft.gltf["animations"] = [_joint_animation(draft, skeleton, bones, fps)]
    draft.save(path)


def _add_joints(draft: Draft, skeleton: AnimatedRig) -> list[int]:
    """A node for each joint, standing as the mesh does; the root's at the root of the scene."""
    nodes, start = draft.gltf["nodes"], len(draft.gltf["nodes"])
    turns = local_quaternions(skeleton, skeleton.rig.rotation[None])[0]
    moves = np.concatenate([skeleton.rig.joints[:1], skeleton.rig.bones(skeleton.parents)])
    for j, name in enumerate(skeleton.names):
        node: dict[str, Any] = {"name": name, "rotation": turns[j].tolist(), "translation": moves[j].tolist()}
        children = [start + c for c, parent in enumerate(skeleton.parents) if parent == j]
        nodes.append(node | ({"children": children} if children else {}))
    stands = stage_transform(skeleton.mesh)
    if stands:  # a skin is shown where its joints are, whatever node it hangs on
        nodes.append({"name": "axes", **stands, "children": [start]})
    _default_scene(draft)["nodes"].append(len(nodes) - 1 if stands else start)
    return list(range(start, start + len(skeleton.names)))


def _add_weights(draft: Draft, written: list[PrimitiveGroup], skeleton: AnimatedRig) -> None:
    """Joints and weights of every element of the primitives."""
    joints, weights = skeleton.strongest()
    spare = ((0, 0), (0, 4 - joints.shape[1]))
    joints, weights = np.pad(joints, spare), np.pad(weights, spare)
    for one in written:
        held, share = joints[one.vertex_of], weights[one.vertex_of].astype("<f4")
        held = np.where(share > 0, held, 0).astype("u1")
        accessor = {"bufferView": draft.add_view(held, target=ARRAY_BUFFER), "componentType": UNSIGNED_BYTE}
        accessor |= {"count": len(held), "type": "VEC4"}
        attributes = {"JOINTS_0": draft.add_accessor(accessor), "WEIGHTS_0": draft.add_floats(share, ARRAY_BUFFER)}
        for primitive in one.primitives:
            primitive["attributes"] = {**primitive["attributes"], **attributes}


def _add_skin(draft: Draft, skeleton: AnimatedRig, bones: list[int], T_world_local: Float[np.ndarray, "4 4"]) -> int:
    """A skin for a mesh whose vertices are in the frame of a node."""
    stand = np.tile(np.eye(4), (len(bones), 1, 1))
    stand[:, :3, :3], stand[:, :3, 3] = skeleton.rig.rotation, skeleton.rig.joints
    inverse = np.linalg.inv(stand) @ T_world_local
    inverse[:, 3] = [0, 0, 0, 1]
    view = draft.add_view(inverse.swapaxes(-1, -2).reshape(-1, 16).astype("<f4"))
    accessor = {"bufferView": view, "componentType": FLOAT, "count": len(bones), "type": "MAT4"}
    skin = {"joints": bones, "skeleton": bones[0], "inverseBindMatrices": draft.add_accessor(accessor)}
    draft.gltf.setdefault("skins", []).append(skin)
    return len(draft.gltf["skins"]) - 1


def _attach_skinned_mesh(draft: Draft, node: int, skin: int, written: list[PrimitiveGroup]) -> None:
    """Show the skinned primitives of a node at the root of the scene; lines and points stay with the node."""
    old = draft.gltf["nodes"][node]
    mesh = draft.gltf["meshes"][old["mesh"]]
    skinned = [primitive for one in written for primitive in one.primitives]
    others = [primitive for primitive in mesh["primitives"] if not any(primitive is one for one in skinned)]
    shown = {"name": old.get("name", "mesh"), "skin": skin, "mesh": old["mesh"]}
    if others:
        draft.gltf["meshes"].append({**mesh, "primitives": skinned})
        shown["mesh"] = len(draft.gltf["meshes"]) - 1
        mesh["primitives"] = others
    else:
        del old["mesh"]
    draft.gltf["nodes"].append(shown)
    _default_scene(draft)["nodes"].append(len(draft.gltf["nodes"]) - 1)


def _default_scene(draft: Draft) -> dict[str, Any]:
    return draft.gltf["scenes"][draft.gltf.get("scene", 0)]


def _joint_animation(draft: Draft, skeleton: AnimatedRig, bones: list[int], fps: float) -> dict[str, Any]:
    times = draft.add_floats(np.arange(len(skeleton.root))[:, None] / fps, bounds=True)
    turns = local_quaternions(skeleton, skeleton.rotation)
    tracks = [(j, "rotation", turns[:, j]) for j in range(len(bones))] + [(0, "translation", skeleton.root)]
    samplers = [
        {"input": times, "interpolation": "LINEAR", "output": draft.add_floats(values)} for _, _, values in tracks
    ]
    channels = [
        {"sampler": number, "target": {"node": bones[joint], "path": path}}
        for number, (joint, path, _) in enumerate(tracks)
    ]
    return {"name": skeleton.mesh.name, "samplers": samplers, "channels": channels}


def local_quaternions(skeleton: AnimatedRig, rotation: Float[np.ndarray, "T J 3 3"]) -> Float[np.ndarray, "T J 4"]:
    """Quaternions (x, y, z, w) of every joint as its parent sees it; each near that of the frame before."""
    from scipy.spatial.transform import Rotation

    local = rotation.copy()
    above = list(skeleton.parents[1:])
    local[:, 1:] = rotation[:, above].swapaxes(-1, -2) @ rotation[:, 1:]
    turns = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_quat().reshape(*local.shape[:2], 4)
    flipped = (turns[1:] * turns[:-1]).sum(axis=-1) < 0
    sign = np.cumprod(np.where(flipped, -1.0, 1.0), axis=0)
    turns[1:] *= sign[..., None]
    return turns
