"""Characters of a pool for training: points of their surfaces, with weights of the shipped body's joints.

A joint of a character counts as the joint of the shipped body with its name (`bodies.character_limbs`); all others
count as their nearest named ancestor. World rotations of the body's joints relate to those of the character's by an
alignment: a character's limb that is turned from rest by D has the rotation G = D A, A being the rotation from the
body's limb at rest to the character's (`evaluate.character_poses.rest_alignments`).
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..bodies import RiggedBody
from ..bodies.character_limbs import SIDES
from ..bodies.character_pool import PoolCharacter, read_pool
from ..core import geometry, surface_points
from ..core.errors import InputError
from ..core.mesh import Mesh
from ..evaluate.character_poses import body_pose, place_body_joints, rest_alignments

POINTS = 3000
"""Points that a character is represented by."""
PLACED = ("ForeArm", "Hand", "Leg", "Foot")
"""Joints whose position is known from the ends of limbs where a character has no such joint."""
TRUNK = ("LowerBack", "Spine", "Spine1", "Neck", "Neck1")
"""Joints that are matched by their number along the trunk: their positions differ from maker to maker."""
CLIP_STEP = 2
"""Every CLIP_STEP-th frame of a clip is taken; neighbouring frames are nearly the same pose."""


@dataclass(frozen=True, eq=False)
class CharacterSurface:
    """A character at rest, as large as the shipped body (root mean square distance of its points from their mean)."""

    pack: str
    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    weights: Float[np.ndarray, "N J"]
    """Weights of the shipped body's joints, rows sum to 1."""
    joints: Float[np.ndarray, "J 3"]
    """Positions of the shipped body's joints."""
    alignment: Float[np.ndarray, "J 3 3"]
    """Rotation A of each joint from the shipped body's rest pose to the character's."""
    carrier: Int[np.ndarray, " J"]
    """The joint whose rotation each joint has: itself, or its nearest ancestor that the character has."""
    placed: Bool[np.ndarray, " J"]
    """Whether the position of each joint is known."""

    @property
    def turning(self) -> Bool[np.ndarray, " J"]:
        """Whether the character has the joint, so that its rotation is known."""
        return self.carrier == np.arange(len(self.carrier))

    @classmethod
    def of(cls, character: PoolCharacter, body: RiggedBody) -> CharacterSurface:
        """Sample the surface of a character at rest."""
        mesh = character.rig.mesh
        face, share = surface_points.sample_surface(mesh.vertices, mesh.faces, POINTS, np.random.default_rng(0))
        points = surface_points.at_barycentric(mesh.vertices, mesh.faces, face, share)
        vertex_weights = body_weights(character, body)
        size = spread(Mesh(body.vertices, body.faces)) / np.sqrt(np.square(points - points.mean(axis=0)).sum(-1).mean())
        found = place_body_joints(character)
        carrier, alignment = (
            carriers(set(character.joints) | {"Hips"}, body),
            np.tile(np.eye(3), (len(body.parents), 1, 1)),
        )
        aligned = rest_alignments(character)
        joints = np.empty((len(body.parents), 3))
        for j, (name, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
            alignment[j] = aligned.get(body.joint_names[carrier[j]], np.eye(3))
            if name in found:
                joints[j] = found[name][1]
            else:  # as far from the parent as in the body
                joints[j] = joints[parent] + alignment[parent] @ (body.joints[j] - body.joints[parent]) / size
        named = {*character.joints, *(side + part for side in SIDES for part in PLACED)}.difference(TRUNK)
        return cls(
            pack=character.meta.pack,
            points=size * points,
            normals=geometry.face_normals(mesh.vertices, mesh.faces)[face],
            weights=surface_points.at_barycentric(vertex_weights, mesh.faces, face, share),
            joints=size * joints,
            alignment=alignment,
            carrier=carrier,
            placed=np.array([name in named for name in body.joint_names]),
        )


@dataclass(frozen=True, eq=False)
class TrainingCharacters:
    """The characters of a folder that a training uses."""

    surfaces: tuple[CharacterSurface, ...]
    poses: Float[np.ndarray, "P J 3"]
    """Poses of all their clips: rotation vectors of the shipped body's joints."""
    facts: dict[str, Any]
    """For cards: `makers`, the number of characters of each "maker: pack (licence)", and `sha256` of all arrays."""
    refused: dict[str, int]
    """Number of characters that cannot be used, by reason."""
    characters: tuple[PoolCharacter, ...] = ()
    """The characters themselves."""

    def described(self) -> str:
        """Say in words whose the characters are and how many cannot be used."""
        used = ", ".join(f"{count} of {maker}" for maker, count in self.facts["makers"].items())
        left_out = "; ".join(f"{count} left out: {reason}" for reason, count in self.refused.items())
        return f"{used}; {len(self.poses)} poses of their clips{'; ' if left_out else ''}{left_out}"

    @classmethod
    def read(cls, folder: str | Path, body: RiggedBody, split: str = "train") -> TrainingCharacters:
        """Read the characters of a split of a pool.

        Raises:
            InputError: not a pool, or none of its characters can be used.
        """
        pool = read_pool(folder, split)
        if not pool.characters:
            raise InputError(
                f"{folder}: expected humanoids of the split {split}, found none that can be used; add some"
            )
        metas = [character.meta for character in pool.characters]
        makers = Counter(f"{meta.maker}: {meta.pack} ({meta.licence})" for meta in metas)
        surfaces = tuple(CharacterSurface.of(character, body) for character in pool.characters)
        poses = clip_poses(pool.characters, body)
        digest = hashlib.sha256(poses.round(4).tobytes())
        for surface in surfaces:
            digest.update(surface.points.round(4).tobytes() + surface.weights.round(4).tobytes())
        facts = {"makers": dict(makers), "sha256": digest.hexdigest()}
        return cls(surfaces, poses, facts, pool.refusals(), pool.characters)


def body_weights(character: PoolCharacter, body: RiggedBody) -> Float[np.ndarray, "V J"]:
    """Add up a character's weights by the shipped body's joints, rows sum to 1."""
    rig = character.rig
    names = {joint: name for name, joint in character.joints.items()}
    target = np.full(len(rig.parents) + 1, body.joint("Hips"))  # the last entry is the world
    for j, parent in enumerate(rig.parents):
        target[j] = body.joint(names[j]) if j in names else target[parent]
    weights = np.zeros((len(rig.weights), len(body.parents)))
    np.add.at(weights, (np.arange(len(weights))[:, None], target[rig.joint_of]), rig.weights)
    return weights / weights.sum(axis=1, keepdims=True)


def carriers(names: set[str], body: RiggedBody) -> Int[np.ndarray, " J"]:
    """Find the joint whose rotation each of the body's joints has in a figure that has only the named ones."""
    carrier = np.arange(len(body.parents))
    for j, (name, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
        if name not in names and parent >= 0:
            carrier[j] = carrier[parent]
    return carrier


def clip_poses(characters: Iterable[PoolCharacter], body: RiggedBody) -> Float[np.ndarray, "P J 3"]:
    """Convert the clips of characters to rotation vectors of the shipped body's joints; shared clips are taken once."""
    from scipy.spatial.transform import Rotation

    first = {character.meta.clips_from: character for character in characters if character.clips}
    poses = [
        body_pose(character, character.clip_transforms(name, frame))
        for character in first.values()
        for name, clip in character.clips.items()
        for frame in range(0, len(clip), CLIP_STEP)
    ]
    rotmat = np.array(poses).reshape(-1, 3, 3)
    return Rotation.from_matrix(rotmat).as_rotvec().reshape(-1, len(body.parents), 3)


def spread(mesh: Mesh) -> float:
    """Measure the root mean square distance of a surface from its centroid."""
    face, share = surface_points.sample_surface(mesh.vertices, mesh.faces, POINTS, np.random.default_rng(0))
    points = surface_points.at_barycentric(mesh.vertices, mesh.faces, face, share)
    return float(np.sqrt(np.square(points - points.mean(axis=0)).sum(-1).mean()))
