"""The shipped body model, its skinning, and random shapes and poses."""

import numpy as np
import pytest

from mimesh.bodies import load_body, save_body
from mimesh.bodies.sampling import JOINT_LIMITS, TABLE_6, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.core.errors import InputError
from mimesh.core.geometry import edges


@pytest.fixture(scope="module")
def body():
    return load_body()


def test_the_body_is_a_closed_manifold_with_the_documented_counts(body):
    assert (body.vertices.shape, body.faces.shape) == ((6890, 3), (13776, 3))
    assert len(body.components) >= 10
    assert 24 <= len(body.joint_names) <= 31
    assert len(body.vertices) - len(edges(body.faces)) + len(body.faces) == 2  # Euler: one closed surface, no handles
    directed = body.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)  # every edge once in each direction


def test_rest_is_a_t_pose_with_y_up_facing_z(body):
    left, right = body.joints[body.joint("LeftHand")], body.joints[body.joint("RightHand")]
    shoulder, toes = body.joints[body.joint("LeftArm")], body.joints[body.joint("LeftToeBase")]
    assert left[0] > 0.5 > -0.5 > right[0]
    assert abs(left[1] - shoulder[1]) < 0.01
    assert toes[2] > body.joints[body.joint("LeftFoot")][2]  # toes in front: +z
    assert 1.4 < np.ptp(body.vertices[:, 1]) < 2.1


def test_weights_are_a_partition_of_unity(body):
    np.testing.assert_allclose(body.weights.sum(axis=1), 1, atol=1e-12)
    assert body.weights.min() >= 0


def test_identity_rotations_give_the_rest_shape(body):
    shape = sample_shape(body, 0, 0)
    rest = body.posed(shape, np.tile(np.eye(3), (len(body.parents), 1, 1)))
    np.testing.assert_allclose(rest, body.shaped(shape)[0], atol=1e-12)


def test_rotating_the_root_rotates_the_body(body):
    shape, pose = sample_shape(body, 0, 1), rotvec_to_rotmat(sample_pose(body, 0, 1))
    turn = rotvec_to_rotmat(np.array([0.3, -1.0, 0.2]))
    turned = pose.copy()
    turned[0] = turn @ pose[0]
    hips = body.shaped(shape)[1][0]
    expected = (body.posed(shape, pose) - hips) @ turn.T + hips
    np.testing.assert_allclose(body.posed(shape, turned), expected, atol=1e-12)


def test_samples_depend_on_seed_and_index_only(body):
    first = [sample_pose(body, 7, i) for i in range(5)]
    np.testing.assert_array_equal(sample_pose(body, 7, 4), first[4])
    assert not np.array_equal(sample_pose(body, 8, 4), first[4])
    assert not np.array_equal(sample_shape(body, 7, 0), sample_shape(body, 7, 1))


def test_ranges_of_table_6_are_those_of_the_paper(body):
    assert len(TABLE_6) == 24
    poses = np.degrees(np.stack([sample_pose(body, 0, i) for i in range(200)]))
    knee, elbow = poses[:, body.joint("LeftLeg")], poses[:, body.joint("RightForeArm")]
    assert 0 <= knee[:, 0].min() < 10 < 90 < knee[:, 0].max() <= 100
    assert (knee[:, 1:] == 0).all()
    assert 0 <= elbow[:, 1].min() < 10 < 50 < elbow[:, 1].max() <= 60
    assert (poses[:, body.joint("LHipJoint")] == 0).all()


def test_joint_limits_of_left_and_right_are_mirror_images(body):
    for name, (x, y, z) in JOINT_LIMITS.items():
        if name.startswith("Left"):
            other = JOINT_LIMITS["Right" + name[4:]]
            assert other == (x, (-y[1], -y[0]), (-z[1], -z[0]))


def test_a_saved_body_loads_unchanged(body, tmp_path):
    save_body(body, tmp_path / "again.npz")
    again = load_body(tmp_path / "again.npz")
    np.testing.assert_array_equal(again.vertices, body.vertices)
    np.testing.assert_array_equal(again.components, body.components)
    assert again.joint_names == body.joint_names


def test_errors_of_unknown_names_list_the_known_ones(body):
    with pytest.raises(InputError, match="expected a shipped body"):
        load_body("octopus")
    with pytest.raises(KeyError, match="LeftArm"):
        body.joint("Tail")
