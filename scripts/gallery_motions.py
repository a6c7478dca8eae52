"""Motions of the gallery that are written by hand, pose by pose: a dance that loops, and a handstand."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.interpolate import CubicSpline

from mimesh.bodies import RiggedBody
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.motions import Motion
from mimesh.motions.procedural import planted

Turns = dict[str, tuple[float, float, float]]
"""Rotation vectors in degrees about the world's axes at rest; x is the person's left."""

LOW: Turns = {
    **{f"{side}UpLeg": (-48, 0, 12 * sign) for side, sign in (("Left", 1), ("Right", -1))},
    **{f"{side}Leg": (76, 0, 0) for side in ("Left", "Right")},
    **{f"{side}Foot": (-28, 0, -8 * sign) for side, sign in (("Left", 1), ("Right", -1))},
    **{f"{side}Arm": (0, -38 * sign, -42 * sign) for side, sign in (("Left", 1), ("Right", -1))},
    **{f"{side}ForeArm": (0, -70 * sign, 0) for side, sign in (("Left", 1), ("Right", -1))},
    "LowerBack": (14, 0, 0),
    "Head": (-8, 0, 0),
}
SIDE: Turns = {
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
OPEN: Turns = {
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


def dance(body: RiggedBody, seconds: float = 3.0, fps: float = 15.0) -> Motion:
    """Six poses in a circle: down, left, down, right, down, arms up. It ends where it begins."""
    circle = [LOW, SIDE, LOW, _mirrored(SIDE), LOW, OPEN, LOW]
    rotvec = np.stack([_pose(body, turns) for turns in circle])
    at = np.arange(round(seconds * fps)) / fps
    rotmat = rotvec_to_rotmat(CubicSpline(np.linspace(0, seconds, 7), rotvec, bc_type="periodic")(at))
    root = planted(body, rotmat)
    # What the soles carried it over the whole circle is taken back along the way, so that it closes.
    drift = (root[-1] - root[0]) * len(at) / (len(at) - 1) * [1, 0, 1]
    return Motion("dance", body.joint_names, rotmat, root - drift * at[:, None] / seconds, fps)


def handstand(body: RiggedBody) -> np.ndarray:
    """Joint rotations (J, 3, 3) of somebody on their hands."""
    return rotvec_to_rotmat(_pose(body, {"Hips": (180, 0, 0), "LeftArm": (0, 0, 80), "RightArm": (0, 0, -80)}))


def faced(motion: Motion) -> Motion:
    """The motion turned so that it begins at the origin of the floor and looks along +z."""
    x, _, z = motion.rotmat[0, 0, :, 2]
    back = rotvec_to_rotmat(np.array([0.0, -np.arctan2(x, z), 0.0]))
    rotmat = motion.rotmat.copy()
    rotmat[:, 0] = back @ rotmat[:, 0]
    return dataclasses.replace(motion, rotmat=rotmat, root=(motion.root - motion.root[0] * [1, 0, 1]) @ back.T)


def _mirrored(turns: Turns) -> Turns:
    """Left and right exchanged."""
    other = {"Left": "Right", "Right": "Left"}
    return {
        next((other[side] + name[len(side) :] for side in other if name.startswith(side)), name): (x, -y, -z)
        for name, (x, y, z) in turns.items()
    }


def _pose(body: RiggedBody, turns: Turns) -> np.ndarray:
    """Rotation vectors (J, 3) in radians; joints that are not named stay at zero."""
    pose = np.zeros((len(body.joint_names), 3))
    for name, degrees in turns.items():
        pose[body.joint(name)] = np.radians(degrees)
    return pose
