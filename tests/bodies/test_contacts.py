"""Poses with contacts: the limbs meet, joints stay within their limits, and the rest of the pose is kept."""

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
def test_left_and_right_meet(kind):
    shape = sample_shape(BODY, 0, 0)
    before, after = (
        BODY.posed(shape, rotvec_to_rotmat(pose)) for pose in (0.5 * lowered_arms(BODY), pose_of(kind, 0, shape))
    )
    # A contact of legs may be of a foot, and of the thigh on the other side.
    below = [[j for j in range(len(BODY.parents)) if name in _line(j)] for name in SIDES[kind]]
    below[1] += [BODY.joint("RightUpLeg")] * (kind == "legs")
    one, other = (np.isin(BODY.weights.argmax(axis=1), joints) for joints in below)
    apart = [KDTree(points[one]).query(points[other])[0].min() for points in (before, after)]
    assert apart[1] < 0.02 < apart[0]


def _line(j):
    """Names of a joint and of all it hangs from."""
    return [BODY.joint_names[j], *(_line(BODY.parents[j]) if BODY.parents[j] >= 0 else [])]


@pytest.mark.parametrize("kind", CONTACTS)
def test_only_the_limbs_move_and_within_their_limits(kind):
    pose = pose_of(kind, 1, sample_shape(BODY, 0, 1))
    changed = {BODY.joint_names[j] for j in np.flatnonzero(np.abs(pose - 0.5 * lowered_arms(BODY)).max(axis=1))}
    assert changed
    assert changed <= {name for contact in CONTACTS[kind] for name in contact.moving}
    low, high = limits_rotvec(BODY, JOINT_LIMITS)
    moved = [BODY.joint(name) for name in changed]
    assert (pose[moved] > low[moved] - 2e-3).all()
    assert (pose[moved] < high[moved] + 2e-3).all()


def test_a_pose_is_a_function_of_its_generator():
    shape = sample_shape(BODY, 0, 2)
    assert np.array_equal(pose_of("arms", 2, shape), pose_of("arms", 2, shape))
    assert not np.array_equal(pose_of("arms", 2, shape), pose_of("arms", 3, shape))
