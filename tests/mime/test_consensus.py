"""Tests of the consensus of several predictions."""

import numpy as np
from scipy.spatial.transform import Rotation

from mimesh.core.rig import Rig
from mimesh.mime.prediction import agreeing, consensus


def prediction(degrees, noise=0, joints=4, axis="y"):
    """Make a prediction whose joints are all turned about an axis by an angle, with noise of a few degrees."""
    rng = np.random.default_rng(noise)
    turned = Rotation.from_euler(axis, degrees, degrees=True) * Rotation.from_rotvec(rng.normal(0, 0.03, (joints, 3)))
    return Rig(turned.as_matrix(), rng.normal(0, 0.01, (joints, 3)) + degrees, np.zeros((0, joints)))


def test_all_predictions_that_agree_are_kept():
    rigs = [prediction(40), *(prediction(10, noise) for noise in range(1, 8))]
    assert sorted(agreeing(rigs)) == list(range(8))
    assert agreeing(rigs)[-1] == 0, "the nearest to the centre comes first"
    np.testing.assert_allclose(consensus(rigs).joints, np.mean([rig.joints for rig in rigs], axis=0))


def test_a_minority_that_contradicts_the_others_has_no_influence():
    majority = [prediction(5, noise) for noise in range(5)]
    found = consensus([*majority, prediction(80, 5), prediction(80, 6), prediction(80, 7)])
    np.testing.assert_array_equal(found.rotation, consensus(majority).rotation)
    np.testing.assert_array_equal(found.joints, consensus(majority).joints)


def test_of_contradictory_facings_the_one_towards_the_front_wins():
    front = [prediction(0, noise) for noise in range(2)]
    found = consensus([prediction(180, noise) for noise in range(2, 8)] + front)
    np.testing.assert_array_equal(found.rotation, consensus(front).rotation)


def test_predictions_that_all_face_away_are_kept():
    away = [prediction(180, noise) for noise in range(8)]
    assert consensus(away).rotation[0, 2, 2] < -0.9


def test_somebody_upside_down_does_not_face_away():
    """In a handstand the front of the hips points away from +z too."""
    handstand = [prediction(180, noise, axis="x") for noise in range(7)]
    np.testing.assert_array_equal(consensus([*handstand, prediction(0, 7)]).joints, consensus(handstand).joints)
