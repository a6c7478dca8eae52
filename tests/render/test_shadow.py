"""Points of a surface and the light that they leave: even cover, and the same whatever the order of corners."""

import numpy as np
import pytest
import zoo

from mimesh.render import shadow
from mimesh.render.camera import fit


def corners_of(*triangle):
    return np.array(triangle, float), np.array([[0, 1, 2]])


@pytest.mark.parametrize("order", [[0, 2, 1], [1, 2, 0], [2, 1, 0]])
def test_points_do_not_depend_on_the_order_of_corners(order):
    vertices, faces = corners_of([0, 0, 0], [9, 1, 0], [2, 7, 3])
    found = shadow.surface_points(vertices, faces, shadow.TILT)
    np.testing.assert_allclose(shadow.surface_points(vertices, faces[:, order], shadow.TILT), found, atol=1e-12)


@pytest.mark.parametrize("tall", [30.0, 3.0, 0.1])
def test_points_leave_few_gaps(tall):
    """Almost none of more than a texel and a half; the tip of a sliver may stay bare for a few."""
    vertices, faces = corners_of([0, 0, 0], [40, 0, 0], [0, tall, 0])
    points = shadow.surface_points(vertices, faces, shadow.TILT)
    share = np.random.default_rng(0).dirichlet([1, 1, 1], 500)
    gap = np.linalg.norm((share @ vertices)[:, None] - points, axis=2).min(axis=1)
    assert np.percentile(gap, 95) < 1.5
    assert gap.max() < 4.0
    assert len(points) < shadow.DENSITY * 20 * tall + 100


def test_light_comes_freely_to_what_stands_out_and_not_below_a_roof():
    roof = zoo.cube()
    camera = fit(roof.vertices, (64, 64))
    cast = shadow.cast(roof.vertices, roof.faces, camera)
    low, high = roof.vertices.min(axis=0), roof.vertices.max(axis=0)
    middle = (low + high) / 2
    above, below = np.array([middle[0], high[1], middle[2]]), np.array([middle[0], low[1] + 1e-3, middle[2]])
    up = np.array([[0.0, 1, 0]])
    sky, key = shadow.visible_light(cast, above[None], up)
    assert sky[0] > 0.95
    assert key[0] == 1.0
    sky, key = shadow.visible_light(cast, below[None], up)
    assert sky[0] < 0.05
    assert key[0] == 0.0


def test_enlarging_keeps_an_even_image_even_and_its_size():
    image = np.full((3, 5), 0.25, np.float32)
    large = shadow.enlarged(image, 4, (18, 11))
    assert large.shape == (11, 18)
    np.testing.assert_allclose(large, 0.25)
