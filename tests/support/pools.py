"""Pools of rigged characters: the shipped body after decimation, in the format of `bodies.character_pool`."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from people import decimation

from mimesh.bodies import load_body
from mimesh.bodies.hands import body_with_fingers
from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose, sample_shape

FRAMES = 6
"""Number of frames of the clip of a character."""
BLOCKS = ("Hips", "Spine1", "Head", "LeftArm", "RightArm", "LeftUpLeg", "RightUpLeg")
"""Joints of a figure of blocks."""


def blocks(name: str) -> str:
    """Spell the joints of a figure of blocks."""
    names = {"Hips": "root", "Spine1": "torso", "Head": "head"}
    return names.get(name) or f"{name[5 if name.startswith('R') else 4 :].removeprefix('Up').lower()}-{name[0].lower()}"


@dataclass
class Made:
    """What a character of a pool was made of, in the frame of the body."""

    vertices: np.ndarray
    joints: dict[str, np.ndarray]
    """Joints at rest, by the body's names."""
    posed: np.ndarray
    """Vertices in the frames of the clip (T, V, 3)."""


def write_character(
    folder: Path,
    file: str,
    shape: int = 0,
    without: Collection[str] = (),
    spell: Callable[[str], str] = str,
    on_root: Collection[str] = (),
    turn: np.ndarray | None = None,
    size: float = 1.0,
    clip: bool = True,
    frames: int = 0,
    fingers: bool = False,
    palms: bool = False,
    **meta: str,
) -> Made:
    """Write a character of person `shape` and its clip, add it to index.json, and return what it was made of.

    Args:
        without: joints that the skeleton lacks; those above carry their weights.
        spell: maps our joint names to those of the file.
        on_root: joints whose parent in the file is the root.
        turn: rotation of the whole character.
        frames: seed of the random axes of the joints, which are the same for all characters by default.
        fingers: write all vertices, and fifteen joints in each hand.
        palms: give the weights of the hands to a joint below each.
    """
    body, turn = body_with_fingers() if fingers else load_body(), np.eye(3) if turn is None else turn
    remaining, faces = (np.arange(len(body.vertices)), body.faces) if fingers else decimation(300)
    coefficients = sample_shape(body, 7, shape)
    rest, joints = body.shaped(coefficients)
    rest, joints = size * rest[remaining], size * joints
    names = [name for name in body.joint_names if name not in without]
    index = {name: n for n, name in enumerate(names)}
    above = {}
    for name, parent in zip(body.joint_names, body.parents, strict=True):
        above[name] = name if name in index else above[body.joint_names[parent]]
    weights = np.zeros((len(rest), len(names)))
    for j, name in enumerate(body.joint_names):
        weights[:, index[above[name]]] += body.weights[remaining][:, j]
    kept = [body.joint(name) for name in names]
    parents = [
        0 if name in on_root else -1 if body.parents[j] < 0 else index[above[body.joint_names[body.parents[j]]]]
        for name, j in zip(names, kept, strict=True)
    ]
    # World transforms from rest in the frames of the clip, of a body of this shape and size.
    rotmat = np.stack([rotvec_to_rotmat(sample_pose(load_body(), 3, t)) for t in range(FRAMES)])
    if fingers:  # which are at rest
        named = [load_body().joint(name) for name in body.joint_names[:-30]]
        rotmat = np.concatenate([rotmat[:, named], np.tile(np.eye(3), (FRAMES, 30, 1, 1))], axis=1)
    rotation, translation = body.skinning_transforms(joints / size, rotmat)
    moves = np.tile(np.eye(4), (FRAMES, len(names), 1, 1))
    path = np.arange(FRAMES)[:, None, None] * np.array([0.1, 0.02, 0.2])
    moves[..., :3, :3], moves[..., :3, 3] = rotation[:, kept], size * (translation[:, kept] + path)
    if palms:
        hands = [names.index(f"{side}Hand") for side in ("Left", "Right")]
        names, parents, kept = [*names, "LeftPalm", "RightPalm"], parents + hands, kept + [kept[j] for j in hands]
        weights, moves = np.concatenate([weights, weights[:, hands]], axis=1), moves[:, [*range(len(index)), *hands]]
        weights[:, hands] = 0.0
    posed = np.einsum("vj,tjkl,vl->tvk", weights, moves, np.column_stack([rest, np.ones(len(rest))]))[..., :3]

    world = np.tile(np.eye(4), (len(names), 1, 1))
    world[:, :3, :3] = np.linalg.qr(np.random.default_rng(frames).normal(size=(len(names), 3, 3)))[0]
    world[:, :3, :3] *= np.linalg.det(world[:, :3, :3])[:, None, None]
    world[:, :3, 3] = joints[kept]
    turned = np.eye(4)
    turned[:3, :3] = turn
    strongest = np.argsort(-weights, axis=1)[:, :8]
    arrays: dict[str, Any] = {
        "vertices": (rest @ turn.T).astype("f4"),
        "faces": faces.astype("i4"),
        "joint_names": np.array([spell(name) for name in names]),
        "parents": np.array(parents, "i2"),
        "rest_matrices": (turned @ world).astype("f4"),
        "weight_joints": strongest.astype("i2"),
        "weights": np.take_along_axis(weights, strongest, axis=1).astype("f4"),
    }
    values = {"pack": "ours", "maker": "we", "licence": "CC0-1.0", "kind": "realistic", "class": "humanoid",
              "split": "val", "facing": "+z", "clips_from": f"_clips_{file}.npz" if clip else ""} | meta  # fmt: skip
    np.savez_compressed(folder / f"{file}.npz", meta=json.dumps({"file": file, **values}), **arrays)
    if clip:
        write_clip(folder / f"_clips_{file}.npz", arrays, turned @ moves @ world, turned @ world)
    path = folder / "index.json"
    rows = json.loads(path.read_text()) if path.exists() else []
    path.write_text(json.dumps([*rows, {"file": file, **values}]))
    return Made(rest, {name: joints[j] for name, j in zip(names, kept, strict=True)}, posed)


def write_clip(path: Path, arrays: dict[str, Any], world: np.ndarray, rest: np.ndarray) -> None:
    """Write world frames (T, J, 4, 4) of a character as its clip, with the translations of joints that move."""
    from scipy.spatial.transform import Rotation

    parents = arrays["parents"]
    local, at_rest = (
        np.stack(
            [frames[:, j] if p < 0 else np.linalg.inv(frames[:, p]) @ frames[:, j] for j, p in enumerate(parents)], 1
        )
        for frames in (world, rest[None])
    )
    moved = np.abs(local - at_rest)[..., :3, 3].max(axis=(0, 2)) > 1e-6
    translated = np.flatnonzero(moved | (parents < 0))
    quaternions = Rotation.from_matrix(local[..., :3, :3].reshape(-1, 3, 3)).as_quat().reshape(*local.shape[:2], 4)
    np.savez_compressed(
        path,
        joint_names=arrays["joint_names"],
        parents=parents,
        clip_names=np.array(["dance"]),
        clip_translated=translated.astype("i2"),
        clip0_rotations=quaternions.astype("f4"),
        clip0_translations=local[:, translated][..., :3, 3].astype("f4"),
    )
