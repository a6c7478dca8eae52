"""Heat weights: what must hold on any mesh, then a dense twin."""

import numpy as np
import pytest
from zoo import ZOO

from mimesh.geometry import face_areas
from mimesh.mesh import Mesh
from mimesh.methods.heat_weights import (
    HEAT,
    closest_on_segment,
    cotangent_laplacian,
    heat_weights,
    nearest_segment,
    outward_normals,
    vertex_areas,
)

BONES = np.array([[[0.0, 0, 0], [1, 0, 0]], [[1, 0, 0], [2, 0, 0]]])
OWNERS = np.array([0, 1])


def tube(rings: int = 21, around: int = 12, radius: float = 0.1) -> Mesh:
    """A closed cylinder along x from 0 to 2, outward faces."""
    angle = np.linspace(0, 2 * np.pi, around, endpoint=False)
    ring = np.stack([0 * angle, np.cos(angle), np.sin(angle)], axis=1) * radius
    vertices = np.concatenate([*(ring + [x, 0, 0] for x in np.linspace(0, 2, rings)), [[0.0, 0, 0], [2, 0, 0]]])
    at = np.arange(rings * around).reshape(rings, around)
    a, b, c, d = at[:-1], np.roll(at, -1, 1)[:-1], at[1:], np.roll(at, -1, 1)[1:]
    sides = np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])
    first, last = rings * around, rings * around + 1
    caps = [(first, (k + 1) % around, k) for k in range(around)]
    caps += [(last, at[-1, k], at[-1, (k + 1) % around]) for k in range(around)]
    return Mesh(vertices, np.concatenate([sides, np.array(caps)]), name="tube")


@pytest.mark.parametrize("make", [*ZOO, tube], ids=lambda make: make.__name__)
def test_rows_sum_to_one_and_lie_between_0_and_1(make):
    mesh = make()
    weights = heat_weights(mesh.vertices, mesh.faces, BONES, OWNERS, 3)
    assert weights.shape == (len(mesh.vertices), 3)
    assert np.allclose(weights.sum(axis=1), 1, rtol=0, atol=1e-12)
    assert weights.min() >= 0
    assert weights.max() <= 1
    assert not weights[:, 2].any()  # a bone without segments warms nothing


def test_far_along_a_bone_its_weight_is_one_and_half_at_the_joint():
    mesh = tube()
    weights = heat_weights(mesh.vertices, mesh.faces, BONES, OWNERS, 2)
    x = mesh.vertices[:, 0]
    assert weights[x < 0.4, 0].min() > 0.999
    assert weights[x > 1.6, 1].min() > 0.999
    assert np.abs(weights[np.isclose(x, 1), 0] - 0.5).max() < 0.3  # the vertices there belong to one of two equals
    along = [weights[np.isclose(x, at), 0].mean() for at in np.linspace(0, 2, 21)]
    assert (np.diff(along) <= 1e-12).all()


def test_segments_of_one_owner_are_one_bone():
    mesh = tube()
    whole = heat_weights(mesh.vertices, mesh.faces, BONES, np.array([0, 0]), 1)
    assert np.allclose(whole, 1, rtol=0, atol=1e-12)


def test_weights_are_those_of_a_dense_twin():
    mesh = tube(rings=5, around=5)
    vertices, n = mesh.vertices, len(mesh.vertices)
    stiffness, area = np.zeros((n, n)), np.zeros(n)
    for face, surface in zip(mesh.faces, face_areas(vertices, mesh.faces), strict=True):
        area[face] += surface / 3
        for k in range(3):
            corner, i, j = np.roll(face, -k)
            u, v = vertices[i] - vertices[corner], vertices[j] - vertices[corner]
            cotangent = max(u @ v / np.linalg.norm(np.cross(u, v)), 0) / 2
            stiffness[[i, j], [j, i]] -= cotangent
            stiffness[[i, j], [i, j]] += cotangent
    nearest, distance = nearest_segment(vertices, mesh.faces, BONES)
    rate = area * HEAT / np.maximum(distance, 2e-3) ** 2
    expected = np.linalg.solve(stiffness + np.diag(rate), rate[:, None] * np.eye(2)[nearest])
    assert np.allclose(cotangent_laplacian(vertices, mesh.faces).toarray(), stiffness, rtol=0, atol=1e-12)
    assert np.allclose(heat_weights(vertices, mesh.faces, BONES, OWNERS, 2), expected, rtol=0, atol=1e-10)


def test_scale_changes_no_weight():
    mesh = tube()
    expected = heat_weights(mesh.vertices, mesh.faces, BONES, OWNERS, 2)
    scaled = heat_weights(100 * mesh.vertices, mesh.faces, 100 * BONES, OWNERS, 2)
    assert np.allclose(scaled, expected, rtol=0, atol=1e-9)


def test_a_bone_in_front_of_the_surface_is_not_seen():
    """Two tubes side by side: the second bone is the nearer one for none of the first tube's vertices."""
    mesh = tube()
    thin_neighbour = np.array([[[0.0, 0, 0], [2, 0, 0]], [[0, 0.15, 0], [2, 0.15, 0]]])
    nearest, distance = nearest_segment(mesh.vertices, mesh.faces, thin_neighbour)
    side = np.isclose(mesh.vertices[:, 1], 0.1)
    assert side.any()
    assert not nearest[side].any()
    assert np.allclose(distance[side & (mesh.vertices[:, 0] > 0)], 0.1)
    assert nearest_segment(mesh.vertices, mesh.faces[:0], thin_neighbour)[0][side].all()  # a cloud sees through itself


def test_an_inside_out_mesh_gets_the_same_weights():
    mesh = tube()
    expected = heat_weights(mesh.vertices, mesh.faces, BONES, OWNERS, 2)
    turned = heat_weights(mesh.vertices, mesh.faces[:, [0, 2, 1]], BONES, OWNERS, 2)
    assert np.allclose(turned, expected, rtol=0, atol=1e-12)


def test_points_without_faces_follow_the_nearest_bone():
    points = np.array([[0.2, 0.5, 0], [1.7, 0.1, 0], [5, 0, 0]])
    weights = heat_weights(points, np.zeros((0, 3), int), BONES, OWNERS, 2)
    assert np.allclose(weights, [[1, 0], [0, 1], [0, 1]])


def test_a_sliver_and_a_face_without_area_do_no_harm():
    mesh = tube()
    faces = np.concatenate([mesh.faces, [[0, 0, 1], [0, 12, 24]]])
    weights = heat_weights(mesh.vertices, faces, BONES, OWNERS, 2)
    assert np.isfinite(weights).all()
    assert np.allclose(weights.sum(axis=1), 1)


def test_areas_sum_to_the_surface():
    mesh = tube()
    assert np.isclose(vertex_areas(mesh.vertices, mesh.faces).sum(), face_areas(mesh.vertices, mesh.faces).sum())


def test_normals_look_outward_whatever_the_winding():
    mesh = tube()
    around = mesh.vertices * [0, 1, 1]
    sides = (np.abs(mesh.vertices[:, 0] - 1) < 0.95) & around.any(axis=1)
    for faces in (mesh.faces, mesh.faces[:, [0, 2, 1]]):
        assert np.allclose(outward_normals(mesh.vertices, faces)[sides], around[sides] / 0.1, rtol=0, atol=1e-9)


def test_closest_on_segment_is_that_of_dense_sampling():
    rng = np.random.default_rng(0)
    points, start, end = rng.normal(size=(20, 3)), rng.normal(size=3), rng.normal(size=3)
    dense = start + np.linspace(0, 1, 20001)[:, None] * (end - start)
    expected = dense[np.square(points[:, None] - dense).sum(-1).argmin(axis=1)]
    assert np.allclose(closest_on_segment(points, start, end), expected, rtol=0, atol=1e-3)
    assert np.allclose(closest_on_segment(points, start, start), start)
