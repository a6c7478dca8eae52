"""Rigged characters as files: the shipped body thinned, as other people's exporters would write it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from people import _thin

from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_shape
from mimesh.io.gltf.draft import Draft

ARMATURE = np.array([[100.0, 0, 0, 0], [0, 0, 100.0, 0], [0, -100.0, 0, 0], [0, 0, 0, 1]])
"""The world from a z-up armature in hundredths of a unit."""


def kept(faces: int = 300) -> np.ndarray:
    """The vertices of the body that a character of so many faces has, in its order."""
    return _thin(faces)[0]


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
    """Write person `shape` (None: the mean) with a skin of two sets of influences; returns `path`.

    Args:
        rest: rotation matrices of the joints in the pose in which the character is made.
        name: what the file calls our joints.
        hold: joints that hang on another parent than ours ("": on the armature).
        frames: seed of the directions of the joints' own axes.
        moved: what each joint's node does after binding: matrices that take the rest pose elsewhere.
        turn: rotation of the whole character.
    """
    body = load_body()
    count, turn = len(body.parents), np.eye(3) if turn is None else turn
    left, triangles = _thin(faces)
    rotmat = np.tile(np.eye(3), (count, 1, 1)) if rest is None else rest
    coefficients = np.zeros(1) if shape is None else sample_shape(body, 7, shape)
    vertices = body.posed(coefficients, rotmat)[left] @ turn.T
    joints = body.shaped(coefficients)[1]
    rotation, translation = body.skinning_transforms(joints, rotmat)
    T_world_joint = np.tile(np.eye(4), (count, 1, 1))
    T_world_joint[:, :3, :3] = 100 * np.linalg.qr(np.random.default_rng(frames).normal(size=(count, 3, 3)))[0]
    T_world_joint[:, :3, 3] = ((rotation @ joints[..., None])[..., 0] + translation) @ turn.T
    bind = np.linalg.inv(T_world_joint) @ ARMATURE
    world = T_world_joint if moved is None else moved @ T_world_joint
    parents = [-1 if (hold or {}).get(n) == "" else p for n, p in zip(body.joint_names, body.parents, strict=True)]
    for joint, holder in (hold or {}).items():
        if holder:
            parents[body.joint(joint)] = body.joint(holder)

    strongest = np.argsort(-body.weights[left], axis=1)[:, :8]
    weights = np.take_along_axis(body.weights[left], strongest, axis=1)
    draft = Draft({"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}]})
    small = np.concatenate([vertices, np.ones((len(left), 1))], axis=1) @ np.linalg.inv(ARMATURE).T
    attributes = {"POSITION": draft.add_floats(small[:, :3], bounds=True)}
    for k in range(2):
        four = slice(4 * k, 4 * k + 4)
        view = draft.add_view((strongest[:, four] + 0).astype("<u1"))
        kind = {"componentType": 5121, "count": len(left), "type": "VEC4"}
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
