"""The protocol of fingers: true results, the errors of fingers, and hands that are not moved."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from matrix import matrix
from pools import write_character

from mimesh.core.errors import InputError
from mimesh.core.geometry import nearest_rotation
from mimesh.evaluate.fingers import LEAST_VERTICES, finger_metrics, fingered_characters, fingers
from mimesh.evaluate.run import find_protocol

PROTOCOL = fingers()


@pytest.fixture(scope="module")
def pool(tmp_path_factory) -> Path:
    """Two people with fingers, one of whose palms have joints of their own, and one without."""
    folder = tmp_path_factory.mktemp("pool")
    write_character(folder, "man", 0, fingers=True)
    write_character(folder, "woman", 1, fingers=True, palms=True)
    write_character(folder, "mitten", 2)
    return folder


@matrix("kind", PROTOCOL.kinds, quick=["gesture"])
def test_the_truth_has_no_error_wherever_it_stands(kind):
    pair = PROTOCOL.pair("val", kind, 0)
    turn = nearest_rotation(np.random.default_rng(0).normal(size=(3, 3)))
    metrics = finger_metrics(pair.truth @ turn.T + 0.3, pair)
    assert metrics["fingertip_mm"] < 1e-6
    assert metrics["finger_deg"] < 1e-4


def test_fingers_that_stay_have_the_error_of_the_gesture():
    pair = PROTOCOL.pair("val", "rest", 1)
    metrics = finger_metrics(pair.identity.vertices, pair)
    assert metrics["fingertip_mm"] > 20
    assert metrics["finger_deg"] > 15
    still = PROTOCOL.pair("val", "still", 1)
    assert finger_metrics(still.identity.vertices, still)["fingertip_mm"] < 5  # linear blend skinning at the wrist


def test_pairs_are_shuffled_with_what_belongs_to_the_vertices():
    rng = PROTOCOL.rng("val", "rest", 2)
    plain, pair = PROTOCOL.unshuffled_pair("val", "rest", 2, rng), PROTOCOL.pair("val", "rest", 2)
    assert np.allclose(plain.identity.vertices[plain.tips], pair.identity.vertices[pair.tips])
    assert np.allclose(plain.truth[plain.part == 5].mean(axis=0), pair.truth[pair.part == 5].mean(axis=0))


def test_pairs_of_characters_have_palms_and_fingers(pool):
    protocol = find_protocol("fingers", pool)
    protocol.check("val")
    assert protocol.kinds == ("characters", "rest", "gesture", "still")
    assert [character.meta.file for character in fingered_characters(pool, "val")] == ["man", "woman"]
    for i in range(3):
        pair = protocol.pair("val", "characters", i)
        assert set(pair.groups) == {"man", "woman"}
        assert (np.bincount(pair.part, minlength=33)[1:] >= LEAST_VERTICES).all()
        assert finger_metrics(pair.truth, pair)["fingertip_mm"] < 1e-6
        still = finger_metrics(pair.identity.vertices, pair)
        assert still["fingertip_mm"] > 5
        assert still["finger_deg"] > 5


def test_fingers_with_few_vertices_have_no_rotations():
    pair = PROTOCOL.pair("val", "rest", 0)
    palms = dataclasses.replace(pair, part=np.where(np.isin(pair.part, (1, 17)), pair.part, 0))
    assert set(finger_metrics(pair.truth, palms)) == {"fingertip_mm", "fingertip_max_mm"}


def test_a_split_without_two_fingered_characters_is_an_error(pool):
    with pytest.raises(InputError, match="expected two characters with fifteen joints a hand in the split train"):
        find_protocol("fingers", pool).check("train")


def test_joints_below_a_hand_count_as_their_nearest_ancestor(pool):
    character = next(one for one in fingered_characters(pool, "val") if one.meta.file == "woman")
    rig, hand = character.rig, character.joints["LeftHand"]
    columns = rig.nearest_columns({hand: 0, character.fingers["LeftHandThumb1"]: 1}, other=2)
    named = dict(zip((*rig.joint_names, "world"), columns, strict=True))
    assert (named["LeftPalm"], named["LeftHandIndex2"], named["LeftHandThumb3"]) == (0, 0, 1)
    assert (named["RightPalm"], named["LeftForeArm"], named["world"]) == (2, 2, 2)
