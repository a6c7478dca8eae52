"""Measure how the joints of a skeleton are turned at rest, from a motion whose rest pose does not define it.

This gives M_j of `motions.retarget`, the constant rotation between the rest poses. Joint positions give an estimate of
D_j(t) in every frame, with y up; M_j is the rotation nearest to the weighted sum of G_j(t)^T D_j(t) over the frames
(`geometry.nearest_rotation`). Knees and elbows are hinges: their bending defines the roll of thigh and shin, of upper
arm and forearm, with little weight while they are straight. Hips and shoulders define where the trunk faces. Hands have
the rotation of the forearm, and hips and head are level while a person stands upright, as feet are while they are flat
on the ground.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..bodies.joint_names import ancestors
from ..core.geometry import (
    angles_between,
    frames_along,
    nearest_rotation,
    rotation_between,
    rotations_between,
    unit_vectors,
)
from ..core.normalization import ROTATIONS, turn
from .motion import BONES, LEG, leg_length

ON_FLOOR = 0.2
"""Leg lengths from y = 0, the floor of most captures, up to which the lowest joint is on it."""
FRAMES = 400
"""Frames, evenly spread, that are used at most (up to twice as many)."""
STRAIGHT_WEIGHT = 0.01
"""Weight of the roll of a straight limb (smallest rotation from the T-pose); a hinge bent by 90 degrees weighs 1."""
HINGES = (("UpLeg", "Leg", "Foot", (0.0, 0.0, -1.0)), ("Arm", "ForeArm", "Hand", (0.0, 0.5, 0.866)))
"""Joints of a hinge's two bones, the end of the second bone, and its direction of bending from the T-pose.

Palms of the body's T-pose face down, so elbows bend to the front and up: 30 degrees, as in the shipped takes.
"""
UPRIGHT_POWER = 16
"""Power of the smallest cosine between trunk, legs and the vertical that weights a frame for hips and head: both are
level in a person who stands upright, as in a T-pose."""
LOWEST = 0.02
"""Quantile of heights over the frames that counts as the lowest one."""
FLAT, BENT_WEIGHT = 0.03, 1e-4
"""Height above their lowest one, in lengths of the shin, at which ankle or toes weigh 1 / e in the rotation of a foot;
and the weight of the angle between foot and shin in all frames. Chosen on the shipped takes and animations by hand."""
ALONG_AXES = 20.0, 8.0
"""Largest angles (degrees) of the left of hips, and of thighs and shins in the mean, from where frames have the axes of
a T-pose. In clips of KayKit's and Mixamo's, written as sticks, up to 17 and 6; thighs and shins that are turned about
their bones at random are below it in one of a hundred skeletons."""
SAME_AXES = 60.0
"""Angle (degrees) up to which trunk and head are turned in the mean of a clip while their frames have the same axes."""
OBLIQUE_FRAME = 30.0
"""Angle (degrees) from the axes from which on a frame is oblique, as those of hip joints and collar bones may be."""


def axes_from_motion(position: Float[np.ndarray, "T J 3"], index: dict[str, int]) -> Float[np.ndarray, "3 3"]:
    """Compute the axis rotation of a motion's world to y up: on average, shoulders are above feet.

    Who lies or crawls in all frames has them beside the feet: all joints are less than a leg over y = 0 then, and along
    the axis from feet to shoulders the person stands on no floor. The heading is not changed but for axis rotations.
    """
    above = middle(position, index, "Arm") - middle(position, index, "Foot")
    up = nearest_axis(unit_vectors(above).mean(axis=0))
    points = position[:, list(index.values())]
    leg = leg_length(position[0, [index[joint] for joint in LEG]], LEG)
    heights, along = points[..., 1], points @ up
    if heights.min() > -ON_FLOOR * leg and heights.max() < leg and abs(along.min()) > ON_FLOOR * leg:
        up = np.array([0.0, 1.0, 0.0])
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
            estimates |= hinge_rotations(position, index, body_rest, body_index, chain, direction, trunk)
        estimates |= _foot_rotations(position, index, body_rest, body_index, side, estimates[f"{side}Leg"])
    measured = {
        joint: nearest_rotation((weight[:, None, None] * _back(rotation[:, index[joint]], estimate)).sum(0))
        for joint, (estimate, weight) in estimates.items()
        if joint in index
    }

    def exact(found):
        """Turn limbs by the smallest rotation that makes the body's bone parallel to the source's at rest."""
        turned = dict(found)
        for joint in BONES.keys() & found.keys():
            tail, m = BONES[joint], found[joint]
            bone = body.joints[body_index[tail]] - body.joints[body_index[joint]]
            turned[joint] = rotation_between(m @ bone, rest[index[tail]] - rest[index[joint]]) @ m
        return turned

    # The axis rotations that those of hips and limbs are nearest to.
    arms = [[f"{side}Arm", f"{side}ForeArm"] for side in ("Left", "Right")]
    both = paired_axes([np.sum([measured[joint] for joint in joints], axis=0) for joints in arms])
    axes = {joint: nearest_axes(measured[joint]) for joint in ("Hips", *BONES) if "Arm" not in joint}
    axes |= {joint: of_side for of_side, joints in zip(both, arms, strict=True) for joint in joints}
    found, of_axes = exact(measured), exact(axes)
    hips = np.subtract(*(position[:, index[f"{side}UpLeg"]] for side in ("Left", "Right")))
    left = unit_vectors(_back(rotation[:, index["Hips"]], hips[..., None]).sum(0)[:, 0])
    # Hips, thighs and shins are turned nearly as where frames have the axes of a T-pose. Of hips their left axis tells:
    # how far they lean is not measured well where a person never stands upright.
    lean = np.degrees(np.arccos(np.clip(left @ of_axes["Hips"][:, 0], -1, 1)))
    legs = [angles_between(found[joint], of_axes[joint]) for joint in BONES if "Leg" in joint]
    axial = lean < ALONG_AXES[0] and np.mean(legs) < ALONG_AXES[1]
    if axial:
        found = of_axes | {n: _without_yaw(m) for n, m in found.items() if n.endswith(("Foot", "ToeBase"))}
    # All others are turned like one of these, in the mean.
    for joint in sorted(index.keys() - found.keys(), key=body.joint):
        above = [body.joint_names[k] for k in ancestors(body.parents, body.joint(joint))]
        if joint in ("LowerBack", "Spine"):  # the chest is estimated better than the hips
            above = ["Spine1", *above]
        near = next(name for name in above if name in found)
        turn = _back(rotation[:, index[joint]], rotation[:, index[near]]).sum(0)
        found[joint] = (_turn_of_axes if axial else nearest_rotation)(turn) @ found[near]
    return found


def _back(rotation, turned):
    """Express rotations, or columns of vectors, in the frames of a joint."""
    return np.swapaxes(rotation, -1, -2) @ turned


def _without_yaw(measured):
    """Turn a measured rotation about the body's vertical until its left is nearest to an axis of the joint's frame.

    Motion shows where soles are level, but not how far toes point outwards at rest. In a T-pose feet are parallel, and
    a frame is along the world's axes or along the foot.
    """
    x, _, z = measured.T @ nearest_axis(measured[:, 0])
    angle = np.arctan2(z, x)
    return measured if abs(angle) > np.radians(OBLIQUE_FRAME) else measured @ turn(-angle)


def _turn_of_axes(turn):
    """Find the rotation from one joint's frame to another's in a T-pose, from the sum over the frames of a clip."""
    mean = nearest_rotation(turn)
    if angles_between(mean, np.eye(3)) < SAME_AXES:
        return np.eye(3)
    axes = nearest_axes(mean)
    return axes if angles_between(mean, axes) < OBLIQUE_FRAME else mean


def nearest_axes(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the axis rotation nearest to a sum of rotations."""
    return ROTATIONS[np.einsum("rkl,kl->r", ROTATIONS, rotation).argmax()]


def paired_axes(totals: Sequence[Float[np.ndarray, "3 3"]]) -> list[Float[np.ndarray, "3 3"]]:
    """Find the axis rotations nearest to the sums of estimates M of the joints of a left and a right limb.

    Elbows of animations by hand do not bend about one axis. All joints of both limbs have the same axis up in a T-pose,
    left and right in the same or the opposite direction, so all estimates together choose it.
    """
    scores = np.stack([np.einsum("rkl,kl->r", ROTATIONS, total) for total in totals])
    up = np.abs(ROTATIONS[:, :, 1])
    pairs = np.where(up @ up.T > 0.5, scores[0][:, None] + scores[1], -np.inf)
    return [ROTATIONS[k] for k in np.unravel_index(pairs.argmax(), pairs.shape)]


def _rotations(body_vectors, source_vectors):
    """Compute the rotations from the frame of two vectors of the body at rest to that of two vectors of the source."""
    return frames_along(*source_vectors) @ np.swapaxes(frames_along(*body_vectors), -1, -2)


def _trunk_rotations(position, index, body_rest, body_index):
    """Estimate rotation and weight of hips, chest and head in each frame; other joints get those of the chest."""

    def left_to_right(points, joints, part):
        return np.subtract(*(points[:, joints[f"{side}{part}"]] for side in ("Left", "Right")))

    def trunk_of(points, joints):
        return middle(points, joints, "Arm") - middle(points, joints, "UpLeg")

    trunk = trunk_of(position, index)
    legs = middle(position, index, "UpLeg") - middle(position, index, "Foot")
    cosines = (
        (unit_vectors(trunk) * unit_vectors(legs)).sum(axis=-1),
        unit_vectors(trunk)[:, 1],
        unit_vectors(legs)[:, 1],
    )
    upright = np.maximum(np.minimum.reduce(cosines), STRAIGHT_WEIGHT) ** UPRIGHT_POWER
    up = np.array([[0.0, 1.0, 0.0]])
    ups, always = np.tile(up, (len(position), 1)), np.ones(len(position))
    body_hips, hips = left_to_right(body_rest, body_index, "UpLeg"), left_to_right(position, index, "UpLeg")
    body_arms, arms = left_to_right(body_rest, body_index, "Arm"), left_to_right(position, index, "Arm")
    return {
        "Hips": (_rotations((up, body_hips), (ups, hips)), upright),
        "Spine1": (_rotations((body_arms, trunk_of(body_rest, body_index)), (arms, trunk)), always),
        "Head": (_rotations((up, body_arms), (ups, arms)), upright),
    }


def hinge_rotations(position, index, body_rest, body_index, chain, direction, trunk):
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
        straight = trunk @ rotations_between(body_bone, (np.swapaxes(trunk, -1, -2) @ bone[..., None])[..., 0])
        # Combined in every frame, so that the weight belongs to one rotation.
        combined = nearest_rotation(bend[:, None, None] * bent + STRAIGHT_WEIGHT * straight)
        estimates[joint] = (combined, bend + STRAIGHT_WEIGHT)
    return estimates


def _foot_rotations(position, index, body_rest, body_index, side, shin):
    """Estimate rotation and weight of foot and toes from the foot's bone and the vertical; without toes as the shin.

    How steep the bone of a flat foot is differs from skeleton to skeleton, so frames in which it is flat on the ground
    decide; with a small weight, the angle between foot and shin does.
    """
    foot, toes, knee = f"{side}Foot", f"{side}ToeBase", f"{side}Leg"
    if toes not in index:
        return {foot: shin}
    rows = (body_rest, body_index), (position, index)
    ahead, leg = ([points[:, joints[end]] - points[:, joints[foot]] for points, joints in rows] for end in (toes, knee))
    up = [np.tile([0.0, 1.0, 0.0], (len(points), 1)) for points, _ in rows]
    heights = position[:, [index[foot], index[toes]], 1]
    above = (heights - np.quantile(heights, LOWEST, axis=0)) / np.linalg.norm(leg[1], axis=1).mean()
    flat = np.exp(-np.square(above / FLAT).sum(axis=1))
    on_ground, bent = (_rotations(*zip(*vectors, strict=True)) for vectors in ((up, ahead), (ahead, leg)))
    combined = nearest_rotation(flat[:, None, None] * on_ground + BENT_WEIGHT * bent)
    return dict.fromkeys((foot, toes), (combined, flat + BENT_WEIGHT))


def nearest_axis(vector: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
    """Find the signed coordinate axis nearest to a vector."""
    axis = np.zeros(3)
    largest = int(np.abs(vector).argmax())
    axis[largest] = np.sign(vector[largest])
    return axis


def middle(position: Float[np.ndarray, "T J 3"], index: Mapping[str, int], part: str) -> Float[np.ndarray, "T 3"]:
    """Compute the midpoint of the left and right joint of a part."""
    return (position[:, index[f"Left{part}"]] + position[:, index[f"Right{part}"]]) / 2
