"""The protocol of fingers: true results, the errors of fingers, and hands that are not moved."""

import numpy as np
import pytest

from mimesh.core.geometry import nearest_rotation
from mimesh.evaluate.fingers import finger_metrics, fingers
from mimesh.evaluate.run import find_protocol

PROTOCOL = fingers()


@pytest.mark.parametrize("kind", PROTOCOL.kinds)
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


def test_the_protocol_is_found_by_name():
    assert find_protocol("fingers").kinds == ("rest", "gesture", "still")
