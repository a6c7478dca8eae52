"""A mesh has the same normalised points for every heading."""

import dataclasses

import numpy as np
import pytest
from people import boxes_person, person

from mimesh.bodies.animals import animal
from mimesh.core import mesh as mesh_module
from mimesh.core.geometry import edges
from mimesh.core.mesh import Mesh, permute_vertices
from mimesh.core.normalization import Normalization, principal_heading, turn, turned_to_front, without_heading
from mimesh.evaluate.remesh import split_faces

ANGLES = (0.01, 20.0, 45.0, 100.0, 180.0, -70.0)
"""Degrees."""


def headed(mesh, degrees):
    return mesh.with_vertices(mesh.vertices @ turn(np.radians(degrees)).T)


def normalised_points(mesh, **axes):
    norm = without_heading(mesh, Normalization.fit(mesh, up="+y", **axes), bool(axes))
    return norm, norm.apply(mesh.vertices)


@pytest.mark.parametrize("mesh", [person(0), person(1, pose=2), person(2, pose=5), boxes_person(0.3)], ids="abcd")
def test_every_heading_has_the_same_normalised_points(mesh):
    _, expected = normalised_points(mesh)
    for degrees in ANGLES:
        _, points = normalised_points(headed(mesh, degrees))
        np.testing.assert_allclose(points, expected, atol=1e-9)


@pytest.mark.parametrize("degrees", [0.01, 20.0, -20.0])
def test_a_given_front_holds_for_a_mesh_that_faces_it_roughly(degrees):
    mesh = person(1)
    norm, expected = normalised_points(mesh, front="+z")
    turned_norm, points = normalised_points(headed(mesh, degrees), front="+z")
    np.testing.assert_allclose(points, expected, atol=1e-9)
    assert (turned_norm.front, turned_norm.detected) == ("+z", False)
    assert np.degrees(turned_norm.heading - norm.heading) == pytest.approx(degrees, abs=1e-6)


def test_the_front_is_the_nearest_axis_and_the_heading_what_is_left():
    for degrees, front in ((20, "+z"), (70, "+x"), (-70, "-x"), (170, "-z")):
        norm, _ = normalised_points(headed(person(0), degrees))
        assert norm.front == front
        nearest = {"+z": 0, "+x": 90, "-z": 180, "-x": -90}[front]
        assert np.degrees(norm.heading) == pytest.approx(degrees - nearest, abs=3)
        assert not norm.unsure


def test_undo_inverts_and_normalised_points_are_centred_with_radius_1():
    mesh = headed(person(1, pose=2), 33)
    norm, points = normalised_points(mesh)
    assert norm.heading != 0
    np.testing.assert_allclose(norm.undo(points), mesh.vertices, atol=1e-12)
    np.testing.assert_allclose(points.max(axis=0) + points.min(axis=0), 0, atol=1e-12)
    assert np.linalg.norm(points, axis=1).max() == pytest.approx(1)
    np.testing.assert_allclose(norm.rotation @ norm.rotation.T, np.eye(3), atol=1e-12)


def test_the_order_of_vertices_has_no_influence():
    mesh = headed(person(0, pose=3), 33)
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    norm, shuffled = (normalised_points(m)[0] for m in (mesh, permute_vertices(mesh, order)))
    assert (norm.heading, norm.radius) == (shuffled.heading, shuffled.radius)
    assert np.array_equal(norm.centre, shuffled.centre)


def test_other_triangles_of_a_surface_have_the_same_principal_axes():
    mesh = headed(person(0, pose=3), 33)
    pairs = edges(mesh.faces)
    points = np.concatenate([mesh.vertices, mesh.vertices[pairs].mean(axis=1)])
    finer = Mesh(points, split_faces(mesh.faces, pairs, len(mesh.vertices)))
    assert len(finer.faces) > 3 * len(mesh.faces)
    assert principal_heading(finer) == pytest.approx(principal_heading(mesh), abs=1e-9)
    scaled = mesh.with_vertices(mesh.vertices * 300 + [1e3, -20, 4e3])
    assert principal_heading(scaled) == pytest.approx(principal_heading(mesh), abs=1e-9)


def test_principal_axes_of_points_and_of_a_round_shape():
    points = np.random.default_rng(0).normal(size=(4000, 3)) * [0.2, 1.0, 3.0]
    assert np.degrees(principal_heading(headed(Mesh(points), 30))) == pytest.approx(30, abs=1)
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    points = np.concatenate([np.stack([np.cos(angle), np.full(64, y), np.sin(angle)], 1) for y in (0.0, 1.0)])
    cloud = Mesh(points)
    assert principal_heading(cloud) is None
    norm = Normalization.fit(cloud, "+y", "+z")
    assert without_heading(cloud, norm, True) is norm  # a round shape keeps its heading


def test_the_body_of_an_animal_lies_along_its_front():
    cow = animal("cow")
    norms = [Normalization.fit(mesh, "+y", "+z") for mesh in (cow, headed(cow, 30))]
    plain, turned = without_heading(cow, norms[0], True, False), without_heading(headed(cow, 30), norms[1], True, False)
    assert plain.heading == pytest.approx(0, abs=0.02)
    assert np.degrees(turned.heading - plain.heading) == pytest.approx(30)


def test_normals_change_nothing_and_are_not_turned(monkeypatch):
    mesh = headed(person(1), 30.0)
    normals = np.broadcast_to([0.0, 1.0, 0.0], (len(mesh.faces), 3, 3)).copy()
    shaded = dataclasses.replace(mesh, corner_normals=normals)
    expected, points = normalised_points(mesh)
    monkeypatch.setattr(mesh_module, "normal_turner", lambda *_: pytest.fail("normals are turned"))
    norm, shaded_points = normalised_points(shaded)
    assert (points == shaded_points).all()
    front = np.array([0.3, 0.0, 1.0])
    assert turned_to_front(shaded, norm, front, False).heading == turned_to_front(mesh, expected, front, False).heading
