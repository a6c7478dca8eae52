"""Poses of the shipped quadruped: ranges of its joints.

Triples of degrees are rotation vectors from standing, about the axis to the animal's left, up, and to the front:
positive ones about the first turn what hangs down backwards, and what points forwards down.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from .body_model import RiggedBody
from .joint_names import without_side
from .sampling import Range, mirror_ranges

Ranges = dict[str, tuple[Range, Range, Range]]

_CENTRE: Ranges = {
    "Hips": ((-40, 25), (0, 0), (-12, 12)),
    **{f"Spine{i}": ((-10, 10), (-10, 10), (-6, 6)) for i in range(1, 5)},
    "Chest": ((-10, 15), (-12, 12), (-6, 6)),
    "Neck1": ((-35, 60), (-35, 35), (-12, 12)),
    "Neck2": ((-20, 30), (-25, 25), (-10, 10)),
    "Neck3": ((-20, 25), (-25, 25), (-15, 15)),
    "Head": ((-35, 35), (-35, 35), (-20, 20)),
    "Jaw": ((-5, 35), (0, 0), (0, 0)),
    "Tail1": ((-60, 70), (-40, 40), (0, 0)),
    **{f"Tail{i}": ((-30, 30), (-35, 35), (0, 0)) for i in range(2, 7)},
}
_LEFT: Ranges = {
    "Ear": ((-30, 30), (-30, 30), (-40, 40)),
    "Scapula": ((-20, 20), (-4, 4), (-6, 6)),
    "UpperArm": ((-45, 50), (-8, 8), (-10, 20)),
    "Forearm": ((-130, 12), (-8, 8), (-5, 5)),
    "Hand": ((-12, 90), (-8, 8), (-8, 8)),
    "Fingers": ((-35, 60), (0, 0), (0, 0)),
    "Thigh": ((-70, 45), (-15, 15), (-12, 30)),
    "Shin": ((-25, 118), (-6, 6), (-4, 4)),
    "Foot": ((-85, 30), (-6, 6), (-6, 6)),
    "Toes": ((-35, 60), (0, 0), (0, 0)),
}
_USUAL_CENTRE: Ranges = {
    "Hips": ((-3, 3), (-2, 2), (-2, 2)),
    **{f"Spine{i}": ((-2, 2), (-3, 3), (-2, 2)) for i in range(1, 5)},
    "Neck1": ((-15, 30), (-15, 15), (-4, 4)),
    "Neck2": ((-8, 15), (-10, 10), (-4, 4)),
    "Head": ((-15, 15), (-15, 15), (-8, 8)),
    "Jaw": ((-2, 15), (0, 0), (0, 0)),
    "Tail1": ((-30, 40), (-20, 20), (0, 0)),
    **{f"Tail{i}": ((-12, 12), (-15, 15), (0, 0)) for i in range(2, 7)},
}
_USUAL_LEFT: Ranges = {
    "Ear": ((-10, 10), (-10, 10), (-15, 15)),
    "Scapula": ((-8, 8), (-2, 2), (-2, 2)),
    "UpperArm": ((-25, 25), (-4, 4), (-4, 6)),
    "Forearm": ((-60, 0), (-2, 2), (-2, 2)),
    "Hand": ((0, 50), (-4, 4), (-4, 4)),
    "Fingers": ((-15, 30), (0, 0), (0, 0)),
    "Thigh": ((-30, 25), (-4, 4), (-4, 8)),
    "Shin": ((0, 50), (-2, 2), (-2, 2)),
    "Foot": ((-40, 5), (-2, 2), (-2, 2)),
    "Toes": ((-15, 30), (0, 0), (0, 0)),
}


def _both_sides(centre: Ranges, left: Ranges) -> Ranges:
    return {
        **centre,
        **{f"Left{bone}": ranges for bone, ranges in left.items()},
        **{f"Right{bone}": mirror_ranges(ranges) for bone, ranges in left.items()},
    }


LIMITS: Ranges = _both_sides(_CENTRE, _LEFT)
"""Approximate ranges of the joints of quadrupeds."""
USUAL: Ranges = _both_sides(_USUAL_CENTRE, _USUAL_LEFT)
"""Ranges of everyday poses on four feet: what Table 6 of the NPT paper is for people."""
LOWERED_HEAD = {"Neck1": 40.0, "Neck2": 20.0, "Head": -20.0}
"""First angle of joints (degrees) in which animals are modelled too: a share of this, from the head up to it down."""
POSTURES: dict[str, dict[str, tuple[float, float]]] = {
    "dog": {},
    "hound": {"Ear": (0, -70)},
    "terrier": {},
    "cat": {"Neck1": (14, 0), "Neck2": (8, 0), "Head": (-16, 0)},
    "lion": {"Neck1": (18, 0), "Neck2": (10, 0), "Head": (-18, 0)},
    "fox": {"Neck1": (14, 0), "Head": (-8, 0)},
    "horse": {
        "Neck1": (6, 0),
        "Head": (34, 0),
        "Fingers": (22, 0),
        "Toes": (20, 0),
        "Tail1": (-40, 0),
        "Tail2": (-20, 0),
        "Thigh": (-4, 0),
    },
    "donkey": {
        "Neck1": (16, 0),
        "Head": (26, 0),
        "Fingers": (22, 0),
        "Toes": (20, 0),
        "Tail1": (-40, 0),
        "Tail2": (-20, 0),
        "Thigh": (-4, 0),
    },
    "cow": {
        "Neck1": (34, 0),
        "Neck2": (10, 0),
        "Head": (2, 0),
        "Fingers": (22, 0),
        "Toes": (20, 0),
        "Tail1": (-50, 0),
        "Tail2": (-25, 0),
        "Thigh": (-2, 0),
        "Ear": (0, -70),
    },
    "pig": {"Neck1": (32, 0), "Neck2": (16, 0), "Head": (-4, 0), "Ear": (40, -25), "Fingers": (18, 0), "Toes": (18, 0)},
    "sheep": {"Neck1": (20, 0), "Head": (12, 0), "Fingers": (20, 0), "Toes": (18, 0), "Ear": (0, -70)},
    "goat": {"Neck1": (12, 0), "Head": (12, 0), "Fingers": (20, 0), "Toes": (18, 0), "Ear": (0, -60)},
    "deer": {"Neck1": (8, 0), "Head": (16, 0), "Fingers": (22, 0), "Toes": (20, 0), "Ear": (0, -35)},
    "camel": {"Neck1": (44, 0), "Neck2": (-18, 0), "Neck3": (-12, 0), "Head": (8, 0), "Thigh": (-4, 0)},
    "giraffe": {
        "Spine1": (-6, 0),
        "Spine3": (-6, 0),
        "Neck1": (4, 0),
        "Head": (26, 0),
        "Fingers": (20, 0),
        "Toes": (20, 0),
        "Ear": (0, -50),
    },
    "rhino": {"Neck1": (40, 0), "Neck2": (12, 0), "Head": (2, 0)},
    "bear": {"Neck1": (34, 0), "Neck2": (8, 0), "Head": (-12, 0)},
}
"""How animals stand at rest, beside the dog that the shipped quadruped was made from: first and third angle (degrees)
of joints without their side, the third of the left one. The shipped quadruped at rest has the mean of them. Looked up
in no book: chosen by eye."""


def lowered_head(body: RiggedBody, shares: Float[np.ndarray, " 3"] | float = 1.0) -> Float[np.ndarray, "J 3"]:
    """Make rotation vectors (radians) that lower the head by a share of LOWERED_HEAD, or one share for each joint."""
    rotvec = np.zeros_like(body.joints)
    places = [body.joint(name) for name in LOWERED_HEAD]
    rotvec[places, 0] = shares * np.radians(list(LOWERED_HEAD.values()))
    return rotvec


def mean_posture() -> dict[str, tuple[float, float]]:
    """Compute the mean of POSTURES, which is in the rest pose of the shipped quadruped."""
    joints = dict.fromkeys(joint for posture in POSTURES.values() for joint in posture)
    each = {joint: [posture.get(joint, (0.0, 0.0)) for posture in POSTURES.values()] for joint in joints}
    return {
        joint: (float(np.mean([a for a, _ in angles])), float(np.mean([b for _, b in angles])))
        for joint, angles in each.items()
    }


def postures(body: RiggedBody) -> Float[np.ndarray, "R J 3"]:
    """Give POSTURES as rotation vectors (radians) from the rest pose of the shipped quadruped."""
    mean, rotvec = mean_posture(), np.zeros((len(POSTURES), *body.joints.shape))
    for k, posture in enumerate(POSTURES.values()):
        for j, name in enumerate(body.joint_names):
            kind, side = without_side(name), -1 if name.startswith("Right") else 1
            (pitch, roll), (mean_pitch, mean_roll) = posture.get(kind, (0.0, 0.0)), mean.get(kind, (0.0, 0.0))
            rotvec[k, j] = np.radians([pitch - mean_pitch, 0.0, side * (roll - mean_roll)])
    return rotvec


def posture(body: RiggedBody, species: str) -> Float[np.ndarray, "J 3"]:
    """Give the rotation vectors (radians) with which a species of POSTURES stands."""
    return postures(body)[list(POSTURES).index(species)]
