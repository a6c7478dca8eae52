"""A rigged humanoid of any maker, whose joints are known by name, and how its rest pose differs from a T-pose.

The rotation of joint j since the T-pose of the shipped body is D_j(t) = M_j(t) A_j, where M_j is the rotation since the
character's own rest pose and A_j (`frames`) takes the T-pose to that rest pose. D_j means the same for all characters:
it turns the limbs of each of them to the same directions. So M_j(t) of an identity is D_j(t) of a driving times A_j^T.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody, load_body
from ..bodies.anatomy import anatomy_of
from ..bodies.character_limbs import SIDES, Limb, attach_feet, find_limbs, moves_vertices, name_limb_joints
from ..bodies.engine_names import TRUNK
from ..bodies.hand_chains import find_fingers
from ..bodies.hands import body_with_fingers, hand_frames, has_hand
from ..bodies.joint_names import ancestors, finger_joints, parents_first
from ..bodies.skinned_character import SkinnedCharacter
from ..core.geometry import nearest_rotation
from ..core.normalization import axis_name
from ..core.normalization import turn as turned_about_y
from ..core.person_motion import PersonMotion
from ..core.rig import descendants
from .motion import BONES
from .posed_rest import action_frames, rests_in_action
from .retarget import limb_alignments, rest_heading

LEG = ("UpLeg", "Leg", "Foot")
"""Joints of a leg from hip to ankle, without their side."""
WHOLE = {"Arm": "Hand", "UpLeg": "Foot"}
"""Joints that stand for a whole limb in figures of blocks, and the joint at the limb's other end."""


@dataclass(frozen=True, eq=False)
class HumanoidRig:
    """A character at rest with the joints that are known by name, in the axes and unit of its file."""

    character: SkinnedCharacter
    """All joints; feet on roots of their own are children of their shins."""
    joints: dict[str, int]
    """Joint of the shipped body, or a finger's -> index of the character's joint."""
    frames: dict[str, Float[np.ndarray, "3 3"]]
    """Rotation A_j of each named joint from the T-pose (y up, +z front) to the character's rest pose."""
    limbs: dict[str, Limb]
    """Limbs in the axes of the file."""
    turn: Float[np.ndarray, "3 3"]
    """Rotation from the file's axes to y up, +z front."""
    heading: float = 0.0
    """Angle (radians, from z towards x, after `turn`) at which it faces, where that is between the axes."""
    in_action: bool = False
    """Whether it rests in another pose than a T- or A-pose, in which it need not stand on its soles."""
    palms: Mapping[str, Float[np.ndarray, "3 3"]] = field(default_factory=dict)
    """Rotation A of each hand, by side, whose fingers hang on the forearm, as there is no joint of the hand."""

    body_name: ClassVar[str] = "human"
    """The shipped body whose joints these are."""
    stands: ClassVar[frozenset[str]] = frozenset()
    """Joints that keep how they stand at rest (`KnownIdentity.standing`). People rest in T-poses, A-poses and others,
    which say nothing about how they stand."""

    @property
    def body(self) -> RiggedBody:
        """That body."""
        return load_body(self.body_name)

    @property
    def legs(self) -> tuple[tuple[int, ...], ...]:
        """Of each leg hip, knee and ankle, those of them that it has; of forelegs shoulder, elbow and wrist."""
        return self._chains(anatomy_of(self.body_name).legs)

    @property
    def arms(self) -> tuple[tuple[int, ...], ...]:
        """Of each arm of a person shoulder, elbow and wrist, those of them that it has."""
        return self._chains(anatomy_of(self.body_name).arms)

    def _chains(self, limbs: tuple[tuple[str, str, str], ...]) -> tuple[tuple[int, ...], ...]:
        return tuple(tuple(self.joints[name] for name in limb if name in self.joints) for limb in limbs)

    @property
    def leg(self) -> float:
        """Mean length of the legs, from hip to ankle; of a leg of one joint, to its sole."""
        lengths = []
        for side in SIDES:
            chain = [self.limbs[side + part] for part in LEG[:2] if side + part in self.limbs]
            lengths.append(sum(float(np.linalg.norm(limb.end - limb.start)) for limb in chain))
        return float(np.mean(lengths))

    @property
    def whole_limbs(self) -> dict[str, str]:
        """Joints that stand for a whole limb, and the joint of a person at the limb's other end."""
        lower = {"Arm": "ForeArm", "UpLeg": "Leg"}
        return {
            side + part: side + end
            for side in SIDES
            for part, end in WHOLE.items()
            if side + lower[part] not in self.joints
        }

    @property
    def person(self) -> tuple[str, ...]:
        """Names of the joints that are known, the hips first."""
        return ("Hips", *(name for name in self.joints if name != "Hips"))

    def motion(self, world: Float[np.ndarray, "T K 4 4"], rest: Float[np.ndarray, "K 4 4"]) -> PersonMotion:
        """Compute the motion of the known joints from their transforms, with weights for the character's vertices.

        A hand without a joint, whose fingers hang on the forearm, gets one where they begin.

        Args:
            world: transform of each joint of `person` in every frame, in the axes and unit of the character.
            rest: the same at rest, with the same scales.
        """
        names, character = self.person, self.character
        column_of = {self.joints[name]: k for k, name in enumerate(names)}
        columns, frames = character.nearest_columns(column_of, 0), dict(self.frames)
        weights = character.summed_weights(columns, len(names))
        for side, palm in self.palms.items():
            forearm, frames[f"{side}Hand"] = names.index(f"{side}ForeArm"), palm
            knuckles = [names.index(name) for name in finger_joints(side) if name in names and name.endswith("1")]
            place, at_rest = forearm + 1, rest[forearm].copy()
            at_rest[:3, 3] = rest[knuckles, :3, 3].mean(axis=0)
            hand = world[:, forearm] @ np.linalg.pinv(rest[forearm]) @ at_rest
            names = (*names[:place], f"{side}Hand", *names[place:])
            world, rest = np.insert(world, place, hand, axis=1), np.insert(rest, place, at_rest, axis=0)
            weights = np.insert(weights, place, 0.0, axis=1)
        moved = nearest_rotation(world[..., :3, :3] @ np.linalg.pinv(rest[:, :3, :3]))
        turns = np.stack([frames[name] for name in names])
        up, front = axis_name(self.turn[1]), axis_name(self.turn[2])
        resting = turns, rest[:, :3, 3]
        surface = None if self.in_action else character.mesh.vertices
        positions = world[..., :3, 3]
        return PersonMotion(
            names, moved @ turns, positions, self.leg, weights, surface, front, up, resting, self.turn, self.heading
        )

    def tree(self) -> tuple[list[int], tuple[int, ...]]:
        """Select the joints that move with the hips, the hips first, and the parent of each among them.

        Besides those below the hips these are joints elsewhere that are a person's or move vertices: they go with the
        hips. Others (handles of the animator, a root) stay as they are. Legs go with the hips and arms with the chest,
        wherever the file hangs them (`_hung`).
        """
        hips, parents = self.joints["Hips"], self.character.parents
        below = descendants([hips], parents)
        weighted = np.union1d(self.character.joint_of[self.character.weights > 0], list(self.joints.values())).tolist()
        # The chain from a part that moves vertices up to the hips' tree or a root turns as one with the hips.
        others = [j for j in weighted if j < len(parents) and j not in below]
        kept = [hips, *(j for j in below if j != hips), *others]
        place = {joint: k for k, joint in enumerate(kept)}
        above, hung = [-1], self._hung() if self.body_name == "human" else {}
        for joint in kept[1:]:
            chain = [j for j in ancestors(parents, joint)[1:] if j in place]
            above.append(place[hung.get(joint, chain[0])] if chain else 0)
        order = parents_first(above)
        rank = np.argsort(order)
        return [kept[k] for k in order], tuple(int(rank[above[k]]) if above[k] >= 0 else -1 for k in order)

    def _hung(self) -> dict[int, int]:
        """Return the first joint of limbs that hang on a joint below the hips or chest, and the hips or chest.

        3ds Max Bipeds have legs on the spine and arms on the neck ("triangle pelvis" and "triangle neck"), and thighs
        and collar bones that keep their places in pelvis and chest by keys of position.
        """
        parents, joints, found = self.character.parents, self.joints, {}
        trunk = [joints[name] for name in TRUNK if name in joints]
        chest = next(joints[name] for name in ("Spine1", "Spine", "LowerBack", "Hips") if name in joints)
        for side in SIDES:
            for parts, goal in ((("Shoulder", "Arm"), chest), (("UpLeg",), joints["Hips"])):
                limb = ancestors(parents, next(joints[side + part] for part in parts if side + part in joints))
                held = next((k for k, j in enumerate(limb) if j in trunk), len(limb))
                if goal in limb[held + 1 :]:
                    found[limb[held - 1]] = goal
        return found


def humanoid_rig(
    character: SkinnedCharacter,
    turn: Float[np.ndarray, "3 3"],
    known: Mapping[str, int],
    poses: Callable[[], Float[np.ndarray, "N J 4 4"]],
    path: object,
) -> tuple[HumanoidRig, list[int]]:
    """Find the limbs of a character and calibrate its rest pose.

    Args:
        character: at rest, in the axes of its file.
        turn: rotation after which y is up and it faces +z.
        known: joints that the file itself names, in place of those found by their names.
        poses: makes transforms of each joint from rest to some poses; called if a foot is not below its shin.
        path: in error messages.

    Returns the rig, and the order of its joints: joint k is joint `order[k]` of `character`.
    """
    facing = character.turned(turn)
    joints = name_limb_joints(facing, path, known)
    loose = any(
        f"{side}Foot" in joints
        and joints.get(f"{side}Leg", joints[f"{side}UpLeg"]) not in ancestors(facing.parents, joints[f"{side}Foot"])
        for side in SIDES
    )
    moved = poses() if loose else np.zeros((0, len(facing.parents), 4, 4))
    facing, joints, order = attach_feet(facing, joints, moved, path)
    # Fingers that the file itself names count before those found by their names.
    unnamed = [side for side in SIDES if not any(name in joints for name in finger_joints(side))]
    joints |= find_fingers(facing, joints, unnamed)
    moving = moves_vertices(facing)
    named = joints
    joints = {name: joint for name, joint in named.items() if moving[joint] or name in ("Hips", "Head")}
    limbs = find_limbs(facing, joints, path)
    # Joints without weights, such as tips of fingers, still show where the bone above them points.
    in_action = rests_in_action({name: facing.joints[joint] for name, joint in named.items()})
    frames = action_frames(facing, named, limbs) if in_action else rest_frames(facing.joints, named, limbs)
    back = turn.T
    rig = HumanoidRig(
        facing.turned(back),
        joints,
        {name: back @ frames[name] for name in joints},
        {name: Limb(limb.joint, back @ limb.start, back @ limb.end) for name, limb in limbs.items()},
        turn,
        0.0 if in_action else rest_heading(facing.joints, named),
        in_action,
        {side: back @ frames[hand] for side in SIDES if (hand := f"{side}Hand") in frames and hand not in named},
    )
    return rig, order.tolist()


def rest_frames(
    rest: Float[np.ndarray, "J 3"], joints: Mapping[str, int], limbs: Mapping[str, Limb]
) -> dict[str, Float[np.ndarray, "3 3"]]:
    """Compute A_j (see the module) of all named joints of a character that faces +z more than any other axis."""
    body, heading = body_with_fingers(), turned_about_y(rest_heading(rest, joints))
    rest = rest @ heading  # rows: turned back to +z
    bones = {name: (limb.end - limb.start) @ heading for name, limb in limbs.items() if name in BONES}
    aligned = limb_alignments(bones, body)
    frames = {name: aligned.get(name, np.eye(3)) for name in joints}
    positions = {name: rest[joint] for name, joint in joints.items()}
    for side in SIDES:
        if has_hand(joints, side):
            turn = aligned.get(f"{side}Hand", frames.get(f"{side}ForeArm", np.eye(3)))  # an arm may have no elbow
            frames |= hand_frames(positions, turn, side)
    return {name: heading @ frame for name, frame in frames.items()}
