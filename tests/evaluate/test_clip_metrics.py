"""Metrics of clips: exact values for known errors, naive implementations, and the errors that each ignores."""

import numpy as np
import pytest

from mimesh.evaluate.metrics import acceleration_ratio, foot_skate, jitter, largest_step_mm, path_error_mm, pmd

FPS = 10.0


def clips(seed: int = 0, frames: int = 6, vertices: int = 20):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(frames, vertices, 3)), rng.normal(size=(frames, vertices, 3))


def test_error_of_the_truth_is_zero():
    truth, _ = clips()
    assert pmd(truth, truth) == path_error_mm(truth, truth, 1.7) == jitter(truth, truth, 1.7, FPS) == 0
    static = np.repeat(truth[:1], 4, axis=0)
    assert largest_step_mm(static, 1.7) == 0
    assert foot_skate(static, static, 1.7, FPS) == 0


def test_path_error_is_the_mean_drift():
    truth, _ = clips(4)
    drift = truth + np.arange(len(truth))[:, None, None] * [0.01, 0.0, 0.0]
    mean = 10 * np.arange(len(truth)).mean()
    assert path_error_mm(drift, truth, 1.7) == pytest.approx(mean)
    assert path_error_mm(drift, truth, 0.85) == pytest.approx(2 * mean)
    assert path_error_mm(truth + [5.0, 0, 0], truth, 1.7) == pytest.approx(0, abs=1e-9)


def test_acceleration_ratio_is_one_for_the_truth_and_grows_with_flicker():
    _, truth = clips(7)
    assert acceleration_ratio(truth, truth) == pytest.approx(1)
    assert acceleration_ratio(2 * truth + 3, truth) == pytest.approx(2)
    flicker = 0.05 * (-1.0) ** np.arange(len(truth))[:, None, None] * [0, 1, 0]
    assert acceleration_ratio(truth[:1] + flicker, truth[:1] + 0.5 * flicker) == pytest.approx(2)
    assert acceleration_ratio(truth[:2], truth[:2]) is None
    assert acceleration_ratio(truth, np.repeat(truth[:1], len(truth), axis=0)) is None


def test_jitter_equals_a_naive_implementation_and_ignores_constant_errors():
    result, truth = clips(5)
    lengths = [
        np.linalg.norm(
            (result[t + 1, v] - 2 * result[t, v] + result[t - 1, v])
            - (truth[t + 1, v] - 2 * truth[t, v] + truth[t - 1, v])
        )
        for t in range(1, len(truth) - 1)
        for v in range(truth.shape[1])
    ]
    assert jitter(result, truth, 1.7, FPS) == pytest.approx(np.mean(lengths) * FPS**2)
    assert jitter(result, truth, 3.4, FPS) == pytest.approx(np.mean(lengths) * FPS**2 / 2)
    steady = truth + np.random.default_rng(6).normal(size=truth.shape[1:]) + np.arange(len(truth))[:, None, None]
    assert jitter(steady, truth, 1.7, FPS) == pytest.approx(0, abs=1e-9)
    flicker = truth + 0.01 * (-1.0) ** np.arange(len(truth))[:, None, None] * [0, 1, 0]
    assert jitter(flicker, truth, 1.7, FPS) == pytest.approx(0.04 * FPS**2)
    assert jitter(truth[:2], truth[:2], 1.7, FPS) is None


def test_largest_step_is_that_of_any_vertex():
    result = np.zeros((4, 3, 3))
    result[2, 1] = [0.003, 0.0, 0.004]
    assert largest_step_mm(result, 1.7) == pytest.approx(5.0)
    assert largest_step_mm(result, 0.85) == pytest.approx(10.0)
    assert largest_step_mm(result[:1], 1.7) == 0


def test_foot_skate_counts_vertices_in_contact_in_the_truth():
    """Four vertices: one in contact, one above the floor, one moving on the floor, one lifted halfway through."""
    frames = np.arange(5)[:, None]
    truth = np.zeros((5, 4, 3))
    truth[:, 1, 1] = 0.5
    truth[:, 2, :1] = 0.1 * frames
    truth[2:, 3, 1] = 0.2
    result = truth + np.arange(5)[:, None, None] * [0.003, 0.5, 0.004]  # 5 mm per frame along the ground
    assert foot_skate(result, truth, 1.7, FPS) == pytest.approx(5.0)
    assert foot_skate(truth, truth, 1.7, FPS) == 0
    sliding = truth.copy()
    sliding[1:, 0, 0] += [1, 2, 3, 4]
    assert foot_skate(sliding[:, :3], truth[:, :3], 1.7, FPS) == pytest.approx(100 * FPS)
    assert foot_skate(result[:, 2:3], truth[:, 2:3], 1.7, FPS) is None


@pytest.mark.parametrize(("metric", "more"), [(pmd, ()), (path_error_mm, (1.7,)), (jitter, (1.7, FPS)),
                                              (foot_skate, (1.7, FPS))])  # fmt: skip
@pytest.mark.parametrize("cut", [np.s_[1:], np.s_[:, 1:]])
def test_different_shapes_are_refused(metric, more, cut):
    result, truth = clips()
    with pytest.raises(ValueError, match="must have one shape"):
        metric(result, truth[cut], *more)
