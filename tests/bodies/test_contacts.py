"""Poses with self-contact: limbs meet, joints stay within their limits, and other joints are unchanged."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from mimesh.bodies import load_body
from mimesh.bodies.contacts import CONTACTS, touching
from mimesh.bodies.sampling import JOINT_LIMITS, limits_rotvec, lowered_arms, rotvec_to_rotmat, sample_shape

BODY = load_body()
SIDES = {"hands": ("LeftHand", "RightHand"), "legs": ("LeftLeg", "RightLeg")}


def pose_of(kind, i, shape):
    return touching(BODY, shape, 0.5 * lowered_arms(BODY), kind, np.random.default_rng(i))


@pytest.mark.parametrize("kind", SIDES)
def test_left_and_right_limbs_touch(kind):
    shape = sample_shape(BODY, 0, 0)
    before, after = (
        BODY.posed(shape, rotvec_to_rotmat(pose)) for pose in (0.5 * lowered_arms(BODY), pose_of(kind, 0, shape))
    )
    # A contact of legs may be of a foot, and of the thigh on the other side.
    limbs = [[j for j in range(len(BODY.parents)) if name in _ancestor_names(j)] for name in SIDES[kind]]
    limbs[1] += [BODY.joint("RightUpLeg")] * (kind == "legs")
    left, right = (np.isin(BODY.weights.argmax(axis=1), joints) for joints in limbs)
    distance = [KDTree(points[left]).query(points[right])[0].min() for points in (before, after)]
    assert distance[1] < 0.02 < distance[0]


def _ancestor_names(j):
    """Names of a joint and of its ancestors."""
    return [BODY.joint_names[j], *(_ancestor_names(BODY.parents[j]) if BODY.parents[j] >= 0 else [])]


@pytest.mark.parametrize("kind", CONTACTS)
def test_only_the_joints_of_the_contact_move_within_their_limits(kind):
    pose = pose_of(kind, 1, sample_shape(BODY, 0, 1))
    changed = {BODY.joint_names[j] for j in np.flatnonzero(np.abs(pose - 0.5 * lowered_arms(BODY)).max(axis=1))}
    assert changed
    assert changed <= {name for contact in CONTACTS[kind] for name in contact.moving}
    low, high = limits_rotvec(BODY, JOINT_LIMITS)
    moved = [BODY.joint(name) for name in changed]
    assert (pose[moved] > low[moved] - 2e-3).all()
    assert (pose[moved] < high[moved] + 2e-3).all()


def test_a_contact_pose_is_reproducible():
    shape = sample_shape(BODY, 0, 2)
    assert np.array_equal(pose_of("arms", 2, shape), pose_of("arms", 2, shape))
    assert not np.array_equal(pose_of("arms", 2, shape), pose_of("arms", 3, shape))
