"""The z-buffer against analytic pixels, exact coverage, and a loop over every pixel and triangle."""

import numpy as np
import pytest

from mimesh.view.zbuffer import visible_faces, weights_at


def picture(points, faces, width, rows, shifts=None):
    """Return the visible face at each sample, -1 where there is none."""
    return visible_faces(np.asarray(points, float), np.asarray(faces), width, rows, shifts)


def random_triangles(rng, count, width, rows):
    """Make triangles of every size, some beyond the picture's edge, at random depths."""
    centre = rng.uniform(-0.2, 1.2, (count, 1, 2)) * [width, rows]
    spread = rng.lognormal(0.5, 1.2, (count, 1, 1)) * rng.normal(size=(count, 3, 2))
    points = np.concatenate([centre + spread, rng.uniform(1, 2, (count, 3, 1))], axis=2).reshape(-1, 3)
    return points, np.arange(3 * count).reshape(-1, 3)


def naive(points, faces, width, rows):
    """Return the nearest face and its barycentric weights at every pixel centre, one pixel and triangle at a time."""
    visible, weights = np.full((rows, width), -1), np.zeros((rows, width, 3))
    for row in range(rows):
        for column in range(width):
            nearest = np.inf
            for index, face in enumerate(faces):
                (a, b, c), p = points[face], np.array([column + 0.5, row + 0.5])
                system = np.array([[a[0], b[0], c[0]], [a[1], b[1], c[1]], [1, 1, 1]])
                bary = np.linalg.solve(system, [*p, 1.0])
                rank = bary @ points[face, 2]
                if (bary > 0).all() and rank < nearest:
                    nearest, visible[row, column], weights[row, column] = rank, index, bary
    return visible, weights


def test_a_triangle_covers_the_pixels_whose_centres_are_inside():
    column, row = np.meshgrid(np.arange(6), np.arange(6))
    inside = (column + 0.5) + (row + 0.5) < 4  # centres on the right or lower edge belong to the neighbour
    visible = picture([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]], 6, 6)
    np.testing.assert_array_equal(visible == 0, inside)


def test_interpenetrating_triangles_are_cut_where_they_cross():
    points = [[-50, 0, 0], [50, 0, 0], [0, 99, 0], [0, -9, -1], [0, 99, -1], [10, -9, 1], [10, 99, 1]]
    visible = picture(points, [[0, 1, 2], [3, 4, 5], [4, 6, 5]], 10, 8)
    assert (visible[:, :5] > 0).all()
    assert (visible[:, 5:] == 0).all()


def test_a_triangulated_sheet_covers_every_sample_exactly_once():
    rng = np.random.default_rng(0)
    n = 12
    x, y = np.meshgrid(np.linspace(-3, 43, n), np.linspace(-3, 43, n), indexing="ij")
    points = np.stack([x, y, np.ones_like(x)], axis=-1)
    points[1:-1, 1:-1, :2] += rng.uniform(-1.0, 1.0, (n - 2, n - 2, 2))
    points[4:8, 4:8, :2] = np.round(points[4:8, 4:8, :2]) + 0.5  # vertices and edges right on sample centres
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    lower, upper = [corner, corner + n, corner + n + 1], [corner, corner + n + 1, corner + 1]
    faces = np.concatenate([np.stack(lower, 1), np.stack(upper, 1)])
    drawn = np.concatenate([np.flatnonzero(picture(points.reshape(-1, 3), face[None], 40, 40) == 0) for face in faces])
    np.testing.assert_array_equal(np.sort(drawn), np.arange(1600))


@pytest.mark.parametrize("seed", range(2))
def test_agrees_with_a_loop_over_every_pixel_and_triangle(seed):
    points, faces = random_triangles(np.random.default_rng(seed), 25, 17, 13)
    expected, weights = naive(points, faces, 17, 13)
    np.testing.assert_array_equal(picture(points, faces, 17, 13), expected)
    row, column = np.nonzero(expected >= 0)
    found, area = weights_at(points, faces, expected[row, column], column + 0.5, row + 0.5)
    np.testing.assert_allclose(found, weights[row, column], atol=1e-9)
    assert (area != 0).all()


def test_turning_faces_over_or_reordering_them_changes_nothing():
    rng = np.random.default_rng(5)
    points, faces = random_triangles(rng, 200, 40, 30)
    visible, order = picture(points, faces, 40, 30), rng.permutation(200)
    np.testing.assert_array_equal(picture(points, faces[:, ::-1], 40, 30), visible)
    permuted = picture(points, faces[order], 40, 30)
    np.testing.assert_array_equal(np.where(permuted >= 0, order[permuted], -1), visible)


def test_the_block_size_does_not_change_the_result(monkeypatch):
    points, faces = random_triangles(np.random.default_rng(6), 60, 40, 30)
    visible = picture(points, faces, 40, 30)
    monkeypatch.setattr("mimesh.view.zbuffer.BLOCK", 7)
    np.testing.assert_array_equal(picture(points, faces, 40, 30), visible)


def test_shifted_samples_equal_a_shifted_mesh():
    points, faces = random_triangles(np.random.default_rng(7), 60, 40, 30)
    visible = picture(points, faces, 40, 30, np.array([0.25]))
    np.testing.assert_array_equal(visible, picture(points + [0.25, 0, 0], faces, 40, 30))


def test_triangles_with_nan_or_no_area_and_empty_meshes_draw_nothing():
    points = [[0, 0, 1], [9, 0, 1], [np.nan] * 3, [0, 9, 1], [0, 0, 1]]
    assert (picture(points, [[0, 1, 2], [0, 3, 4], [1, 1, 1]], 6, 6) == -1).all()
    assert (picture(points, np.zeros((0, 3), int), 6, 6) == -1).all()


def test_the_nearer_triangle_wins_and_of_equally_near_ones_the_first():
    points = [[0, 0, 2], [9, 0, 2], [0, 9, 2], [0, 0, 1], [9, 0, 1], [0, 9, 1]]
    for faces, wins in (
        ([[0, 1, 2], [3, 4, 5]], 1),
        ([[3, 4, 5], [0, 1, 2]], 0),
        ([[3, 4, 5], [5, 3, 4]], 0),
    ):
        assert set(picture(points, faces, 6, 6).ravel()) == {-1, wins}
