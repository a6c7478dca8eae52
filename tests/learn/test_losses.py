"""Losses against naive twins, and the one thing that matters: the truth is where they are smallest."""

import pytest
import torch

from mimesh.core.geometry import edges
from mimesh.evaluate.protocols import HUMAN_NPT
from mimesh.learn.losses import edge_paper, edge_ratio, npt_loss, reconstruction


@pytest.fixture
def meshes():
    torch.manual_seed(0)
    result, truth, identity = torch.rand(3, 2, 6, 3, dtype=torch.float64)
    return result, truth, identity, torch.tensor([[[0, 1], [1, 2], [4, 5]]] * 2)


def test_reconstruction_is_equation_5(meshes):
    result, truth, *_ = meshes
    naive = sum(((result[b, v] - truth[b, v]) ** 2).sum() for b in range(2) for v in range(6)) / 2
    torch.testing.assert_close(reconstruction(result, truth), naive)


def test_edge_loss_is_equation_6(meshes):
    result, _, _, pairs = meshes
    neighbours = {0: [1], 1: [0, 2], 2: [1], 4: [5], 5: [4]}
    naive = (
        sum(((result[b, p] - result[b, v]) ** 2).sum() for b in range(2) for p in neighbours for v in neighbours[p]) / 2
    )
    torch.testing.assert_close(edge_paper(result, pairs), naive)


def test_edge_ratio_is_zero_for_rigid_motion(meshes):
    _, _, identity, pairs = meshes
    turn = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64)).Q
    assert edge_ratio(identity @ turn + 1.0, identity, pairs) < 1e-12
    assert edge_ratio(2 * identity, identity, pairs) == pytest.approx(1.0)


def test_the_loss_wants_the_truth():
    """Minimising NPT's full loss over free vertices, started at the truth, moves PMD by less than 0.1e-4."""
    pair = next(HUMAN_NPT.trials("val", "unseen", 1))
    truth = torch.from_numpy(pair.truth)
    truth = ((truth - truth.mean(0)) / (truth - truth.mean(0)).norm(dim=-1).max())[None]
    pairs = torch.from_numpy(edges(pair.identity.faces))[None]
    free = truth.clone().requires_grad_()
    optimizer = torch.optim.LBFGS([free], max_iter=60, line_search_fn="strong_wolfe")

    def closure():
        optimizer.zero_grad()
        loss = npt_loss(free, truth, truth, pairs, "paper", 5e-4) * truth.shape[1]
        loss.backward()
        return loss.detach()

    before = closure().item()
    optimizer.step(closure)
    assert closure().item() < before
    assert (free.detach() - truth).square().sum(-1).mean() < 0.1e-4


def test_a_sample_of_edges_stands_for_all():
    torch.manual_seed(0)
    points = torch.rand(1, 200, 3, dtype=torch.float64)
    pairs = torch.randint(200, (1, 4000, 2))
    whole = npt_loss(points, points, points, pairs, "paper", 1.0)
    sample = npt_loss(points, points, points, pairs[:, :2000], "paper", 1.0, edges_of_mesh=2.0)
    torch.testing.assert_close(whole, sample, rtol=0.05, atol=0)
