"""A tail that hangs between the hind legs and is weighted to them gets the weights of its root; all else stays."""

import numpy as np
import pytest

from mimesh.bodies import load_body
from mimesh.bodies.animals import animal, animal_body
from mimesh.core.geometry import vertex_areas
from mimesh.mime.weights import LARGEST_TAIL, with_whole_tail

BODY = animal_body("cow")
POINTS = animal("cow").vertices
STRONGEST = BODY.weights.argmax(axis=1)
TAIL = [BODY.joint(f"Tail{k}") for k in range(1, 7)]
HANGING = np.isin(STRONGEST, TAIL[3:])


def whole(weights):
    return with_whole_tail(weights, POINTS, BODY.faces, BODY.joint_names, BODY.parents)


def taken(halves=("LeftShin", "RightShin"), part=HANGING):
    """Weights that give the left half of a part to one joint and its right half to another one."""
    weights = BODY.weights.copy()
    for half, joint in zip((POINTS[:, 0] >= 0, POINTS[:, 0] < 0), halves, strict=True):
        weights[part & half] = np.eye(len(BODY.parents))[BODY.joint(joint)]
    return weights


def test_correct_weights_stay():
    assert whole(BODY.weights) is BODY.weights


@pytest.mark.parametrize("halves", [("LeftShin", "RightShin"), ("LeftShin", "RightFoot")])
def test_a_tail_that_is_held_by_both_legs_gets_its_own_weights(halves):
    weights = taken(halves)
    repaired = whole(weights)
    assert weights[HANGING][:, TAIL].sum(axis=1).max() == 0
    assert repaired[HANGING][:, TAIL].sum(axis=1).min() > 0.5
    np.testing.assert_allclose(repaired.sum(axis=1), 1, atol=1e-9)
    np.testing.assert_array_equal(repaired[~HANGING], weights[~HANGING])


def test_what_lies_between_tip_and_tail_is_repaired_too():
    """Vertices of one leg, or of the trunk, between those of both and those of the tail."""
    weights = taken(part=np.isin(STRONGEST, TAIL[4:]))
    weights[np.isin(STRONGEST, TAIL[3:4])] = np.eye(len(BODY.parents))[BODY.joint("Spine4")]
    assert whole(weights)[HANGING][:, TAIL].sum(axis=1).min() > 0.5


def test_a_tail_that_is_held_by_one_leg_stays():
    weights = taken(("LeftShin", "LeftShin"))
    assert whole(weights) is weights


def test_a_foot_that_is_held_by_both_legs_is_no_tail():
    left = np.isin(STRONGEST, [BODY.joint("LeftToes"), BODY.joint("LeftFoot")])
    weights = BODY.weights.copy()
    weights[left & (POINTS[:, 2] > np.median(POINTS[left, 2]))] = np.eye(len(BODY.parents))[BODY.joint("RightToes")]
    assert whole(weights) is weights


def test_a_separate_piece_that_both_legs_hold_is_no_tail():
    """Nothing that it touches is known: the equations of its weights are singular."""
    points = np.concatenate([0.01 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]), POINTS])
    faces = np.concatenate([[[0, 1, 2], [1, 3, 2]], BODY.faces + 4])
    held = np.eye(len(BODY.parents))[[BODY.joint(f"{side}Shin") for side in ("Left", "Right", "Left", "Right")]]
    weights = np.concatenate([held, BODY.weights])
    assert with_whole_tail(weights, points, faces, BODY.joint_names, BODY.parents) is weights


def test_nothing_is_repaired_without_a_tail_without_triangles_and_on_people():
    weights = taken(part=np.isin(STRONGEST, TAIL))
    assert whole(weights) is weights
    cloud = taken()
    assert with_whole_tail(cloud, POINTS, BODY.faces[:0], BODY.joint_names, BODY.parents) is cloud
    human = load_body()
    same = with_whole_tail(human.weights, human.vertices, human.faces, human.joint_names, human.parents)
    assert same is human.weights


def test_tails_of_the_shipped_animals_are_smaller_than_the_largest_one():
    for name in ("dog", "cat", "cow", "lion"):
        area = vertex_areas(animal(name).vertices, BODY.faces)
        assert area[HANGING].sum() < LARGEST_TAIL * area.sum(), name
