"""Retarget the motion of another skeleton to a body; joints are matched by name (`bodies.joint_names`).

The world rotation of joint j of the body is D_j = C G_j M_j: G_j is the source's world rotation, C the change of the
world's axes, and M_j the constant rotation between the rest poses; the local rotation is D_parent^T D_j. If the source
stands at rest, M_j = C^T A_j with the smallest rotation A_j from the body's bone to the source's bone at rest (limbs
only). Otherwise M_j is measured from the motion (`rest_calibration`). In both cases limb bones of the result have
exactly the directions of the source's, whatever the rest poses are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..bodies.hands import hand_frames
from ..bodies.joint_names import captured_fingers, finger_joints, followed_fingers, named_joints, require_joints
from ..core.errors import InputError, damaged
from ..core.geometry import rotation_between, unit_vectors
from ..core.mesh import LARGEST
from ..core.normalization import turn
from ..core.rig import local_rotations
from ..core.soles import floor_height
from .bvh import Bvh
from .motion import BONES, LEG, Motion, leg_length, lowest
from .rest_calibration import axes_from_motion, calibrated_joints, middle, nearest_axis

NEEDED = ("Hips", *BONES, *BONES.values())
"""Joints that a source must have."""
STANDING = 0.7
"""Cosine of the largest angle (45 degrees) between legs and trunk of a rest pose that stands."""
FLOOR_QUANTILE = 0.2
"""The floor is this quantile, over frames, of the lowest vertex's height: most takes are on it for longer."""
FLOOR_FRAMES = 400
"""Frames, evenly spread, that are used to find the floor."""
OBLIQUE = np.radians(1.5)
"""Angle between a rest pose and the nearest axis from which on it has a heading of its own. Left and right are not
quite symmetric: in files of two takes and 20 characters by up to 0.5 degrees, where joints were found by 1.2."""
SAME_FLOOR = 0.1
"""Leg lengths between this height and the soles of the rest pose up to which both are one floor."""


def retarget_skeleton(
    source: Bvh,
    body: RiggedBody,
    name: str | None = None,
    grounded: bool = True,
    hands: bool = False,
    stands_at_rest: bool = False,
) -> Motion:
    """Retarget a motion to `body` (mean shape), at the source's frame rate; errors name `name`.

    The root's path is scaled by the ratio of leg lengths and starts above the origin. The floor is estimated from the
    result (FLOOR_QUANTILE). Joints that the source lacks are not rotated; fingers go with those beside them. Contacts
    are not enforced.

    Args:
        grounded: find the floor, which poses every vertex; without, only the rotations of the result are meant.
        hands: rotate hands and fingers as those of the source are at rest (`bodies.hands.hand_frames`); without, hands
            rest as the body's, relaxed, and fingers follow them.
        stands_at_rest: where the take is not on the floor of the rest pose (it jumps, or sits), that is the floor.

    Raises:
        InputError: the hips or a limb joint are not found by name, a limb bone has no length at rest, or numbers are
            not finite.
    """
    index = named_joints(source.joint_names, source.parents)
    require_joints(index, NEEDED, source.joint_names, name or source.name)
    rest, (rotation, position) = source.rest(), source.world()
    if not all(np.abs(values).max() <= LARGEST for values in (rest, rotation, position)):
        expected = f"positions and rotations of joints that are finite and up to {LARGEST:g}"
        raise damaged(name or source.name, expected, "others")
    zero_length = [joint for joint, tail in BONES.items() if not (rest[index[tail]] - rest[index[joint]]).any()]
    if zero_length:
        raise InputError(
            f"{name or source.name}: expected limbs with a length at rest, found none for {', '.join(zero_length)}; "
            "export the skeleton with its bones"
        )
    if standing := rests_standing(rest, index):
        axes = axes_from_rest(rest, index)
        placed = rest @ axes.T
        bones = {joint: placed[index[tail]] - placed[index[joint]] for joint, tail in BONES.items()}
        aligned = limb_alignments(bones, body)
        rest_rotation = {joint: axes.T @ aligned.get(joint, np.eye(3)) for joint in index}
    else:
        axes = axes_from_motion(position, index)
        rest_rotation = calibrated_joints(axes @ rotation, position @ axes.T, rest, index, body)
    if hands:
        index |= captured_fingers(source.joint_names, source.parents, index)
        # Frames of the source are parallel at rest, so fingers are placed in the frame of the hand.
        found = {}
        for hand in ("LeftHand", "RightHand"):
            side = hand.removesuffix("Hand")
            joints = [name for name in (hand, *finger_joints(side)) if name in index]
            placed = {name: rest_rotation[hand].T @ (rest[index[name]] - rest[index[hand]]) for name in joints}
            frames = hand_frames(placed, np.eye(3), side)
            found |= {name: rest_rotation[hand] @ frames[name] for name in joints}
        rest_rotation |= found
    target = np.empty((len(rotation), len(body.joint_names), 3, 3))
    for j, (joint, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
        known = next((n for n in (joint, *followed_fingers(joint)) if n in index), None)
        target[:, j] = axes @ rotation[:, index[known]] @ rest_rotation[known] if known else target[:, parent]
    # The path is in units of the leg, so steps fit the body's legs.
    source_leg = [rest[index[joint]] for joint in LEG]
    scale = leg_length(body.joints, body.joint_names) / leg_length(np.array(source_leg), LEG)
    path = position[:, index["Hips"]] @ axes.T * scale
    if grounded:
        at_rest = None
        # Hips that never move say nothing about the floor.
        if stands_at_rest and standing and np.ptp(path, axis=0).max() > 0:
            hips = (source.offsets[0] + rest[index["Hips"]]) @ axes.T * scale
            turned = np.empty((1, *target.shape[1:]))  # joints that the source lacks go with their parents
            for j, (joint, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
                turned[:, j] = axes @ rest_rotation[joint] if joint in index else turned[:, parent]
            at_rest = float(lowest(body, local_rotations(turned, body.parents), hips[None])[0])
        path = on_floor(path, target, body, at_rest)
    return Motion(name or source.name, body.joint_names, local_rotations(target, body.parents), path, source.fps)


def righted(source: Bvh) -> Bvh:
    """Turn a skeleton that stands at rest and upside down in its frames upright, about its left axis, with a note.

    Poses that are found in images are often left in the axes of a camera: x right, y down, z ahead. In a handstand or
    headstand, hands are beyond the shoulders, away from the feet; who stands has them on the side of the feet.
    """
    index = named_joints(source.joint_names, source.parents)
    if not all(joint in index for joint in NEEDED) or not rests_standing(source.rest(), index):
        return source
    axes = axes_from_rest(source.rest(), index)
    position = source.world()[1] @ axes.T
    shoulders, feet, hands = (middle(position, index, part) for part in ("Arm", "Foot", "Hand"))
    above = unit_vectors(shoulders - feet)
    if np.median(above[:, 1]) > -STANDING or np.median(((hands - shoulders) * above).sum(axis=-1)) > 0:
        return source
    upright = axes.T @ np.diag([1.0, -1.0, -1.0]) @ axes
    rotmat = source.rotmat.copy()
    rotmat[:, 0] = upright @ rotmat[:, 0]
    note = f"{source.name} stands upside down, as in the axes of a camera: it is turned upright"
    return replace(source, rotmat=rotmat, root=source.root @ upright.T, notes=(*source.notes, note))


def rests_standing(rest: Float[np.ndarray, "J 3"], index: dict[str, int]) -> bool:
    """Tell whether a rest pose stands: legs point away from the shoulders, and left and right are beside the trunk.

    In some files (LAFAN1's for example) all limbs are parallel to one axis at rest; then only the motion defines what
    is up and front.
    """
    hips, feet, arms = (_pair(rest, index, part).mean(axis=0) for part in ("UpLeg", "Foot", "Arm"))
    up = unit_vectors(hips - feet)
    upright = up @ unit_vectors(arms - hips) > STANDING
    # Hips and shoulders must be roughly perpendicular to up, and on the same sides.
    across = [np.subtract(*_pair(rest, index, part)) for part in ("UpLeg", "Arm")]
    return bool(
        upright and all(abs(up @ unit_vectors(side)) < STANDING for side in across) and across[0] @ across[1] > 0
    )


def axes_from_rest(rest: Float[np.ndarray, "J 3"], index: dict[str, int]) -> Float[np.ndarray, "3 3"]:
    """Compute the rotation C from the source's axes to x left, y up, z front, from its rest pose.

    An axis rotation, unless the rest pose stands between the axes (`rest_heading`).
    """
    hips = rest[[index["LeftUpLeg"], index["RightUpLeg"]]]
    # Up is the axis from the feet to the hips; left is the axis from right to left hip, perpendicular to up.
    up = nearest_axis(hips.mean(axis=0) - (rest[index["LeftFoot"]] + rest[index["RightFoot"]]) / 2)
    left = nearest_axis((hips[0] - hips[1]) * (up == 0))
    axes = np.stack([left, up, np.cross(left, up)])
    return turn(-rest_heading(rest @ axes.T, index)) @ axes


def rest_heading(rest: Float[np.ndarray, "J 3"], index: Mapping[str, int]) -> float:
    """Compute the angle (radians, from z towards x) at which a rest pose faces by hips and shoulders; 0 below OBLIQUE.

    Args:
        rest: y up, facing +z more than any other axis.
    """
    pairs = [[rest[index[f"{side}{part}"]] for side in ("Left", "Right")] for part in ("UpLeg", "Arm")]
    across = np.sum([unit_vectors((left - right) * [1.0, 0.0, 1.0]) for left, right in pairs], axis=0)
    angle = float(np.arctan2(-across[2], across[0]))
    return angle if abs(angle) > OBLIQUE else 0.0


def limb_alignments(
    bones: Mapping[str, Float[np.ndarray, " 3"]], body: RiggedBody, tails: Mapping[str, str] = BONES
) -> dict[str, Float[np.ndarray, "3 3"]]:
    """Compute the rotation A_j of the joint of each bone, of hands (that of the forearm) and of feet.

    A foot gets only the part of its shin's rotation in the frontal plane: capture skeletons spread their legs at rest
    with soles perpendicular to the shin in that plane, while the pitch of ankle and toes is that of a flat sole, as in
    the body's rest pose.

    Args:
        bones: vectors of limb bones at rest, of a person who faces +z.
        tails: joint of the body at the other end of each.
    """
    aligned = {}
    for joint, bone in bones.items():
        tail = tails[joint]
        body_bone = body.joints[body.joint(tail)] - body.joints[body.joint(joint)]
        aligned[joint] = rotation_between(body_bone, bone)
        if tail.endswith("Hand"):
            aligned[tail] = aligned[joint]
        if tail.endswith("Foot"):
            frontal = np.array([1.0, 1.0, 0.0])
            toes = tail.replace("Foot", "ToeBase")
            aligned[tail] = aligned[toes] = rotation_between(body_bone * frontal, bone * frontal)
    return aligned


def on_floor(
    path: Float[np.ndarray, "T 3"], target: Float[np.ndarray, "T J 3 3"], body: RiggedBody, at_rest: float | None = None
) -> Float[np.ndarray, "T 3"]:
    """Shift the path of a root to start at x = z = 0, with the floor at y = 0.

    Args:
        target: world rotations of the joints.
        at_rest: height of the soles of the rest pose, along this path; None: not known.
    """
    path = path - path[0] * [1.0, 0.0, 1.0]
    step = slice(None, None, max(len(path) // FLOOR_FRAMES, 1))
    floor = np.quantile(lowest(body, local_rotations(target[step], body.parents), path[step]), FLOOR_QUANTILE)
    leg = leg_length(body.joints, body.joint_names)
    # Rest poses of captures stand some centimetres beside their floor: they only tell the air from the ground.
    if at_rest is not None and abs(floor - at_rest) > SAME_FLOOR * leg:
        floor = floor_height(at_rest, float(floor), leg)
    return path - [0.0, floor, 0.0]


def _pair(rest, index, part):
    return rest[[index[f"Left{part}"], index[f"Right{part}"]]]
