"""Writes a rigged character with its clips as a glTF file: a tree of joints, one skinned mesh, an animation a clip."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mimesh.bodies.character_pool import CharacterClip, PoolCharacter
from mimesh.core.geometry import vertex_normals
from mimesh.io.gltf.animation import AnimationChannel, add_animation
from mimesh.io.gltf.check import ARRAY_BUFFER
from mimesh.io.gltf.draft import Draft


def write_character(character: PoolCharacter, path: Path, clips: Mapping[str, CharacterClip], fps: float) -> None:
    """Write a character of a pool, facing +z, with the hierarchy of joints of its file and some of its clips."""
    rig = character.rig
    draft = Draft({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"name": "scene"}], "nodes": []})
    in_file = np.argsort(character.order)  # index in the rig of each joint of the file
    world = rig.T_world_joint[in_file]
    parents = character.file_parents
    for j, parent in enumerate(parents):
        local = world[j] if parent < 0 else np.linalg.inv(world[parent]) @ world[j]
        draft.gltf["nodes"].append(_node(rig.joint_names[in_file[j]], local, parents, j))
    draft.gltf["nodes"].append({"name": character.meta.file, "mesh": 0, "skin": 0})
    draft.gltf["scenes"][0]["nodes"] = [*(j for j, parent in enumerate(parents) if parent < 0), len(parents)]
    draft.gltf["meshes"] = [{"name": character.meta.file, "primitives": [_primitive(draft, character)]}]
    inverse = draft.add_matrices(np.linalg.inv(world))
    draft.gltf["skins"] = [{"joints": list(range(len(parents))), "inverseBindMatrices": inverse}]
    draft.gltf["animations"] = [_animation(draft, character, name, clip, fps) for name, clip in clips.items()]
    draft.save(path)


def _node(name: str, local: Float[np.ndarray, "4 4"], parents: tuple[int, ...], joint: int) -> dict:
    from scipy.spatial.transform import Rotation

    node = {
        "name": name,
        "translation": local[:3, 3].tolist(),
        "rotation": Rotation.from_matrix(local[:3, :3]).as_quat().tolist(),
    }
    children = [j for j, parent in enumerate(parents) if parent == joint]
    return node | ({"children": children} if children else {})


def _primitive(draft: Draft, character: PoolCharacter) -> dict:
    rig = character.rig
    vertices, faces = rig.mesh.vertices, rig.mesh.faces
    attributes = {
        "POSITION": draft.add_floats(vertices, ARRAY_BUFFER, bounds=True),
        "NORMAL": draft.add_floats(vertex_normals(vertices, faces), ARRAY_BUFFER),
    }
    columns = -(-rig.weights.shape[1] // 4)
    padding = ((0, 0), (0, 4 * columns - rig.weights.shape[1]))
    weights = np.pad(rig.weights, padding)
    joints = np.where(weights > 0, character.order[np.pad(rig.joint_of, padding).clip(max=len(rig.parents) - 1)], 0)
    for k in range(columns):
        some = slice(4 * k, 4 * k + 4)
        attributes[f"JOINTS_{k}"] = draft.add_array(joints[:, some].astype("<u2"), "VEC4", ARRAY_BUFFER)
        attributes[f"WEIGHTS_{k}"] = draft.add_floats(weights[:, some], ARRAY_BUFFER)
    return {"attributes": attributes, "indices": draft.add_indices(faces)}


def _animation(draft: Draft, character: PoolCharacter, name: str, clip: CharacterClip, fps: float) -> dict:
    """Add a clip: the rotation of every joint, and the translation of those that move; roots are turned to face +z."""
    from scipy.spatial.transform import Rotation

    times, channels = np.arange(len(clip)) / fps, []
    for j, parent in enumerate(character.file_parents):
        rotation, translation = clip.rotations[:, j], clip.translations[:, j]
        if parent < 0:
            turn = Rotation.from_matrix(character.turn)
            rotation, translation = (turn * Rotation.from_quat(rotation)).as_quat(), translation @ character.turn.T
        channels.append(AnimationChannel(j, "rotation", times, rotation))
        if np.ptp(translation, axis=0).max() > 0 or parent < 0:
            channels.append(AnimationChannel(j, "translation", times, translation))
    return add_animation(draft, name, channels)
