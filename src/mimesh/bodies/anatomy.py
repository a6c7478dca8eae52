"""What the joints of each shipped body are: limbs, legs that stand on the ground, ends of limbs, carriers of props."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from .animal_limbs import TRUNK
from .character_limbs import SIDES


@dataclass(frozen=True)
class Anatomy:
    """Names of the joints of a shipped body by what they are."""

    legs: tuple[tuple[str, str, str], ...]
    """Of each leg that stands on the ground: hip or shoulder, knee or elbow, ankle or wrist."""
    arms: tuple[tuple[str, str, str], ...]
    """Of each arm whose hand may stand on the ground: shoulder, elbow, wrist."""
    hinges: tuple[tuple[str, str, str], ...]
    """Of each arm and leg: its first joint, the elbow or knee, and the wrist or ankle."""
    long_bones: tuple[str, ...]
    """Joints of the long bones of arms and legs."""
    ends: tuple[tuple[str, ...], ...]
    """Hands and feet, or forefeet and hind feet: the joints of each kind, on both sides."""
    regions: dict[str, str]
    """Head and limbs as messages name them -> the first joint of each."""
    inner: tuple[str, ...]
    """Joints that are well inside of the surface; empty where legs are so thin that this tells nothing."""
    optional_trunk: tuple[str, ...]
    """Joints of the trunk that many rigs lack, so that one joint moves all of it."""
    props: dict[str, float]
    """Share of the hats, saddles, swords, ... that figures wear or carry on each joint. Chosen by hand."""


def _both(*parts: str) -> tuple[str, ...]:
    return tuple(side + part for side in SIDES for part in parts)


_HUMAN_LEGS = tuple((f"{side}UpLeg", f"{side}Leg", f"{side}Foot") for side in SIDES)
_ARMS = tuple((f"{side}Arm", f"{side}ForeArm", f"{side}Hand") for side in SIDES)
_ANIMAL_LEGS = tuple(
    (side + upper, side + middle, side + end)
    for upper, middle, end in (("UpperArm", "Forearm", "Hand"), ("Thigh", "Shin", "Foot"))
    for side in SIDES
)
HUMAN = Anatomy(
    legs=_HUMAN_LEGS,
    arms=_ARMS,
    hinges=(*_ARMS, *_HUMAN_LEGS),
    long_bones=_both("Arm", "ForeArm", "UpLeg", "Leg"),
    ends=(
        (*_both("Hand", "FingerBase", "HandFinger1"), "LThumb", "RThumb"),
        _both("Foot", "ToeBase"),
    ),
    regions={
        "head": "Neck",
        **{f"{side.lower()} arm": f"{side}Arm" for side in SIDES},
        **{f"{side.lower()} leg": f"{side}UpLeg" for side in SIDES},
    },
    inner=(
        *("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1"),
        *_both("Shoulder", "Arm", "ForeArm", "UpLeg", "Leg"),
    ),
    optional_trunk=(),
    props={
        "Head": 0.3,
        "LeftHand": 0.12,
        "RightHand": 0.12,
        "Spine1": 0.16,
        "Hips": 0.08,
        "LeftForeArm": 0.04,
        "RightForeArm": 0.04,
        "LeftShoulder": 0.03,
        "RightShoulder": 0.03,
        "LeftLeg": 0.04,
        "RightLeg": 0.04,
    },
)
QUADRUPED = Anatomy(
    legs=_ANIMAL_LEGS,
    arms=(),
    hinges=_ANIMAL_LEGS,
    long_bones=_both("UpperArm", "Forearm", "Hand", "Thigh", "Shin", "Foot"),
    ends=(_both("Fingers"), _both("Toes")),
    regions={
        "head": "Neck1",
        **{f"{side.lower()} foreleg": f"{side}UpperArm" for side in SIDES},
        **{f"{side.lower()} hind leg": f"{side}Thigh" for side in SIDES},
    },
    inner=(),
    optional_trunk=tuple(TRUNK),
    props={"Head": 0.3, "Chest": 0.2, "Spine3": 0.2, "Hips": 0.15, "Neck2": 0.15},
)


def anatomy_of(body: str) -> Anatomy:
    """Return the anatomy of a shipped body by its name, `human` or `quadruped`."""
    return QUADRUPED if body == "quadruped" else HUMAN


def anatomy_of_joints(names: Collection[str]) -> Anatomy:
    """Return the anatomy of the shipped body whose legs are among some joints; that of the human if none has them."""
    return QUADRUPED if any(leg[0] in names for leg in QUADRUPED.legs) else HUMAN


def body_of_joints(names: Collection[str]) -> str:
    """Return the name of the shipped body whose legs are among some joints; `human` if none has them."""
    return "quadruped" if anatomy_of_joints(names) is QUADRUPED else "human"
