"""Random shapes and poses of the shipped body: sample i is a function of (seed, i) alone.

Triples of degrees are rotation vectors about the world's axes at rest (x the person's left, y up, z front).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from .body_model import RiggedBody

Range = tuple[int, int]
"""Lowest and highest angle about one axis, in degrees."""

TABLE_6: dict[str, tuple[Range, Range, Range]] = {
    "Hips": ((-2, 2), (-2, 2), (-2, 2)),
    "LeftUpLeg": ((-90, 0), (0, 0), (0, 40)),
    "RightUpLeg": ((-90, 0), (0, 0), (-40, 0)),
    "LowerBack": ((-1, 1), (-1, 1), (-1, 1)),
    "LeftLeg": ((0, 100), (0, 0), (0, 0)),
    "RightLeg": ((0, 100), (0, 0), (0, 0)),
    "Spine": ((-1, 1), (-1, 1), (-1, 1)),
    "LeftFoot": ((-10, 10), (-10, 10), (-1, 1)),
    "RightFoot": ((-10, 10), (-10, 10), (-1, 1)),
    "Spine1": ((-1, 1), (-1, 1), (-1, 1)),
    "LeftToeBase": ((-1, 1), (-1, 1), (-1, 1)),
    "RightToeBase": ((-1, 1), (-1, 1), (-1, 1)),
    "Neck": ((-3, 3), (-3, 3), (-3, 3)),
    "LeftShoulder": ((0, 0), (-30, 30), (-30, 30)),
    "RightShoulder": ((0, 0), (-30, 30), (-30, 30)),
    "Head": ((-3, 3), (-3, 3), (-3, 3)),
    "LeftArm": ((0, 0), (-30, 30), (-30, 30)),
    "RightArm": ((0, 0), (-30, 30), (-30, 30)),
    "LeftForeArm": ((0, 0), (-60, 0), (0, 0)),
    "RightForeArm": ((0, 0), (0, 60), (0, 0)),
    "LeftHand": ((-10, 10), (-10, 10), (-10, 10)),
    "RightHand": ((-10, 10), (-10, 10), (-10, 10)),
    "LeftFingerBase": ((-5, 5), (0, 10), (-10, 0)),
    "RightFingerBase": ((-5, 5), (-10, 0), (0, 10)),
}
"""Ranges of rotation vectors in NPT's Table 6 (rows 1 to 24 in order), by joint of the shipped body."""

_LEFT_LIMITS: dict[str, tuple[Range, Range, Range]] = {
    "UpLeg": ((-110, 40), (-35, 35), (-20, 50)),
    "Leg": ((0, 140), (-8, 8), (-4, 4)),
    "Foot": ((-25, 45), (-15, 15), (-15, 15)),
    "ToeBase": ((-30, 15), (0, 0), (0, 0)),
    "Shoulder": ((-10, 10), (-20, 20), (-15, 30)),
    "Arm": ((-70, 70), (-100, 35), (-95, 80)),
    "ForeArm": ((-70, 70), (-140, 0), (-10, 10)),
    "Hand": ((-25, 25), (-20, 20), (-60, 60)),
    "FingerBase": ((-5, 5), (-5, 10), (-60, 5)),
}
"""Limits of the joints of the left side, named without it."""
_CENTRE_LIMITS: dict[str, tuple[Range, Range, Range]] = {
    "Hips": ((-12, 12), (0, 0), (-12, 12)),
    "LowerBack": ((-15, 30), (-15, 15), (-15, 15)),
    "Spine": ((-12, 20), (-15, 15), (-12, 12)),
    "Spine1": ((-12, 20), (-15, 15), (-12, 12)),
    "Neck": ((-20, 20), (-25, 25), (-12, 12)),
    "Neck1": ((-12, 12), (-15, 15), (-8, 8)),
    "Head": ((-20, 20), (-25, 25), (-12, 12)),
}
"""Limits of the trunk, neck and head."""


def mirror_ranges(ranges: tuple[Range, Range, Range]) -> tuple[Range, Range, Range]:
    """Compute the limits of the other side: reflection at x = 0 keeps rotations about x and negates the others."""
    x, (y0, y1), (z0, z1) = ranges
    return x, (-y1, -y0), (-z1, -z0)


JOINT_LIMITS: dict[str, tuple[Range, Range, Range]] = {
    **_CENTRE_LIMITS,
    **{f"Left{bone}": ranges for bone, ranges in _LEFT_LIMITS.items()},
    **{f"Right{bone}": mirror_ranges(ranges) for bone, ranges in _LEFT_LIMITS.items()},
}
"""Approximate ranges of human joints, as rotation vectors from a T-pose. Headings are not included."""

FOLDED_LEGS: dict[str, tuple[Range, Range, Range, Range, Range]] = {
    "on a chair": ((70, 110), (-5, 30), (-15, 15), (60, 115), (-15, 20)),
    "legs forward": ((65, 110), (0, 40), (-10, 25), (0, 35), (-10, 30)),
    "cross-legged": ((70, 110), (20, 60), (20, 60), (95, 145), (-10, 30)),
    "knees drawn up": ((100, 135), (-5, 25), (-5, 15), (85, 140), (-10, 30)),
    "squatting": ((85, 130), (0, 45), (0, 20), (100, 150), (-30, 10)),
    "on the heels": ((40, 95), (-5, 25), (-10, 15), (120, 155), (20, 55)),
    "kneeling": ((-15, 25), (-5, 20), (-10, 10), (75, 125), (0, 55)),
}
"""How legs are folded: hip bent, thigh to the outside, thigh turned outwards, knee bent, foot stretched (degrees).
Chosen by hand from how people sit, squat and kneel; all but the turned thighs of the cross-legged lie within what
clinical tables give for adults."""
UNEVEN = 0.3
"""Share of people whose legs are folded in two of these ways, one each."""
LEANING = 25.0
"""Largest angle that people with folded legs lean forward or back (degrees)."""


def limits_rotvec(body: RiggedBody, limits: dict[str, tuple[Range, Range, Range]]) -> Float[np.ndarray, "2 J 3"]:
    """Convert a table of limits to the lowest and highest rotation vector of every joint (radians); zero by default."""
    bounds = np.zeros((2, len(body.joint_names), 3))
    for name, ranges in limits.items():
        bounds[:, body.joint(name)] = np.radians(ranges).T
    return bounds


def sample_shape(body: RiggedBody, seed: int, index: int, spread: float = 1.0) -> Float[np.ndarray, " K"]:
    """Draw shape coefficients of person `index`: normal, clipped at 2.5 standard deviations, times `spread`."""
    drawn = _generator(seed, index, 0).normal(size=len(body.components))
    return spread * np.clip(drawn, -2.5, 2.5)


def sample_pose(
    body: RiggedBody, seed: int, index: int, limits: dict[str, tuple[Range, Range, Range]] | None = None
) -> Float[np.ndarray, "J 3"]:
    """Draw rotation vectors of pose `index`, uniform within `limits` (default: NPT's Table 6)."""
    low, high = limits_rotvec(body, TABLE_6 if limits is None else limits)
    return _generator(seed, index, 1).uniform(low, high)


def folded_legs(body: RiggedBody, count: int, seed: int = 0) -> Float[np.ndarray, "N J 3"]:
    """Draw rotation vectors of people who sit, squat and kneel; only hips, legs and feet are turned."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    ranges = np.array(list(FOLDED_LEGS.values()), dtype=float)
    kind = rng.integers(len(ranges), size=(count, 2))
    kind[:, 1] = np.where(rng.random(count) < UNEVEN, kind[:, 1], kind[:, 0])
    # Both legs of one person differ by up to a quarter of the range where they are folded in one way.
    part = np.clip(rng.random((count, 1, 5)) + rng.uniform(-0.25, 0.25, (count, 2, 5)), 0, 1)
    low, high = ranges[kind, :, 0], ranges[kind, :, 1]
    angles = low + part * (high - low)
    poses = np.zeros((count, len(body.joint_names), 3))
    poses[:, body.joint("Hips"), 0] = np.radians(rng.uniform(-LEANING, LEANING, count))
    for k, (side, sign) in enumerate((("Left", 1), ("Right", -1))):
        bend, outside, outwards, knee, foot = angles[:, k].T
        # Bent first, a thigh points to the front (z): turned outwards about z, then to the outside about y.
        turns = Rotation.from_euler("xzy", np.stack([-bend, -sign * outwards, sign * outside], axis=-1), degrees=True)
        poses[:, body.joint(f"{side}UpLeg")] = turns.as_rotvec()
        poses[:, body.joint(f"{side}Leg"), 0] = np.radians(knee)
        poses[:, body.joint(f"{side}Foot"), 0] = np.radians(foot)
    return poses


def lowered_arms(body: RiggedBody) -> Float[np.ndarray, "J 3"]:
    """Make rotation vectors that lower the arms of the T-pose by 75 degrees; a fraction of them gives an A-pose."""
    return pose_of(body, {"LeftArm": (0.0, 0.0, -75.0), "RightArm": (0.0, 0.0, 75.0)})


def pose_of(body: RiggedBody, degrees: Mapping[str, tuple[float | int, ...]]) -> Float[np.ndarray, "J 3"]:
    """Convert a table of rotation vectors by joint (degrees) to all joints' rotation vectors (radians)."""
    pose = np.zeros((len(body.joint_names), 3))
    for name, turn in degrees.items():
        pose[body.joint(name)] = np.radians(turn)
    return pose


def rotvec_to_rotmat(rotvec: Float[np.ndarray, "*B 3"]) -> Float[np.ndarray, "*B 3 3"]:
    """Convert rotation vectors (radians) to rotation matrices."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(rotvec.reshape(-1, 3)).as_matrix().reshape(*rotvec.shape, 3)


def _generator(seed: int, index: int, stream: int) -> np.random.Generator:
    """Make the generator of sample `index`; shapes are stream 0, poses 1, motions 2 and 3 (`motions.procedural`)."""
    return np.random.default_rng(np.random.SeedSequence([seed, index, stream]))
