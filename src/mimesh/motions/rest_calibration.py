"""Calibrate the joints of a skeleton whose rest pose is not a standing pose, from the joint positions in its motion.

`retarget` needs the constant rotation M_j between a body joint and the source joint: D_j(t) = G_j(t) M_j, with the
source's world rotation G_j and the body's D_j. In every frame, joint positions give an estimate of D_j(t); M_j is the
rotation nearest to the weighted sum of G_j(t)^T D_j(t) over the frames (`geometry.nearest_rotation`).

Estimates: knees and elbows are hinges, so their bending defines the roll of thigh and shin, of upper arm and forearm,
with little weight while they are straight. Hips and shoulders define where the trunk faces. Hands have the rotation of
the forearm, and a head is level and faces forward on average.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..core.geometry import nearest_rotation, rotate_between, unit_vectors

FRAMES = 400
"""Frames, evenly spread, that are used at most (up to twice as many)."""
STRAIGHT_WEIGHT = 0.01
"""Weight of the roll of a straight limb (smallest rotation from the T-pose); a hinge bent by 90 degrees weighs 1."""
HINGES = (("UpLeg", "Leg", "Foot", (0.0, 0.0, -1.0)), ("Arm", "ForeArm", "Hand", (0.0, 0.5, 0.866)))
"""Joints of a hinge's two bones, the end of the second bone, and its direction of bending from the T-pose.

Palms of the body's T-pose face down, so elbows bend to the front and up: 30 degrees, as in the shipped takes.
"""
LEAN = (0.0, 0.97, 0.22)
"""Direction from hips to shoulders of an upright person in the frame of the hips (mean of the shipped takes)."""
UPRIGHT_POWER = 16
"""Power of the cosine between trunk and legs that weights a frame for the hips: a bent trunk says little about them."""


def axes_from_motion(position: Float[np.ndarray, "T J 3"], index: dict[str, int]) -> Float[np.ndarray, "3 3"]:
    """Compute the axis rotation of a motion's world to y up: on average, shoulders are above feet.

    The heading is not changed but for axis rotations.
    """
    above = _middle(position, index, "Arm") - _middle(position, index, "Foot")
    mean = unit_vectors(above).mean(axis=0)
    up = np.zeros(3)
    largest = int(np.abs(mean).argmax())
    up[largest] = np.sign(mean[largest])
    return np.round(rotation_between(up, np.array([0.0, 1.0, 0.0])))


def calibrated_joints(
    rotation: Float[np.ndarray, "T J 3 3"],
    position: Float[np.ndarray, "T J 3"],
    rest: Float[np.ndarray, "J 3"],
    index: dict[str, int],
    body: RiggedBody,
) -> dict[str, Float[np.ndarray, "3 3"]]:
    """Measure M_j of each body joint in `index` from world rotations and positions with y up.

    `rest` are the source's joint positions at rest, in the frames of its joints; limb bones match them exactly.
    """
    step = slice(None, None, max(len(position) // FRAMES, 1))
    rotation, position = rotation[step], position[step]
    body_rest = body.joints[None]
    body_index = {joint: body.joint(joint) for joint in index}
    estimates = _trunk_rotations(position, index, body_rest, body_index)
    for side in ("Left", "Right"):
        for upper, lower, end, direction in HINGES:
            trunk = estimates["Hips" if upper == "UpLeg" else "Spine1"][0]
            chain = (f"{side}{upper}", f"{side}{lower}", f"{side}{end}")
            estimates |= _hinge_rotations(position, index, body_rest, body_index, chain, direction, trunk)
        estimates[f"{side}Hand"] = estimates[f"{side}ForeArm"]
        estimates |= _foot_rotations(position, index, body_rest, body_index, side, estimates[f"{side}Leg"])
    measured = {}
    for joint, j in index.items():
        estimate, weight = estimates.get(joint, estimates["Spine1"])
        total = (weight[:, None, None] * np.swapaxes(rotation[:, j], -1, -2) @ estimate).sum(0)
        measured[joint] = nearest_rotation(total)
    return {joint: _with_exact_bone(joint, m, rest, index, body_rest[0], body_index) for joint, m in measured.items()}


def rotation_between(old: Float[np.ndarray, " 3"], new: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Compute the matrix of the smallest rotation from direction `old` to direction `new`."""
    return rotations_between(old, new[None])[0]


def rotations_between(old: Float[np.ndarray, " 3"], new: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3 3"]:
    """Compute the matrices of the smallest rotations from direction `old` to each of the directions `new`."""
    olds, news = np.tile(old / np.linalg.norm(old), (3 * len(new), 1)), np.repeat(unit_vectors(new), 3, axis=0)
    # The rotated unit vectors are the columns of the matrices.
    columns = rotate_between(olds, news, np.tile(np.eye(3), (len(new), 1)))
    return np.swapaxes(columns.reshape(-1, 3, 3), -1, -2)


def _middle(position, index, part):
    """Compute the midpoint of the left and right joint of a part."""
    return (position[:, index[f"Left{part}"]] + position[:, index[f"Right{part}"]]) / 2


def _frames(first, second):
    """Build frames (T, 3, 3) with the first column along a vector and the second in the plane of both vectors."""
    x = unit_vectors(first)
    y = unit_vectors(second - (second * x).sum(axis=-1, keepdims=True) * x)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _rotations(body_vectors, source_vectors):
    """Compute the rotations from the frame of two vectors of the body at rest to that of two vectors of the source."""
    return _frames(*source_vectors) @ np.swapaxes(_frames(*body_vectors), -1, -2)


def _trunk_rotations(position, index, body_rest, body_index):
    """Estimate rotation and weight of hips, chest and head in each frame; other joints get those of the chest."""

    def left_to_right(points, joints, part):
        return np.subtract(*(points[:, joints[f"{side}{part}"]] for side in ("Left", "Right")))

    def trunk_of(points, joints):
        return _middle(points, joints, "Arm") - _middle(points, joints, "UpLeg")

    trunk = trunk_of(position, index)
    legs = _middle(position, index, "UpLeg") - _middle(position, index, "Foot")
    cosine = (unit_vectors(trunk) * unit_vectors(legs)).sum(axis=-1)
    upright, always = np.maximum(cosine, STRAIGHT_WEIGHT) ** UPRIGHT_POWER, np.ones(len(position))
    up = np.array([[0.0, 1.0, 0.0]])
    body_hips, hips = left_to_right(body_rest, body_index, "UpLeg"), left_to_right(position, index, "UpLeg")
    body_arms, arms = left_to_right(body_rest, body_index, "Arm"), left_to_right(position, index, "Arm")
    return {
        "Hips": (_rotations((body_hips, np.array([LEAN])), (hips, trunk)), upright),
        "Spine1": (_rotations((body_arms, trunk_of(body_rest, body_index)), (arms, trunk)), always),
        "Head": (_rotations((up, body_arms), (np.tile(up, (len(position), 1)), arms)), upright),
    }


def _hinge_rotations(position, index, body_rest, body_index, chain, direction, trunk):
    """Estimate rotation and weight of the two bones at a knee or an elbow in each frame.

    While the hinge is bent, a bone and the other bone define the rotation. The smallest rotation from the trunk's
    pose, with a small weight, defines the roll of straight limbs.
    """
    top, hinge, end = chain

    def two_bones(points, joints):
        return points[:, joints[hinge]] - points[:, joints[top]], points[:, joints[end]] - points[:, joints[hinge]]

    (body_upper, body_lower), (upper, lower) = two_bones(body_rest, body_index), two_bones(position, index)
    # Squared sine of the angle between the bones.
    bend = np.square(np.linalg.norm(np.cross(unit_vectors(upper), unit_vectors(lower)), axis=-1))
    front = np.array([direction])
    estimates = {}
    # At rest the body's bones are in line, so the direction of bending stands for the other bone.
    for joint, bone, body_bone, other, body_other in (
        (top, upper, body_upper, lower, front),
        (hinge, lower, body_lower, upper, -front),
    ):
        bent = _rotations((body_bone, body_other), (bone, other))
        straight = trunk @ rotations_between(body_bone[0], (np.swapaxes(trunk, -1, -2) @ bone[..., None])[..., 0])
        # Combined in every frame, so that the weight belongs to one rotation.
        combined = nearest_rotation(bend[:, None, None] * bent + STRAIGHT_WEIGHT * straight)
        estimates[joint] = (combined, bend + STRAIGHT_WEIGHT)
    return estimates


def _foot_rotations(position, index, body_rest, body_index, side, shin):
    """Estimate rotation and weight of foot and toes from the foot's bone and the shin; without toes as the shin."""
    foot, toes, knee = f"{side}Foot", f"{side}ToeBase", f"{side}Leg"
    if toes not in index:
        return {foot: shin}
    pairs = [
        (points[:, joints[toes]] - points[:, joints[foot]], points[:, joints[knee]] - points[:, joints[foot]])
        for points, joints in ((body_rest, body_index), (position, index))
    ]
    estimate = (_rotations(*pairs), np.ones(len(position)))
    return {foot: estimate, toes: estimate}


def _with_exact_bone(joint, measured, rest, index, body_rest, body_index):
    """Correct M_j by the smallest rotation that makes the body's limb bone parallel to the source's at rest."""
    # Joint at the other end of each limb bone.
    tails = {f"{s}{a}": f"{s}{b}" for s in ("Left", "Right") for h in HINGES for a, b in (h[:2], h[1:3])}
    if joint not in tails:
        return measured
    bone = body_rest[body_index[tails[joint]]] - body_rest[body_index[joint]]
    return rotation_between(measured @ bone, rest[index[tails[joint]]] - rest[index[joint]]) @ measured
