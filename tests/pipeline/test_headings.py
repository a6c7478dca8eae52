"""The angle at which a mesh stands in its file moves no vertex of the result."""

import numpy as np
import pytest
from animals import small
from grouped_options import grouped
from matrix import matrix
from people import person

import mimesh
from mimesh.bodies.animals import animal
from mimesh.core.mesh import Clip
from mimesh.core.normalization import turn

pytestmark = pytest.mark.usefixtures("kept")
IDENTITY, DRIVING = person(0), person(1, pose=2)
LARGEST = 0.002
"""Largest distance of a vertex, over the size; the samples of points that lie between two triangles may change."""


def headed(mesh, degrees):
    return mesh.with_vertices(mesh.vertices @ turn(np.radians(degrees)).T)


def largest_move(vertices, expected):
    """Largest distance of a vertex over the longest side; the ground point of the bounding box turns with a mesh."""
    vertices, expected = vertices - vertices.mean(axis=-2, keepdims=True), expected - expected.mean(-2, keepdims=True)
    return np.linalg.norm(vertices - expected, axis=-1).max() / np.ptp(expected.reshape(-1, 3), axis=0).max()


@pytest.fixture(scope="module")
def plain():
    return mimesh.transfer(IDENTITY, DRIVING).mesh.vertices


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [0.01, 20, -40])
def test_the_heading_of_the_identity_moves_nothing(plain, degrees):
    result = mimesh.transfer(headed(IDENTITY, degrees), DRIVING)
    assert largest_move(result.mesh.vertices, plain) < LARGEST


@matrix(("degrees", "front", "angle"), [(-40, "+z", -40), (70, "+x", -20)], quick=[(-40, "+z", -40)])
def test_the_result_turns_with_the_driving(plain, degrees, front, angle):
    """At 70 degrees the nearest axis is x: the result has the heading from there, -20 degrees."""
    result = mimesh.transfer(IDENTITY, headed(DRIVING, degrees))
    assert result.report["driving"]["front"] == front
    assert largest_move(result.mesh.vertices, plain @ turn(np.radians(angle)).T) < LARGEST


@pytest.mark.slow
def test_joints_and_movement_over_the_ground_turn_with_the_driving():
    steps = np.linspace(0, 0.5, 3)[:, None, None] * np.array([0.3, 0, 1.0])
    clip = Clip(DRIVING, DRIVING.vertices + steps, 30.0)
    angle = turn(np.radians(25))
    turned = Clip(headed(DRIVING, 25), clip.vertices @ angle.T, 30.0)
    options = {"model": "mime", "ground": False, "skinned": True}
    plain, result = (mimesh.animate(IDENTITY, driving, **grouped(**options)) for driving in (clip, turned))
    assert largest_move(result.clip.vertices, plain.clip.vertices @ angle.T) < LARGEST
    skeleton, expected = result.skeleton, plain.skeleton
    np.testing.assert_allclose(skeleton.rig.joints, expected.rig.joints, atol=1e-3)
    np.testing.assert_allclose(np.diff(skeleton.root, axis=0), np.diff(expected.root, axis=0) @ angle.T, atol=1e-4)
    assert skeleton.deviation(result.frames) < 1e-5  # what the file plays is what is returned


@pytest.mark.slow
def test_animals_too():
    identity, driving = small(animal("cat")), small(animal("horse"))
    plain = mimesh.transfer(identity, driving, hints=mimesh.Hints(body="quadruped")).mesh.vertices
    result = mimesh.transfer(
        headed(identity, -30), headed(driving, 20), hints=mimesh.Hints(body="quadruped")
    ).mesh.vertices
    assert largest_move(result, plain @ turn(np.radians(20)).T) < LARGEST
