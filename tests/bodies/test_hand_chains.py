"""Finger joints of rigged hands, found by place: hands of boxes along +x, whose palm faces down."""

from __future__ import annotations

import numpy as np
import pytest
from people import rigged

from mimesh.bodies.hand_chains import find_fingers, fingers_by_place
from mimesh.core.mesh import Mesh


def hand(chains: dict[str, tuple[tuple[float, float], ...]], apart: str = "", palm: float = 0.1):
    """Make a left hand: a strip of triangles for the palm and for each chain, which begins on the palm.

    Args:
        chains: (x, z) of the joints of each chain, and of its end.
        apart: chain whose surface is not that of the hand.
        palm: length of the palm.
    """
    names, parents, joints = ["LeftForeArm", "LeftHand"], [-1, 0], [(-0.25, 0.0), (0.0, 0.0)]
    points, owner, faces = [(0.0, -0.04), (0.0, 0.04), (palm, -0.04), (palm, 0.04)], [1] * 4, [(0, 2, 1), (1, 2, 3)]
    for name, path in chains.items():
        for k, place in enumerate(path[:-1]):
            parents.append(len(names) - 1 if k else 1)
            names.append(f"{name}{k + 1}" if len(path) > 2 else name)
            joints.append(place)
        first = len(points)
        points += [(x, z - 0.004) for x, z in path] + [(x, z + 0.004) for x, z in path]
        of_joints = [*range(len(names) - len(path) + 1, len(names)), len(names) - 1]
        owner += of_joints * 2
        for a in range(first, first + len(path) - 1):
            b = a + len(path)
            faces += [(a, a + 1, b), (b, a + 1, b + 1)]
        faces += [] if name == apart else [(2, first, 3)]
    placed = np.insert(np.array(points), 1, 0.0, axis=1)
    weights = np.eye(len(names))[owner]
    at = np.insert(np.array(joints), 1, 0.0, axis=1)
    return rigged(Mesh(placed, np.array(faces)), tuple(names), tuple(parents), at, weights)


def finger(z: float, joints: int = 3, length: float = 0.09) -> tuple[tuple[float, float], ...]:
    """Place the joints and the end of a finger that begins at the end of the palm."""
    return tuple((0.1 + length * k / joints, z) for k in range(joints + 1))


THUMB = ((0.05, 0.05), (0.065, 0.08), (0.08, 0.11))
"""A thumb of two joints and its end."""
SIDEWAYS = ((0.09, 0.05), (0.10, 0.08), (0.11, 0.11))
"""One that begins no nearer to the wrist than others, and points elsewhere."""


def firsts(rig) -> dict[str, str]:
    """Name the first joint of each finger found."""
    found = fingers_by_place(rig, 1, "Left")
    return {name[8:-1]: rig.joint_names[j][:-1] for name, j in found.items() if name.endswith("1")}


@pytest.mark.parametrize("thumb", [THUMB, SIDEWAYS])
@pytest.mark.parametrize(
    ("places", "names"),
    [
        ([0.0], ["Middle"]),
        ([0.02, -0.02], ["Index", "Pinky"]),
        ([0.03, 0.0, -0.03], ["Index", "Middle", "Pinky"]),
        ([0.03, 0.01, -0.01, -0.03], ["Index", "Middle", "Ring", "Pinky"]),
    ],
)
def test_fingers_are_named_from_the_thumb_on(places, names, thumb):
    if len(places) == 4 and thumb is SIDEWAYS:
        pytest.skip("of five the thumb begins nearest to the wrist")
    chains = {chr(97 + k): finger(z) for k, z in enumerate(places)}
    expected = {name: chr(97 + k) for k, name in enumerate(names)}
    assert firsts(hand(chains)) == expected
    assert firsts(hand({"t": thumb} | chains)) == {"Thumb": "t"} | expected


def test_claws_have_no_thumb():
    turned = [[(0.1 + d * np.cos(a), d * np.sin(a)) for d in (0.0, 0.04, 0.08)] for a in np.radians([40, 0, -40])]
    chains = {name: tuple(path) for name, path in zip("abc", turned, strict=True)}
    assert firsts(hand(chains)) == {"Index": "a", "Middle": "b", "Pinky": "c"}


def test_a_chain_of_four_joints_may_begin_with_a_metacarpal():
    plain, metacarpal = hand({"a": finger(0.0, 4)}), hand({"a": ((0.02, 0.0), *finger(0.0))})
    assert [plain.joint_names[j] for j in fingers_by_place(plain, 1, "Left").values()] == ["a1", "a2", "a3"]
    assert [metacarpal.joint_names[j] for j in fingers_by_place(metacarpal, 1, "Left").values()] == ["a2", "a3", "a4"]


def test_things_in_a_hand_are_no_fingers():
    sword = finger(0.0, 1, 0.6)
    assert firsts(hand({"sword": sword}, apart="sword")) == {}
    assert firsts(hand({"sword": sword, "a": finger(0.0), "t": THUMB}, apart="sword")) == {"Middle": "a", "Thumb": "t"}
    assert fingers_by_place(hand({"fingers": sword}, apart="fingers"), 1, "Left") == {"LeftHandMiddle1": 2}


def test_a_joint_that_carries_the_palm_is_no_finger():
    assert fingers_by_place(hand({"block": ((0.005, 0.0), (0.2, 0.0))}, palm=0.001), 1, "Left") == {}


def test_unnamed_fingers_are_found_beside_a_named_thumb():
    rig = hand({"Thumb": THUMB, "Fingers": finger(0.0)})
    found = find_fingers(rig, {"LeftForeArm": 0, "LeftHand": 1}, ["Left"])
    assert {name: rig.joint_names[j] for name, j in found.items()} == {
        **{f"LeftHandThumb{k}": f"Thumb{k}" for k in (1, 2)},
        **{f"LeftHandMiddle{k}": f"Fingers{k}" for k in (1, 2, 3)},
    }


def test_numbers_beside_a_named_thumb_begin_with_the_index_finger():
    rig = hand({"Thumb": THUMB, **{f"Finger{n}_": finger(0.06 - 0.03 * n) for n in (1, 2, 3)}})
    found = find_fingers(rig, {"LeftForeArm": 0, "LeftHand": 1}, ["Left"])
    assert {name: rig.joint_names[j] for name, j in found.items() if name.endswith("1")} == {
        "LeftHandThumb1": "Thumb1",
        "LeftHandIndex1": "Finger1_1",
        "LeftHandMiddle1": "Finger2_1",
        "LeftHandRing1": "Finger3_1",
    }
