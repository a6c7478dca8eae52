"""Left hands of the shipped body in random gestures, and how other hands at rest are turned against them.

Gestures are within the limits of each joint, as angles of flexion and abduction from the rest pose, whose fingers are
nearly straight. Rotations are about the world's axes at rest, in the frame of the parent, as in `RiggedBody`, so that
one pose fits any hand whose rest pose is aligned.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float, Int

from mimesh.bodies.body_model import RiggedBody, load_body
from mimesh.bodies.hands import FLEXION, HAND_PARENTS, hand_weight, load_hands
from mimesh.bodies.joint_names import finger_joints
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.geometry import rotate_between, unit_vectors

TIP_SHARE = 0.5
"""Share of a finger's last joint from which on a vertex can be the fingertip."""
OF_HAND = 0.5
"""Weight of the hand and its finger stubs from which on a vertex belongs to the hand."""
ABDUCTION = ((-20, 30), (0, 0), (0, 0)) + 4 * ((-15, 20), (0, 0), (0, 0))
"""The same for abduction; AAOS has 20 degrees for knuckles, and 70 for the thumb from the palm, of which the rest pose
has about half."""
END_RATIO = 2 / 3
"""Flexion of the last joint of a finger over that of the joint before (Rijpkema and Girard 1991)."""
CLOSED, STRAIGHT, RELAXED = np.array([(80.0, 95.0), (0.0, 3.0), (20.0, 28.0)])
"""Flexion of knuckle and middle joint (degrees) of a closed, a straight and a relaxed finger."""
THUMB_IN, THUMB_OUT, THUMB_RELAXED = np.array([(20.0, 40.0, 50.0), (-12.0, -8.0, -10.0), (3.0, 8.0, 12.0)])
"""The same of the thumb's three joints: across the palm, stretched out and relaxed."""
SPREAD, NO_SPREAD = np.array([25.0, 14.0, 2.0, -9.0, -15.0]), np.zeros(5)
"""Abduction of the first joint of each finger (degrees) in a spread hand and at rest; positive towards the thumb."""
GRASP, GRASP_SPREAD = ((15, 15), (65, 70)), 0.6
"""Least and largest flexion of knuckle and middle joint in a grasp (degrees), and its largest share of SPREAD."""
FREE, FREE_SPREAD = 95, 10
"""Largest flexion of knuckles and middle joints, and largest abduction either way, of free fingers (degrees)."""
GESTURES = ("relaxed", "fist", "grasp", "spread", "point", "thumb up", "flat", "free")
"""All are drawn equally often; the joints of a free hand are bent independently."""
NOISE = 6.0
"""Standard deviation of what is added to every angle (degrees); joints that cannot bend sideways stay at zero."""
BLENDED = 0.4
"""Share of poses that are a mixture of two gestures."""


def palm_frame(wrist: Float[np.ndarray, " 3"], joints: Float[np.ndarray, "15 3"]) -> Float[np.ndarray, "3 3"]:
    """Compute the axes of a left palm as columns, as in the T-pose: x along the hand, y off its back, z to the thumb.

    Joints are those of `finger_joints`: rows 3, 6, 9 and 12 are the knuckles, from the index to the little finger.
    """
    x = unit_vectors(joints[[3, 6, 9, 12]].mean(axis=0) - wrist)
    across = joints[3] - joints[12]
    z = unit_vectors(across - (across @ x) * x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def fingertips(
    vertices: Float[np.ndarray, "V 3"], weights: Float[np.ndarray, "V 15"], joints: Float[np.ndarray, "15 3"]
) -> list[int]:
    """Find the vertex at the end of each finger: the farthest along its last bone among those of its last joint.

    Args:
        weights: of the finger joints, or their shares in the weight of the hand.
    """
    found = []
    for finger in range(5):
        last = 3 * finger + 2
        share = weights[:, last]
        along = (vertices - joints[last]) @ (joints[last] - joints[last - 1])
        found.append(int(np.where(share >= min(TIP_SHARE, share.max()), along, -np.inf).argmax()))
    return found


@cache
def left_hand_body() -> RiggedBody:
    """Return the left hand of the shipped body's mean shape: 16 joints, the hand first, and no shape components."""
    body, hands = load_body(), load_hands()
    kept = np.flatnonzero(hand_weight(body, "Left") > OF_HAND)
    rank = np.full(len(body.vertices), -1)
    rank[kept] = np.arange(len(kept))
    return RiggedBody(
        name="left hand",
        vertices=body.vertices[kept],
        faces=rank[body.faces[(rank[body.faces] >= 0).all(axis=1)]],
        components=np.zeros((0, len(kept), 3)),
        joints=np.concatenate([body.joints[[body.joint("LeftHand")]], hands.joints[:15]]),
        joint_components=np.zeros((0, 16, 3)),
        weights=hands.shares[0, kept],
        joint_names=("LeftHand", *finger_joints("Left")),
        parents=HAND_PARENTS,
    )


def hand_alignment(
    joints: Float[np.ndarray, "16 3"], tips: Float[np.ndarray, "5 3"]
) -> tuple[Float[np.ndarray, "16 3 3"], Float[np.ndarray, "16 3"]]:
    """Compute the rotation of each joint from the shipped body's left hand at rest to another left hand at rest.

    The hand's is that of its palm; a finger joint's is the palm's, then the smallest one to the direction of its bone.
    Also returns the unit directions of the bones of the other hand, which end at joints and fingertips.
    """
    ours = left_hand_body()
    our_tips = ours.vertices[fingertips(ours.vertices, ours.weights[:, 1:], ours.joints[1:])]
    bones, our_bones = (_bones(at, ends) for at, ends in ((joints, tips), (ours.joints, our_tips)))
    palm = palm_frame(joints[0], joints[1:]) @ palm_frame(ours.joints[0], ours.joints[1:]).T
    # Each column of the palm's rotation, a row of its transpose, is rotated as the bone of each finger joint is.
    old, new = (np.repeat(directions[1:], 3, axis=0) for directions in (our_bones @ palm.T, bones))
    columns = rotate_between(old, new, np.tile(palm.T, (15, 1))).reshape(15, 3, 3)
    return np.concatenate([palm[None], columns.swapaxes(-1, -2)]), bones


def _bones(joints: Float[np.ndarray, "16 3"], tips: Float[np.ndarray, "5 3"]) -> Float[np.ndarray, "16 3"]:
    """Compute unit directions from the hand to its knuckles, and from each finger joint to the next or to the tip."""
    knuckles = joints[[4, 7, 10, 13]].mean(axis=0)
    fingers = phalanges(joints[1:], tips).reshape(15, 3)
    return unit_vectors(np.concatenate([knuckles[None] - joints[:1], fingers]))


def phalanges(joints: Float[np.ndarray, "15 3"], tips: Float[np.ndarray, "5 3"]) -> Float[np.ndarray, "5 3 3"]:
    """Compute the vectors from each joint of each finger to the next one or to the fingertip."""
    return np.diff(np.concatenate([joints.reshape(5, 3, 3), tips[:, None]], axis=1), axis=1)


def sample_finger_poses(count: int, rng: np.random.Generator) -> Float[np.ndarray, "N 15 2"]:
    """Draw angles (degrees) of flexion and abduction of the joints of hands, within their limits."""
    first, second = (gestures(rng.integers(len(GESTURES), size=count), rng) for _ in range(2))
    share = rng.random((count, 1, 1)) * (rng.random((count, 1, 1)) < BLENDED)
    return within_limits((1 - share) * first + share * second + rng.normal(0, NOISE, (count, 15, 2)))


def gestures(which: Int[np.ndarray, " N"], rng: np.random.Generator) -> Float[np.ndarray, "N 15 2"]:
    """Make angles (degrees) of the gestures with the given places in GESTURES."""
    angles = np.zeros((len(which), 5, 3, 2))  # finger, its joint, flexion and abduction
    for hand, gesture in zip(angles, which, strict=True):
        fingers, thumb, spread = _gesture(GESTURES[gesture], rng)
        hand[1:, :2, 0], hand[0, :, 0], hand[:, 0, 1] = fingers, thumb, spread
    angles[:, 1:, 2, 0] = END_RATIO * angles[:, 1:, 1, 0]
    return angles.reshape(-1, 15, 2)


def _gesture(
    name: str, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "*F 2"], Float[np.ndarray, "3"], Float[np.ndarray, "5"]]:
    """Make a gesture of GESTURES, as angles (degrees).

    Returns:
        Flexion of knuckle and middle joint of the four fingers (4, 2) or of each of them (2,), flexion of the thumb's
        joints (3,), and abduction of the first joint of each finger (5,).
    """
    match name:
        case "relaxed":
            return RELAXED, THUMB_RELAXED, NO_SPREAD
        case "fist":
            return CLOSED, THUMB_IN, NO_SPREAD
        case "thumb up":
            return CLOSED, THUMB_OUT, NO_SPREAD
        case "point":
            return np.stack([STRAIGHT, CLOSED, CLOSED, CLOSED]), THUMB_IN, NO_SPREAD
        case "flat":
            return STRAIGHT, THUMB_RELAXED, NO_SPREAD
        case "spread":
            return STRAIGHT, THUMB_OUT, SPREAD
        case "grasp":  # all fingers around one thing
            fingers, thumb = rng.uniform(*GRASP), rng.uniform(0, 1) * THUMB_IN
            return fingers, thumb, rng.uniform(0, GRASP_SPREAD) * SPREAD
        case _:  # free: the first row of five is the thumb's, whose joints have limits of their own
            fingers, thumb = rng.uniform(0, FREE, (5, 2))[1:], rng.uniform(*np.array(FLEXION[:3]).T)
            return fingers, thumb, rng.uniform(-1, 1, 5) * FREE_SPREAD


def within_limits(angles: Float[np.ndarray, "*N 15 2"]) -> Float[np.ndarray, "*N 15 2"]:
    """Clip angles (degrees) to the limits of the joints."""
    limits = np.array([FLEXION, ABDUCTION], float)  # (2, 15, 2): kind of angle, joint, ends
    return angles.clip(limits[:, :, 0].T, limits[:, :, 1].T)


def finger_rotations(angles: Float[np.ndarray, "*N 15 2"], left: bool) -> Float[np.ndarray, "*N 15 3 3"]:
    """Compute the local rotations of a hand's joints from angles (degrees) of flexion and abduction."""
    hands, side = load_hands(), slice(0, 15) if left else slice(15, 30)
    # The mirror image of a rotation is a rotation the other way about the mirrored axis; the axes have that in them.
    flexion, abduction = (
        rotvec_to_rotmat(np.radians(angles[..., k, None]) * axis[side])
        for k, axis in enumerate((hands.flexion, hands.abduction))
    )
    return abduction @ flexion
