"""Hand-written motions and poses of the pictures: a looping dance, a handstand, and a sit."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.interpolate import CubicSpline

from mimesh.bodies import RiggedBody
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.motions import Motion
from mimesh.motions.procedural import planted

PoseDegrees = dict[str, tuple[float, float, float]]
"""Joint name -> rotation vector in degrees, about the world's axes at rest; x is the person's left."""

CROUCH: PoseDegrees = {
    **{f"{side}UpLeg": (-48, 0, 12 * sign) for side, sign in (("Left", 1), ("Right", -1))},
    **{f"{side}Leg": (76, 0, 0) for side in ("Left", "Right")},
    **{f"{side}Foot": (-28, 0, -8 * sign) for side, sign in (("Left", 1), ("Right", -1))},
    **{f"{side}Arm": (0, -38 * sign, -42 * sign) for side, sign in (("Left", 1), ("Right", -1))},
    **{f"{side}ForeArm": (0, -70 * sign, 0) for side, sign in (("Left", 1), ("Right", -1))},
    "LowerBack": (14, 0, 0),
    "Head": (-8, 0, 0),
}
LUNGE_LEFT: PoseDegrees = {
    "Hips": (0, 18, -6),
    "LeftUpLeg": (-10, 0, 2),
    "LeftLeg": (18, 0, 0),
    "LeftFoot": (-8, 0, 4),
    "RightUpLeg": (-14, 0, -46),
    "RightLeg": (10, 0, 0),
    "RightFoot": (24, 0, 0),
    "LeftArm": (0, -10, 58),
    "LeftForeArm": (0, -28, 0),
    "RightArm": (0, 12, 8),
    "RightForeArm": (0, 40, 0),
    "Spine": (0, 0, -8),
    "Spine1": (0, -14, -8),
    "Head": (-6, -16, 6),
}
ARMS_UP: PoseDegrees = {
    "LeftUpLeg": (-4, 0, 9),
    "RightUpLeg": (-4, 0, -9),
    "LeftFoot": (4, 0, -9),
    "RightFoot": (4, 0, 9),
    "LeftArm": (0, -16, 66),
    "RightArm": (0, 16, -66),
    "LeftForeArm": (0, -22, 0),
    "RightForeArm": (0, 22, 0),
    "Spine1": (-8, 0, 0),
    "Head": (-12, 0, 0),
}
SITTING: PoseDegrees = {
    **{f"{side}UpLeg": (-88, 0, 6 * sign) for side, sign in (("Left", 1), ("Right", -1))},
    **{f"{side}Leg": (86, 0, 0) for side in ("Left", "Right")},
    **{f"{side}Arm": (0, -26 * sign, -58 * sign) for side, sign in (("Left", 1), ("Right", -1))},
    **{f"{side}ForeArm": (0, -34 * sign, 0) for side, sign in (("Left", 1), ("Right", -1))},
}


def dance(body: RiggedBody, seconds: float = 3.0, fps: float = 15.0) -> Motion:
    """Return a dance that ends where it begins: poses interpolated by a periodic cubic spline."""
    keys = [CROUCH, LUNGE_LEFT, CROUCH, _mirrored(LUNGE_LEFT), CROUCH, ARMS_UP, CROUCH]
    rotvec = np.stack([_pose(body, degrees) for degrees in keys])
    times = np.arange(round(seconds * fps)) / fps
    rotmat = rotvec_to_rotmat(CubicSpline(np.linspace(0, seconds, 7), rotvec, bc_type="periodic")(times))
    root = planted(body, rotmat)
    # Planting the feet lets the root drift over one loop. The drift is subtracted linearly, so that the loop closes.
    drift = (root[-1] - root[0]) * len(times) / (len(times) - 1) * [1, 0, 1]
    return Motion("dance", body.joint_names, rotmat, root - drift * times[:, None] / seconds, fps)


def handstand(body: RiggedBody) -> np.ndarray:
    """Return the joint rotations (J, 3, 3) of a handstand."""
    return rotvec_to_rotmat(_pose(body, {"Hips": (180, 0, 0), "LeftArm": (0, 0, 80), "RightArm": (0, 0, -80)}))


def sitting(body: RiggedBody) -> np.ndarray:
    """Return the joint rotations (J, 3, 3) of a person who sits upright, hands towards the knees."""
    return rotvec_to_rotmat(_pose(body, SITTING))


def faced(motion: Motion) -> Motion:
    """Move and turn a motion so that it begins at the origin of the floor, facing +z."""
    x, _, z = motion.rotmat[0, 0, :, 2]
    turn = rotvec_to_rotmat(np.array([0.0, -np.arctan2(x, z), 0.0]))
    rotmat = motion.rotmat.copy()
    rotmat[:, 0] = turn @ rotmat[:, 0]
    return dataclasses.replace(motion, rotmat=rotmat, root=(motion.root - motion.root[0] * [1, 0, 1]) @ turn.T)


def _mirrored(pose: PoseDegrees) -> PoseDegrees:
    """Mirror a pose: exchange left and right."""
    other = {"Left": "Right", "Right": "Left"}
    return {
        next((other[side] + name[len(side) :] for side in other if name.startswith(side)), name): (x, -y, -z)
        for name, (x, y, z) in pose.items()
    }


def _pose(body: RiggedBody, degrees: PoseDegrees) -> np.ndarray:
    """Return rotation vectors (J, 3) in radians; joints that are not named stay at zero."""
    rotvec = np.zeros((len(body.joint_names), 3))
    for name, rotation in degrees.items():
        rotvec[body.joint(name)] = np.radians(rotation)
    return rotvec
