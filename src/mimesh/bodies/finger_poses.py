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
ABDUCTION = (-20, 30), *2 * ((0, 0),), *(4 * ((-15, 20), (0, 0), (0, 0)))
"""The same for abduction; AAOS has 20 degrees for knuckles, and 70 for the thumb from the palm, of which the rest pose
has about half."""
END_RATIO = 2 / 3
"""Flexion of the last joint of a finger over that of the joint before (Rijpkema and Girard 1991)."""
CURLED, STRAIGHT, RELAXED = (80.0, 95.0), (0.0, 3.0), (20.0, 28.0)
"""Flexion of knuckle and middle joint (degrees) of a closed, a straight and a relaxed finger."""
THUMB_IN, THUMB_OUT, THUMB_RELAXED = (20.0, 40.0, 50.0), (-12.0, -8.0, -10.0), (3.0, 8.0, 12.0)
"""Flexion of the thumb's three joints (degrees): across the palm, stretched out and relaxed."""
SPREAD = (25.0, 14.0, 2.0, -9.0, -15.0)
"""Abduction of the first joint of each finger (degrees) in a spread hand; positive towards the thumb's side."""
GESTURES = ("relaxed", "fist", "grasp", "spread", "point", "thumb up", "flat", "free")
NOISE = 6.0
"""Standard deviation of every angle that a gesture has not fixed at zero (degrees)."""
BLENDED = 0.4
"""Share of poses that are a mixture of two gestures."""


def sample_finger_poses(count: int, rng: np.random.Generator) -> Float[np.ndarray, "N 15 2"]:
    """Draw angles (degrees) of flexion and abduction of the joints of hands, within their limits."""
    first, second = (gestures(rng.integers(len(GESTURES), size=count), rng) for _ in range(2))
    share = rng.random((count, 1, 1)) * (rng.random((count, 1, 1)) < BLENDED)
    return within_limits((1 - share) * first + share * second + rng.normal(0, NOISE, (count, 15, 2)))


def gestures(which: Int[np.ndarray, " N"], rng: np.random.Generator) -> Float[np.ndarray, "N 15 2"]:
    """Make angles (degrees) of the gestures with the given places in GESTURES."""
    closed = np.empty((len(which), 5, 2))  # knuckle and middle joint of each finger; the thumb's are ignored
    thumb, spread = np.empty((len(which), 3)), np.zeros((len(which), 5))
    for k, gesture in enumerate(which):
        name = GESTURES[gesture]
        closed[k], thumb[k] = RELAXED, THUMB_RELAXED
        if name in ("fist", "point", "thumb up"):
            closed[k], thumb[k] = CURLED, THUMB_OUT if name == "thumb up" else THUMB_IN
        if name == "point":
            closed[k, 1] = STRAIGHT
        if name in ("spread", "flat"):
            closed[k], thumb[k] = STRAIGHT, THUMB_OUT if name == "spread" else THUMB_RELAXED
            spread[k] = SPREAD if name == "spread" else 0.0
        if name == "grasp":  # all fingers around one thing
            closed[k], thumb[k] = rng.uniform((15, 15), (65, 70)), rng.uniform(0, 1) * np.array(THUMB_IN)
            spread[k] = rng.uniform(0, 0.6) * np.array(SPREAD)
        if name == "free":
            closed[k], thumb[k] = rng.uniform(0, 95, (5, 2)), rng.uniform(*np.array(FLEXION[:3]).T)
            spread[k] = rng.uniform(-1, 1, 5) * 10
    angles = np.zeros((len(which), 5, 3, 2))
    angles[:, :, :2, 0], angles[:, :, 2, 0] = closed, END_RATIO * closed[:, :, 1]
    angles[:, 0, :, 0], angles[:, :, 0, 1] = thumb, spread
    return angles.reshape(-1, 15, 2)


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
