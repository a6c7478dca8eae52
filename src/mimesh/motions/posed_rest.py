"""How the joints of a person are turned at rest where a rig was bound in an action: sitting, crouching, lying, running.

Directions of bones do not tell how a trunk or a limb is turned about them. The frames that a file gives its joints do:
in a T-pose one axis is along the bone and the others are along those of the body, in all makers' files but for some
feet. So the rotation of a joint since the T-pose is that of its frame from an axis rotation, the nearest one to
estimates from the positions of joints. Where frames are near to none, the estimates are used.

Of 50 rigs of nine makers in a T- or A-pose, axes of hips lean by up to 8 degrees, those of chests and limbs by 17.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ..bodies.character_limbs import SIDES, Limb, carried_vertices
from ..bodies.hands import body_with_fingers, hand_frames, has_hand
from ..bodies.joint_names import ancestors
from ..bodies.sampling import rotvec_to_rotmat
from ..bodies.skinned_character import SkinnedCharacter
from ..core.geometry import angles_between, frames_along, nearest_rotation, rotation_between, unit_vectors
from .rest_calibration import HINGES, hinge_rotations, nearest_axes, paired_axes
from .retarget import limb_alignments

TRUNK = ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Head")
"""Joints of the trunk, from the hips up."""
LEAN, TWIST, THIGH, KNEE, ELBOW = 12.0, 12.0, 40.0, 35.0, 60.0
"""Largest angles (degrees) in a T- or A-pose: trunk from the vertical, shoulders from hips, thighs to front or back,
bend of knees and elbows. Of 225 humanoids of the pool and 50 files up to 8, 5, 39, 23 and 25."""
LYING = 0.9
"""Sine of the angle (64 degrees) by which the front of the hips points up or down when a person lies."""
PARALLEL, ALONG = 40.0, 30.0
"""Largest angle (degrees) between arms and legs on all fours, and smallest one of both from the line of the trunk."""
NEAR = 30.0
"""Largest angle (degrees) of an estimate from the axes of a joint's frame; beyond it they say nothing."""
ANKLE, BENT = 70, 0.2
"""Largest bend of an ankle (degrees), and by which share of its height a foot counts as higher for each radian."""
SOLE_PITCH = 40.0
"""Largest angle (degrees) of a flat sole from where the foot is lowest."""
UP = np.array([0.0, 1.0, 0.0])

Positions = Mapping[str, Float[np.ndarray, " 3"]]
"""Joint of the shipped body, or a finger's -> its position, y up."""
Hinge = tuple[str, str, str, tuple[float, float, float]]
"""One of HINGES."""
Frames = dict[str, Float[np.ndarray, "3 3"]]
"""Rotations of such joints."""


def rests_in_action(joints: Positions) -> bool:
    """Tell whether a rest pose is neither a T- nor an A-pose."""
    hips, shoulders = _pair(joints, "UpLeg"), _pair(joints, "Arm")
    left, across = (unit_vectors(pair[0] - pair[1]) for pair in (hips, shoulders))
    if _angle(_trunk(joints), UP) > LEAN or _angle(left, across) > TWIST:
        return True
    for (*limb, _), most in zip(HINGES, (KNEE, ELBOW), strict=True):
        for side in SIDES:
            bones = np.diff([joints[side + name] for name in limb if side + name in joints], axis=0)
            if len(bones) == 2 and _angle(*bones) > most:
                return True
            thigh = bones[0] - (bones[0] @ left) * left if limb[0] == "UpLeg" and len(bones) else -UP
            if _angle(thigh, -UP) > THIGH:
                return True
    return False


def on_all_fours(joints: Positions) -> bool:
    """Tell whether arms and legs are about parallel and across the trunk, as those of animals at rest."""
    limbs = []
    for first, *names, _ in HINGES:
        last = next(name for name in (*names[::-1], first) if any(side + name in joints for side in SIDES))
        ends = [(side + first, side + last) for side in SIDES if side + last in joints]
        limbs.append(np.sum([joints[end] - joints[start] for start, end in ends], axis=0))
    if not all(np.any(limb) for limb in limbs):  # limbs of one joint have no direction, and are an animal's rather
        return True
    return _angle(*limbs) < PARALLEL and all(ALONG < _angle(limb, _trunk(joints)) < 180 - ALONG for limb in limbs)


def action_front(joints: Positions) -> Float[np.ndarray, " 2"]:
    """Compute the horizontal direction (x, z) to the front of the hips; of who lies, from feet to head or its opposite.

    Who lies on the back, with the head to the back, faces the front when set up, and so who lies on the belly, with the
    head to the front.
    """
    frame = frames_along(np.subtract(*_pair(joints, "UpLeg")), _trunk(joints))
    front = frame[:, 2] if abs(frame[1, 2]) < LYING else -np.sign(frame[1, 2]) * frame[:, 1]
    return front[[0, 2]]


def action_frames(character: SkinnedCharacter, joints: Mapping[str, int], limbs: Mapping[str, Limb]) -> Frames:
    """Compute the rotation of each named joint from the shipped body's T-pose to a rest pose in action.

    Args:
        character: y up, with the frames of its file at its joints.
        joints: joint of the body, or a finger's -> index of the character's joint.
    """
    body, positions = body_with_fingers(), {name: character.joints[j] for name, j in joints.items()}
    axes = {name: nearest_rotation(character.T_world_joint[j, :3, :3]) for name, j in joints.items()}
    # Frames tell if they are near those of a T-pose at hips and thighs, whose estimates are good.
    hips = _trunk_frames(positions, {})["Hips"]
    found = {"Hips": hips} | {f"{side}UpLeg": _estimates(limbs, side, HINGES[0], hips)[0][0] for side in SIDES}
    if any(angles_between(near, _by_axes(near, axes[name])) >= NEAR for name, near in found.items()):
        axes = {}
    frames = _trunk_frames(positions, axes)
    legs, arms = HINGES
    frames |= _limb_frames(limbs, axes, legs, frames["Hips"]) | _limb_frames(limbs, axes, arms, frames[_chest(joints)])
    for side in SIDES:
        foot, hand = f"{side}Foot", f"{side}Hand"
        if foot in frames and foot in joints:
            points = character.mesh.vertices[carried_vertices(character, joints[foot])]
            frames |= dict.fromkeys((foot, f"{side}ToeBase"), _foot_frame(points, frames[foot]))
        if has_hand(joints, side):
            above = (hand, f"{side}ForeArm", f"{side}Arm", _chest(joints))
            frames |= hand_frames(positions, frames[next(name for name in above if name in frames)], side)
    above = {name: [body.joint_names[j] for j in ancestors(body.parents, body.joint(name))] for name in joints}
    return frames | {name: frames[next(known for known in above[name] if known in frames)] for name in joints}


def _trunk_frames(joints: Positions, axes: Frames) -> Frames:
    """Compute the rotations of the joints of the trunk, from the hips up.

    Hips and chest are estimated by thighs and shoulders, others by the smallest rotation from the joint below.
    """
    chain = [name for name in TRUNK if name in joints]
    frames: Frames = {}
    below = np.eye(3)
    for name, above in zip(chain, [*chain[1:], None], strict=True):
        part = {"Hips": "UpLeg", _chest(joints): "Arm"}.get(name)
        start = _pair(joints, "UpLeg").mean(axis=0) if name == "Hips" else joints[name]
        bone = below[:, 1] if above is None else joints[above] - start  # nothing tells the direction of a head
        estimate = rotation_between(below[:, 1], bone) @ below
        if part is not None:
            estimate = frames_along(np.subtract(*_pair(joints, part)), bone)
        below = frames[name] = _by_axes(estimate, axes.get(name))
    return frames


def _limb_frames(limbs: Mapping[str, Limb], axes: Frames, hinge: Hinge, trunk: Float[np.ndarray, "3 3"]) -> Frames:
    """Compute the rotations of the joints of both arms or legs, whose bones keep their directions, of hands and feet.

    All estimates together choose the axes of their frames (`paired_axes`).
    """
    names = hinge[:2]
    estimates = {side: _estimates(limbs, side, hinge, trunk) for side in SIDES}
    kept = {side: [name for name in names if side + name in limbs] for side in SIDES}
    chosen: dict[str, np.ndarray] = {}
    if axes:
        totals = [
            np.sum(
                [
                    axes[side + name].T @ each
                    for name, of in zip(kept[side], estimates[side], strict=True)
                    for each in of
                ],
                axis=0,
            )
            for side in SIDES
        ]
        chosen = dict(zip(SIDES, paired_axes(totals), strict=True))
    frames: Frames = {}
    for side in SIDES:
        for name, found in zip(kept[side], estimates[side], strict=True):
            joint, limb = side + name, limbs[side + name]
            turned = axes[joint] @ chosen[side] if axes else found[0]
            aligned = limb_alignments({joint: (limb.end - limb.start) @ turned}, body_with_fingers())
            frames |= {of: turned @ each for of, each in aligned.items()}
            hand = f"{side}Hand"
            if hand in aligned and hand in axes:
                frames[hand] = axes[hand] @ chosen[side] @ aligned[hand]
    return frames


def _estimates(
    limbs: Mapping[str, Limb], side: str, hinge: Hinge, trunk: Float[np.ndarray, "3 3"]
) -> list[list[Float[np.ndarray, "3 3"]]]:
    """Estimate the rotations of the joints of a limb: by its hinge, that of the first also by the trunk's alone."""
    body, (*names, direction) = body_with_fingers(), hinge
    chain = [side + name for name in names]
    upper, lower = limbs[chain[0]], limbs.get(chain[1])
    bone = body.joints[body.joint(chain[1])] - body.joints[body.joint(chain[0])]
    straight = rotation_between(trunk @ bone, upper.end - upper.start) @ trunk
    if lower is None:
        return [[straight]]
    places = np.stack([upper.start, upper.end, upper.end + lower.end - lower.start])[None]
    index, at_rest = {name: k for k, name in enumerate(chain)}, {name: body.joint(name) for name in chain}
    bent = hinge_rotations(places, index, body.joints[None], at_rest, chain, direction, trunk[None])
    return [[bent[chain[0]][0][0], straight], [bent[chain[1]][0][0]]]


def _foot_frame(points: Float[np.ndarray, "V 3"], shin: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Compute the rotation of a foot from its surface and as it goes with its shin: about the left axis to a flat sole.

    A foot is longer than high, so it is flat where it is lowest; then its heel and its ball are at one height. In 50
    rigs in T- and A-poses that is up to 3 degrees off.
    """
    if len(points) == 0:
        return shin
    pitches, left = np.radians(np.arange(-ANKLE, ANKLE + 1)), np.array([1.0, 0.0, 0.0])  # toes go down
    heights = np.einsum("vk,pk->pv", points @ shin, rotvec_to_rotmat(pitches[:, None] * left)[..., 1])
    turned = shin @ rotvec_to_rotmat(left * pitches[(np.ptp(heights, axis=1) * (1 + BENT * np.abs(pitches))).argmin()])
    height, length = (points @ turned)[:, 1:].T
    front = length > (length.min() + length.max()) / 2
    heel, ball = (int(np.where(half, height, np.inf).argmin()) for half in (~front, front))
    sole = np.arctan2(height[ball] - height[heel], length[ball] - length[heel])
    return turned @ rotvec_to_rotmat(-sole * left) if abs(np.degrees(sole)) < SOLE_PITCH else turned


def _by_axes(estimate: Float[np.ndarray, "3 3"], axes: Float[np.ndarray, "3 3"] | None) -> Float[np.ndarray, "3 3"]:
    """Return the rotation of a frame from the axis rotation nearest to an estimate; without a frame the estimate."""
    if axes is None:
        return estimate
    return axes @ nearest_axes(axes.T @ estimate)


def _chest(joints: Mapping[str, object]) -> str:
    return next(name for name in reversed(TRUNK[:4]) if name in joints)


def _trunk(joints: Positions) -> Float[np.ndarray, " 3"]:
    return _pair(joints, "Arm").mean(axis=0) - _pair(joints, "UpLeg").mean(axis=0)


def _pair(joints: Positions, part: str) -> Float[np.ndarray, "2 3"]:
    return np.stack([joints[side + part] for side in SIDES])


def _angle(first: Float[np.ndarray, " 3"], second: Float[np.ndarray, " 3"]) -> float:
    return float(np.degrees(np.arccos(np.clip(unit_vectors(first) @ unit_vectors(second), -1, 1))))
