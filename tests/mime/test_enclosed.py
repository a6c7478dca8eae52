"""Which joints a surface encloses: a property of the surface alone, whatever its faces are like."""

from __future__ import annotations

import numpy as np
import pytest
from people import person

from mimesh import rig
from mimesh.mime.misread import share_enclosed


def sphere(side: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return 2000 points of a sphere of radius 1 and the normals there; `side` -1: of one that is inside out."""
    points = np.random.default_rng(0).normal(size=(2000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return points, side * points


INSIDE, OUTSIDE = np.array([[0, 0, 0], [0.5, 0.2, -0.3]]), np.array([[1.2, 0, 0], [0, -3.0, 0]])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_points_within_a_sphere_are_enclosed_and_others_are_not(side):
    assert share_enclosed(INSIDE, *sphere(side)) == 1
    assert share_enclosed(OUTSIDE, *sphere(side)) == 0
    assert share_enclosed(np.concatenate([INSIDE, OUTSIDE]), *sphere(side)) == 0.5


def test_an_inner_shell_that_is_inside_out_changes_nothing():
    points, normals = sphere()
    shell = np.concatenate([points, 0.95 * points]), np.concatenate([normals, -normals])
    assert share_enclosed(INSIDE, *shell) == 1
    assert share_enclosed(OUTSIDE, *shell) == 0


def test_of_half_a_surface_nothing_is_said():
    points, normals = (of[of[:, 2] > 0] for of in sphere())
    assert share_enclosed(OUTSIDE, points, normals) == 1


def test_a_person_encloses_its_joints():
    assert rig(person(0)).report["enclosed"] >= 0.9375
