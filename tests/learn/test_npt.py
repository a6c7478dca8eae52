"""NPT's training: pairs with aligned truth, independent orders and normalised meshes; the loss and its equations."""

import dataclasses

import pytest
import torch
from matrix import matrix
from trainings import assert_steps_are_pure, length_changes

from mimesh.core.geometry import edges
from mimesh.evaluate.protocols import HUMAN_NPT
from mimesh.learn.aniformer import AniFormerData, WindowSource
from mimesh.learn.data.people import PairSource
from mimesh.learn.npt import NPTData, npt_loss
from mimesh.learn.task import shipped_body

CASES = [NPTData("table6"), NPTData("table6", 64), NPTData("wide"), NPTData("wide", 64, "identity")]


@pytest.fixture(
    scope="module",
    params=matrix("source", CASES, quick=CASES[1::2]).args[1],
    ids=lambda c: f"{c.kind}-{c.vertices or 'all'}",
)
def source(request):
    return PairSource(request.param, shipped_body(), torch.device("cpu"), seed=3)


@pytest.mark.slow
def test_truth_is_aligned_with_the_identity_and_driving_shuffled_on_its_own(source):
    batch = source.batch(3, 0)
    assert (length_changes(batch.identity, batch.truth, batch.edges) < 0.05).all()
    assert batch.driving.shape == batch.identity.shape
    # Were the rows in one order, driving and truth (the same pose) would lie near each other.
    apart = (batch.driving - batch.truth).norm(dim=-1).median()
    assert apart > 0.3
    assert not torch.equal(batch.driving[0], batch.driving[1])


def test_a_step_is_a_pure_function(source):
    assert_steps_are_pure(source)


def test_meshes_are_in_the_unit_sphere(source):
    batch = source.batch(3, 1)
    meshes = [batch.identity, batch.driving]
    if source.config.target_scale == "truth":
        meshes.append(batch.truth)
    for mesh in meshes:
        radius = mesh.norm(dim=-1).amax(1)
        assert (radius < 1.001).all()
        if not source.config.vertices:
            torch.testing.assert_close(radius, torch.ones(3), atol=1e-5, rtol=0)
            torch.testing.assert_close(mesh.amax(1), -mesh.amin(1), atol=1e-5, rtol=0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "data"),
    [
        (PairSource, NPTData("table6", 64)),
        (PairSource, NPTData("wide", 64)),
        (WindowSource, AniFormerData("clips80", 64)),
    ],
)
def test_reflection_mirrors_both_meshes_and_the_truth_of_a_share_of_the_pairs(kind, data):
    frames = [3] if kind is WindowSource else []
    plain, mirrored = (
        kind(dataclasses.replace(data, reflect=share), shipped_body(), torch.device("cpu"), 3, *frames).batch(4, 0)
        for share in (0.0, 0.5)
    )
    sign = torch.tensor([-1.0, 1.0, 1.0])
    for name in ("identity", "driving", "truth"):
        before, after = getattr(plain, name), getattr(mirrored, name)
        assert torch.equal(after[:2], before[:2] * sign)
        assert torch.equal(after[2:], before[2:])
    assert torch.equal(mirrored.edges, plain.edges)


@pytest.mark.slow
def test_a_share_of_less_than_one_pair_is_mirrored_in_the_mean():
    plain, mirrored = (
        PairSource(NPTData("table6", 8, reflect=share), shipped_body(), torch.device("cpu"), seed=3)
        for share in (0.0, 0.5)
    )
    turned = [not torch.equal(mirrored.batch(1, i).truth, plain.batch(1, i).truth) for i in range(40)]
    assert 10 <= sum(turned) <= 30


def test_the_loss_is_least_near_the_truth():
    """Minimising NPT's full loss over free vertices, started at the truth, moves PMD by less than 0.1e-4."""
    pair = HUMAN_NPT.pair("val", "unseen", 0)
    truth = torch.from_numpy(pair.truth)
    truth = ((truth - truth.mean(0)) / (truth - truth.mean(0)).norm(dim=-1).max())[None]
    pairs = torch.from_numpy(edges(pair.identity.faces))[None]
    free = truth.clone().requires_grad_()
    optimizer = torch.optim.LBFGS([free], max_iter=60, line_search_fn="strong_wolfe")

    def closure():
        optimizer.zero_grad()
        loss = npt_loss(free, truth, pairs, "paper", 5e-4) * truth.shape[1]
        loss.backward()
        return loss.detach()

    before = closure().item()
    optimizer.step(closure)
    assert closure().item() < before
    assert (free.detach() - truth).square().sum(-1).mean() < 0.1e-4


def test_a_sample_of_edges_gives_the_loss_of_all():
    torch.manual_seed(0)
    points = torch.rand(1, 200, 3, dtype=torch.float64)
    pairs = torch.randint(200, (1, 4000, 2))
    whole = npt_loss(points, points, pairs, "paper", 1.0)
    sample = npt_loss(points, points, pairs[:, :2000], "paper", 1.0, edges_of_mesh=2.0)
    torch.testing.assert_close(whole, sample, rtol=0.05, atol=0)
