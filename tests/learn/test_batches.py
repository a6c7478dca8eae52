"""Training pairs: aligned truth, independent shuffles, normalised meshes, reproducible steps."""

import dataclasses

import numpy as np
import pytest
import torch

from mimesh.bodies import load_body
from mimesh.learn.batches import DataConfig, PairSource, extreme_vertices

CASES = [DataConfig("table6"), DataConfig("table6", 64), DataConfig("wide"), DataConfig("wide", 64, "identity")]


@pytest.fixture(scope="module", params=CASES, ids=lambda c: f"{c.kind}-{c.vertices or 'all'}")
def source(request):
    return PairSource(request.param, load_body(), torch.device("cpu"), seed=3)


def test_truth_is_aligned_with_the_identity(source):
    """The classic bug is a shuffle that misaligns truth: then edges would change length wildly."""
    batch = source.batch(3, 0)
    ends = [
        [m.gather(1, batch.edges[..., k, None].expand(-1, -1, 3)) for k in range(2)]
        for m in (batch.identity, batch.truth)
    ]
    old, new = ((b - a).norm(dim=-1) for a, b in ends)
    scale = (new / old).median(dim=1, keepdim=True).values
    assert ((new / old / scale - 1).abs().median(dim=1).values < 0.05).all()


def test_driving_is_shuffled_on_its_own(source):
    batch = source.batch(2, 0)
    assert batch.driving.shape == batch.identity.shape
    # Were the rows in one order, driving and truth (the same pose) would lie near each other.
    apart = (batch.driving - batch.truth).norm(dim=-1).median()
    assert apart > 0.3
    assert not torch.equal(batch.driving[0], batch.driving[1])


def test_a_step_is_a_pure_function(source):
    first, again, other = source.batch(2, 5), source.batch(2, 5), source.batch(2, 6)
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(again, field.name)
        assert torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b
    assert not torch.equal(first.truth, other.truth)


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


def test_subsets_are_normalised_as_the_whole():
    """Centre and radius come from the outermost vertices of the whole body, within a hundredth or two of its radius."""
    body = load_body()
    some, whole = (PairSource(DataConfig("wide", n), body, torch.device("cpu"), seed=3) for n in (64, 0))
    rng = torch.Generator().manual_seed(0)
    shapes, poses, _ = some._endless(8, rng)
    index = torch.arange(0, 6890, 10).expand(8, -1)
    subset, radius = some._mesh(shapes[1], poses[1], index)
    full, full_radius = whole._mesh(shapes[1], poses[1], torch.arange(6890).expand(8, -1))
    torch.testing.assert_close(radius, full_radius, rtol=1e-2, atol=0)
    torch.testing.assert_close(subset, full[:, ::10], rtol=0, atol=2e-2)


def test_spread_vertices_cover_the_body():
    source = PairSource(DataConfig("table6", 64), load_body(), torch.device("cpu"), seed=0)
    drawn = source._spread(2, 100, torch.Generator().manual_seed(0))
    rank = torch.empty(6890, dtype=torch.long)
    rank[source.order] = torch.arange(6890)
    cells = (rank[drawn].sort(dim=1).values * 100 / 6890).long()
    assert all(len(c.unique()) >= 95 for c in cells)


def test_wide_meshes_may_be_as_dense_as_their_area():
    source = PairSource(DataConfig("wide", 64), load_body(), torch.device("cpu"), seed=0)
    drawn = source._spread(400, 100, torch.Generator().manual_seed(0))
    hands = torch.from_numpy(
        load_body().weights[:, [n.startswith(("LeftHand", "RightHand")) for n in load_body().joint_names]].sum(1) > 0.5
    )
    share = hands[drawn].float().mean(dim=1)
    assert share.quantile(0.9) > 1.5 * share.quantile(0.1) > 0


def test_extreme_vertices_are_few():
    found = extreme_vertices(load_body(), poses=20)
    assert 20 < len(found) < 600
    np.testing.assert_array_equal(found, np.unique(found))


def test_some_driving_meshes_tumble_and_nothing_else_changes():
    """A share of them is turned any way; identities and all others are those without it."""
    poses = [
        PairSource(DataConfig("wide", 64, tumble=share), load_body(), torch.device("cpu"), 0)._endless(
            200, torch.Generator().manual_seed(1)
        )[1]
        for share in (0.0, 0.3)
    ]
    same = torch.isclose(poses[0], poses[1], atol=1e-6).flatten(2).all(-1)
    assert same[0].all()
    assert 0.2 < 1 - same[1].float().mean() < 0.4
    up = poses[1][1][~same[1]][:, 0, 1, 1]
    assert up.min() < -0.5 < 0.5 < up.max()
    assert torch.allclose(poses[0][:, :, 1:], poses[1][:, :, 1:])
