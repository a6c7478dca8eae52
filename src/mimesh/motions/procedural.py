"""Procedural motions: splines through random poses, and walks. Motion `i` is a function of (seed, i) alone.

They contain no captured data, so their number and use are not limited. The root's path is computed from the feet
(`planted`), so that soles stay on the floor without sliding.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ..bodies import RiggedBody
from ..bodies.sampling import JOINT_LIMITS, limits_rotvec, pose_of, rotvec_to_rotmat
from .motion import Motion, lowest

SOLE = 0.03
"""Vertices below this height at rest (metres) are the soles."""
SOFTNESS = 0.004
"""Height (metres) by which the weight of a vertex of the soles falls by a factor of e."""
LOWERED_ARMS = {"LeftArm": (0.0, 0.0, -72.0), "RightArm": (0.0, 0.0, 72.0)}
"""Rotation vectors (degrees) that lower the arms of a T-pose."""


def spline_motion(
    body: RiggedBody,
    seed: int,
    index: int,
    *,
    seconds: float = 2.0,
    fps: float = 30.0,
    reach: float = 0.6,
    beat: float = 0.6,
) -> Motion:
    """Generate a smooth motion through random poses within `JOINT_LIMITS`, with a random heading.

    Keyframes are `beat` seconds apart. Each is interpolated, by `reach` (0..1), between standing with lowered arms and
    a uniform sample of the limits. Rotation vectors between keyframes are monotone cubics (PCHIP), which stay within
    the values of the keyframes and so within the limits. Limbs may intersect the body.
    """
    from scipy.interpolate import PchipInterpolator

    rng = np.random.default_rng(np.random.SeedSequence([seed, index, 2]))
    at = np.arange(max(round(seconds * fps), 1)) / fps
    keys = np.arange(int(np.ceil(seconds / beat)) + 2) * beat
    low, high = limits_rotvec(body, JOINT_LIMITS)
    standing = pose_of(body, LOWERED_ARMS)
    poses = standing + reach * (rng.uniform(low, high, (len(keys), *low.shape)) - standing)
    rotmat = rotvec_to_rotmat(PchipInterpolator(keys, poses)(at))
    heading = PchipInterpolator(keys, rng.uniform(-np.pi, np.pi) + rng.normal(0, 0.5, len(keys)).cumsum())(at)
    # The heading turns the root about the vertical axis, after its rotation within the limits.
    rotmat[:, 0] = _about(1, heading) @ rotmat[:, 0]
    return Motion(f"spline-{seed}-{index}", body.joint_names, rotmat, planted(body, rotmat), float(fps))


def walk_motion(body: RiggedBody, seed: int, index: int, *, seconds: float = 2.0, fps: float = 30.0) -> Motion:
    """Generate a walk with random pace, stride, bounce, arm swing, stoop and turn; the planted foot gives the path.

    The pace is in cycles per second, all angles are in degrees.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, index, 3]))
    pace, stride, swing = rng.uniform(0.7, 1.1), rng.uniform(16, 30), rng.uniform(5, 35)
    elbow, stoop, lift = rng.uniform(10, 70), rng.uniform(-4, 12), rng.uniform(45, 75)
    at = np.arange(max(round(seconds * fps), 1)) / fps
    step = rng.random() + pace * at
    turn = rng.uniform(-np.pi, np.pi) + np.radians(rng.uniform(-35, 35)) * at
    rotmat = np.tile(np.eye(3), (len(at), len(body.joint_names), 1, 1))

    def set_joint(name: str, *turns: tuple[int, Float[np.ndarray, " T"] | float]) -> None:
        """Apply rotations given as (axis, degrees) to a joint, one after the other."""
        for axis, degrees in turns:
            angle = np.broadcast_to(np.radians(degrees), at.shape)
            rotmat[:, body.joint(name)] = rotmat[:, body.joint(name)] @ _about(axis, angle)

    wave = np.cos(2 * np.pi * step)  # 1 when the left heel strikes
    set_joint("Hips", (1, np.degrees(turn) - 0.2 * stride * wave), (2, 2.5 * np.sin(2 * np.pi * step)))
    set_joint("LowerBack", (0, stoop / 2), (1, 0.15 * stride * wave))
    set_joint("Spine", (0, stoop / 2), (1, 0.15 * stride * wave), (2, -2.5 * np.sin(2 * np.pi * step)))
    set_joint("Head", (0, -stoop / 2))
    for side, sign, phase in (("Left", 1.0, step), ("Right", -1.0, step + 0.5)):
        leg = gait(phase, stride, lift)
        set_joint(f"{side}UpLeg", (0, leg["hip"]))
        set_joint(f"{side}Leg", (0, leg["knee"]))
        set_joint(f"{side}Foot", (0, leg["ankle"]))
        set_joint(f"{side}ToeBase", (0, leg["toes"]))
        back = swing * np.cos(2 * np.pi * phase)  # arms swing against the legs
        set_joint(f"{side}Arm", (0, back), (2, -72.0 * sign))
        set_joint(f"{side}ForeArm", (1, -sign * (elbow - 0.4 * back)))
    return Motion(f"walk-{seed}-{index}", body.joint_names, rotmat, planted(body, rotmat), float(fps))


def gait(phase: Float[np.ndarray, " T"], stride: float, lift: float) -> dict[str, Float[np.ndarray, " T"]]:
    """Compute the joint angles of one leg (degrees about the x axis); `phase` counts its steps from heel strike.

    Sums of smooth bumps approximate charts of human gait: the knee flexes once under load and up to `lift` in swing,
    and the heel rises before the toes leave the ground at phase 0.6.
    """
    hip = -stride * np.cos(2 * np.pi * phase) - 0.15 * stride
    knee = 4.0 + 12.0 * _bump(phase, 0.14, 0.08) + (lift - 4.0) * _bump(phase, 0.74, 0.10)
    ankle = 5.0 * _bump(phase, 0.08, 0.05) - 9.0 * _bump(phase, 0.42, 0.12) + 20.0 * _bump(phase, 0.63, 0.06)
    return {"hip": hip, "knee": knee, "ankle": ankle - 4.0, "toes": -25.0 * _bump(phase, 0.58, 0.06)}


def planted(body: RiggedBody, rotmat: Float[np.ndarray, "T J 3 3"]) -> Float[np.ndarray, "T 3"]:
    """Compute the root's path (metres, from x = z = 0) on which the planted sole does not slide.

    From frame to frame the root moves against the mean motion of the soles, with the largest weights on the lowest
    vertices. Then the lowest vertex of the mean shape is placed at height 0 in every frame, so jumps are impossible.
    """
    sole = np.flatnonzero(body.vertices[:, 1] < SOLE)
    # Only the vertices of the soles are posed, with the root at the origin.
    soles = body.part(sole).posed(np.zeros(0), rotmat, np.zeros((len(rotmat), 3)))
    height = soles[:-1, :, 1] + soles[1:, :, 1]
    # A soft minimum over two frames: the sole that is lowest in both carries the body.
    weight = np.exp(-(height - height.min(axis=1, keepdims=True)) / (2 * SOFTNESS))
    moved = np.einsum("tv,tvc->tc", weight / weight.sum(axis=1, keepdims=True), np.diff(soles, axis=0))
    root = np.zeros((len(rotmat), 3))
    # The root cancels the horizontal motion of the sole that carries the body.
    root[1:, [0, 2]] = -np.cumsum(moved, axis=0)[:, [0, 2]]
    root[:, 1] = -lowest(body, rotmat, np.zeros_like(root))
    return root


def _bump(phase: Float[np.ndarray, " T"], centre: float, width: float) -> Float[np.ndarray, " T"]:
    """Compute a periodic Gaussian of height 1 at `centre` (0..1) of every cycle."""
    offset = (phase - centre + 0.5) % 1.0 - 0.5
    return np.exp(-0.5 * (offset / width) ** 2)


def _about(axis: int, angle: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T 3 3"]:
    return rotvec_to_rotmat(angle[:, None] * np.eye(3)[axis])
