"""glTF files of rigged characters: the shipped body after decimation, as various exporters would write it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from people import decimation

from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_shape
from mimesh.io.gltf.draft import Draft

ARMATURE = np.array([[100.0, 0, 0, 0], [0, 0, 100.0, 0], [0, -100.0, 0, 0], [0, 0, 0, 1]])
"""T_world_armature of a z-up armature in hundredths of a unit."""


def kept(faces: int = 300) -> np.ndarray:
    """List the vertices of the body that a character of so many faces has, in its order."""
    return decimation(faces)[0]


def character(
    path: Path,
    shape: int | None = 0,
    rest: np.ndarray | None = None,
    faces: int = 300,
    name: Callable[[str], str] = str,
    hold: dict[str, str] | None = None,
    frames: int = 0,
    moved: np.ndarray | None = None,
    turn: np.ndarray | None = None,
) -> Path:
    """Write person `shape` (None: the mean) with a skin of two sets of influences, and return `path`.

    Args:
        rest: local joint rotations of the character's rest pose.
        name: maps our joint names to those of the file.
        hold: other parents of joints, by joint name ("": the armature).
        frames: seed of the random axes of the joints.
        moved: world transforms of the joints' nodes after binding, relative to the rest pose.
        turn: rotation of the whole character.
    """
    body = load_body()
    count, turn = len(body.parents), np.eye(3) if turn is None else turn
    remaining, triangles = decimation(faces)
    rotmat = np.tile(np.eye(3), (count, 1, 1)) if rest is None else rest
    coefficients = np.zeros(1) if shape is None else sample_shape(body, 7, shape)
    vertices = body.posed(coefficients, rotmat)[remaining] @ turn.T
    joints = body.shaped(coefficients)[1]
    rotation, translation = body.skinning_transforms(joints, rotmat)
    T_world_joint = np.tile(np.eye(4), (count, 1, 1))
    T_world_joint[:, :3, :3] = 100 * np.linalg.qr(np.random.default_rng(frames).normal(size=(count, 3, 3)))[0]
    T_world_joint[:, :3, 3] = ((rotation @ joints[..., None])[..., 0] + translation) @ turn.T
    bind = np.linalg.inv(T_world_joint) @ ARMATURE
    world = T_world_joint if moved is None else moved @ T_world_joint
    parents = [-1 if (hold or {}).get(n) == "" else p for n, p in zip(body.joint_names, body.parents, strict=True)]
    for joint, parent in (hold or {}).items():
        if parent:
            parents[body.joint(joint)] = body.joint(parent)

    strongest = np.argsort(-body.weights[remaining], axis=1)[:, :8]
    weights = np.take_along_axis(body.weights[remaining], strongest, axis=1)
    draft = Draft({"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}]})
    local = np.concatenate([vertices, np.ones((len(remaining), 1))], axis=1) @ np.linalg.inv(ARMATURE).T
    attributes = {"POSITION": draft.add_floats(local[:, :3], bounds=True)}
    for k in range(2):
        four = slice(4 * k, 4 * k + 4)
        view = draft.add_view((strongest[:, four] + 0).astype("<u1"))
        kind = {"componentType": 5121, "count": len(remaining), "type": "VEC4"}
        attributes[f"JOINTS_{k}"] = draft.add_accessor({"bufferView": view, **kind})
        attributes[f"WEIGHTS_{k}"] = draft.add_floats(weights[:, four])
    nodes = [{"name": "armature", "matrix": ARMATURE.T.ravel().tolist(), "children": [1]}]
    nodes += [{"name": "body", "mesh": 0, "skin": 0}]
    for j, parent in enumerate(parents):
        above = ARMATURE if parent < 0 else world[parent]
        local = np.linalg.inv(above) @ world[j]
        nodes.append({"name": name(body.joint_names[j]), "matrix": local.T.ravel().tolist()})
        nodes[0 if parent < 0 else parent + 2].setdefault("children", []).append(j + 2)
    columns = draft.add_view(bind.transpose(0, 2, 1).astype("<f4"))
    inverse = draft.add_accessor({"bufferView": columns, "componentType": 5126, "count": count, "type": "MAT4"})
    primitive = {"attributes": attributes, "indices": draft.add_indices(triangles)}
    skin = {"joints": list(range(2, count + 2)), "inverseBindMatrices": inverse}
    draft.gltf |= {"nodes": nodes, "meshes": [{"primitives": [primitive]}], "skins": [skin]}
    draft.save(path)
    return path
