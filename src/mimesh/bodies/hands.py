"""Finger joints of the shipped body: fifteen a hand, with weights and the axes that fingers bend about.

They come from the same source as the body (`research/recipes/build_hands.py`) and divide the weight that the body's
hand joints have. Joints are called as by Mixamo: LeftHandThumb1 to LeftHandPinky3, the first of each finger below the
hand.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.geometry import rotate_between, unit_vectors
from .body_model import RiggedBody, load_body
from .character_limbs import SIDES
from .joint_names import FINGER_STUBS, finger_joints, with_finger_joints

HAND_PARENTS = (-1, *(parent for k in range(5) for parent in (0, 3 * k + 1, 3 * k + 2)))
"""Parents within one hand: the hand, then three joints for each of five fingers."""
STORED = ("joints", "joint_components", "flexion", "abduction")
"""Arrays that are stored as they are."""
TIP_SHARE = 0.5
"""Share of a finger's last joint from which on a vertex can be the fingertip."""
OF_HAND = 0.5
"""Weight of the hand and its finger stubs from which on a vertex belongs to the hand."""


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
            rows = np.zeros((len(data[f"vertices{s}"]), 16))
            np.put_along_axis(rows, data[f"joints{s}"].astype(int), data[f"shares{s}"].astype(np.float64), axis=1)
            shares[s, data[f"vertices{s}"]] = rows / rows.sum(axis=1, keepdims=True)
        given = {name: data[name].astype(np.float64) for name in STORED}
        return Hands(shares=shares, **given)


def save_hands(path: Path, hands: Hands, influences: int) -> None:
    """Write a compact `.npz` with the largest shares of each vertex that a finger joint moves.

    Args:
        influences: number of shares of a vertex.
    """
    arrays = {}
    for s in range(2):
        moved = np.flatnonzero(hands.shares[s, :, 0] < 1.0)
        strongest = np.argsort(-hands.shares[s, moved], axis=1)[:, :influences]
        arrays[f"vertices{s}"] = moved.astype(np.uint16)
        arrays[f"joints{s}"] = strongest.astype(np.uint8)
        arrays[f"shares{s}"] = np.take_along_axis(hands.shares[s, moved], strongest, axis=1).astype(np.float16)
    for name in STORED:
        arrays[name] = getattr(hands, name).astype(np.float32)
    np.savez_compressed(path, **arrays)


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


def bend_axes(
    wrist: Float[np.ndarray, " 3"], joints: Float[np.ndarray, "15 3"], tips: Float[np.ndarray, "5 3"]
) -> tuple[Float[np.ndarray, "15 3"], Float[np.ndarray, "15 3"]]:
    """Compute unit axes of flexion and abduction from the joints and fingertips of a left hand at rest.

    Fingers bend towards the palm's normal, and spread in the plane of the palm. The thumb bends across the palm,
    towards the first joint of the little finger.
    """
    bones = unit_vectors(_phalanges(joints, tips))
    goal = np.tile(-palm_frame(wrist, joints)[:, 1], (5, 3, 1))
    goal[0] = joints[12] - joints[1]
    flexion = unit_vectors(np.cross(bones, goal))
    abduction = unit_vectors(np.cross(flexion, bones))
    return flexion.reshape(15, 3), abduction.reshape(15, 3)


def palm_frame(wrist: Float[np.ndarray, " 3"], joints: Float[np.ndarray, "15 3"]) -> Float[np.ndarray, "3 3"]:
    """Compute the axes of a left palm as columns, as in the T-pose: x along the hand, y off its back, z to the thumb.

    Joints are those of `finger_joints`: rows 3, 6, 9 and 12 are the knuckles, from the index to the little finger.
    """
    x = unit_vectors(joints[[3, 6, 9, 12]].mean(axis=0) - wrist)
    across = joints[3] - joints[12]
    z = unit_vectors(across - (across @ x) * x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def fingertips(
    vertices: Float[np.ndarray, "V 3"], weights: Float[np.ndarray, "V 15"], joints: Float[np.ndarray, "15 3"]
) -> list[int]:
    """Find the vertex at the end of each finger: the farthest along its last bone among those of its last joint.

    Args:
        weights: of the finger joints, or their shares in the weight of the hand.
    """
    found = []
    for finger in range(5):
        last = 3 * finger + 2
        share = weights[:, last]
        along = (vertices - joints[last]) @ (joints[last] - joints[last - 1])
        found.append(int(np.where(share >= min(TIP_SHARE, share.max()), along, -np.inf).argmax()))
    return found


@cache
def left_hand_body() -> RiggedBody:
    """Return the left hand of the shipped body's mean shape: 16 joints, the hand first, and no shape components."""
    body, hands = load_body(), load_hands()
    kept = np.flatnonzero(hand_weight(body, "Left") > OF_HAND)
    rank = np.full(len(body.vertices), -1)
    rank[kept] = np.arange(len(kept))
    return RiggedBody(
        name="left hand",
        vertices=body.vertices[kept],
        faces=rank[body.faces[(rank[body.faces] >= 0).all(axis=1)]],
        components=np.zeros((0, len(kept), 3)),
        joints=np.concatenate([body.joints[[body.joint("LeftHand")]], hands.joints[:15]]),
        joint_components=np.zeros((0, 16, 3)),
        weights=hands.shares[0, kept],
        joint_names=("LeftHand", *finger_joints("Left")),
        parents=HAND_PARENTS,
    )


def hand_alignment(
    joints: Float[np.ndarray, "16 3"], tips: Float[np.ndarray, "5 3"]
) -> tuple[Float[np.ndarray, "16 3 3"], Float[np.ndarray, "16 3"]]:
    """Compute the rotation of each joint from the shipped body's left hand at rest to another left hand at rest.

    The hand's is that of its palm; a finger joint's is the palm's, then the smallest one to the direction of its bone.
    Also returns the unit directions of the bones of the other hand, which end at joints and fingertips.
    """
    ours = left_hand_body()
    our_tips = ours.vertices[fingertips(ours.vertices, ours.weights[:, 1:], ours.joints[1:])]
    bones, our_bones = (_bones(at, ends) for at, ends in ((joints, tips), (ours.joints, our_tips)))
    palm = palm_frame(joints[0], joints[1:]) @ palm_frame(ours.joints[0], ours.joints[1:]).T
    # Each column of the palm's rotation, a row of its transpose, is rotated as the bone of each finger joint is.
    old, new = (np.repeat(directions[1:], 3, axis=0) for directions in (our_bones @ palm.T, bones))
    columns = rotate_between(old, new, np.tile(palm.T, (15, 1))).reshape(15, 3, 3)
    return np.concatenate([palm[None], columns.swapaxes(-1, -2)]), bones


def _bones(joints: Float[np.ndarray, "16 3"], tips: Float[np.ndarray, "5 3"]) -> Float[np.ndarray, "16 3"]:
    """Compute unit directions from the hand to its knuckles, and from each finger joint to the next or to the tip."""
    knuckles = joints[[4, 7, 10, 13]].mean(axis=0)
    fingers = _phalanges(joints[1:], tips).reshape(15, 3)
    return unit_vectors(np.concatenate([knuckles[None] - joints[:1], fingers]))


def _phalanges(joints: Float[np.ndarray, "15 3"], tips: Float[np.ndarray, "5 3"]) -> Float[np.ndarray, "5 3 3"]:
    """Compute the vectors from each joint of each finger to the next one or to the fingertip."""
    return np.diff(np.concatenate([joints.reshape(5, 3, 3), tips[:, None]], axis=1), axis=1)
