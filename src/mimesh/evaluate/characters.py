"""`characters`: pairs of rigged characters of several makers, from a pool (`bodies.character_pool`).
`cross-body`: pairs of those of a folder of rigged files (`character_folder`) that share a skeleton.

Kinds `table6`, `limits` and `clips` are pairs of two characters with one skeleton: the truth is the identity under the
bone rotations of the driving character. The same kinds with `across-` are pairs of different skeletons: they have no
true vertices, and are measured by their limbs. Poses of `table6` and `limits` are drawn like those of `human-wide`.
Frames of `clips` are from the driving character's own clips; characters without any take the shipped captures.

A pool says which split a character belongs to; those of a folder of files are in all, in other poses. Packs take turns,
files are drawn from a pack, so that a pack of many files counts as much as one of few. Pairs of `across-` are of two
packs: all ordered pairs of packs take turns.

Each limb is turned from its own direction at rest to that of the shipped body, so a pose means the same directions in
the world for every character. Limbs are given by their ends, so that figures without hands or with one joint a limb
take poses too: an arm of one joint has the direction from the body's shoulder to its wrist. Joints that a character
lacks follow their parents.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..bodies import RiggedBody
from ..bodies.body_model import EXTREMES, LANDMARKS, NEAR, landmarks
from ..bodies.character_limbs import SIDES, TAILS, Limb
from ..bodies.character_pool import CharacterMeta, Pool, PoolCharacter, read_pool, transferred_transforms
from ..bodies.skinned_character import SkinnedCharacter
from ..core.errors import InputError
from ..core.geometry import rotation_between
from ..core.mesh import Mesh
from ..core.rig import local_rotations
from ..io.gltf.character import NOT_STATED
from ..motions.animal_rig import rest_directions
from ..motions.retarget import limb_alignments
from .character_folder import INDEX, read_character_folder
from .pairs import Pair, human
from .protocols import Wide

ACROSS = "across-"
"""Prefix of the kinds of pairs with different skeletons."""
ACROSS_POSES = 5_000
"""Number of the first pose of these kinds, beyond the poses of the others."""
KINDS = ("table6", "limits", "clips")
Transforms = Float[np.ndarray, "K 4 4"]


@dataclass(frozen=True, eq=False)
class PosedCharacter:
    """A character in a pose, with its vertices in the order of the mesh that methods get."""

    meta: CharacterMeta
    rig: SkinnedCharacter
    limbs: dict[str, Limb]
    transforms: Transforms
    """Transform of each joint from rest to the pose; the last one, of the world, is the identity."""

    @property
    def vertices(self) -> Float[np.ndarray, "V 3"]:
        """Vertices in the pose."""
        return self.rig.skinned(self.transforms)


@dataclass(frozen=True, eq=False, kw_only=True)
class CharacterPair(Pair):
    """A pair of two characters; lengths are in the units of their files, y is up, both face +z at rest.

    Across skeletons `truth` is an estimate: the identity with its limbs in the directions of the driving character's.
    """

    identity_character: PosedCharacter
    """The identity in the pose of its mesh."""
    driving_character: PosedCharacter
    """The driving character in its pose."""

    def reordered(self, order: Int[np.ndarray, " V"], driving_order: Int[np.ndarray, " U"]) -> CharacterPair:
        """Reorder the vertices of both meshes, and the weights of both characters with them."""
        return dataclasses.replace(
            super().reordered(order, driving_order),
            identity_character=_permuted(self.identity_character, order),
            driving_character=_permuted(self.driving_character, driving_order),
        )


@dataclass(frozen=True)
class Characters(Wide):
    """Pairs of the characters of a folder. Two of three identities are in the rest pose of their file."""

    data: Path = Path()
    """The folder of the pool, or of rigged files."""

    def pool(self, split: str) -> Pool:
        """Read the characters of a split, once, and the files that cannot be used with the reasons."""
        return _read_pool(self.data, split)

    def check(self, split: str) -> None:
        """Raise InputError for a folder of another format, or with too few characters for pairs of all kinds."""
        across = any(kind.startswith(ACROSS) for kind in self.kinds)
        if not _within(self.data, split) or (across and not _across(self.data, split)):
            found = [character.meta.pack for character in self.pool(split).characters]
            counts = ", ".join(f"{found.count(pack)} of {pack}" for pack in dict.fromkeys(found))
            others = ", and two packs with different skeletons," if across else ""
            raise InputError(
                f"{self.data}: expected two characters of one skeleton{others} in the split {split}, found "
                f"{counts or 'none'}; add some"
            )

    def left_out(self, split: str) -> dict[str, int]:
        return self.pool(split).refusals()

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> CharacterPair:
        base, across = kind.removeprefix(ACROSS), kind.startswith(ACROSS)
        identity, driving = self.draw_characters(split, kind, i, rng)
        number = ACROSS_POSES + i if across else i
        rest, rest_label = np.tile(np.eye(4), (len(identity.rig.parents) + 1, 1, 1)), "rest"
        if rng.random() >= 2 / 3:
            pose = self.sample_rest_pose(split, base, number, rng)
            rest, rest_label = pose_character(identity, pose.rotmat), pose.label
        transforms, label = self.draw_pose(driving, split, base, number, rng)
        return _make_pair(identity, driving, rest, transforms, (rest_label, label), across)

    def draw_characters(
        self, split: str, kind: str, i: int, rng: np.random.Generator
    ) -> tuple[PoolCharacter, PoolCharacter]:
        """Draw the identity and the driving character of pair `i`."""
        if kind.startswith(ACROSS):
            choices = _across(self.data, split)
            identities, others = choices[i % len(choices)]
            identity = identities[rng.integers(len(identities))]
            partners = [c for c in others if c.rig.skeleton != identity.rig.skeleton]
        else:
            choices = _within(self.data, split)
            identities = choices[i % len(choices)]
            identity = identities[rng.integers(len(identities))]
            partners = [c for c in identities if c is not identity and c.rig.skeleton == identity.rig.skeleton]
        return identity, partners[rng.integers(len(partners))]

    def draw_pose(
        self, driving: PoolCharacter, split: str, kind: str, number: int, rng: np.random.Generator
    ) -> tuple[Transforms, str]:
        """Draw a pose of the driving character, as transforms of its joints from rest, and its name."""
        if kind == "clips" and driving.clips:
            name = list(driving.clips)[rng.integers(len(driving.clips))]
            frame = int(rng.integers(len(driving.clips[name])))
            return driving.clip_transforms(name, frame), f"{name.replace('/', '-')}{frame}"
        pose = self.sample_driving_pose(split, kind, number, rng)
        return pose_character(driving, pose.rotmat), pose.label


def characters(data: str | Path) -> Characters:
    """Return the protocol for a pool of characters; `check` tells whether a split can be generated."""
    return Characters("characters", 2, (*KINDS, *(ACROSS + kind for kind in KINDS)), pairs=36, spread=0.0,
                      data=Path(data))  # fmt: skip


def cross_body(data: str | Path) -> Characters:
    """Return the protocol for a folder of rigged files; `check` tells whether it can be generated."""
    return Characters("cross-body", 2, KINDS, pairs=12, spread=0.0, data=Path(data))


@cache
def _read_pool(data: Path, split: str) -> Pool:
    if (data / INDEX).is_file():
        return read_pool(data, split)
    return read_character_folder(data)


def _packs(data: Path, split: str) -> dict[str, list[PoolCharacter]]:
    packs: dict[str, list[PoolCharacter]] = {}
    for character in sorted(_read_pool(data, split).characters, key=lambda c: (c.meta.pack, c.meta.file)):
        packs.setdefault(character.meta.pack, []).append(character)
    return packs


@cache
def _within(data: Path, split: str) -> list[list[PoolCharacter]]:
    """List, for each pack that has any, the characters whose skeleton others of the pack have too."""
    shared = []
    for pack in _packs(data, split).values():
        skeletons = [character.rig.skeleton for character in pack]
        shared.append([c for c in pack if skeletons.count(c.rig.skeleton) > 1])
    return [pack for pack in shared if pack]


@cache
def _across(data: Path, split: str) -> list[tuple[list[PoolCharacter], list[PoolCharacter]]]:
    """List the ordered pairs of packs, of which each identity has a partner with another skeleton."""
    packs = _packs(data, split)
    choices = []
    for first, identities in packs.items():
        for second, others in packs.items():
            usable = [c for c in identities if any(other.rig.skeleton != c.rig.skeleton for other in others)]
            if first != second and usable:
                choices.append((usable, others))
    return choices


def _make_pair(identity, driving, rest, transforms, labels, across: bool) -> CharacterPair:
    """Make a pair; within one skeleton the truth is the identity under the bone rotations of the driving character.

    Across skeletons it is an estimate, see `CharacterPair`. The baseline `copy` needs a true correspondence, which
    exists only if both characters have the same triangles.
    """
    identity_posed, driving_posed = (
        PosedCharacter(character.meta, character.rig, character.limbs, pose)
        for character, pose in ((identity, rest), (driving, transforms))
    )
    driving_mesh, extra = _mesh(driving_posed, labels[1]), {}
    if across:
        # From what the driving mesh shows, not from the pose drawn: an arm of one joint has lost the bend of the elbow.
        truth = identity.rig.skinned(pose_character(identity, body_pose(driving, transforms)))
    else:
        size = identity.leg / driving.leg
        truth = identity.rig.skinned(transferred_transforms(driving.rig, identity.rig, transforms, size))
        reference = driving.rig.skinned(transferred_transforms(identity.rig, driving.rig, rest, 1 / size))
        markers = np.stack([find_character_landmarks(identity), find_character_landmarks(driving)], axis=1)
        markers[(markers < 0).any(axis=1), 1] = -1
        extra = {"reference": reference, "markers": markers}
        if np.array_equal(identity.rig.mesh.faces, driving.rig.mesh.faces):
            extra |= {"aligned": driving_mesh.vertices, "aligned_reference": reference}
    height = float(np.ptp(identity.rig.mesh.vertices[:, 1]))
    return CharacterPair(
        identity=_mesh(identity_posed, labels[0]),
        driving=driving_mesh,
        truth=truth,
        height=height,
        metres=1.7 / height,
        truth_name=f"{identity.meta.file}_{labels[1]}",
        groups=(character_label(identity.meta), character_label(driving.meta)),
        identity_character=identity_posed,
        driving_character=driving_posed,
        truth_known=not across,
        **extra,
    )


def character_label(meta: CharacterMeta) -> str:
    """Return maker, pack and file of a character, for reports."""
    return f"{meta.maker or NOT_STATED}: {meta.pack}: {meta.file}"


def _mesh(posed: PosedCharacter, label: str) -> Mesh:
    mesh = posed.rig.mesh
    return dataclasses.replace(mesh, vertices=posed.vertices, name=f"{mesh.name}_{label}")


def _permuted(posed: PosedCharacter, order: Int[np.ndarray, " V"]) -> PosedCharacter:
    return dataclasses.replace(posed, rig=posed.rig.permuted(order))


def pose_character(character: PoolCharacter, rotmat: Float[np.ndarray, "B 3 3"]) -> Float[np.ndarray, "K 4 4"]:
    """Compute the transforms of a character's joints, from rest, that give it a pose of the shipped body."""
    body, rig, aligned = human(), character.rig, rest_alignments(character)
    rotation, translation = body.skinning_transforms(body.joints, rotmat)
    posed = np.einsum("jkl,jl->jk", rotation, body.joints) + translation
    named = {}
    for name, joint in character.joints.items():
        turned = rotation[body.joint(name)]
        if tail := body_tail(character, name):
            # A limb of one joint also turns from the direction of the body's upper arm to that of the whole arm.
            head, end = body.joint(name), body.joint(tail)
            turned = (
                rotation_between(turned @ (body.joints[end] - body.joints[head]), posed[end] - posed[head]) @ turned
            )
        named[joint] = turned @ aligned.get(name, np.eye(3)).T
    hips = named[character.joints["Hips"]]
    world = np.empty((len(rig.parents), 3, 3))
    for j, parent in enumerate(rig.parents):
        world[j] = named[j] if j in named else world[parent] if parent >= 0 else hips
    return rig.skinning_transforms(local_rotations(world[None], rig.parents)[0])


def body_pose(character: PoolCharacter, transforms: Float[np.ndarray, "K 4 4"]) -> Float[np.ndarray, "B 3 3"]:
    """Compute the local joint rotations that give the shipped body a pose of a character; see `body_poses`."""
    return body_poses(character, transforms[None])[0]


def body_poses(
    character: PoolCharacter, transforms: Float[np.ndarray, "T K 4 4"], body: RiggedBody | None = None
) -> Float[np.ndarray, "T B 3 3"]:
    """Compute the local joint rotations that give a shipped body poses of a character.

    Args:
        transforms: of each joint of the character from rest to the poses.
        body: the shipped body whose joints the character has; None: the human.
    """
    body = body or human()
    of_animal = body.name == "quadruped"
    aligned = animal_alignments(character, body) if of_animal else rest_alignments(character)
    world = np.empty((len(transforms), len(body.parents), 3, 3))
    for j, (name, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
        if name in character.joints:
            world[:, j] = transforms[:, character.joints[name], :3, :3] @ aligned.get(name, np.eye(3))
        else:
            world[:, j] = world[:, parent] if parent >= 0 else np.eye(3)
    return local_rotations(world, body.parents)


def rest_alignments(character: PoolCharacter) -> dict[str, Float[np.ndarray, "3 3"]]:
    """Compute the rotation of each limb joint from the shipped body's direction at rest to the character's."""
    names = (side + part for side in SIDES for part in TAILS)
    tails = {name: tail for name in names if (tail := body_tail(character, name))}
    bones = {name: character.limbs[name].end - character.limbs[name].start for name in tails}
    return limb_alignments(bones, human(), tails)


def animal_alignments(character: PoolCharacter, body: RiggedBody) -> dict[str, Float[np.ndarray, "3 3"]]:
    """Compute the rotations of an animal's joints from the shipped quadruped's rest pose to its own."""
    positions = {name: character.rig.joints[joint] for name, joint in character.joints.items()}
    return rest_directions(positions, float(character.rig.mesh.vertices[:, 1].min()), body)


def body_tail(character: PoolCharacter, name: str) -> str | None:
    """Find the joint of the shipped body at the far end of what a character's limb stands for; None for no limb."""
    side, part = next(((side, name.removeprefix(side)) for side in SIDES if name.startswith(side)), ("", ""))
    if part not in TAILS or name not in character.limbs:
        return None
    inner = [tail for tail in TAILS[part][:-1] if side + tail in character.limbs]
    return side + (inner[0] if inner else TAILS[part][-1])


@cache
def find_character_landmarks(character: PoolCharacter) -> Int[np.ndarray, "M"]:
    """Find the vertices of a character at the landmarks of the shipped body; -1 where it has no vertex there."""
    rig, points = character.rig, place_body_joints(character)
    t_pose = pose_character(character, np.tile(np.eye(3), (len(human().parents), 1, 1)))
    # In the shipped body's T-pose and at its height, with its joints, so that `landmarks` works on it.
    body = human()
    scale = np.ptp(body.vertices[:, 1]) / np.ptp(rig.mesh.vertices[:, 1])
    joints = body.joints.copy()
    for own, (j, point) in points.items():
        joints[body.joint(own)] = scale * (t_pose[j] @ [*point, 1.0])[:3]
    # Influences of the fixed world count as the root joint.
    columns = rig.nearest_columns({j: body.joint(own) for own, j in character.joints.items()}, other=0)
    weights = rig.summed_weights(columns, len(body.parents))
    vertices = scale * rig.skinned(t_pose)
    no_shapes, no_joint_shapes = np.zeros((0, len(vertices), 3)), np.zeros((0, len(joints), 3))
    faces, names = rig.mesh.faces, body.joint_names
    wrapped = RiggedBody("", vertices, faces, no_shapes, joints, no_joint_shapes, weights, names, body.parents)
    found = np.array(list(landmarks(wrapped).values()))
    for k, name in enumerate(LANDMARKS):
        if name in EXTREMES:
            # A large low-poly fist may have no vertex near the line through the hand.
            joint, direction = EXTREMES[name]
            offset = wrapped.vertices[found[k]] - wrapped.joints[wrapped.joint(joint)]
            if np.linalg.norm(np.cross(offset, direction)) >= NEAR:
                found[k] = -1
    return found


def place_body_joints(character: PoolCharacter) -> dict[str, tuple[int, Float[np.ndarray, " 3"]]]:
    """Place the shipped body's joints on a character: the joint that carries each, and the point at rest.

    Elbows and knees of limbs of one joint are in the middle; missing hands and feet are at the ends, toes at the foot.
    """
    joints, rig = character.joints, character.rig
    points = {name: (j, rig.joints[j]) for name, j in joints.items()}
    for side in SIDES:
        for upper, lower, end in (("Arm", "ForeArm", "Hand"), ("UpLeg", "Leg", "Foot")):
            limb = character.limbs[side + upper]
            points.setdefault(side + lower, (limb.joint, (limb.start + limb.end) / 2))
            last = character.limbs.get(side + lower, limb)
            points.setdefault(side + end, (last.joint, last.end))
        points.setdefault(f"{side}ToeBase", points[f"{side}Foot"])
    return points
