"""`animals`: pairs of rigged four-legged animals that share the names of their joints, of a pool or a folder of files.

The truth is the identity under the bone rotations of the driving animal, by the joints' names. Identities are in the
rest pose of their file, driving animals in frames of their own clips.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from ..bodies import RiggedBody
from ..bodies.body_model import landmarks
from ..bodies.character_pool import Pool, PoolCharacter, local_frames, read_pool
from ..bodies.skinned_character import SkinnedCharacter
from ..core.errors import InputError
from ..core.mesh import Mesh
from ..io.gltf.character import read_rigged_animal
from .characters import shapeless
from .pairs import Pair
from .protocols import Protocol, quadruped

SUFFIXES = (".fbx", ".glb", ".gltf")
SHARED = 0.6
"""Smallest share of the joints that move an animal's surface that the driving animal must have by name."""


@dataclass(frozen=True)
class Animals(Protocol):
    """Pairs of the animals of a folder: each in turn is the identity."""

    body: ClassVar[str] = "quadruped"
    data: Path = Path()
    """A pool with an index, of which a split is taken, or a folder of rigged files, all of which are taken."""

    def check(self, split: str) -> None:
        """Raise InputError if no two animals share a skeleton."""
        if not _choices(self.data, split):
            raise InputError(
                f"{self.data}: expected two rigged four-legged animals with clips and the same names of joints, found "
                f"none in the split {split}; add some"
            )

    def left_out(self, split: str) -> dict[str, int]:
        return read_animals(self.data, split).refusals()

    def draw(self, split: str, i: int, rng: np.random.Generator) -> tuple[PoolCharacter, PoolCharacter, str, int]:
        """Choose the identity of a pair, and the driving animal, clip and frame."""
        choices = _choices(self.data, split)
        identity, partners = choices[i % len(choices)]
        driving = partners[rng.integers(len(partners))]
        clip = list(driving.clips)[rng.integers(len(driving.clips))]
        return identity, driving, clip, int(rng.integers(len(driving.clips[clip])))

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        identity, driving, clip, frame = self.draw(split, i, rng)
        transforms = driving.clip_transforms(clip, frame)
        size = _height(identity) / _height(driving)
        label = f"{clip.replace('/', '-').replace('|', '-')}{frame}"
        truth = identity.rig.skinned(transforms_by_name(driving.rig, identity.rig, transforms, size))
        same = np.array_equal(identity.rig.mesh.faces, driving.rig.mesh.faces)
        posed = driving.rig.skinned(transforms)
        markers = np.stack([find_animal_landmarks(identity), find_animal_landmarks(driving)], axis=1)
        markers[(markers < 0).any(axis=1), 1] = -1
        return Pair(
            identity=_mesh(identity, identity.rig.mesh.vertices, "rest"),
            driving=_mesh(driving, posed, label),
            truth=truth,
            height=_height(identity),
            metres=1.7 / _height(identity),
            truth_name=f"{identity.meta.file}_{label}",
            groups=(identity.meta.file, driving.meta.file),
            reference=driving.rig.mesh.vertices,
            markers=markers,
            aligned=posed if same else None,
            aligned_reference=driving.rig.mesh.vertices if same else None,
        )


def animals(data: str | Path) -> Animals:
    """Return the protocol for a folder of animals; `check` tells whether a split can be generated."""
    return Animals("animals", 1, ("clips",), pairs=72, spread=0.0, data=Path(data))


def transforms_by_name(
    source: SkinnedCharacter, target: SkinnedCharacter, transforms: Float[np.ndarray, "K 4 4"], scale: float
) -> Float[np.ndarray, "L 4 4"]:
    """Compute a pose of `target` with the bone rotations of a pose of `source`, by the names of the joints.

    As `character_pool.transferred_transforms`, for skeletons of which each may have joints that the other lacks; these
    rest in the frames of their parents.
    """
    place = {name: j for j, name in enumerate(source.joint_names)}
    posed = local_frames(transforms[:-1] @ source.T_world_joint, source.parents)
    rest, frames = (local_frames(rig.T_world_joint, rig.parents) for rig in (source, target))
    for j, name in enumerate(target.joint_names):
        if name in place:
            k = place[name]
            frames[j, :3, :3] = posed[k, :3, :3]
            frames[j, :3, 3] += scale * (posed[k, :3, 3] - rest[k, :3, 3])
    for j, parent in enumerate(target.parents):  # parents come first, so theirs are in the world already
        if parent >= 0:
            frames[j] = frames[parent] @ frames[j]
    return np.concatenate([frames @ np.linalg.inv(target.T_world_joint), np.eye(4)[None]])


@cache
def find_animal_landmarks(animal: PoolCharacter) -> Int[np.ndarray, " M"]:
    """Find the vertices of an animal at the landmarks of the shipped quadruped; -1 where it has no vertex there."""
    body, rig = quadruped(), animal.rig
    low, high = rig.mesh.vertices.min(axis=0), rig.mesh.vertices.max(axis=0)
    scale = np.ptp(body.vertices[:, 2]) / (high - low)[2]
    joints = place_animal_joints(animal, body) * scale
    target = rig.nearest_columns({j: body.joint(name) for name, j in animal.joints.items()}, body.joint("Hips"))
    weights = rig.summed_weights(target, len(body.parents))[:, body.carriers(animal.joints)]
    wrapped = shapeless(body, "quadruped", scale * rig.mesh.vertices, rig.mesh.faces, joints, weights)
    return np.array(list(landmarks(wrapped).values()))


def place_animal_joints(animal: PoolCharacter, body: RiggedBody) -> Float[np.ndarray, "J 3"]:
    """Place the shipped quadruped's joints on an animal at rest: those that it lacks are as far from their parents."""
    rig = animal.rig
    size = np.ptp(rig.mesh.vertices[:, 2]) / np.ptp(body.vertices[:, 2])
    joints = np.empty_like(body.joints)
    for j, (name, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
        if name in animal.joints:
            joints[j] = rig.joints[animal.joints[name]]
        else:
            joints[j] = joints[parent] + size * (body.joints[j] - body.joints[parent])
    return joints


@cache
def read_animals(data: Path, split: str) -> Pool:
    """Read the rigged four-legged animals of a pool's split, or all those of a folder of files."""
    if (data / "index.json").is_file():
        return read_pool(data, split, body="quadruped")
    found, refused = [], {}
    for path in sorted(path for path in data.rglob("*") if path.suffix.lower() in SUFFIXES):
        try:
            found.append(read_rigged_animal(path))
        except InputError as error:
            refused[path.name] = str(error).removeprefix(f"{path}: ")
    return Pool(tuple(found), refused)


@cache
def _choices(data: Path, split: str) -> list[tuple[PoolCharacter, list[PoolCharacter]]]:
    """List the animals, each with those that may drive it."""
    choices = []
    for identity in read_animals(data, split).characters:
        moving = _moving(identity)
        partners = [
            other
            for other in read_animals(data, split).characters
            if other is not identity
            and other.clips
            and len(moving & set(other.rig.joint_names)) >= SHARED * len(moving)
        ]
        if partners:
            choices.append((identity, partners))
    return choices


def _moving(animal: PoolCharacter) -> set[str]:
    """List the names of the joints that move an animal's surface."""
    rig = animal.rig
    used = np.unique(rig.joint_of[rig.weights > 0])
    return {rig.joint_names[j] for j in used if j < len(rig.joint_names)}


def _height(animal: PoolCharacter) -> float:
    return float(np.ptp(animal.rig.mesh.vertices[:, 1]))


def _mesh(animal: PoolCharacter, vertices: Float[np.ndarray, "V 3"], label: str) -> Mesh:
    return dataclasses.replace(animal.rig.mesh, vertices=vertices, name=f"{animal.meta.file}_{label}")
