"""The torch body gives what the NumPy body gives."""

import numpy as np
import pytest
import torch

from mimesh.bodies import load_body
from mimesh.bodies.sampling import JOINT_LIMITS, rotvec_to_rotmat, sample_pose, sample_shape
from mimesh.learn.data import bodies


@pytest.fixture(scope="module")
def sample():
    body = load_body()
    shapes = np.stack([sample_shape(body, 5, i) for i in range(2)])
    rotvec = np.stack([sample_pose(body, 5, i, JOINT_LIMITS) for i in range(2)])
    return body, shapes, rotvec


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 5e-6), (torch.float64, 1e-12)])
def test_same_vertices(sample, dtype, tolerance):
    body, shapes, rotvec = sample
    twin = bodies.TorchBody(body, dtype)
    rotmat = bodies.rotvec_to_rotmat(torch.from_numpy(rotvec).to(dtype))
    posed = twin.posed(torch.from_numpy(shapes).to(dtype), rotmat).numpy()
    np.testing.assert_allclose(posed, body.posed(shapes, rotvec_to_rotmat(rotvec)), atol=tolerance)


def test_picked_vertices_are_those_of_the_whole(sample):
    body, shapes, rotvec = sample
    twin = bodies.TorchBody(body)
    arguments = torch.from_numpy(shapes).float(), bodies.rotvec_to_rotmat(torch.from_numpy(rotvec).float())
    whole = twin.posed(*arguments)
    each = torch.tensor([[5, 6], [6889, 0]])
    expected = torch.stack([whole[i, each[i]] for i in range(2)])
    torch.testing.assert_close(twin.posed(*arguments, each), expected, atol=1e-6, rtol=0)


def test_zero_rotation_is_the_identity():
    np.testing.assert_array_equal(bodies.rotvec_to_rotmat(torch.zeros(2, 3)).numpy(), np.tile(np.eye(3), (2, 1, 1)))
