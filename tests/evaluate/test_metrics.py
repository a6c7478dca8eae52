"""Metrics of meshes and clips: naive implementations, exact values for known errors, and what each ignores."""

import numpy as np
import pytest
import zoo

from mimesh.core.geometry import edges
from mimesh.evaluate.metrics import (
    acceleration_ratio,
    box_aligned,
    box_radius,
    chamfer,
    edge_score,
    flipped,
    foot_skate,
    jitter,
    largest_step_mm,
    largest_stretch,
    mean_error_mm,
    path_error_mm,
    pmd,
    pmd_public,
    resized,
)

FPS = 10.0
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
    result, truth = clips()
    for metric, more in ((path_error_mm, (1.7,)), (jitter, (1.7, FPS)), (foot_skate, (1.7, FPS))):
        with pytest.raises(ValueError, match="must have one shape"):
            metric(result, truth[:, 1:], *more)


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


def test_what_moving_and_scaling_change():
    """Both meshes: nothing, but the public formula grows with the square; the result alone: Equation 7 alone."""
    result, truth = pair(2)
    assert pmd(100 * result + SHIFT, 100 * truth + SHIFT) == pytest.approx(pmd(result, truth))
    assert pmd_public(100 * result + SHIFT, 100 * truth + SHIFT) == pytest.approx(1e4 * pmd_public(result, truth))
    assert pmd_public(100 * result, 100 * truth, metres=0.01) == pytest.approx(pmd_public(result, truth))
    assert pmd_public(result + SHIFT, truth) == pytest.approx(pmd_public(result, truth))
    assert pmd(truth + SHIFT, truth) == pytest.approx(SHIFT @ SHIFT / box_radius(truth) ** 2)
    assert pmd_public(truth + SHIFT, truth) == pytest.approx(0, abs=1e-30)
