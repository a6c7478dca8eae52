"""Predictions in other orientations: animals that lie on their sides."""

import dataclasses

import numpy as np
import pytest
from matrix import matrix
from scipy.spatial.transform import Rotation

from mimesh.bodies.animals import animal
from mimesh.core.canonical_order import canonical_order
from mimesh.core.rig import Rig
from mimesh.core.surface_points import generator
from mimesh.methods.find import find_model
from mimesh.mime.body_fit import SurfaceSample
from mimesh.mime.prediction import ENSEMBLE, sampled_points

METHOD = find_model("mime-quadruped")


def points_of(turn: np.ndarray):
    """Sample a horse that stands, rotated."""
    mesh = animal("horse")
    vertices = (mesh.vertices - mesh.vertices.mean(axis=0)) @ turn.T
    mesh = mesh.with_vertices(vertices)
    ranked = canonical_order(vertices)
    return sampled_points(mesh, vertices, ranked, ENSEMBLE * METHOD.points, generator(0, 1)), vertices


@matrix(("angle", "axis"), [(-90, "x"), (-90, "z"), (100, "x"), (100, "z")], quick=[(-90, "z")])
def test_a_mesh_that_lies_is_turned_to_stand(axis, angle):
    turn = Rotation.from_euler(axis, angle, degrees=True).as_matrix()
    found = METHOD.turn_to_stand(*points_of(turn))
    assert found is not None
    assert (found @ turn)[1, 1] > np.cos(np.radians(20))


def test_a_mesh_that_stands_is_left_alone():
    assert METHOD.turn_to_stand(*points_of(np.eye(3))) is None


def test_predictions_after_a_turn_are_those_of_the_turned_mesh():
    turn = Rotation.from_euler("xyz", [30, 40, 50], degrees=True).as_matrix()
    samples, vertices = points_of(np.eye(3))
    points = SurfaceSample.of(samples.part(0, ENSEMBLE), vertices)
    direct = METHOD.run(points.turned(turn), points.turned(turn))
    back = METHOD.run(points, points, turn=turn)
    np.testing.assert_allclose(turn @ back.rotation, direct.rotation, atol=1e-5)
    np.testing.assert_allclose(back.joints @ turn.T, direct.joints, atol=1e-5)
    np.testing.assert_allclose(back.weights, direct.weights, atol=1e-6)


@pytest.mark.slow
def test_the_body_fits_a_reading_better_than_the_same_upside_down():
    samples, vertices = points_of(np.eye(3))
    right = METHOD.predict_keyframes(samples, [vertices], [vertices], 0)
    over = Rotation.from_euler("z", 180, degrees=True).as_matrix()

    def turned(rig: Rig) -> Rig:
        return Rig(over @ rig.rotation, rig.joints @ over.T, rig.weights)

    right = dataclasses.replace(right, predictions=())  # of which each would be fitted, too
    wrong = dataclasses.replace(right, consensus=turned(right.consensus))
    assert 10 * METHOD._cost(right, [vertices], [vertices]) < METHOD._cost(wrong, [vertices], [vertices])
