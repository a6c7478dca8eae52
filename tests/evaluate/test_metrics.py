"""Metrics compared with naive implementations, and their properties."""

import numpy as np
import pytest
import zoo

from mimesh.core.geometry import edges
from mimesh.evaluate.metrics import (
    box_aligned,
    box_radius,
    chamfer,
    edge_score,
    flipped,
    largest_stretch,
    mean_error_mm,
    pmd,
    pmd_public,
    resized,
)

SHIFT = np.array([1.0, -2.0, 3.0])


def pair(seed=0, shape=(25, 3)):
    return np.random.default_rng(seed).normal(size=(2, *shape))


def naive_box(mesh):
    """Centre of the box, and largest distance from it."""
    centre = [(min(column) + max(column)) / 2 for column in mesh.T]
    return centre, max(sum((x - c) ** 2 for x, c in zip(point, centre, strict=True)) ** 0.5 for point in mesh)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_pmd_is_equation_7_in_the_unit_sphere_about_the_box_of_the_truth(dtype):
    result, truth = pair().astype(dtype)
    centre, size = naive_box(truth)
    total = 0.0
    for p, q in zip(result, truth, strict=True):
        total += sum(((x - c) / size - (y - c) / size) ** 2 for x, y, c in zip(p, q, centre, strict=True))
    assert pmd(result, truth) == pytest.approx(total / 25, rel=1e-5)


def test_values_computed_by_hand():
    """The box of the truth has the centre (1, 1, 0); its radius is the root of 2."""
    truth = np.array([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]])
    result = truth + [[0, 0, 0.3], [0, 0, 0.3], [0, 0, 0.6]]  # its box is 0.45 above that of the truth
    assert pmd(result, truth) == pytest.approx((0.09 + 0.09 + 0.36) / 3 / 2)
    assert pmd_public(result, truth) == pytest.approx(3 * 0.15**2 / 9)
    assert mean_error_mm(result, truth, height=1.7) == pytest.approx(150)


def test_pmd_of_a_clip_is_the_mean_over_frames_each_in_its_own_sphere():
    result, truth = pair(1, (4, 20, 3))
    truth *= 2.0 ** np.arange(4)[:, None, None]
    frames = list(zip(result, truth, strict=True))
    assert pmd(result, truth) == pytest.approx(np.mean([pmd(*frame) for frame in frames]))
    assert pmd_public(result, truth) == pytest.approx(np.mean([pmd_public(*frame) for frame in frames]))


def test_nothing_is_broadcast():
    for metric in (pmd, pmd_public):
        with pytest.raises(ValueError, match=r"\(1, 3\) and \(5, 3\)"):
            metric(np.zeros((1, 3)), np.zeros((5, 3)))


def test_moving_both_meshes_changes_nothing():
    result, truth = pair(2)
    assert pmd(result + SHIFT, truth + SHIFT) == pytest.approx(pmd(result, truth))
    assert pmd_public(result + SHIFT, truth + SHIFT) == pytest.approx(pmd_public(result, truth))


def test_moving_the_result_alone_changes_equation_7_and_not_the_public_formula():
    result, truth = pair(3)
    assert pmd_public(result + SHIFT, truth) == pytest.approx(pmd_public(result, truth))
    assert pmd(truth + SHIFT, truth) == pytest.approx(SHIFT @ SHIFT / box_radius(truth) ** 2)
    assert pmd_public(truth + SHIFT, truth) == pytest.approx(0, abs=1e-30)


def test_scaling_both_leaves_equation_7_and_squares_in_the_public_formula():
    result, truth = pair(4)
    assert pmd(100 * result, 100 * truth) == pytest.approx(pmd(result, truth))
    assert pmd_public(100 * result, 100 * truth) == pytest.approx(1e4 * pmd_public(result, truth))
    assert pmd_public(100 * result, 100 * truth, metres=0.01) == pytest.approx(pmd_public(result, truth))


def test_public_formula_equals_a_naive_implementation():
    result, truth = pair(5)
    centres = naive_box(result)[0], naive_box(truth)[0]
    total = sum(
        ((p[axis] - centres[0][axis]) - (q[axis] - centres[1][axis])) ** 2
        for p, q in zip(result, truth, strict=True)
        for axis in range(3)
    )
    assert pmd_public(result, truth) == pytest.approx(total / (25 * 3))


def test_equation_7_of_a_box_centred_result_is_three_times_the_public_formula_over_the_squared_radius():
    result, truth = pair(6)
    aligned = box_aligned(result, truth)
    assert pmd(aligned, truth) == pytest.approx(3 * pmd_public(result, truth) / naive_box(truth)[1] ** 2)
    assert pmd(aligned, truth) != pytest.approx(pmd(result, truth))


def test_a_resized_mesh_has_box_centre_and_radius_of_the_truth():
    mesh, truth = pair(7)
    fitted = resized(5 * mesh + SHIFT, truth)
    assert box_radius(fitted) == pytest.approx(naive_box(truth)[1])
    assert naive_box(fitted)[0] == pytest.approx(naive_box(truth)[0])
    assert pmd(resized(3 * truth - SHIFT, truth), truth) == pytest.approx(0, abs=1e-30)


def test_mean_error_is_scaled_to_the_height_of_the_person_and_ignores_position():
    result, truth = pair(8)
    error = mean_error_mm(result, truth, height=1.7)
    assert error == pytest.approx(1e3 * np.linalg.norm(box_aligned(result, truth) - truth, axis=1).mean())
    assert mean_error_mm(result, truth, height=0.85) == pytest.approx(2 * error)
    assert mean_error_mm(result + SHIFT, truth, height=1.7) == pytest.approx(error)


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
