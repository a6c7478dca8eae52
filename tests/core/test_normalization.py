"""Normalization is invertible, exact for axis rotations, and detects the facing of people."""

import dataclasses

import numpy as np
import pytest
from people import person
from zoo import ZOO

from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh, permute_vertices
from mimesh.core.normalization import (
    GRID,
    ORIENTATIONS,
    ROTATIONS,
    TURNED_CELLS,
    Normalization,
    bbox_centre,
    occupancy,
    parse_axis,
    turned_to_front,
)

MESHES = [make() for make in ZOO]


def with_vertices(mesh: Mesh, vertices: np.ndarray) -> Mesh:
    return dataclasses.replace(mesh, vertices=vertices)


def test_the_24_rotations_are_distinct_and_map_their_axes():
    assert len({rotation.tobytes() for rotation in ROTATIONS}) == 24
    assert np.allclose(np.linalg.det(ROTATIONS), 1)
    for (up, front), rotation in zip(ORIENTATIONS, ROTATIONS, strict=True):
        for name, image in ((up, [0, 1, 0]), (front, [0, 0, 1])):
            axis = np.eye(3)["xyz".index(name[1])] * (1 if name[0] == "+" else -1)
            assert np.array_equal(rotation @ axis, image)


@pytest.mark.parametrize("mesh", MESHES, ids=lambda mesh: mesh.name)
def test_apply_normalises_and_undo_inverts(mesh):
    normalization = Normalization.fit(mesh)
    inside = normalization.apply(mesh.vertices)
    assert np.allclose(bbox_centre(inside), 0, atol=1e-12)
    assert np.isclose(np.linalg.norm(inside, axis=1).max(), 1)
    assert np.allclose(normalization.undo(inside), mesh.vertices, atol=1e-12)
    clip = np.stack([mesh.vertices, mesh.vertices + 1])
    assert np.allclose(normalization.undo(normalization.apply(clip)), clip, atol=1e-12)


@pytest.mark.parametrize("pose", [None, 2])
def test_a_person_in_other_axes_has_the_same_normalised_points_to_the_last_bit(pose):
    """With another size and place, too, to rounding."""
    mesh = person(0, pose)
    expected = Normalization.fit(mesh).apply(mesh.vertices)
    for rotation in ROTATIONS:
        turned = with_vertices(mesh, mesh.vertices @ rotation.T)
        assert np.array_equal(Normalization.fit(turned).apply(turned.vertices), expected)
        turned = with_vertices(mesh, turned.vertices * 0.3 + [5, -2, 1])
        assert np.allclose(Normalization.fit(turned).apply(turned.vertices), expected, atol=1e-12)


@pytest.mark.parametrize("mesh", [person(0), *MESHES], ids=lambda mesh: mesh.name)
def test_the_order_of_vertices_has_no_influence(mesh):
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    normalization, shuffled = Normalization.fit(mesh), Normalization.fit(permute_vertices(mesh, order))
    for name in ("up", "front", "radius"):
        assert getattr(normalization, name) == getattr(shuffled, name)
    assert np.array_equal(normalization.centre, shuffled.centre)


@pytest.mark.parametrize("pose", [None, 0, 1, 2, 3, 4, 5])
def test_the_facing_of_people_is_detected(pose):
    mesh = person(3, pose)
    points = Mesh(mesh.vertices, np.zeros((0, 3), int))
    for shape in (mesh, points):
        normalization = Normalization.fit(shape)
        assert (normalization.up, normalization.front, normalization.detected) == ("+y", "+z", True)


def test_a_heading_between_the_axes_is_kept():
    mesh = person(0)
    angle = np.radians(25)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    assert Normalization.fit(with_vertices(mesh, mesh.vertices @ turn.T)).front == "+z"


@pytest.mark.parametrize(("angle", "front"), [(180, "+z"), (-100, "+x"), (70, "-x"), (50, "-z"), (-40, "-z")])
def test_results_face_the_axis_nearest_to_a_predicted_front(angle, front):
    """A detected front that the network contradicts is another axis; of a given one only the heading is taken."""
    mesh = person(0)
    norm = Normalization.fit(mesh, "+y", "-z")
    predicted = np.array([np.sin(np.radians(angle)), 0, np.cos(np.radians(angle))])
    found = turned_to_front(mesh, norm, predicted, front_known=False)
    assert found.front == front
    np.testing.assert_allclose(found.rotation.T @ [0, 0, 1], norm.rotation.T @ predicted, atol=0.06)  # FRONT_DIGITS
    assert turned_to_front(mesh, norm, predicted, front_known=True).front == "-z"


def test_given_axes_are_used():
    mesh = person(0)
    given = Normalization.fit(mesh, up="z", front="-Y")
    assert (given.up, given.front, given.detected, given.margin) == ("+z", "-y", False, 1.0)
    partial = Normalization.fit(mesh, up="+y")
    assert (partial.up, partial.front, partial.detected) == ("+y", "+z", True)


def test_a_shape_without_facing_is_unsure():
    cube = next(mesh for mesh in MESHES if mesh.name == "cube")
    assert Normalization.fit(cube).unsure
    assert not Normalization.fit(cube, up="y", front="z").unsure
    assert not Normalization.fit(person(0)).unsure


@pytest.mark.parametrize(
    ("up", "front", "message"), [("w", None, "up"), (None, "", "front"), ("y", "-y", "two different")]
)
def test_wrong_axes_are_refused(up, front, message):
    with pytest.raises(InputError, match=message):
        Normalization.fit(person(0), up, front)


def test_axis_names_are_parsed():
    assert [parse_axis(name, "up") for name in ("y", " +Y", "-z", None)] == ["+y", "+y", "-z", None]


def test_occupancy_rotates_with_the_points():
    rng = np.random.default_rng(1)
    points, weights = rng.normal(size=(200, 3)) * [1, 2, 0.5], rng.random(200)
    features = occupancy(points, weights)
    assert features.shape == (GRID**3,)
    assert np.isclose((features**2).sum(), 1)
    for rotation, cells in zip(ROTATIONS, TURNED_CELLS, strict=True):
        assert np.allclose(occupancy(points @ rotation.T, weights), features[cells])
