"""The paper's protocol: splits are disjoint, truth is aligned, trials are reproducible."""

import numpy as np
import pytest

from mimesh.bodies import load_body
from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose
from mimesh.evaluate.metrics import pmd_of_pair, resized
from mimesh.evaluate.protocols import HUMAN_NPT


@pytest.fixture(scope="module")
def body():
    return load_body()


def test_people_of_the_splits_are_disjoint(body):
    streams = [HUMAN_NPT.seed(split) for split in ("train", "val", "test")]
    assert len(set(streams)) == 3
    assert len(HUMAN_NPT.train_people(body)) == 16


def test_truth_is_the_identity_in_the_driving_pose(body):
    """Aligned vertex for vertex: copying the driving person is wrong by body shape alone, a wrong order by far more."""
    for poses in ("seen", "unseen"):
        pair = next(HUMAN_NPT.trials(body, "val", poses, 1))
        aligned = pmd_of_pair(resized(pair.aligned, pair.truth), pair.truth)
        assert aligned < 60e-4 < 500e-4 < pmd_of_pair(pair.driving.vertices, pair.truth)
        edge = pair.identity.faces[:, :2]
        old, new = (
            np.linalg.norm(np.diff(v[edge], axis=1)[:, 0], axis=1) for v in (pair.identity.vertices, pair.truth)
        )
        assert np.median(np.abs(new / old - 1)) < 0.05


def test_seen_poses_are_training_poses(body):
    train = HUMAN_NPT.train_poses(body)
    pair = next(HUMAN_NPT.trials(body, "test", "seen", 1))
    rng = np.random.default_rng(np.random.SeedSequence([HUMAN_NPT.seed("test"), True, 0]))
    rng.choice(HUMAN_NPT.new_people, 2, replace=False)
    played = train[rng.choice(HUMAN_NPT.poses, 2, replace=False)[1]]
    index = int(np.flatnonzero((train == played).all((1, 2)))[0])
    np.testing.assert_array_equal(played, sample_pose(body, HUMAN_NPT.seed("train"), index))
    span = np.ptp(body.posed(np.zeros(1), rotvec_to_rotmat(played))[:, 1])
    assert abs(np.ptp(pair.truth[:, 1]) / span - 1) < 0.35


def test_trials_are_a_pure_function_of_the_seed(body):
    first, second = (list(HUMAN_NPT.trials(body, "val", "unseen", 3)) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.truth, b.truth)
        np.testing.assert_array_equal(a.driving.faces, b.driving.faces)
    assert not np.array_equal(first[0].truth, first[1].truth)
