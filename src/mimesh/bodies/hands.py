"""Finger joints of the shipped body: fifteen a hand, with weights and the axes that fingers bend about.

They come from the same source as the body (`research/recipes/build_hands.py`) and divide the weight that the body's
hand joints have. Joints are called as by Mixamo: LeftHandThumb1 to LeftHandPinky3, the first of each finger below the
hand. In the rest pose fingers are nearly straight.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.geometry import frames_along, rotation_between
from .body_model import RiggedBody, load_body, unpacked_weights
from .character_limbs import SIDES
from .joint_names import FINGER_STUBS, FINGERS, finger_joints, with_finger_joints

HAND_PARENTS = (-1, *(parent for k in range(5) for parent in (0, 3 * k + 1, 3 * k + 2)))
"""Parents within one hand: the hand, then three joints for each of five fingers."""
STORED = ("joints", "joint_components", "flexion", "abduction")
"""Arrays that are stored as they are."""
FLEXION = ((-15, 25), (-10, 55), (-15, 80)) + 4 * ((-20, 90), (0, 100), (0, 75))
"""Least and largest flexion of each joint (degrees), thumb first: American Academy of Orthopaedic Surgeons, "Joint
Motion" (1965), with half of its extension of knuckles (45), which few hands reach without help."""


@dataclass(frozen=True, eq=False)
class Hands:
    """Finger joints of the shipped body at rest; 30 joints, the left hand's first, in the order of `finger_joints`."""

    joints: Float[np.ndarray, "30 3"]
    """Positions of the mean shape (metres)."""
    joint_components: Float[np.ndarray, "K 30 3"]
    """Displacement for one standard deviation of each shape coefficient."""
    shares: Float[np.ndarray, "2 V 16"]
    """Share of the hand and of its 15 joints in the weight of a side's hand, rows sum to 1; where there is none: the
    hand's."""
    flexion: Float[np.ndarray, "30 3"]
    """Unit axis of each joint, in the world at rest: a positive angle bends the finger towards the palm."""
    abduction: Float[np.ndarray, "30 3"]
    """Unit axis across it: a positive angle turns the finger towards the thumb."""


@cache
def load_hands() -> Hands:
    """Load the finger joints of the shipped body."""
    body = load_body()
    path = Path(str(resources.files("mimesh.bodies") / "hands.npz"))
    with np.load(path) as data:
        shares = np.zeros((2, len(body.vertices), 16))
        shares[:, :, 0] = 1.0
        for s in range(2):
            shares[s, data[f"vertices{s}"]] = unpacked_weights(data[f"joints{s}"], data[f"shares{s}"], 16)
        given = {name: data[name].astype(np.float64) for name in STORED}
        return Hands(shares=shares, **given)


@cache
def body_with_fingers() -> RiggedBody:
    """Return the shipped body with thirty finger joints in place of its finger stubs: 55 joints, the same vertices."""
    body, hands = load_body(), load_hands()
    names = with_finger_joints(body.joint_names)
    kept = [body.joint(name) for name in names[:-30]]
    weights = np.concatenate([body.weights[:, kept], np.zeros((len(body.vertices), 30))], axis=1)
    parents = [names.index(body.joint_names[body.parents[j]]) if body.parents[j] >= 0 else -1 for j in kept]
    for s, side in enumerate(SIDES):
        columns = [names.index(name) for name in (f"{side}Hand", *finger_joints(side))]
        weights[:, columns] = hand_weight(body, side)[:, None] * hands.shares[s]
        parents += [columns[parent] for parent in HAND_PARENTS[1:]]
    return dataclasses.replace(
        body,
        joints=np.concatenate([body.joints[kept], hands.joints]),
        joint_components=np.concatenate([body.joint_components[:, kept], hands.joint_components], axis=1),
        weights=weights,
        joint_names=names,
        parents=tuple(parents),
    )


def hand_weight(body: RiggedBody, side: str) -> Float[np.ndarray, " V"]:
    """Add up the weights of a side's hand and finger stubs."""
    return body.weights[:, hand_joints(body.joint_names, side)].sum(axis=1)


def hand_joints(joint_names: tuple[str, ...], side: str) -> list[int]:
    """List the indices of a side's hand and of its finger stubs."""
    wanted = {f"{side}Hand", *(s + stub for s in (side, side[0]) for stub in FINGER_STUBS)}
    return [j for j, name in enumerate(joint_names) if name in wanted]


KNUCKLES = tuple(f"Hand{finger}1" for finger in FINGERS[1:])
"""First joints of the fingers without the thumb, without their side."""
FEWEST_KNUCKLES = 2
"""Knuckles that show where a palm faces."""
ONE_PLACE = 0.05
"""Distance of the outer knuckles over that from the wrist below which they show no direction; people have 0.7."""


def has_hand(joints: Collection[str], side: str) -> bool:
    """Tell whether there is a joint of a side's hand, or one of its fingers, which then hangs on the forearm."""
    on_forearm = f"{side}ForeArm" in joints and not set(finger_joints(side)).isdisjoint(joints)
    return f"{side}Hand" in joints or on_forearm


def hand_frames(
    rest: Mapping[str, Float[np.ndarray, " 3"]], hand: Float[np.ndarray, "3 3"], side: str
) -> dict[str, Float[np.ndarray, "3 3"]]:
    """Compute the rotations of a hand and its finger joints from the shipped body's T-pose to another rest pose.

    A hand is turned as its knuckles are, and each finger joint as its bone; the last of a finger follows the one
    before. Where all knuckles are at one place, the joints after them tell. With one knuckle or none it is taken for a
    straight hand (`straight_hand`): the one of a mitten is where its maker put it, 5 to 25 degrees away. A hand without
    a joint is on the forearm: its direction is that from the elbow to the knuckles.

    Args:
        rest: positions of the forearm, the hand and its finger joints at rest.
        hand: rotation of the forearm.
        side: Left or Right.
    """
    body = body_with_fingers()
    t_pose = {name: body.joints[j] for j, name in enumerate(body.joint_names)}
    wrist, knuckles = f"{side}Hand", [side + knuckle for knuckle in KNUCKLES if side + knuckle in rest]
    if wrist not in rest:
        rest = {**rest, wrist: rest[f"{side}ForeArm"]}
    if len(knuckles) >= FEWEST_KNUCKLES:
        spread, reach = (rest[knuckles[0]] - rest[name] for name in (knuckles[-1], wrist))
        if np.linalg.norm(spread) < ONE_PLACE * np.linalg.norm(reach):
            knuckles = [after for name in knuckles if (after := f"{name[:-1]}2") in rest]
    if len(knuckles) < FEWEST_KNUCKLES:
        hand = hand @ straight_hand(side)
    else:
        hand = _palm(rest, wrist, knuckles) @ _palm(t_pose, wrist, knuckles).T
    frames = {wrist: hand}
    for finger in FINGERS:
        frame = hand
        chain = [name for k in (1, 2, 3) if (name := f"{side}Hand{finger}{k}") in rest]
        for name, tail in itertools.zip_longest(chain, chain[1:]):
            if tail is not None:
                frame = rotation_between(frame @ (t_pose[tail] - t_pose[name]), rest[tail] - rest[name]) @ frame
            frames[name] = frame
    return frames


@cache
def straight_hand(side: str) -> Float[np.ndarray, "3 3"]:
    """Compute the rotation from the shipped body's hand, which hangs relaxed, to one whose palm faces down in a T-pose.

    It is 33 degrees. Rigs are bound with straight hands, and captures begin with them.
    """
    body = body_with_fingers()
    t_pose = {name: body.joints[j] for j, name in enumerate(body.joint_names)}
    along, thumbs = np.array([1.0 if side == "Left" else -1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    return frames_along(along, thumbs) @ _palm(t_pose, f"{side}Hand", [side + knuckle for knuckle in KNUCKLES]).T


def straight_hands(joints: Sequence[str], above: Sequence[tuple[str, ...]]) -> Float[np.ndarray, "J 3 3"]:
    """Return `straight_hand` for the joints of hands whose palm no knuckles show, the identity for all other joints.

    Args:
        joints: names of the joints that are known.
        above: for each of J joints, the names of those that it is or is below.
    """
    turns = np.tile(np.eye(3), (len(above), 1, 1))
    for side in SIDES:
        if sum(side + knuckle in joints for knuckle in KNUCKLES) < FEWEST_KNUCKLES:
            turns[[f"{side}Hand" in names for names in above]] = straight_hand(side)
    return turns


def _palm(at: Mapping[str, Float[np.ndarray, " 3"]], wrist: str, knuckles: list[str]) -> Float[np.ndarray, "3 3"]:
    """Build axes with the first from the wrist to the middle of the knuckles, the second towards the first of them."""
    return frames_along(
        np.mean([at[name] for name in knuckles], axis=0) - at[wrist], at[knuckles[0]] - at[knuckles[-1]]
    )
