"""Procedural motions of the shipped quadruped: gaits, and ways to sit, lie, eat and look around and back.

Motion `i` is a function of (seed, i) alone. Angles are rotations about the axis to the animal's left, in degrees from
standing: positive ones turn what hangs down backwards, and what points forwards down.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from ..bodies import RiggedBody
from ..bodies.joint_names import without_side
from ..bodies.sampling import rotvec_to_rotmat
from .motion import Motion, rotmat_to_rotvec
from .procedural import planted

LEGS = ("LeftHind", "LeftFront", "RightHind", "RightFront")
"""Order of the phases of a gait."""


SEEDS = {"train": 0, "val": 1, "test": 2}
TAKES = 40
"""Motions of each gait and posture in a split."""


class Gait(NamedTuple):
    """How an animal moves its legs in a cycle."""

    phases: tuple[float, float, float, float]
    """When each of LEGS touches the ground, in cycles."""
    duty: float
    """Share of the cycle that a foot is on the ground."""
    pace: tuple[float, float]
    """Cycles a second: lowest and highest."""
    stride: tuple[float, float]
    """Degrees that a leg swings to either side."""
    back: float = 0.0
    """Degrees that the spine bends and stretches in each cycle."""


class Style(NamedTuple):
    """What is drawn at random for one motion."""

    pace: float
    """Cycles a second."""
    stride: float
    """Degrees that a leg swings to either side."""
    lift: float
    """Factor on how far a foot is lifted."""
    head: float
    """Degrees by which the neck is turned down."""
    tail: float
    """Degrees by which the tail is raised."""
    sway: float
    """Degrees that the tail swings to either side."""
    start: float
    """Where in the cycle the motion begins, from 0 to 1."""

    @classmethod
    def draw(cls, gait: Gait, tail: tuple[float, float], rng: np.random.Generator) -> Style:
        """Draw the style of a motion in a gait, whose tail is raised within some range (degrees)."""
        between = (gait.pace, gait.stride, (0.8, 1.3), (-18, 18), tail, (2, 10), (0, 1))
        return cls(*(rng.uniform(low, high) for low, high in between))


GAITS = {
    "walk": Gait((0.0, 0.25, 0.5, 0.75), 0.65, (0.7, 1.3), (12, 22)),
    "pace": Gait((0.0, 0.0, 0.5, 0.5), 0.52, (1.2, 2.0), (14, 24)),
    "trot": Gait((0.0, 0.5, 0.5, 0.0), 0.48, (1.3, 2.2), (16, 28)),
    "canter": Gait((0.0, 0.3, 0.3, 0.6), 0.42, (1.5, 2.2), (20, 32), 10.0),
    "gallop": Gait((0.0, 0.12, 0.48, 0.6), 0.3, (2.0, 3.0), (28, 42), 22.0),
    "bound": Gait((0.0, 0.45, 0.0, 0.45), 0.3, (1.6, 2.6), (26, 40), 26.0),
}
"""Phases after Hildebrand (1965, 1989); the canter leads with the right foreleg. Those of the gallop are in the order
left hind, right hind, left fore, right fore, which is not that of LEGS: its feet land in the order of an amble. They
stay because networks were trained on these gaits, and test sets are made of them. Clips: `animal_clips.py`."""
POSTURES: dict[str, dict[str, float]] = {
    "sit": {
        **{"Hips": -38, "Spine1": 2, "Spine4": 6, "Chest": 8, "Neck1": 10, "Head": 12, "Tail1": 25},
        **{"Thigh": -52, "Shin": 92, "Foot": -58, "Toes": 55, "Scapula": 10, "UpperArm": 12, "Hand": 4},
    },
    "lie": {
        **{"Thigh": -60, "Shin": 118, "Foot": -82, "Toes": 30, "Scapula": 12, "UpperArm": 48, "Forearm": -130},
        **{"Hand": 62, "Fingers": 8, "Neck1": -6, "Head": 6},
    },
    "eat": {"Neck1": 52, "Neck2": 24, "Neck3": 14, "Head": -10, "Jaw": 10, "Chest": 6, "Scapula": -4},
    "look up": {"Neck1": -28, "Neck2": -14, "Head": -14},
    "stretch": {
        "Hips": 14,
        "Chest": 8,
        "Scapula": -16,
        "UpperArm": -26,
        "Forearm": 8,
        "Neck1": -20,
        "Head": -12,
        "Thigh": -6,
    },
}
"""Angles of the joints from standing, by their names without a side."""


def gait_motion(
    body: RiggedBody, name: str, seed: int, index: int, *, seconds: float = 2.0, fps: float = 30.0
) -> Motion:
    """Generate a gait of random pace, stride, lift, bearing of head and tail; the feet on the ground give the path."""
    rotmat = gait_rotations(body, name, seed, index, seconds, fps)
    return Motion(f"{name}-{seed}-{index}", body.joint_names, rotmat, planted(body, rotmat), float(fps))


def gait_rotations(
    body: RiggedBody, name: str, seed: int, index: int, seconds: float, fps: float
) -> Float[np.ndarray, "T J 3 3"]:
    """Generate the joint rotations of a gait; its path takes longer."""
    gait = GAITS[name]
    rng = np.random.default_rng(np.random.SeedSequence([seed, index, 4, list(GAITS).index(name)]))
    style = Style.draw(gait, (-35.0, 15.0), rng)
    return gait_pose(body, gait, style, style.start + style.pace * np.arange(max(round(seconds * fps), 1)) / fps)


def gait_pose(
    body: RiggedBody, gait: Gait, style: Style, cycle: Float[np.ndarray, " T"], sways: bool = True
) -> Float[np.ndarray, "T J 3 3"]:
    """Compute the joint rotations of a gait in some style.

    Args:
        cycle: where in its cycles the gait is, in each frame.
        sways: whether the trunk bends to the sides.
    """
    turn = np.zeros((len(cycle), len(body.joint_names), 3))

    def bend(joint: str, degrees: Float[np.ndarray, " T"] | float, axis: int = 0) -> None:
        turn[:, body.joint(joint), axis] += degrees

    # The back is bent while the hind feet reach forward.
    reaching = gait.back * np.cos(2 * np.pi * (cycle + 0.12))
    for joint in ("Spine1", "Spine2", "Spine3", "Spine4"):
        bend(joint, reaching / 4)
        bend(joint, sways * 0.1 * style.stride * np.sin(2 * np.pi * cycle), axis=1)
    bend("Hips", -reaching / 2)
    for joint, share in (("Neck1", 0.6), ("Neck2", 0.4), ("Head", -0.7)):
        bend(joint, share * style.head + 0.12 * style.stride * share * np.sin(4 * np.pi * cycle))
    for k in range(1, 7):
        bend(f"Tail{k}", style.tail / 6)
        bend(f"Tail{k}", style.sway * np.sin(2 * np.pi * (cycle - 0.08 * k)), axis=1)
    for leg, start in zip(LEGS, gait.phases, strict=True):
        side, of_leg = leg.removesuffix("Hind").removesuffix("Front"), hind_leg if leg.endswith("Hind") else foreleg
        for joint, degrees in of_leg((cycle - start) % 1.0, gait.duty, style.stride, style.lift).items():
            bend(side + joint, degrees)
    return rotvec_to_rotmat(np.radians(turn))


def swing(phase: Float[np.ndarray, " T"], duty: float) -> tuple[Float[np.ndarray, " T"], Float[np.ndarray, " T"]]:
    """Give where a leg is between front (-1) and back (1), and how much it is lifted (0 to 1), by its phase."""
    stance = np.clip(phase / duty, 0.0, 1.0)
    air = np.clip((phase - duty) / (1.0 - duty), 0.0, 1.0)
    place = np.where(phase < duty, 2.0 * stance - 1.0, np.cos(np.pi * air))
    return place, np.where(phase < duty, 0.0, np.sin(np.pi * air) ** 2)


def foreleg(
    phase: Float[np.ndarray, " T"], duty: float, stride: float, lift: float
) -> dict[str, Float[np.ndarray, " T"]]:
    """Compute the angles of a foreleg: elbow and wrist fold in the air, the foot stays level on the ground."""
    place, up = swing(phase, duty)
    return {
        "Scapula": 0.35 * stride * place,
        "UpperArm": 0.6 * stride * place + 8.0 * lift * up,
        "Forearm": -45.0 * lift * up,
        "Hand": 62.0 * lift * up - 0.15 * stride * place,
        "Fingers": 20.0 * lift * up - 0.6 * stride * place * (up == 0.0),
    }


def hind_leg(
    phase: Float[np.ndarray, " T"], duty: float, stride: float, lift: float
) -> dict[str, Float[np.ndarray, " T"]]:
    """Compute the angles of a hind leg: knee and hock fold in the air together."""
    place, up = swing(phase, duty)
    return {
        "Thigh": 0.9 * stride * place - 14.0 * lift * up,
        "Shin": 42.0 * lift * up + 0.1 * stride * place,
        "Foot": -34.0 * lift * up - 0.1 * stride * place,
        "Toes": 30.0 * lift * up - 0.7 * stride * place * (up == 0.0),
    }


def posture_motion(
    body: RiggedBody, name: str, seed: int, index: int, *, seconds: float = 2.0, fps: float = 30.0
) -> Motion:
    """Generate the way from standing into a posture and back, with small random turns of all joints."""
    rotmat = posture_rotations(body, name, seed, index, seconds, fps)
    return Motion(f"{name}-{seed}-{index}", body.joint_names, rotmat, planted(body, rotmat), float(fps))


def posture_rotations(
    body: RiggedBody, name: str, seed: int, index: int, seconds: float, fps: float
) -> Float[np.ndarray, "T J 3 3"]:
    """Generate the joint rotations of a posture."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, index, 5, list(POSTURES).index(name)]))
    at = np.linspace(0.0, 1.0, max(round(seconds * fps), 1))
    share = np.sin(np.pi * at)[:, None, None] ** 2 * rng.uniform(0.7, 1.1)
    goal = np.zeros((len(body.joint_names), 3))
    for j, joint in enumerate(body.joint_names):
        goal[j, 0] = POSTURES[name].get(without_side(joint), 0.0)
    turn = share * (goal + rng.normal(0.0, 3.0, goal.shape))
    return rotvec_to_rotmat(np.radians(turn))


def quadruped_poses(body: RiggedBody, split: Literal["train", "val", "test"]) -> Float32[np.ndarray, "N J 3"]:
    """Make the poses of a split as rotation vectors: frames of `quadruped_takes`, ten a second."""
    return np.concatenate(quadruped_takes(body, split, fps=10.0))


def quadruped_takes(
    body: RiggedBody, split: Literal["train", "val", "test"], fps: float
) -> list[Float32[np.ndarray, "T J 3"]]:
    """Make all gaits and postures of a split, 2 seconds each, with its seeds, as rotation vectors (radians)."""
    seed = SEEDS[split]
    takes = [gait_rotations(body, name, seed, i, 2.0, fps) for name in GAITS for i in range(TAKES)]
    takes += [posture_rotations(body, name, seed, i, 2.0, fps) for name in POSTURES for i in range(TAKES)]
    return [rotmat_to_rotvec(take).astype(np.float32) for take in takes]
