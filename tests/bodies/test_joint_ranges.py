"""Ranges of joints: poses are clipped to them, and least squares pull back into them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.joint_ranges import MARGIN, joint_ranges
from mimesh.bodies.quadruped import LIMITS
from mimesh.bodies.sampling import JOINT_LIMITS, sample_pose
from mimesh.core.rig import descendant_matrix


@pytest.mark.parametrize(("name", "table"), [("human", JOINT_LIMITS), ("quadruped", LIMITS)])
def test_random_poses_are_within_the_ranges(name, table):
    body, ranges = load_body(name), joint_ranges(name)
    pose = sample_pose(body, 3, 0, table)
    world = ranges.world(Rotation.from_rotvec(pose[0]).as_matrix(), pose[1:])
    assert np.allclose(ranges.clipped(world), pose[1:], atol=1e-6)
    hessian, gradient = ranges.normal_equations(world)
    assert not hessian.any()
    assert not gradient.any()


def test_other_poses_are_clipped():
    ranges = joint_ranges("quadruped")
    root, vectors = np.eye(3), Rotation.random(len(ranges.low), random_state=0).as_rotvec()
    clipped = ranges.clipped(ranges.world(root, vectors))
    assert (clipped >= ranges.low - 1e-9).all()
    assert (clipped <= ranges.high + 1e-9).all()


def test_a_twisted_hinge_keeps_its_flexion():
    body, ranges = load_body("quadruped"), joint_ranges("quadruped")
    shin = body.joint("LeftShin") - 1
    vectors = np.zeros_like(ranges.low)
    flexion, twist = Rotation.from_rotvec([1.0, 0, 0]), Rotation.from_rotvec([0, 2.6, 0])
    vectors[shin] = (twist * flexion).as_rotvec()
    clipped = ranges.clipped(ranges.world(np.eye(3), vectors))[shin]
    assert clipped[0] == pytest.approx(1.0, abs=0.02)
    assert abs(clipped[1]) <= np.radians(6) + MARGIN + 1e-9


def test_derivatives_are_those_of_the_excess():
    body, ranges = load_body("quadruped"), joint_ranges("quadruped")
    rng = np.random.default_rng(0)
    world = ranges.world(np.eye(3), 1.5 * ranges.high * rng.uniform(0.5, 1.5, ranges.high.shape))
    below = descendant_matrix(body.parents)

    def energy(turns):
        turned = Rotation.from_rotvec(below.T @ turns).as_matrix() @ world
        local = ranges.local(turned)
        return np.square(local - np.clip(local, ranges.low, ranges.high)).sum() / 2

    _, gradient = ranges.normal_equations(world)
    for index in rng.integers(gradient.size, size=8):
        step = np.zeros(gradient.size)
        step[index] = 1e-6
        slope = (energy(step.reshape(-1, 3)) - energy(-step.reshape(-1, 3))) / 2e-6
        assert gradient[index] == pytest.approx(slope, abs=1e-5)
