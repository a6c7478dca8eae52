"""AniFormer's losses: naive twins, where each is zero, and what the printed signs would reward."""

import pytest
import torch

from mimesh.learn.aniformer import (
    MIN_STEP,
    aniformer_loss,
    appearance_paper,
    appearance_ratio,
    motion_paper,
    motion_velocity,
    reconstruction,
)

FRAMES = 4


@pytest.fixture
def clips():
    torch.manual_seed(0)
    result, truth = torch.rand(2, 2, FRAMES, 6, 3, dtype=torch.float64)
    return result, truth, torch.rand(2, 6, 3, dtype=torch.float64), torch.tensor([[[0, 1], [1, 2], [4, 5]]] * 2)


def test_reconstruction_sums_over_vertices_and_averages_over_frames(clips):
    result, truth, *_ = clips
    naive = sum(((result[b, t] - truth[b, t]) ** 2).sum() for b in range(2) for t in range(FRAMES)) / (2 * FRAMES)
    torch.testing.assert_close(reconstruction(result, truth), naive)


def test_motion_is_equation_4(clips):
    m, g, *_ = clips

    def term(b, t):  # t as printed, from 3 to T, counted from 1
        ratios = [
            ((m[b, s - 1] - m[b, s - 2]) ** 2).sum() / ((g[b, s - 1] - g[b, s - 2]) ** 2).sum() for s in (t - 1, t)
        ]
        return ratios[0] - ratios[1]

    terms = torch.stack([term(b, t) for b in range(2) for t in range(3, FRAMES + 1)])
    torch.testing.assert_close(motion_paper(m, g), terms.abs().mean())


def test_appearance_is_equation_5(clips):
    m, _, n, pairs = clips
    neighbours = {0: [1], 1: [0, 2], 2: [1], 4: [5], 5: [4]}

    def growth(b, t, p, u):
        return ((m[b, t, p] - m[b, t, u]) ** 2).sum() - ((n[b, p] - n[b, u]) ** 2).sum()

    every = [(b, t, p, u) for b in range(2) for t in range(FRAMES) for p in neighbours for u in neighbours[p]]
    terms = torch.stack([growth(*which) for which in every])
    scale = 2 * FRAMES * 6
    torch.testing.assert_close(appearance_paper(m, n, pairs), terms.abs().sum() / scale)


def test_motion_is_zero_for_the_driving_in_any_size_and_place_and_for_a_static_result(clips):
    _, g, *_ = clips
    assert motion_paper(3.0 * g + 1.0, g) < 1e-12
    assert motion_paper(g[:, :1].expand_as(g), g) == 0.0
    assert motion_paper(g.flip(2), g) < 1e-12, "whoever moves: only the speed of the whole mesh counts"
    assert motion_paper(g.flip(1), g) > 1e-3


def test_motion_of_a_still_driving_is_finite_and_least_at_rest(clips):
    result, g, *_ = clips
    still = g[:, :1].expand_as(g)
    assert motion_paper(still, still) == 0.0
    moving = still.clone().requires_grad_()
    motion_paper(moving + 1e-4 * result, still).backward()
    assert moving.grad is not None
    assert moving.grad.isfinite().all()
    trembling = motion_paper(still + MIN_STEP * result, still)
    assert trembling < 1e-3, "rounding in a still clip weighs nothing"


def test_velocity_is_zero_for_the_truth_wherever_it_stands(clips):
    result, truth, *_ = clips
    assert motion_velocity(truth + 2.0, truth) < 1e-24
    naive = ((result[:, 1:] - result[:, :-1] - truth[:, 1:] + truth[:, :-1]) ** 2).sum(dim=(2, 3)).mean()
    torch.testing.assert_close(motion_velocity(result, truth), naive)
    static = truth[:, :1].expand_as(truth)
    assert motion_velocity(static, truth) > 0.1


def test_appearance_is_zero_for_the_identity_turned_and_moved(clips):
    _, _, n, pairs = clips
    turns = [torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64)).Q for _ in range(FRAMES)]
    turned = torch.stack([n @ turn + 1.0 for turn in turns], dim=1)
    assert appearance_paper(turned, n, pairs) < 1e-12
    assert appearance_ratio(turned, turned * 1.0, pairs) == 0.0
    assert appearance_ratio(2 * turned, turned, pairs) == pytest.approx(1.0)


@pytest.mark.parametrize("motion", ["paper", "velocity", "off"])
@pytest.mark.parametrize("appearance", ["paper", "ratio", "off"])
def test_the_whole_is_the_weighted_sum_of_its_parts(clips, motion, appearance):
    result, truth, n, pairs = clips
    parts = {
        ("motion", "paper"): motion_paper(result, truth),
        ("motion", "velocity"): motion_velocity(result, truth) / 6,
        ("appearance", "paper"): appearance_paper(result, n, pairs),
        ("appearance", "ratio"): appearance_ratio(result, truth, pairs),
    }
    found = aniformer_loss(result, truth, n, truth, pairs, None, motion, 0.3, appearance, 0.7)
    rest = 0.3 * parts.get(("motion", motion), 0.0) + 0.7 * parts.get(("appearance", appearance), 0.0)
    torch.testing.assert_close(found, reconstruction(result, truth) / 6 + rest)
