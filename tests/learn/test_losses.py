"""Loss terms of several models against naive twins."""

import pytest
import torch

from mimesh.learn.layers import edge_ratio, match_frames, mean_squared_distance, reconstruction
from mimesh.learn.npt import edge_paper


@pytest.fixture
def meshes():
    torch.manual_seed(0)
    result, truth, identity = torch.rand(3, 2, 6, 3, dtype=torch.float64)
    return result, truth, identity, torch.tensor([[[0, 1], [1, 2], [4, 5]]] * 2)


def test_reconstruction_is_equation_5(meshes):
    result, truth, *_ = meshes
    naive = sum(((result[b, v] - truth[b, v]) ** 2).sum() for b in range(2) for v in range(6)) / 2
    torch.testing.assert_close(reconstruction(result, truth), naive)


def test_edge_ratio_is_zero_for_rigid_motion(meshes):
    _, _, identity, pairs = meshes
    turn = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64)).Q
    assert edge_ratio(identity @ turn + 1.0, identity, pairs) < 1e-12
    assert edge_ratio(2 * identity, identity, pairs) == pytest.approx(1.0)


def test_mean_squared_distance_is_equation_7(meshes):
    result, truth, *_ = meshes
    naive = sum(((result[b, v] - truth[b, v]) ** 2).sum() for b in range(2) for v in range(6)) / 12
    torch.testing.assert_close(mean_squared_distance(result, truth), naive)


def test_a_single_frame_is_compared_with_the_middle_one():
    truth = torch.arange(6.0).view(1, 3, 2, 1).expand(1, 3, 2, 3)
    assert torch.equal(match_frames(truth, 1), truth[:, 1:2])
    assert match_frames(truth, 3) is truth


def test_npt_s_edge_loss_is_equation_6(meshes):
    result, _, _, pairs = meshes
    neighbours = {0: [1], 1: [0, 2], 2: [1], 4: [5], 5: [4]}
    ends = [(p, v) for p in neighbours for v in neighbours[p]]
    naive = sum(((result[b, p] - result[b, v]) ** 2).sum() for b in range(2) for p, v in ends) / 2
    torch.testing.assert_close(edge_paper(result, pairs), naive)
