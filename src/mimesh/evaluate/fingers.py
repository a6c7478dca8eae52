"""`fingers`: people in poses of Table 6 with fingers in gestures, and characters of a pool with fifteen joints a hand.

Kinds: the identity's fingers are at rest (`rest`) or in a gesture of their own (`gesture`) and the driving's in
another; `still` has all fingers at rest, which must then follow the hand. `characters` are two realistic characters of
a pool, the identity in the rest pose of its file. Errors are measured in the frame of the palm, so that those of the
arm do not count.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_limbs import SIDES
from ..bodies.character_pool import PoolCharacter, read_pool
from ..bodies.hands import (
    HAND_PARENTS,
    body_with_fingers,
    finger_rotations,
    fingertips,
    hand_alignment,
    sample_finger_poses,
)
from ..bodies.joint_names import finger_joints
from ..bodies.skinned_character import SkinnedCharacter
from ..core.errors import InputError
from ..core.geometry import MIRROR, angles_between, rigid_motion
from ..core.rig import descendants
from ..core.skinning import skinning_transforms
from .characters import pose_character
from .pairs import Pair, Person, Pose, human
from .protocols import Wide

PERSON_HEIGHT_MM = 1700.0
"""Height of the person that distances are given for (mm)."""
LEAST_VERTICES = 4
"""Vertices of a joint from which on its rotation is measured."""
PALMS = (1, 17)
"""Numbers of the two palms in `FingerPair.part`."""
OF_PART = 0.5
"""Weight from which on a vertex belongs to a palm or a finger joint."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FingerPair(Pair):
    """A pair of people, or of characters, with fingers."""

    part: Int[np.ndarray, " V"]
    """Of each vertex of the identity: 0 for none, 1 for the palm of the left hand, 2 to 16 for its finger joints, then
    17 to 32 for those of the right hand."""
    tips: Int[np.ndarray, "10"]
    """Vertices at the fingertips, of the left hand first."""

    def reordered(self, order: Int[np.ndarray, " V"], driving_order: Int[np.ndarray, " U"]) -> FingerPair:
        """Reorder the vertices of both meshes, with what belongs to those of the identity."""
        shuffled = super().reordered(order, driving_order)
        return dataclasses.replace(shuffled, part=self.part[order], tips=np.argsort(order)[self.tips])


@dataclass(frozen=True)
class FingerGestures(Wide):
    """Pairs of people and of characters with fingers in gestures."""

    data: Path | None = None
    """The folder of a pool, for the kind `characters`."""

    def check(self, split: str) -> None:
        """Raise InputError for a pool without two characters that can be measured."""
        if self.data is not None and len(fingered_characters(self.data, split)) < 2:
            raise InputError(
                f"{self.data}: expected two characters with fifteen joints a hand in the split {split}, and "
                f"{LEAST_VERTICES} vertices in each palm, found fewer; add some"
            )

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> FingerPair:
        """Generate pair `i` with the vertices in the order of the body, or of the characters' files."""
        if kind == "characters":
            assert self.data is not None
            return self._characters(fingered_characters(self.data, split), split, i, rng)
        body = body_with_fingers()
        person, other = self.sample_people(body, body, split, kind, i)
        rest, pose = self.sample_rest_pose(split, kind, i, rng), self.sample_driving_pose(split, "table6", i, rng)
        rest, pose = (
            Pose(with_gesture(given.rotmat, draw_gesture(rng) if moves else None), given.label)
            for given, moves in ((rest, kind == "gesture"), (pose, kind != "still"))
        )
        driving = other.posed_mesh(pose)
        part, tips = body_parts(person)
        return FingerPair(
            identity=person.posed_mesh(rest),
            driving=driving,
            truth=person.posed_vertices(pose.rotmat),
            height=float(np.ptp(body.shaped(person.shape)[0][:, 1])),
            aligned=driving.vertices,
            truth_name=f"id{person.label}_{pose.label}",
            groups=(person.label, other.label),
            part=part,
            tips=tips,
        )

    def _characters(self, pool: tuple[PoolCharacter, ...], split: str, i: int, rng: np.random.Generator) -> FingerPair:
        """Make a pair of two characters; the driving one has a pose of Table 6 and a gesture."""
        first, second = (pool[k] for k in rng.choice(len(pool), 2, replace=False))
        pose, gesture = self.sample_driving_pose(split, "table6", i, rng), draw_gesture(rng)
        driving, truth = (
            character.rig.skinned(pose_fingers(character, pose_character(character, pose.rotmat), gesture))
            for character in (second, first)
        )
        part, tips = character_parts(first)
        height = float(np.ptp(first.rig.mesh.vertices[:, 1]))
        return FingerPair(
            identity=first.rig.mesh,
            driving=dataclasses.replace(second.rig.mesh, vertices=driving, name=f"{second.rig.mesh.name}_{pose.label}"),
            truth=truth,
            height=height,
            metres=1.7 / height,
            truth_name=f"{first.rig.mesh.name}_{pose.label}",
            groups=(first.meta.file, second.meta.file),
            part=part,
            tips=tips,
        )


def fingers(data: Path | None = None) -> FingerGestures:
    """Return the protocol; with the folder of a pool it has the kind `characters` too."""
    kinds = ("rest", "gesture", "still") if data is None else ("characters", "rest", "gesture", "still")
    return FingerGestures("fingers", 1, kinds, pairs=36, spread=1.0, data=data)


@cache
def fingered_characters(data: Path, split: str) -> tuple[PoolCharacter, ...]:
    """Read the characters of a split that have fifteen joints in each hand, and palms that can be measured by."""
    found = (character for character in read_pool(data, split).characters if len(character.fingers) == 30)
    return tuple(character for character in found if _palm_vertices(character) >= LEAST_VERTICES)


def _palm_vertices(character: PoolCharacter) -> int:
    """Count the vertices of a character's palms, the smaller number."""
    part, _ = character_parts(character)
    return min(int((part == palm).sum()) for palm in PALMS)


def draw_gesture(rng: np.random.Generator) -> Float[np.ndarray, "2 15 3 3"]:
    """Draw a gesture of the shipped body: local rotations of the finger joints of the left and the right hand."""
    angles = sample_finger_poses(2, rng)
    return np.stack([finger_rotations(angles[s], left=s == 0) for s in range(2)])


def with_gesture(
    rotmat: Float[np.ndarray, "31 3 3"], gesture: Float[np.ndarray, "2 15 3 3"] | None
) -> Float[np.ndarray, "55 3 3"]:
    """Turn local rotations of the shipped body into those of the body with fingers, which are at rest by default."""
    names = body_with_fingers().joint_names
    fingers = np.tile(np.eye(3), (30, 1, 1)) if gesture is None else gesture.reshape(30, 3, 3)
    return np.concatenate([rotmat[[human().joint(name) for name in names[:-30]]], fingers])


def body_parts(person: Person) -> tuple[Int[np.ndarray, " V"], Int[np.ndarray, "10"]]:
    """Assign the vertices of the body with fingers to palms and joints, and find the fingertips."""
    body = person.body
    columns = [body.joint(name) for side in SIDES for name in (f"{side}Hand", *finger_joints(side))]
    return _parts(body.weights[:, columns], body.vertices, body.joints[columns])


def character_parts(character: PoolCharacter) -> tuple[Int[np.ndarray, " V"], Int[np.ndarray, "10"]]:
    """Do the same for a character."""
    rig = character.rig
    columns = [j for side in SIDES for j in _joints(character, side)]
    return _parts(_joint_weights(rig, columns), rig.mesh.vertices, rig.joints[columns])


def _parts(
    weights: Float[np.ndarray, "V 32"], vertices: Float[np.ndarray, "V 3"], joints: Float[np.ndarray, "32 3"]
) -> tuple[Int[np.ndarray, " V"], Int[np.ndarray, "10"]]:
    """Do it from the weights and positions of the joints of both hands, palms first."""
    part = np.where(weights.max(axis=1) > OF_PART, 1 + weights.argmax(axis=1), 0)
    tips = [tip for s in (0, 16) for tip in fingertips(vertices, weights[:, s + 1 : s + 16], joints[s + 1 : s + 16])]
    return part, np.array(tips)


def _joints(character: PoolCharacter, side: str) -> list[int]:
    """List the hand and the finger joints of a side of a character."""
    return [character.joints[f"{side}Hand"], *(character.fingers[name] for name in finger_joints(side))]


def _joint_weights(rig: SkinnedCharacter, joints: list[int]) -> Float[np.ndarray, "V C"]:
    """Return the weights of some joints of a character, with those below them: the palm's bones, ends of fingers."""
    columns = rig.nearest_columns({joint: k for k, joint in enumerate(joints)}, other=len(joints))
    return rig.summed_weights(columns, len(joints) + 1)[:, :-1]


def pose_fingers(
    character: PoolCharacter, transforms: Float[np.ndarray, "K 4 4"], gesture: Float[np.ndarray, "2 15 3 3"]
) -> Float[np.ndarray, "K 4 4"]:
    """Give the fingers of a posed character a gesture of the shipped body; ends of fingers follow the last joint.

    Args:
        transforms: of each joint from rest to the pose, as `pose_character` returns them.
        gesture: as `draw_gesture` returns it.
    """
    rig, posed = character.rig, transforms.copy()
    for side, local in zip(SIDES, gesture, strict=True):
        joints = _joints(character, side)
        rotations = _hand_rotations(character, side, transforms[joints[0], :3, :3], local)
        for k, joint in enumerate(joints[1:], 1):
            # The joint is where its parent moves it, and turns its surface about itself.
            parent, at_rest = posed[joints[HAND_PARENTS[k]]], rig.joints[joint]
            place = parent[:3, :3] @ at_rest + parent[:3, 3]
            posed[joint] = np.eye(4)
            posed[joint, :3, :3], posed[joint, :3, 3] = rotations[k], place - rotations[k] @ at_rest
        for j in descendants(joints[1:], rig.parents):
            if j not in joints:
                posed[j] = posed[rig.parents[j]]
    return posed


def _hand_rotations(
    character: PoolCharacter, side: str, hand: Float[np.ndarray, "3 3"], gesture: Float[np.ndarray, "15 3 3"]
) -> Float[np.ndarray, "16 3 3"]:
    """Compute the world rotation from rest of each joint of a character's hand in a gesture.

    Args:
        hand: rotation of the hand from rest.
        gesture: local rotations of the finger joints of the shipped body.
    """
    rig, joints = character.rig, _joints(character, side)
    mirror = np.ones(3) if side == "Left" else MIRROR
    flip = mirror[:, None] * mirror  # a right hand is posed as the left hand that is its mirror image
    vertices, rest = rig.mesh.vertices, rig.joints[joints]
    tips = vertices[fingertips(vertices, _joint_weights(rig, joints[1:]), rest[1:])]
    alignment, _ = hand_alignment(rest * mirror, tips * mirror)
    # A rotation from the shipped body's hand at rest is that from this hand at rest times the alignment.
    local = np.concatenate([((hand * flip) @ alignment[0])[None], gesture * flip])
    world, _ = skinning_transforms(rest * mirror, local, HAND_PARENTS)
    return (world @ alignment.swapaxes(-1, -2)) * flip


def finger_metrics(result: Float[np.ndarray, "V 3"], pair: FingerPair) -> dict[str, Any]:
    """Measure fingers in the frame of the palm: fingertips in mm on a person of 1.7 m, joint rotations in degrees.

    There are no rotations if no joint has LEAST_VERTICES.
    """
    scale, distances, turns = PERSON_HEIGHT_MM / pair.height, [], []
    for s, number in enumerate(PALMS):
        palm = pair.part == number
        rotation, offset = rigid_motion(result[palm], pair.truth[palm])
        moved = result @ rotation.T + offset
        tips = pair.tips[5 * s : 5 * s + 5]
        distances.append(scale * np.linalg.norm(moved[tips] - pair.truth[tips], axis=1))
        for k in range(15):
            of_joint = pair.part == number + 1 + k
            if of_joint.sum() >= LEAST_VERTICES:
                turn, _ = rigid_motion(moved[of_joint], pair.truth[of_joint])
                turns.append(turn)
    tips = np.concatenate(distances)
    measured = {"fingertip_mm": float(tips.mean()), "fingertip_max_mm": float(tips.max())}
    if turns:
        measured["finger_deg"] = float(angles_between(np.eye(3), np.stack(turns)).mean())
    return measured
