"""Metrics against naive twins and by their properties."""

import numpy as np
import pytest

from mimesh.evaluate.metrics import in_unit_sphere_of, mean_error_mm, pmd, pmd_of_pair


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_pmd_is_equation_7(dtype):
    rng = np.random.default_rng(0)
    result, truth = rng.normal(size=(2, 2, 9, 3)).astype(dtype)
    naive = [sum(sum((p - q) ** 2 for p, q in zip(a, b, strict=True)) for a, b in zip(m, n, strict=True)) / 9
             for m, n in zip(result, truth, strict=True)]  # fmt: skip
    np.testing.assert_allclose(pmd(result, truth), naive, rtol=1e-5)


def test_pmd_never_broadcasts():
    with pytest.raises(ValueError, match=r"\(1, 3\) and \(5, 3\)"):
        pmd(np.zeros((1, 3)), np.zeros((5, 3)))


def test_pair_pmd_ignores_place_and_unit():
    rng = np.random.default_rng(1)
    result, truth = rng.normal(size=(2, 20, 3))
    moved = pmd_of_pair(100 * result + [1, 2, 3], 100 * truth - [4, 5, 6])
    assert moved == pytest.approx(pmd_of_pair(result, truth))
    assert pmd_of_pair(truth + 1.0, truth) == pytest.approx(0, abs=1e-30)


def test_unit_sphere_is_the_truths():
    truth = np.random.default_rng(2).normal(size=(30, 3))
    result, again = in_unit_sphere_of(truth, 2 * truth, truth)
    assert np.linalg.norm(again, axis=1).max() == pytest.approx(1)
    assert np.linalg.norm(result, axis=1).max() == pytest.approx(2)


def test_millimetres_of_a_person():
    truth = np.random.default_rng(3).normal(size=(40, 3))
    shift = np.tile([[0.01, 0, 0], [-0.01, 0, 0]], (20, 1))
    assert mean_error_mm(truth + shift, truth, height=1.7) == pytest.approx(10)
    assert mean_error_mm(truth + shift, truth, height=0.85) == pytest.approx(20)
