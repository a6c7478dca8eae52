"""Shadow maps: even sampling of surfaces, whatever the order of corners, and the light that reaches points."""

import numpy as np
import pytest
import zoo

from mimesh.render import shadow
from mimesh.render.camera import fit


def one_triangle(*triangle):
    return np.array(triangle, float), np.array([[0, 1, 2]])


@pytest.mark.parametrize("order", [[0, 2, 1], [1, 2, 0], [2, 1, 0]])
def test_surface_points_do_not_depend_on_the_order_of_corners(order):
    vertices, faces = one_triangle([0, 0, 0], [9, 1, 0], [2, 7, 3])
    found = shadow.surface_points(vertices, faces, shadow.TILT)
    np.testing.assert_allclose(shadow.surface_points(vertices, faces[:, order], shadow.TILT), found, atol=1e-12)


@pytest.mark.parametrize("tall", [30.0, 3.0, 0.1])
def test_surface_points_leave_few_gaps(tall):
    """Almost no gap is wider than 1.5 texels; at the tip of a sliver up to 4."""
    vertices, faces = one_triangle([0, 0, 0], [40, 0, 0], [0, tall, 0])
    points = shadow.surface_points(vertices, faces, shadow.TILT)
    share = np.random.default_rng(0).dirichlet([1, 1, 1], 500)
    gap = np.linalg.norm((share @ vertices)[:, None] - points, axis=2).min(axis=1)
    assert np.percentile(gap, 95) < 1.5
    assert gap.max() < 4.0
    assert len(points) < shadow.DENSITY * 20 * tall + 100


def test_exposed_points_are_lit_and_points_below_a_roof_are_not():
    roof = zoo.cube()
    camera = fit(roof.vertices, (64, 64))
    maps = shadow.cast_shadows(roof.vertices, roof.faces, camera)
    low, high = roof.vertices.min(axis=0), roof.vertices.max(axis=0)
    middle = (low + high) / 2
    above, below = np.array([middle[0], high[1], middle[2]]), np.array([middle[0], low[1] + 1e-3, middle[2]])
    up = np.array([[0.0, 1, 0]])
    sky, key = shadow.visible_light(maps, above[None], up)
    assert sky[0] > 0.95
    assert key[0] == 1.0
    sky, key = shadow.visible_light(maps, below[None], up)
    assert sky[0] < 0.05
    assert key[0] == 0.0


def test_upsampling_a_constant_image_keeps_it_constant():
    image = np.full((3, 5), 0.25, np.float32)
    large = shadow.upsample(image, 4, (18, 11))
    assert large.shape == (11, 18)
    np.testing.assert_allclose(large, 0.25)
