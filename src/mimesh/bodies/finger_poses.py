"""Random poses of fingers: gestures within the limits of each joint, as angles of flexion and abduction.

Angles are relative to the shipped body's rest pose, whose fingers are nearly straight. Rotations are about the world's
axes at rest, in the frame of the parent, as in `RiggedBody`, so that one pose fits any hand whose rest pose is aligned.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from .hands import load_hands
from .sampling import rotvec_to_rotmat

FLEXION = ((-15, 25), (-10, 55), (-15, 80)) + 4 * ((-20, 90), (0, 100), (0, 75))
"""Least and largest flexion of each joint (degrees), thumb first: American Academy of Orthopaedic Surgeons, "Joint
Motion" (1965), with half of its extension of knuckles (45), which few hands reach without help."""
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
