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
from ..bodies.finger_poses import finger_rotations, sample_finger_poses
from ..bodies.hands import HAND_PARENTS, body_with_fingers, fingertips, hand_alignment
from ..bodies.joint_names import ancestors, finger_joints
from ..core.errors import InputError
from ..core.geometry import MIRROR, angles_between, nearest_rotation
from ..core.mesh import Mesh
from ..core.skinning import skinning_transforms
from .character_poses import pose_character
from .pairs import Pair, Person, human, random_orders, reorder_vertices
from .protocols import Wide

PERSON_HEIGHT_MM = 1700.0
"""Height of the person that distances are given for."""
LEAST_POINTS = 4
"""Vertices of a joint from which on its rotation is measured."""
OF_PART = 0.5
"""Weight from which on a vertex belongs to a palm or a finger joint."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FingerPair(Pair):
    """A pair of people with fingers."""

    part: Int[np.ndarray, " V"]
    """Of each vertex of the identity: 0 for none, then palm and joints of the left hand, and those of the right one."""
    tips: Int[np.ndarray, "10"]
    """Vertices at the fingertips, of the left hand first."""


@dataclass(frozen=True)
class FingerGestures(Wide):
    """Pairs of people and of characters with fingers in gestures."""

    data: Path | None = None
    """The folder of a pool, for the kind `characters`."""

    def check(self, split: str) -> None:
        """Check that a pool has two characters with fifteen joints a hand, if one is given.

        Raises:
            InputError: it has not.
        """
        if self.data is not None and len(fingered_characters(self.data, split)) < 2:
            raise InputError(
                f"{self.data}: expected two characters with fifteen joints a hand in the split {split}, found fewer; "
                "add some"
            )

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> FingerPair:
        if kind == "characters":
            assert self.data is not None
            return self._characters(fingered_characters(self.data, split), split, i, rng)
        body = body_with_fingers()
        people = self.sample_people(body, body, split, kind, i)
        poses = (self.sample_rest_pose(split, kind, i, rng), self.sample_driving_pose(split, "table6", i, rng))
        gestured = (kind == "gesture", kind != "still")
        rotmats = [
            with_gesture(pose.rotmat, draw_gesture(rng) if moved else None)
            for pose, moved in zip(poses, gestured, strict=True)
        ]
        identity, driving, truth = (
            person.posed_vertices(rotmat)
            for person, rotmat in ((people[0], rotmats[0]), (people[1], rotmats[1]), (people[0], rotmats[1]))
        )
        aligned = driving if people[1].body is people[0].body else None
        part, tips = body_parts(people[0])
        return FingerPair(
            identity=Mesh(identity, body.faces, name=f"id{people[0].label}_{poses[0].label}"),
            driving=Mesh(driving, body.faces, name=f"id{people[1].label}_{poses[1].label}"),
            truth=truth,
            height=float(np.ptp(body.shaped(people[0].shape)[0][:, 1])),
            aligned=aligned,
            groups=(people[0].label, people[1].label),
            part=part,
            tips=tips,
        )

    def pair(self, split: str, kind: str, i: int) -> FingerPair:
        """Generate pair `i` with the vertices of both meshes shuffled."""
        rng = self.rng(split, kind, i)
        pair = self.unshuffled_pair(split, kind, i, rng)
        orders = random_orders(pair, rng)
        shuffled = reorder_vertices(pair, *orders)
        assert isinstance(shuffled, FingerPair)
        return dataclasses.replace(shuffled, part=pair.part[orders[0]], tips=np.argsort(orders[0])[pair.tips])

    def _characters(self, pool: tuple[PoolCharacter, ...], split: str, i: int, rng) -> FingerPair:
        """Make a pair of two characters; the driving one has a pose of Table 6 and a gesture."""
        first, second = (pool[k] for k in rng.choice(len(pool), 2, replace=False))
        pose, gesture = self.sample_driving_pose(split, "table6", i, rng).rotmat, draw_gesture(rng)
        driving, truth = (
            character.rig.skinned(pose_fingers(character, pose_character(character, pose), gesture))
            for character in (second, first)
        )
        part, tips = character_parts(first)
        return FingerPair(
            identity=first.rig.mesh,
            driving=dataclasses.replace(second.rig.mesh, vertices=driving),
            truth=truth,
            height=float(np.ptp(first.rig.mesh.vertices[:, 1])),
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
    """Read the characters of a split that have fifteen joints in each hand."""
    return tuple(character for character in read_pool(data, split).characters if len(character.fingers) == 30)


def draw_gesture(rng: np.random.Generator) -> Float[np.ndarray, "2 15 3 3"]:
    """Draw local rotations of the joints of both hands."""
    angles = sample_finger_poses(2, rng)
    return np.stack([finger_rotations(angles[s], left=s == 0) for s in range(2)])


def with_gesture(
    rotmat: Float[np.ndarray, "31 3 3"], gesture: Float[np.ndarray, "2 15 3 3"] | None
) -> Float[np.ndarray, "55 3 3"]:
    """Give a pose of the shipped body to the body with fingers."""
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
    weights = np.stack([(rig.weights * (rig.joint_of == j)).sum(axis=1) for j in columns], axis=1)
    return _parts(weights, rig.mesh.vertices, rig.joints[columns])


def _parts(weights: Float[np.ndarray, "V 32"], vertices, joints: Float[np.ndarray, "32 3"]):
    part = np.where(weights.max(axis=1) > OF_PART, 1 + weights.argmax(axis=1), 0)
    tips = [tip for s in (0, 16) for tip in fingertips(vertices, weights[:, s + 1 : s + 16], joints[s + 1 : s + 16])]
    return part, np.array(tips)


def _joints(character: PoolCharacter, side: str) -> list[int]:
    """List the hand and the finger joints of a side of a character."""
    return [character.joints[f"{side}Hand"], *(character.fingers[name] for name in finger_joints(side))]


def pose_fingers(
    character: PoolCharacter, transforms: Float[np.ndarray, "K 4 4"], gesture: Float[np.ndarray, "2 15 3 3"]
) -> Float[np.ndarray, "K 4 4"]:
    """Give the fingers of a posed character a gesture of the shipped body."""
    rig, posed = character.rig, transforms.copy()
    for s, side in enumerate(SIDES):
        mirror = np.ones(3) if side == "Left" else MIRROR
        columns = _joints(character, side)
        weights = np.stack([(rig.weights * (rig.joint_of == j)).sum(axis=1) for j in columns[1:]], axis=1)
        rest = rig.joints[columns] * mirror
        tips = rig.mesh.vertices[fingertips(rig.mesh.vertices, weights, rig.joints[columns[1:]])] * mirror
        alignment, _ = hand_alignment(rest, tips)
        hand = transforms[columns[0], :3, :3] * mirror[:, None] * mirror @ alignment[0]
        local = np.concatenate([hand[None], gesture[s] * mirror[:, None] * mirror])
        world, _ = skinning_transforms(rest, local, HAND_PARENTS)
        turned = world @ alignment.swapaxes(-1, -2) * mirror[:, None] * mirror
        for k, joint in enumerate(columns[1:], 1):
            parent = posed[columns[HAND_PARENTS[k]]]
            posed[joint] = np.eye(4)
            posed[joint, :3, :3] = turned[k]
            place = parent[:3, :3] @ rig.joints[joint] + parent[:3, 3]
            posed[joint, :3, 3] = place - turned[k] @ rig.joints[joint]
        below = set(columns[1:])
        for j in range(len(rig.parents)):  # ends of fingers follow the last joint
            above = next((k for k in ancestors(rig.parents, j)[1:] if k in below), None)
            if above is not None and j not in below:
                posed[j] = posed[above]
    return posed


def finger_metrics(result: Float[np.ndarray, "V 3"], pair: FingerPair) -> dict[str, Any]:
    """Measure fingers in the frame of the palm: fingertips in mm on a person of 1.7 m, joint rotations in degrees."""
    scale, distances, turns = PERSON_HEIGHT_MM / pair.height, [], []
    for s in range(2):
        palm = pair.part == 1 + 16 * s
        rotation, offset = rigid_motion(result[palm], pair.truth[palm])
        moved = result @ rotation.T + offset
        tips = pair.tips[5 * s : 5 * s + 5]
        distances.append(scale * np.linalg.norm(moved[tips] - pair.truth[tips], axis=1))
        for k in range(15):
            of_joint = pair.part == 2 + 16 * s + k
            if of_joint.sum() >= LEAST_POINTS:
                turn, _ = rigid_motion(moved[of_joint], pair.truth[of_joint])
                turns.append(turn)
    tips = np.concatenate(distances)
    return {
        "fingertip_mm": float(tips.mean()),
        "fingertip_max_mm": float(tips.max()),
        "finger_deg": float(angles_between(np.eye(3), np.stack(turns)).mean()),
    }


def rigid_motion(
    points: Float[np.ndarray, "N 3"], target: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, " 3"]]:
    """Find the rotation and the offset that move points nearest to a target (Kabsch 1976)."""
    centre, goal = points.mean(axis=0), target.mean(axis=0)
    rotation = nearest_rotation((target - goal).T @ (points - centre))
    return rotation, goal - rotation @ centre
