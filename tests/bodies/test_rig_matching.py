"""Joints of creatures correspond by names, places and chains, in any order and with other numbers of joints."""

from __future__ import annotations

import numpy as np
import pytest
from creatures import BIRD, SPIDER, Boxes, pairs, snake
from matrix import matrix

from mimesh.bodies.rig_matching import Creature, _hung, chain_shares, match_rigs, named_front
from mimesh.core.rig import descendants

FEET_FIRST = dict(sorted(SPIDER.items(), key=lambda joint: (joint[0] != "Root", "Foot" not in joint[0])))
"""A spider whose feet, which are on the root, come before the legs that they are moved with."""


def matched(mine: Boxes, theirs: Boxes) -> dict[str, str]:
    """Name the joint that each joint follows most."""
    follows = match_rigs(Creature(mine.character), Creature(theirs.character)).follows
    return {mine.names[j]: theirs.names[int(row.argmax())] for j, row in enumerate(follows) if row.any()}


@pytest.mark.parametrize("table", [BIRD, SPIDER, snake(6)], ids=["bird", "spider", "snake"])
@matrix("seed", range(3), quick=[0])
def test_each_joint_of_a_renamed_copy_is_found(table, seed):
    """The copy has another order of joints and no names, so each joint must be where it was."""
    mine = Boxes.of(table)
    theirs = mine.renamed(seed)
    found = matched(mine, theirs)
    assert set(found) == set(mine.names)
    for name, other in found.items():
        here, there = mine.rig.joints[mine.names.index(name)], theirs.rig.joints[theirs.names.index(other)]
        np.testing.assert_allclose(here, there)


def test_sides_are_not_exchanged():
    found = matched(Boxes.of(BIRD), Boxes.of(BIRD, size=3.0))
    assert found["Wing2.L"] == "Wing2.L"
    assert found["Wing2.R"] == "Wing2.R"


def test_a_chain_of_other_length_is_matched_by_arc_length():
    """Half of the joints: each follows two of the other in equal shares; twice as many: each follows one."""
    four, eight = (Creature(Boxes.of(snake(count)).character) for count in (4, 8))
    tails = [next(chain for chain in creature.chains if "tail" in chain.words) for creature in (four, eight)]
    np.testing.assert_allclose(chain_shares(*tails), np.repeat(np.eye(4), 2, axis=1) / 2, atol=1e-9)
    np.testing.assert_allclose(chain_shares(*tails[::-1]), np.repeat(np.eye(4), 2, axis=0), atol=1e-9)


def test_feet_on_the_root_belong_to_the_legs_that_end_there():
    for table in (SPIDER, FEET_FIRST):
        creature = Creature(Boxes.of(table).character)
        names = creature.rig.joint_names
        for j, name in enumerate(names):
            if "Foot" in name:
                assert names[creature.parents[j]] == name.replace("Foot", "Lower")
        assert descendants([0], creature.parents) == list(range(len(names)))


def test_confidence_falls_with_what_does_not_correspond():
    bird, snakes, spider = (Creature(Boxes.of(table).character) for table in (BIRD, snake(5), SPIDER))
    assert match_rigs(bird, bird).confidence == pytest.approx(1.0)
    assert match_rigs(snakes, Creature(Boxes.of(snake(9)).character)).confidence > 0.8
    assert max(match_rigs(bird, spider).confidence, match_rigs(snakes, spider).confidence) < 0.45


@pytest.mark.parametrize(("degrees", "front"), [(0, "+z"), (90, "+x"), (180, "-z"), (270, "-x")])
def test_the_front_is_where_names_say(degrees, front):
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]).round(12)
    assert named_front(Boxes.of(BIRD, turn=turn).character) == front
    assert named_front(Boxes.of(snake(5), turn=turn).character) == front
    assert named_front(Boxes.of(BIRD, turn=turn).renamed(0).character) is None


@pytest.mark.parametrize(("length", "front"), [(1.0, "+z"), (9.0, None)])
def test_a_head_that_is_most_of_the_creature_says_no_front(length, front):
    """A blob whose one joint is called a head has it everywhere."""
    table = {"Body": ("", (0, 0, 0), (0, 0, -1)), "Head": ("Body", (0, 0, 0.3), (0, 0, 0.3 + length))}
    assert named_front(Boxes.of(table).character) == front


def test_names_decide_between_limbs_at_one_place():
    """Two pairs of wings whose places are exchanged in the other creature."""
    table = pairs(
        {
            "Body": ("", (0, 0, 0), (0, 0, 0.5)),
            "Wing.L": ("Body", (0.2, 0.1, 0.1), (1, 0.1, 0.1)),
            "Arm.L": ("Body", (0.2, 0, 0.1), (1, 0, 0.1)),
        }
    )
    swapped = dict(table)
    for side in "LR":
        swapped[f"Wing.{side}"], swapped[f"Arm.{side}"] = table[f"Arm.{side}"], table[f"Wing.{side}"]
    found = matched(Boxes.of(table), Boxes.of(swapped))
    assert {name: name for name in table} == found


def test_of_several_roots_those_without_a_match_go_with_the_main_joint():
    table = {
        "Body": ("", (0, 0, 0), (0, 0, 0.5)),
        "Lamp": ("", (0, 1, 0), (0, 1, 0.4)),
        "Handle": ("", (0, 2, 0), (0, 2, 0)),
        "Hat": ("", (0, 0.5, 0.3), (0, 0.7, 0.3)),
    }
    mine = Creature(Boxes.of(table).character)
    match = match_rigs(mine, Creature(Boxes.of({name: table[name] for name in ("Body", "Lamp")}).character))
    assert match.follows.any(axis=1).tolist() == [True, True, False, False]
    assert _hung(mine, match) == (-1, -1, -1, 0)
    spider = Creature(Boxes.of(FEET_FIRST | {"Hat": ("", (0, 0.9, 0.3), (0, 1.1, 0.3))}).character)
    names = spider.rig.joint_names
    match = match_rigs(spider, Creature(Boxes.of(SPIDER).character))
    match.follows[0] = 0
    assert names[_hung(spider, match)[names.index("Hat")]] == "Body"
    match.follows[[j for j, name in enumerate(names) if "Foot" not in name]] = 0
    assert _hung(spider, match)[0] == -1, "one of its feet has a match"
