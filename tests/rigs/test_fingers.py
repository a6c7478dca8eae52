"""Hands of fewer fingers or other joints than the driving's: all of its fingers bend them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest
import rigs
from people import decimation, rigged
from scipy.spatial.transform import Rotation

from mimesh.bodies.hands import body_with_fingers
from mimesh.bodies.joint_names import FINGERS, finger_joints, stands_for
from mimesh.core.mesh import Mesh
from mimesh.core.normalization import Normalization
from mimesh.motions.humanoid_rig import HumanoidRig, humanoid_rig
from mimesh.rigs.character import Character

PERSON = rigs.figure(None, fingers=True)
BENDS = {"Thumb": 15.0, "Index": 5.0, "Middle": 10.0, "Ring": 20.0, "Pinky": 30.0}
"""Angle (degrees) by which each joint of a finger of the left hand is bent."""
REST = ("Middle", "Ring", "Pinky")
HANDS: dict[str, tuple[dict[str, tuple[str, ...]], dict[str, float]]] = {
    "mitten": ({"Thumb": ("Thumb",), "Middle": FINGERS[1:]}, {"Thumb": 15.0, "Middle": 16.25}),
    "mitten without a thumb": ({"Middle": FINGERS[1:]}, {"Middle": 16.25}),
    "two": ({"Thumb": ("Thumb",), "Index": ("Index",), "Pinky": REST}, {"Thumb": 15.0, "Index": 5.0, "Pinky": 20.0}),
    "three": (
        {"Thumb": ("Thumb",), "Index": ("Index",), "Middle": ("Middle",), "Pinky": ("Ring", "Pinky")},
        {"Thumb": 15.0, "Index": 5.0, "Middle": 10.0, "Pinky": 25.0},
    ),
    "four": ({finger: (finger,) for finger in FINGERS}, BENDS),
}
"""Fingers of a hand, the person's that each of them is made of, and the bend (degrees) of their joints."""


def left(finger: str, k: int) -> str:
    return f"LeftHand{finger}{k}"


def joined(fingers: Mapping[str, tuple[str, ...]]) -> rigs.Figure:
    """Give a person a left hand of fewer fingers, each in the middle of some of the person's."""
    names, joints, weights = PERSON.names, PERSON.joints.copy(), PERSON.weights.copy()
    gone = [left(finger, k) for finger in FINGERS if finger not in fingers for k in (3, 2, 1)]
    for kept, of in fingers.items():
        for k in (1, 2, 3):
            columns = [names.index(left(finger, k)) for finger in of]
            joints[names.index(left(kept, k))] = joints[columns].mean(axis=0)
            total = weights[:, columns].sum(axis=1)
            weights[:, columns] = 0.0
            weights[:, names.index(left(kept, k))] = total
    return dataclasses.replace(PERSON, joints=joints, weights=weights).without(*gone)


def unnamed(name: str) -> str:
    """Give finger joints names that say nothing."""
    return f"bone_{finger_joints('Left').index(name) * 7 % 31}" if name in finger_joints("Left") else name


def read(person: rigs.Figure, called=str) -> HumanoidRig:
    (kept, triangles), names = decimation(2000), tuple(called(name) for name in person.names)
    mesh = Mesh(person.vertices[kept], triangles)
    character = rigged(mesh, names, person.parents, person.joints, person.weights[kept])
    return humanoid_rig(character, np.eye(3), {}, lambda: np.zeros((0, len(names), 4, 4)), "a.glb")[0]


def character(person: rigs.Figure, called=str) -> Character:
    rig = read(person, called)
    norm = Normalization(np.eye(3), np.zeros(3), 1.0, "+y", "+z", False, 1.0)
    return Character.of_file(rig, norm, rig.character.mesh.vertices)


def about_z(degrees: float) -> np.ndarray:
    return Rotation.from_euler("z", degrees, degrees=True).as_matrix()


def bent(bends: Mapping[str, float]) -> tuple[tuple[str, ...], np.ndarray]:
    """Return names and rotations of the joints of a T-pose, then with bent fingers, in two frames."""
    body = body_with_fingers()
    rotation = np.tile(np.eye(3), (2, len(body.joint_names), 1, 1))
    for finger, angle in bends.items():
        for k in (1, 2, 3):
            rotation[1, body.joint(left(finger, k))] = about_z(k * angle)
    return body.joint_names, rotation


def followed(own: Character, names: tuple[str, ...], rotation: np.ndarray) -> dict[str, float]:
    """Return by how many degrees each joint turns between both frames, relative to its parent; positive about z."""
    linked = own.linked(names).rotations(rotation, np.zeros(rotation.shape[:-1]))
    turned = linked[1] @ linked[0].swapaxes(-1, -2)
    angles = {}
    for j, (name, parent) in enumerate(zip(own.joints, own.parents, strict=True)):
        angle = Rotation.from_matrix(turned[j] @ turned[parent].T if parent >= 0 else turned[j]).as_rotvec(degrees=True)
        angles[name] = float(np.copysign(np.linalg.norm(angle), angle[2]))
    return angles


@pytest.mark.parametrize("called", [str, unnamed])
@pytest.mark.parametrize("hand", HANDS)
def test_each_finger_has_the_mean_bend_of_those_that_it_stands_for(hand, called):
    fingers, expected = HANDS[hand]
    angles = followed(character(joined(fingers), called), *bent(BENDS))
    for finger in fingers:
        for k in (1, 2, 3):
            assert angles[called(left(finger, k))] == pytest.approx(expected[finger], abs=1e-3), (finger, k)


def with_joints(count: int) -> rigs.Figure:
    """Give the left middle finger other joints than three."""
    if count == 4:
        return PERSON.between(left("Middle", 0), left("Middle", 2), left("Middle", 3))
    return PERSON.without(*(left("Middle", k) for k in range(3, count, -1)))


@pytest.mark.parametrize(("count", "bend", "expected"), [(1, 20, 60), (2, 20, 30), (4, 20, 15), (1, 80, 100)])
def test_bends_are_spread_over_the_joints_of_a_finger(count, bend, expected):
    """One joint does not turn through the palm."""
    angles = followed(character(with_joints(count)), *bent({"Middle": bend}))
    found = [angle for name, angle in angles.items() if name.startswith("LeftHandMiddle")]
    np.testing.assert_allclose(found, [expected] * count, atol=1e-3)


def driven(person: rigs.Figure, bends: Mapping[str, float]) -> tuple[tuple[str, ...], np.ndarray]:
    """Return names and rotations of a rigged driving whose fingers are bent, in two frames."""
    rig = read(person)
    turns = {name: about_z(angle) for name, angle in bends.items()}
    world = np.stack([person.pose({}), person.pose(turns)])
    at_rest = np.tile(np.eye(4), (len(person.names), 1, 1))
    at_rest[:, :3, 3] = person.joints
    index = [person.names.index(rig.character.joint_names[rig.joints[name]]) for name in rig.person]
    motion = rig.motion((world @ at_rest)[:, index], at_rest[index])
    return motion.joints, motion.rotation


@pytest.mark.parametrize(
    ("fingers", "bends"),
    [
        ({"Middle": FINGERS[1:]}, {"Middle": BENDS}),
        ({"Index": ("Index",), "Pinky": REST}, {"Index": ["Index"], "Pinky": REST}),
        ({"Index": ("Index",), "Middle": ("Middle",), "Pinky": ("Ring", "Pinky")},
         {"Index": ["Index"], "Middle": ["Middle"], "Pinky": ["Ring", "Pinky"]}),
    ],
    ids=["mitten", "two", "three"],
)  # fmt: skip
def test_fingers_that_the_driving_lacks_follow_the_one_that_stands_for_them(fingers, bends):
    turned = {left(finger, k): 10.0 * (n + 1) for n, finger in enumerate(fingers) for k in (1, 2, 3)}
    angles = followed(character(PERSON), *driven(joined(fingers), turned))
    for n, finger in enumerate(fingers):
        for follower in bends[finger]:
            expected = 10.0 * (n + 1) if follower != "Thumb" else 0.0
            assert angles[left(follower, 1)] == pytest.approx(expected, abs=1e-3), follower


def without_hand() -> rigs.Figure:
    """Hang the left fingers on the forearm, as characters without joints of hands have them."""
    hand, forearm = PERSON.names.index("LeftFingerBase"), PERSON.names.index("LeftForeArm")
    below = [name for name in finger_joints("Left") if name.endswith("1")]
    parents = tuple(
        forearm if name in below else parent for name, parent in zip(PERSON.names, PERSON.parents, strict=True)
    )
    weights = PERSON.weights.copy()
    weights[:, forearm] += weights[:, hand]
    weights[:, hand] = 0.0
    person = dataclasses.replace(PERSON, parents=parents, weights=weights)
    return person.without("LeftHandFinger1", "LeftFingerBase", "LThumb", "LeftHand")


def test_fingers_on_a_forearm_bend_as_on_a_hand():
    """The wrist, which it lacks, does not bend them."""
    names, rotation = bent(BENDS)
    hand = [names.index(name) for name in ("LeftHand", *finger_joints("Left"))]
    rotation[1, hand] = Rotation.from_euler("x", 40, degrees=True).as_matrix() @ rotation[1, hand]
    angles = followed(character(without_hand()), names, rotation)
    for finger, bend in BENDS.items():
        for k in (1, 2, 3):
            assert angles[left(finger, k)] == pytest.approx(bend, abs=1e-3), (finger, k)


def test_a_forearm_with_fingers_drives_a_hand():
    turned = {left(finger, k): angle for finger, angle in BENDS.items() for k in (1, 2, 3)}
    angles = followed(character(PERSON), *driven(without_hand(), turned))
    assert angles["LeftHand"] == pytest.approx(0.0, abs=1e-3)
    for name, angle in turned.items():
        assert angles[name] == pytest.approx(angle, abs=1e-3), name


def test_every_finger_is_stood_for_by_one():
    for present in ({"Index"}, {"Thumb", "Ring"}, {"Index", "Pinky"}, {"Middle", "Pinky"}, {*FINGERS}):
        stood = [finger for of in stands_for(present).values() for finger in of]
        assert sorted(stood) == sorted({*FINGERS[1:], *present})
