"""Rigged four-legged animals of other makers: the shipped quadruped with few faces, other shapes, joints and names."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from people import decimation
from pools import write_clip

from mimesh.bodies import RiggedBody, load_body
from mimesh.bodies.character_limbs import SIDES
from mimesh.bodies.skinned_character import SkinnedCharacter
from mimesh.core.animated_rig import AnimatedRig, RigAnimation
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.rig import Rig, homogeneous
from mimesh.io.gltf.skinned import write_gltf_skinned

BODY = load_body("quadruped")
LEGS = {"front": ("UpperArm", "Forearm", "Hand", "Fingers"), "hind": ("Thigh", "Shin", "Foot", "Toes")}
TRUNK = ("Hips", "Spine2", "Chest", "Neck1", "Head", "Tail1", "Tail3", "Tail5")
FEET = tuple(side + chain[-1] for side in SIDES for chain in LEGS.values())
FACES = 1500

Motion = list[tuple[dict[str, np.ndarray], np.ndarray]]
"""Rotations of joints, relative to their parents, and the place of the root, in each frame."""


def bones(count: int = 4, trunk: Collection[str] = TRUNK) -> tuple[str, ...]:
    """Name the joints of an animal with some joints of the trunk and the first `count` joints of each leg."""
    legs = [side + part for side in SIDES for chain in LEGS.values() for part in chain[:count]]
    return tuple(name for name in BODY.joint_names if name in trunk or name in legs)


def nothing_said(name: str) -> str:
    """Spell a joint so that its name says nothing."""
    return f"Bone.{7 * BODY.joint(name) % len(BODY.joint_names):03d}"


def coefficients(seed: int | None, spread: float = 1.0) -> np.ndarray:
    """Draw the shape of an animal; None: the mean."""
    count = len(BODY.components)
    return np.zeros(count) if seed is None else spread * np.random.default_rng(seed).normal(size=count).clip(-2, 2)


@dataclass(frozen=True, eq=False)
class Animal:
    """The shipped quadruped with some of its joints."""

    shape: np.ndarray
    """Coefficients."""
    kept: tuple[str, ...]
    """Its joints, which carry the weights of those below them that it lacks."""
    detached: Collection[str] = ()
    """Joints with roots of their own, as the handles of animators have."""
    body: RiggedBody = BODY
    """The shipped quadruped, or one with other proportions."""

    @cached_property
    def order(self) -> list[str]:
        """Joints of the body, those of the animal."""
        return [name for name in BODY.joint_names if name in self.kept]

    @cached_property
    def parents(self) -> tuple[int, ...]:
        return tuple(
            -1 if name in self.detached else self._nearest(BODY.parents[BODY.joint(name)]) for name in self.order
        )

    def _nearest(self, joint: int) -> int:
        """Find the nearest joint of the animal from a joint of the body up; -1 for none."""
        while joint >= 0 and BODY.joint_names[joint] not in self.order:
            joint = BODY.parents[joint]
        return -1 if joint < 0 else self.order.index(BODY.joint_names[joint])

    @cached_property
    def joints(self) -> np.ndarray:
        return self.body.shaped(self.shape)[1][[BODY.joint(name) for name in self.order]]

    @cached_property
    def mesh(self) -> Mesh:
        remaining, faces = decimation(FACES, "quadruped")
        return Mesh(self.body.shaped(self.shape)[0][remaining], faces, name="animal")

    @cached_property
    def weights(self) -> np.ndarray:
        """Of the four joints that move a vertex most, as files have them."""
        remaining, _ = decimation(FACES, "quadruped")
        weights = np.zeros((len(remaining), len(self.order)))
        for j in range(len(BODY.parents)):
            weights[:, self._nearest(j)] += BODY.weights[remaining, j]
        return Rig(np.tile(np.eye(3), (len(self.order), 1, 1)), self.joints, weights).limited(4).weights

    def transforms(self, turns: dict[str, np.ndarray], path: np.ndarray | None = None) -> np.ndarray:
        """Compute the transform of each joint from rest, for rotations relative to the parents in the body."""
        rotmat = np.tile(np.eye(3), (len(BODY.parents), 1, 1))
        for name, turn in turns.items():
            rotmat[BODY.joint(name)] = turn
        rotation, translation = self.body.skinning_transforms(self.body.shaped(self.shape)[1], rotmat, path)
        chosen = [BODY.joint(name) for name in self.order]
        return homogeneous(rotation[chosen], translation[chosen])

    def posed(self, turns: dict[str, np.ndarray], path: np.ndarray | None = None) -> np.ndarray:
        """Compute the vertices in a pose; with the joints that the animal has, it is the body's."""
        points = np.column_stack([self.mesh.vertices, np.ones(len(self.mesh.vertices))])
        return np.einsum("vj,jkl,vl->vk", self.weights, self.transforms(turns, path), points)[:, :3]

    def character(self, spell: Callable[[str], str] = nothing_said, turn: np.ndarray | None = None) -> SkinnedCharacter:
        """Make the rig that a file has; `turn` is a rotation of the whole animal."""
        count = len(self.order)
        frames = homogeneous(np.tile(np.eye(3), (count, 1, 1)), self.joints)
        columns = np.argsort(-self.weights, axis=1)[:, :4]
        weights = np.take_along_axis(self.weights, columns, axis=1)
        points = np.repeat(self.mesh.vertices[:, None], 4, axis=1)
        names = tuple(spell(name) for name in self.order)
        rig = SkinnedCharacter(self.mesh, names, self.parents, frames, columns, weights, points)
        return rig if turn is None else rig.turned(turn)

    def write(
        self,
        path: Path,
        clips: dict[str, Motion] | None = None,
        spell: Callable[[str], str] = nothing_said,
        permutation: np.ndarray | None = None,
        size: float = 1.0,
        turn: np.ndarray | None = None,
    ) -> Path:
        """Write a skinned .glb with clips, lists of poses and places of the root; without, it stands still.

        Args:
            permutation: of the vertices.
            size: factor of the whole animal.
            turn: rotation of the whole animal.
        """
        turn = np.eye(3) if turn is None else turn
        several = self.parents.count(-1) > 1
        names = [spell(name) for name in self.order]
        joints, parents, weights = self.joints, self.parents, self.weights
        if several:  # the writer knows one root
            names, joints = ["Root", *names], np.concatenate([np.zeros((1, 3)), joints])
            parents = (-1, *(parent + 1 for parent in parents))
            weights = np.column_stack([np.zeros(len(weights)), weights])
        order = np.arange(len(weights)) if permutation is None else permutation
        mesh = Mesh(size * self.mesh.vertices[order] @ turn.T, np.argsort(order)[self.mesh.faces], name=path.stem)
        # Joints of one name have one frame in all animals.
        seeds = [0] * several + [1 + BODY.joint(name) for name in self.order]
        axes = np.stack([np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0] for seed in seeds])
        axes *= np.linalg.det(axes)[:, None, None]
        rig = Rig(turn @ axes, size * joints @ turn.T, weights[order])
        animations = []
        for name, frames in (clips or {"still": [({}, np.zeros(3))] * 2}).items():
            moves = np.stack([self.transforms(*frame) for frame in frames])
            if several:
                moves = np.concatenate([np.tile(np.eye(4), (len(moves), 1, 1, 1)), moves], axis=1)
            rotation = turn @ moves[..., :3, :3] @ axes
            positions = size * (np.einsum("tjkl,jl->tjk", moves[..., :3, :3], joints) + moves[..., :3, 3]) @ turn.T
            posed = AnimatedRig(mesh, tuple(names), tuple(parents), rig, rotation, positions[:, 0], {}, positions)
            animations.append(RigAnimation(name, posed, 30.0))
        write_gltf_skinned(animations, path)
        return path


def write_pool_animal(folder: Path, file: str, made: Animal, motion: Motion, **meta: str) -> None:
    """Write an animal and its clip as a file of a pool, and add it to index.json."""
    columns = np.argsort(-made.weights, axis=1)[:, :4]
    world = homogeneous(np.tile(np.eye(3), (len(made.order), 1, 1)), made.joints)
    arrays = {
        "vertices": made.mesh.vertices.astype("f4"),
        "faces": made.mesh.faces.astype("i4"),
        "joint_names": np.array([nothing_said(name) for name in made.order]),
        "parents": np.array(made.parents, "i2"),
        "rest_matrices": world.astype("f4"),
        "weight_joints": columns.astype("i2"),
        "weights": np.take_along_axis(made.weights, columns, axis=1).astype("f4"),
    }
    values = {"pack": "zoo", "maker": "we", "licence": "CC0-1.0", "kind": "realistic", "class": "quadruped",
              "split": "train", "facing": "+z", "clips_from": f"_clips_{file}.npz"} | meta  # fmt: skip
    np.savez_compressed(folder / f"{file}.npz", meta=json.dumps({"file": file, **values}), **arrays)
    frames = np.stack([made.transforms(*frame) for frame in motion]) @ world
    write_clip(folder / f"_clips_{file}.npz", arrays, frames, world)
    index = folder / "index.json"
    rows = json.loads(index.read_text()) if index.exists() else []
    index.write_text(json.dumps([*rows, {"file": file, **values}]))


def animal(
    seed: int | None = None, kept: Collection[str] | None = None, detached: Collection[str] = (), **options
) -> Animal:
    """Make an animal of a random shape; None is the mean."""
    return Animal(coefficients(seed), bones() if kept is None else tuple(kept), detached, **options)


def random_turns(seed: int, names: Collection[str], degrees: float = 20.0) -> dict[str, np.ndarray]:
    """Draw rotations of joints."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    return {name: Rotation.from_rotvec(np.radians(degrees) * rng.uniform(-1, 1, 3)).as_matrix() for name in names}


def small(mesh: Mesh) -> Mesh:
    """Take an animal of the shipped body with few faces."""
    remaining, faces = decimation(FACES, "quadruped")
    return replace(mesh, vertices=mesh.vertices[remaining], faces=faces, parts=())


def small_clip(clip: Clip) -> Clip:
    """Take a clip of an animal of the shipped body with few faces."""
    remaining, _ = decimation(FACES, "quadruped")
    return replace(clip, mesh=small(clip.mesh), vertices=clip.vertices[:, remaining])
