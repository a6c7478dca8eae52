"""Poses with self-contact: limbs meet, joints stay within their limits, and other joints are unchanged."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial import KDTree

from mimesh.bodies import load_body
from mimesh.bodies.contacts import CONTACTS, touching
from mimesh.bodies.sampling import JOINT_LIMITS, limits_rotvec, lowered_arms, rotvec_to_rotmat, sample_shape
from mimesh.core.rig import descendants

BODY = load_body()
SIDES = {"hands": ("LeftHand", "RightHand"), "legs": ("LeftLeg", "RightLeg")}


REST = 0.5 * lowered_arms(BODY)


@cache
def touching_pose(kind: str, seed: int = 0):
    return touching(BODY, sample_shape(BODY, 0, 0), REST, kind, np.random.default_rng(seed))


@pytest.mark.parametrize("kind", SIDES)
def test_left_and_right_limbs_touch(kind):
    before, after = (BODY.posed(sample_shape(BODY, 0, 0), rotvec_to_rotmat(p)) for p in (REST, touching_pose(kind)))
    # A contact of legs may be of a foot, and of the thigh on the other side.
    limbs = [descendants([BODY.joint(name)], BODY.parents) for name in SIDES[kind]]
    limbs[1] += [BODY.joint("RightUpLeg")] * (kind == "legs")
    left, right = (np.isin(BODY.weights.argmax(axis=1), joints) for joints in limbs)
    distance = [KDTree(points[left]).query(points[right])[0].min() for points in (before, after)]
    assert distance[1] < 0.02 < distance[0]


@pytest.mark.parametrize("kind", CONTACTS)
def test_only_the_joints_of_the_contact_move_within_their_limits(kind):
    pose = touching_pose(kind)
    changed = {BODY.joint_names[j] for j in np.flatnonzero(np.abs(pose - REST).max(axis=1))}
    assert changed
    assert changed <= {name for contact in CONTACTS[kind] for name in contact.moving}
    low, high = limits_rotvec(BODY, JOINT_LIMITS)
    moved = [BODY.joint(name) for name in changed]
    assert (pose[moved] > low[moved] - 2e-3).all()
    assert (pose[moved] < high[moved] + 2e-3).all()


def test_a_contact_pose_is_reproducible():
    once, other = touching_pose("arms"), touching_pose("arms", 3)
    touching_pose.cache_clear()
    assert np.array_equal(touching_pose("arms"), once)
    assert not np.array_equal(once, other)
