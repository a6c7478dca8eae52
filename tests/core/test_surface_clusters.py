"""Clusters of vertices: how many are left, that the surface stays where it was, and what its corners keep."""

import dataclasses

import numpy as np
import pytest
from people import person

from mimesh.core.geometry import edges, face_areas
from mimesh.core.mesh import Material, Mesh, Part
from mimesh.core.surface_clusters import clustered_mesh, clusters
from mimesh.evaluate.remesh import split_faces


def dense(times: int = 2) -> Mesh:
    """A small person whose triangles are divided into four, several times."""
    mesh = person(0)
    vertices, faces = mesh.vertices, mesh.faces
    for _ in range(times):
        pairs = edges(faces)
        faces = split_faces(faces, pairs, len(vertices))
        vertices = np.concatenate([vertices, vertices[pairs].mean(axis=1)])
    return Mesh(vertices, faces, "dense")


@pytest.mark.parametrize("count", [300, 1000, 3000])
def test_about_as_many_vertices_are_left_and_the_surface_stays(count):
    mesh = dense()
    found = clusters(mesh.vertices, mesh.faces, count)
    vertices, faces, kept = found.vertices, found.faces, found.kept
    assert 0.7 * count < len(vertices) < 3 * count
    assert (np.diff(vertices) > 0).all()
    assert faces.max() < len(vertices)
    area = face_areas(mesh.vertices, mesh.faces).sum()
    assert face_areas(mesh.vertices[vertices], faces).sum() == pytest.approx(area, rel=0.25)
    side = np.sqrt(area / count)
    moved = mesh.vertices[vertices][faces] - mesh.vertices[mesh.faces[kept]]
    assert np.linalg.norm(moved, axis=-1).max() < 3**0.5 * side


def test_enough_cells_keep_all_vertices_that_differ():
    mesh = person(0)
    found = clusters(mesh.vertices, mesh.faces, 10**9)
    assert (found.cluster == np.arange(len(mesh.vertices))).all()
    assert (found.faces == mesh.faces).all()
    assert len(found.kept) == len(mesh.faces)


def test_vertices_of_other_kinds_stay_apart():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0.01], [1, 0, 0.01], [0, 1, 0.01]])
    sheets = np.array([[0, 1, 2], [3, 5, 4]])
    assert clusters(points, sheets, 10).cluster.tolist() == [0, 1, 2, 0, 1, 2]
    found = clusters(points, sheets, 10, np.array([0, 0, 0, 7, 7, 7]))
    assert found.cluster.tolist() == [0, 1, 2, 3, 4, 5]
    assert (found.faces == sheets).all()


def test_far_vertices_without_triangles_and_a_surface_without_area():
    points = np.array([[0.0, 0, 0], [1e-9, 0, 0], [0, 1e-9, 0], [1e9, 1e9, 1e9]])
    for faces in (np.array([[0, 1, 2]]), np.array([[0, 1, 1]])):
        found = clusters(points, faces, 100)
        assert found.vertices.tolist() == [0, 3]
        assert len(found.faces) == 0


def test_corners_and_parts_stay_with_their_triangles():
    mesh = dense(1)
    corners = np.arange(6 * len(mesh.faces), dtype=float).reshape(-1, 3, 2)
    parts = (Part("a", 0, 100, Material("red")), Part("b", 100, len(mesh.faces)))
    colors = np.linspace(0, 1, 4 * len(mesh.vertices)).reshape(-1, 4)
    whole = dataclasses.replace(mesh, corner_uv=corners, parts=parts, vertex_colors=colors, up="+y")
    found, reduced = clustered_mesh(whole, 200), clusters(mesh.vertices, mesh.faces, 200)
    kept = reduced.kept
    np.testing.assert_array_equal(found.corner_uv, corners[kept])
    np.testing.assert_array_equal(found.vertex_colors, colors[reduced.vertices])
    assert found.parts[0].stop == (kept < 100).sum() == found.parts[1].start
    assert [part.name for part in found.parts] == ["a", "b"]
    assert found.parts[-1].stop == len(found.faces)
    assert found.up == "+y"
