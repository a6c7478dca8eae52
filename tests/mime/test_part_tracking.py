"""Tracking finds the rotations of a skinned surface, parts without points follow, outliers do not move the mean."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampling import TABLE_6, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.core.geometry import nearest_rotation
from mimesh.mime.part_tracking import PartTracker, mean_rotation

BODY = load_body()
SAMPLE = np.random.default_rng(0).permutation(len(BODY.vertices))[:3000]


def posed(number: int):
    """Points of a person in a pose of Table 6, and the world rotation and position of each joint."""
    shape, rotmat = sample_shape(BODY, 7, 0), rotvec_to_rotmat(sample_pose(BODY, 7, number, TABLE_6))
    joints = BODY.shaped(shape)[1]
    rotation, offset = BODY.skinning_transforms(joints, rotmat)
    return BODY.posed(shape, rotmat)[SAMPLE], rotation, offset + (rotation @ joints[..., None])[..., 0]


def tracker(number: int, weights=BODY.weights) -> PartTracker:
    points, _, joints = posed(number)
    return PartTracker.of(points, weights[SAMPLE], joints, BODY.parents)


def degrees(a, b):
    return np.degrees(np.arccos(np.clip((np.einsum("jab,jab->j", a, b) - 1) / 2, -1, 1)))


@pytest.mark.parametrize("number", [1, 2])
def test_rotations_of_a_skinned_surface_are_found(number):
    before, (points, after, joints) = posed(0)[1], posed(number)
    motion = after @ before.mT
    assert degrees(motion, np.tile(np.eye(3), (len(motion), 1, 1))).mean() > 15
    rotation, positions = tracker(0).follow(points)
    errors = degrees(rotation, motion)
    assert np.median(errors) < 1.5
    assert errors.mean() < 3  # no vertex is weighted to joints between two bones alone
    assert np.linalg.norm(positions - joints, axis=1).mean() < 0.01


def test_rigid_motion_turns_every_part_alike_and_rest_turns_none():
    rest = posed(1)[0]
    turn = Rotation.from_rotvec([0.3, -2.0, 0.5]).as_matrix()
    assert np.allclose(tracker(1).follow(5 + rest @ turn.T)[0], turn, atol=1e-6)
    assert np.allclose(tracker(1).follow(rest)[0], np.eye(3), atol=1e-6)


def test_part_without_points_turns_as_its_parent():
    hand, thumb = BODY.joint("LeftHandFinger1"), BODY.joint("LeftFingerBase")
    weights = BODY.weights.copy()
    weights[:, thumb] += weights[:, hand]
    weights[:, hand] = 0
    found = tracker(0, weights).follow(posed(2)[0])[0]
    assert degrees(found[hand][None], found[BODY.parents[hand]][None]) < 3
    assert degrees(found[hand][None], np.eye(3)[None]) > 15


def test_mean_rotation_is_not_moved_by_an_outlier():
    true = Rotation.random(5, random_state=0).as_matrix()
    noise = Rotation.from_rotvec(0.02 * np.random.default_rng(1).normal(size=(40, 3))).as_matrix().reshape(8, 5, 3, 3)
    noisy = true @ noise
    noisy[3] = Rotation.random(5, random_state=2).as_matrix()
    assert degrees(mean_rotation(noisy), true).max() < 2
    assert degrees(nearest_rotation(noisy.sum(axis=0)), true).max() > 2
