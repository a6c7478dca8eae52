"""Finger joints of the shipped body: fifteen a hand, with weights, the axes that fingers bend about, and random poses.

They come from the same source as the body (`research/recipes/build_hands.py`) and divide the weight that the body's
hand joints have. Joints are called as by Mixamo: LeftHandThumb1 to LeftHandPinky3, the first of each finger below the
hand. Poses are gestures within the limits of each joint, as angles of flexion and abduction from the rest pose, whose
fingers are nearly straight. Rotations are about the world's axes at rest, in the frame of the parent, as in
`RiggedBody`, so that one pose fits any hand whose rest pose is aligned.
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
from jaxtyping import Float, Int

from ..core.geometry import rotate_between, rotation_between, unit_vectors
from .body_model import RiggedBody, load_body, unpacked_weights
from .character_limbs import SIDES
from .joint_names import FINGER_STUBS, FINGERS, finger_joints, with_finger_joints
from .sampling import rotvec_to_rotmat

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
    straight hand (`straight_hand`): the only knuckle of a mitten is where its maker put it, 5 to 25 degrees away. A
    hand without a joint is on the forearm: its direction is that from the elbow to the knuckles.

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
    if len(knuckles) >= FEWEST_KNUCKLES and _at_one_place([rest[name] for name in knuckles], rest[wrist]):
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
    return _axes(along, thumbs) @ _palm(t_pose, f"{side}Hand", [side + knuckle for knuckle in KNUCKLES]).T


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


def _at_one_place(knuckles: list[Float[np.ndarray, " 3"]], wrist: Float[np.ndarray, " 3"]) -> bool:
    """Tell whether knuckles are so near to each other that they show no direction."""
    return bool(np.linalg.norm(knuckles[0] - knuckles[-1]) < ONE_PLACE * np.linalg.norm(knuckles[0] - wrist))


def _palm(at: Mapping[str, Float[np.ndarray, " 3"]], wrist: str, knuckles: list[str]) -> Float[np.ndarray, "3 3"]:
    """Build axes with the first from the wrist to the middle of the knuckles, the second towards the first of them."""
    return _axes(np.mean([at[name] for name in knuckles], axis=0) - at[wrist], at[knuckles[0]] - at[knuckles[-1]])


def _axes(first: Float[np.ndarray, " 3"], second: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Build axes with the first along a vector and the second in the plane of both vectors."""
    x = unit_vectors(first)
    y = unit_vectors(second - (second @ x) * x)
    return np.stack([x, y, np.cross(x, y)], axis=1)


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
    fingers = phalanges(joints[1:], tips).reshape(15, 3)
    return unit_vectors(np.concatenate([knuckles[None] - joints[:1], fingers]))


def phalanges(joints: Float[np.ndarray, "15 3"], tips: Float[np.ndarray, "5 3"]) -> Float[np.ndarray, "5 3 3"]:
    """Compute the vectors from each joint of each finger to the next one or to the fingertip."""
    return np.diff(np.concatenate([joints.reshape(5, 3, 3), tips[:, None]], axis=1), axis=1)


FLEXION = ((-15, 25), (-10, 55), (-15, 80)) + 4 * ((-20, 90), (0, 100), (0, 75))
"""Least and largest flexion of each joint (degrees), thumb first: American Academy of Orthopaedic Surgeons, "Joint
Motion" (1965), with half of its extension of knuckles (45), which few hands reach without help."""
ABDUCTION = ((-20, 30), (0, 0), (0, 0)) + 4 * ((-15, 20), (0, 0), (0, 0))
"""The same for abduction; AAOS has 20 degrees for knuckles, and 70 for the thumb from the palm, of which the rest pose
has about half."""
END_RATIO = 2 / 3
"""Flexion of the last joint of a finger over that of the joint before (Rijpkema and Girard 1991)."""
CLOSED, STRAIGHT, RELAXED = np.array([(80.0, 95.0), (0.0, 3.0), (20.0, 28.0)])
"""Flexion of knuckle and middle joint (degrees) of a closed, a straight and a relaxed finger."""
THUMB_IN, THUMB_OUT, THUMB_RELAXED = np.array([(20.0, 40.0, 50.0), (-12.0, -8.0, -10.0), (3.0, 8.0, 12.0)])
"""The same of the thumb's three joints: across the palm, stretched out and relaxed."""
SPREAD, NO_SPREAD = np.array([25.0, 14.0, 2.0, -9.0, -15.0]), np.zeros(5)
"""Abduction of the first joint of each finger (degrees) in a spread hand and at rest; positive towards the thumb."""
GRASP, GRASP_SPREAD = ((15, 15), (65, 70)), 0.6
"""Least and largest flexion of knuckle and middle joint in a grasp (degrees), and its largest share of SPREAD."""
FREE, FREE_SPREAD = 95, 10
"""Largest flexion of knuckles and middle joints, and largest abduction either way, of free fingers (degrees)."""
GESTURES = ("relaxed", "fist", "grasp", "spread", "point", "thumb up", "flat", "free")
"""All are drawn equally often; the joints of a free hand are bent independently."""
NOISE = 6.0
"""Standard deviation of what is added to every angle (degrees); joints that cannot bend sideways stay at zero."""
BLENDED = 0.4
"""Share of poses that are a mixture of two gestures."""


def sample_finger_poses(count: int, rng: np.random.Generator) -> Float[np.ndarray, "N 15 2"]:
    """Draw angles (degrees) of flexion and abduction of the joints of hands, within their limits."""
    first, second = (gestures(rng.integers(len(GESTURES), size=count), rng) for _ in range(2))
    share = rng.random((count, 1, 1)) * (rng.random((count, 1, 1)) < BLENDED)
    return within_limits((1 - share) * first + share * second + rng.normal(0, NOISE, (count, 15, 2)))


def gestures(which: Int[np.ndarray, " N"], rng: np.random.Generator) -> Float[np.ndarray, "N 15 2"]:
    """Make angles (degrees) of the gestures with the given places in GESTURES."""
    angles = np.zeros((len(which), 5, 3, 2))  # finger, its joint, flexion and abduction
    for hand, gesture in zip(angles, which, strict=True):
        fingers, thumb, spread = _gesture(GESTURES[gesture], rng)
        hand[1:, :2, 0], hand[0, :, 0], hand[:, 0, 1] = fingers, thumb, spread
    angles[:, 1:, 2, 0] = END_RATIO * angles[:, 1:, 1, 0]
    return angles.reshape(-1, 15, 2)


def _gesture(
    name: str, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "*F 2"], Float[np.ndarray, "3"], Float[np.ndarray, "5"]]:
    """Make a gesture of GESTURES, as angles (degrees).

    Returns:
        Flexion of knuckle and middle joint of the four fingers (4, 2) or of each of them (2,), flexion of the thumb's
        joints (3,), and abduction of the first joint of each finger (5,).
    """
    match name:
        case "relaxed":
            return RELAXED, THUMB_RELAXED, NO_SPREAD
        case "fist":
            return CLOSED, THUMB_IN, NO_SPREAD
        case "thumb up":
            return CLOSED, THUMB_OUT, NO_SPREAD
        case "point":
            return np.stack([STRAIGHT, CLOSED, CLOSED, CLOSED]), THUMB_IN, NO_SPREAD
        case "flat":
            return STRAIGHT, THUMB_RELAXED, NO_SPREAD
        case "spread":
            return STRAIGHT, THUMB_OUT, SPREAD
        case "grasp":  # all fingers around one thing
            fingers, thumb = rng.uniform(*GRASP), rng.uniform(0, 1) * THUMB_IN
            return fingers, thumb, rng.uniform(0, GRASP_SPREAD) * SPREAD
        case _:  # free: the first row of five is the thumb's, whose joints have limits of their own
            fingers, thumb = rng.uniform(0, FREE, (5, 2))[1:], rng.uniform(*np.array(FLEXION[:3]).T)
            return fingers, thumb, rng.uniform(-1, 1, 5) * FREE_SPREAD


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
