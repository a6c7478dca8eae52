"""How the joints of a person are turned at rest where a rig was bound in an action: sitting, crouching, lying, running.

Directions of bones do not tell how a trunk or a limb is turned about them. The frames that a file gives its joints do:
in a T-pose one axis is along the bone and the others are along those of the body, in all makers' files but for some
feet. So the rotation of a joint since the T-pose is that of its frame from an axis rotation, the nearest one to an
estimate from the positions of joints. Of frames that are near to none, the estimate is used.

Of 50 rigs of nine makers in a T- or A-pose, axes of hips lean by up to 8 degrees, those of chests and limbs by 17.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..bodies.character_limbs import SIDES, Limb, carried_vertices
from ..bodies.hands import body_with_fingers, hand_frames
from ..bodies.joint_names import ancestors
from ..bodies.skinned_character import SkinnedCharacter
from ..core.geometry import nearest_rotation, rotation_between, unit_vectors
from ..core.normalization import ROTATIONS
from .retarget import BONES, HINGES, hinge_rotations

TRUNK = ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Head")
"""Joints of the trunk, from the hips up."""
LEAN, TWIST, THIGH, KNEE, ELBOW = np.radians([20, 20, 40, 45, 75])
"""Largest angles in a T- or A-pose: trunk from the vertical, shoulders from hips, thighs to the front or back, bend of
knees and elbows."""
NEAR = np.radians(30)
"""Largest angle of an estimate from the axes of a joint's frame; beyond it they say nothing."""
SOLE_PITCH = np.radians(40)
"""The same of an estimated foot from the flat of its sole."""

LYING = 0.9
"""Sine of the angle (64 degrees) by which the front of the hips points up or down when a person lies."""
PARALLEL = np.radians(40)
"""Largest angle between arms and legs on all fours, and of both from right angles to the trunk."""
UP = np.array([0.0, 1.0, 0.0])

Frames = dict[str, Float[np.ndarray, "3 3"]]


def rests_in_action(rest: Float[np.ndarray, "J 3"], joints: Mapping[str, int]) -> bool:
    """Tell whether a rest pose is neither a T- nor an A-pose, from the positions of its joints, y up."""
    hips, shoulders = _pair(rest, joints, "UpLeg"), _pair(rest, joints, "Arm")
    trunk = shoulders.mean(axis=0) - hips.mean(axis=0)
    left, across = (unit_vectors(pair[0] - pair[1]) for pair in (hips, shoulders))
    if _angle(trunk, UP) > LEAN or _angle(left, across) > TWIST:
        return True
    for (*limb, _), most in zip(HINGES, (KNEE, ELBOW), strict=True):
        for side in SIDES:
            bones = np.diff([rest[joints[side + name]] for name in limb if side + name in joints], axis=0)
            if len(bones) == 2 and _angle(*bones) > most:
                return True
            thigh = bones[0] - (bones[0] @ left) * left if limb[0] == "UpLeg" and len(bones) else -UP
            if _angle(thigh, -UP) > THIGH:
                return True
    return False


def action_frames(character: SkinnedCharacter, joints: Mapping[str, int], limbs: Mapping[str, Limb]) -> Frames:
    """Compute the rotation of each named joint from the shipped body's T-pose to a rest pose in action.

    Args:
        character: y up, with the frames of its file at its joints.
        joints: joint of the body, or a finger's -> index of the character's joint.
    """
    body, rest = body_with_fingers(), character.joints
    axes = {name: nearest_rotation(character.T_world_joint[j, :3, :3]) for name, j in joints.items()}
    frames = _trunk_frames(rest, joints, axes)
    for trunk, hinge in zip(("Hips", _chest(joints)), HINGES, strict=True):
        for side in SIDES:
            frames |= _limb_frames(limbs, axes, body, side, hinge, frames[trunk])
    positions = {name: rest[j] for name, j in joints.items()}
    for side in SIDES:
        foot, hand = f"{side}Foot", f"{side}Hand"
        shin, forearm = (
            frames[next(side + name for name in names if side + name in frames)]
            for names in (("Leg", "UpLeg"), ("ForeArm", "Arm"))
        )
        if foot in joints:
            toes = positions.get(f"{side}ToeBase")
            turned = _foot_frame(character, joints[foot], toes, _bone(body, foot, f"{side}ToeBase"), axes[foot], shin)
            frames |= dict.fromkeys((foot, f"{side}ToeBase"), turned)
        if hand in joints:
            frames |= hand_frames(positions, _by_axes(forearm, axes[hand], np.pi), side)
    above = {name: [body.joint_names[j] for j in ancestors(body.parents, body.joint(name))] for name in joints}
    return {name: frames[next(known for known in above[name] if known in frames)] for name in joints}


def action_front(rest: Float[np.ndarray, "J 3"], joints: Mapping[str, int]) -> Float[np.ndarray, " 2"]:
    """Compute the horizontal direction (x, z) to the front of the hips; of who lies, from the hips to the head or back.

    Args:
        rest: positions of joints, y up.
    """
    hips, shoulders = _pair(rest, joints, "UpLeg"), _pair(rest, joints, "Arm")
    frame = _frame(hips[0] - hips[1], shoulders.mean(axis=0) - hips.mean(axis=0))
    front = frame[:, 2] if abs(frame[1, 2]) < LYING else -np.sign(frame[1, 2]) * frame[:, 1]
    return front[[0, 2]]


def on_all_fours(rest: Float[np.ndarray, "J 3"], joints: Mapping[str, int]) -> bool:
    """Tell whether arms and legs are about parallel and point away from the belly, as those of animals at rest do."""
    hips, shoulders = _pair(rest, joints, "UpLeg"), _pair(rest, joints, "Arm")
    trunk = unit_vectors(shoulders.mean(axis=0) - hips.mean(axis=0))
    limbs = [_whole(rest, joints, names[:-1]) for names in HINGES]
    return _angle(*limbs) < PARALLEL and all(abs(limb @ trunk) < np.sin(PARALLEL) for limb in limbs)


def _whole(rest: Float[np.ndarray, "J 3"], joints: Mapping[str, int], names: Sequence[str]) -> Float[np.ndarray, " 3"]:
    """Compute the mean direction of both limbs from their first joint to their last one that is known."""
    known = [name for name in names if all(side + name in joints for side in SIDES)]
    return unit_vectors((_pair(rest, joints, known[-1]) - _pair(rest, joints, names[0])).sum(axis=0))


def _trunk_frames(rest: Float[np.ndarray, "J 3"], joints: Mapping[str, int], axes: Frames) -> Frames:
    """Compute the rotations of the joints of the trunk, from the hips up.

    Hips and chest are estimated by thighs and shoulders, others by the smallest rotation from the joint below.
    """
    chain = [name for name in TRUNK if name in joints]
    frames: Frames = {}
    below = np.eye(3)
    for name, above in zip(chain, [*chain[1:], None], strict=True):
        part = {"Hips": "UpLeg", _chest(joints): "Arm"}.get(name)
        pair = _pair(rest, joints, part or "Arm")
        start = pair.mean(axis=0) if name == "Hips" else rest[joints[name]]
        # Of a head nothing tells the direction; of a chest without a neck the shoulders do.
        bone = below[:, 1] if above is None else rest[joints[above]] - start
        estimate = rotation_between(below[:, 1], bone) @ below
        if part is not None:
            estimate = _frame(pair[0] - pair[1], bone)
        below = frames[name] = _by_axes(estimate, axes[name], NEAR if part else np.pi)
    return frames


def _limb_frames(
    limbs: Mapping[str, Limb],
    axes: Frames,
    body: RiggedBody,
    side: str,
    hinge: tuple[str, str, str, tuple[float, float, float]],
    trunk: Float[np.ndarray, "3 3"],
) -> Frames:
    """Compute the rotations of the joints of an arm or a leg, whose bones keep their directions."""
    *names, direction = hinge
    chain = [side + name for name in names]
    upper, lower = limbs[chain[0]], limbs.get(chain[1])
    bones = {name: limb.end - limb.start for name in chain[:2] if (limb := limbs.get(name)) is not None}
    if lower is None:
        bone = _bone(body, chain[0], BONES[chain[0]])
        estimates = {chain[0]: rotation_between(trunk @ bone, bones[chain[0]]) @ trunk}
    else:
        places, index = np.stack([upper.start, upper.end, upper.end + bones[chain[1]]])[None], range(3)
        at_rest = {name: body.joint(name) for name in chain}
        found = hinge_rotations(
            places, dict(zip(chain, index, strict=True)), body.joints[None], at_rest, chain, direction, trunk[None]
        )
        estimates = {name: rotation[0] for name, (rotation, _) in found.items()}
    frames = {}
    for name, estimate in estimates.items():
        turned = _by_axes(estimate, axes[name], NEAR)
        frames[name] = rotation_between(turned @ _bone(body, name, BONES[name]), bones[name]) @ turned
    return frames


def _foot_frame(
    character: SkinnedCharacter,
    foot: int,
    toes: Float[np.ndarray, " 3"] | None,
    bone: Float[np.ndarray, " 3"],
    axes: Float[np.ndarray, "3 3"],
    shin: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, "3 3"]:
    """Compute the rotation of a foot: its left axis is one of its frame, its sole is flat.

    Args:
        toes: joint at the end of the foot; None: not known.
        bone: from the ankle to there in the T-pose of the body.
        shin: rotation of the shin.
    """
    ankle, points = character.joints[foot], character.mesh.vertices[carried_vertices(character, foot)]
    if toes is None and len(points) == 0:
        return shin
    end = points.mean(axis=0) if toes is None else toes
    turned = rotation_between(shin @ bone, end - ankle) @ shin
    left = axes[:, np.abs(axes.T @ turned[:, 0]).argmax()]
    left = left * np.sign(left @ turned[:, 0])
    if _angle(left, turned[:, 0]) < NEAR:
        turned = _frame(left, turned[:, 1])
    if len(points) == 0:
        return turned
    height, length = ((points - ankle) @ turned[:, 1:]).T
    middle = (length.min() + length.max()) / 2
    heel, ball = (np.where(half, height, np.inf).argmin() for half in (length < middle, length >= middle))
    pitch = np.arctan2(height[ball] - height[heel], length[ball] - length[heel])
    if abs(pitch) > SOLE_PITCH:
        return turned
    cosine, sine = np.cos(pitch), np.sin(pitch)
    return turned @ np.array([[1, 0, 0], [0, cosine, sine], [0, -sine, cosine]])


def _by_axes(
    estimate: Float[np.ndarray, "3 3"], axes: Float[np.ndarray, "3 3"], most: float
) -> Float[np.ndarray, "3 3"]:
    """Return the rotation of a frame from the axis rotation nearest to an estimate, unless it is off by more."""
    nearest = ROTATIONS[np.einsum("rkl,kl->r", ROTATIONS, estimate.T @ axes).argmax()]
    turned = axes @ nearest.T
    cosine = (np.trace(estimate.T @ turned) - 1) / 2
    return turned if np.arccos(np.clip(cosine, -1, 1)) <= most else estimate


def _chest(joints: Mapping[str, int]) -> str:
    """Return the highest joint of the trunk below neck and head."""
    return next(name for name in reversed(TRUNK[:4]) if name in joints)


def _frame(left: Float[np.ndarray, " 3"], up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Build a frame with its first column along `left` and its second towards `up`."""
    x = unit_vectors(left)
    y = unit_vectors(up - (up @ x) * x)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _pair(rest: Float[np.ndarray, "J 3"], joints: Mapping[str, int], part: str) -> Float[np.ndarray, "2 3"]:
    """Select the positions of the left and right joint of a part."""
    return rest[[joints[f"{side}{part}"] for side in SIDES]]


def _bone(body: RiggedBody, joint: str, tail: str) -> Float[np.ndarray, " 3"]:
    return body.joints[body.joint(tail)] - body.joints[body.joint(joint)]


def _angle(first: Float[np.ndarray, " 3"], second: Float[np.ndarray, " 3"]) -> float:
    """Compute the angle (radians) between two directions."""
    return float(np.arccos(np.clip(unit_vectors(first) @ unit_vectors(second), -1, 1)))
