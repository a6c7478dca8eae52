"""Metrics compared with naive implementations, and their properties."""

import numpy as np
import pytest
import zoo

from mimesh.core.geometry import edges
from mimesh.evaluate.metrics import (
    chamfer,
    edge_score,
    flipped,
    in_unit_sphere_of,
    largest_stretch,
    mean_error_mm,
    pmd,
    pmd_of_pair,
    pmd_public,
)


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


def test_pmd_of_pair_ignores_translation_and_unit():
    rng = np.random.default_rng(1)
    result, truth = rng.normal(size=(2, 20, 3))
    moved = pmd_of_pair(100 * result + [1, 2, 3], 100 * truth - [4, 5, 6])
    assert moved == pytest.approx(pmd_of_pair(result, truth))
    assert pmd_of_pair(truth + 1.0, truth) == pytest.approx(0, abs=1e-30)


def test_unit_sphere_is_that_of_the_truth():
    truth = np.random.default_rng(2).normal(size=(30, 3))
    result, again = in_unit_sphere_of(truth, 2 * truth, truth)
    assert np.linalg.norm(again, axis=1).max() == pytest.approx(1)
    assert np.linalg.norm(result, axis=1).max() == pytest.approx(2)


def test_mean_error_is_scaled_to_the_height_of_the_person():
    truth = np.random.default_rng(3).normal(size=(40, 3))
    shift = np.tile([[0.01, 0, 0], [-0.01, 0, 0]], (20, 1))
    assert mean_error_mm(truth + shift, truth, height=1.7) == pytest.approx(10)
    assert mean_error_mm(truth + shift, truth, height=0.85) == pytest.approx(20)


def test_public_pmd_equals_a_naive_implementation_and_a_third_of_pmd_on_symmetric_meshes():
    rng = np.random.default_rng(4)
    result, truth = rng.normal(size=(2, 25, 3))
    radius = max(np.linalg.norm(point - truth.mean(axis=0)) for point in truth)
    total = 0.0
    for axis in range(3):
        a, b = result[:, axis] / radius, truth[:, axis] / radius
        a, b = a - (a.min() + a.max()) / 2, b - (b.min() + b.max()) / 2
        total += sum((x - y) ** 2 for x, y in zip(a, b, strict=True))
    assert pmd_public(result, truth) == pytest.approx(total / (25 * 3))
    symmetric = np.concatenate([truth, -truth])
    assert pmd_public(1.1 * symmetric, symmetric) == pytest.approx(pmd_of_pair(1.1 * symmetric, symmetric) / 3)


def naive_edges(faces):
    return {tuple(sorted((int(a), int(b)))) for f in faces for a, b in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0]))}


def test_edge_metrics_equal_naive_implementations():
    mesh = zoo.tetrahedron()
    truth, pairs = mesh.vertices, edges(mesh.faces)
    result = truth + np.random.default_rng(5).normal(scale=0.2, size=truth.shape)
    ratios = [
        np.linalg.norm(result[a] - result[b]) / np.linalg.norm(truth[a] - truth[b]) for a, b in naive_edges(mesh.faces)
    ]
    assert edge_score(result, truth, pairs) == pytest.approx(np.mean([abs(r - 1) for r in ratios]))
    assert largest_stretch(result, truth, pairs) == pytest.approx(max(1.0, *ratios))
    turned = result @ np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]) + 7
    assert edge_score(turned, truth, pairs) == pytest.approx(edge_score(result, truth, pairs))
    assert edge_score(truth, truth, pairs) == 0
    assert largest_stretch(truth, truth, pairs) == 1


def test_edges_of_length_zero_are_left_out():
    truth = np.array([[0.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    pairs = edges(np.array([[0, 1, 2]]))
    result = np.array([[0.0, 0, 0], [0, 9, 0], [1, 0, 0]])
    assert np.isfinite(edge_score(result, truth, pairs))
    assert edge_score(truth[:0], truth[:0], pairs[:0]) == 0
    assert largest_stretch(truth[:0], truth[:0], pairs[:0]) == 1


def test_flipped_counts_triangles_that_face_away():
    mesh = zoo.tetrahedron()
    truth, faces = mesh.vertices, mesh.faces
    assert flipped(truth, truth, faces) == 0
    # Mirrored at x = y: the floor and the slanted face turn over, the walls turn by 90 degrees only.
    assert flipped(truth[:, [1, 0, 2]], truth, faces) == 0.5
    up = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]])
    two = np.array([[0, 1, 2], [0, 1, 3]])
    down = up.copy()
    down[2] = [0, -1, 0]
    assert flipped(down, up, two) == 0.5
    assert flipped(up, up, two[:0]) == 0


def test_chamfer_equals_a_naive_implementation_in_any_vertex_order():
    rng = np.random.default_rng(6)
    result, truth = rng.normal(size=(12, 3)), rng.normal(size=(20, 3))
    to_truth = np.mean([min(((p - q) ** 2).sum() for q in truth) for p in result])
    to_result = np.mean([min(((p - q) ** 2).sum() for q in result) for p in truth])
    assert chamfer(result, truth) == pytest.approx(to_truth + to_result)
    assert chamfer(truth[rng.permutation(20)], truth) == 0
