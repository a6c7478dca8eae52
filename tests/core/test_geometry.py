"""Properties of geometric functions: areas, welding, sampling, closest points, normals that follow the surface."""

import numpy as np
import pytest
import zoo
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.core import geometry
from mimesh.core.canonical_order import canonical_order, rank_order
from mimesh.core.surface_points import at_barycentric, sample_surface

FACED = [make for make in zoo.ZOO if make is not zoo.point_cloud]


def random_rotation(rng):
    return Rotation.random(random_state=rng).as_matrix()


def test_areas_edges_and_normals_of_a_cube_and_normals_without_an_area():
    cube = zoo.cube()
    assert geometry.face_areas(cube.vertices, cube.faces).sum() == pytest.approx(6)
    assert len(geometry.edges(cube.faces)) == 18
    centre = cube.vertices.mean(axis=0)
    assert ((cube.vertices - centre) * geometry.vertex_normals(cube.vertices, cube.faces) > 0).all()
    normals = geometry.face_normals(np.eye(3), np.array([[0, 1, 2], [0, 0, 1]]))
    np.testing.assert_allclose(normals, [np.full(3, 3**-0.5), [0, 1, 0]])
    cloud = zoo.point_cloud()
    np.testing.assert_array_equal(geometry.vertex_normals(cloud.vertices, cloud.faces), np.tile([0.0, 1, 0], (50, 1)))


@pytest.mark.parametrize("make", zoo.ZOO)
def test_welded_positions_index_to_the_vertices(make):
    vertices = np.concatenate([make().vertices, make().vertices[::-1]])
    merged, index = geometry.weld(vertices)
    np.testing.assert_array_equal(merged[index], vertices)
    assert len(merged) == len(np.unique(vertices, axis=0)) <= len(vertices) // 2


def test_neighbours_are_the_ends_of_edges():
    faces = zoo.two_parts().faces
    first, index = geometry.neighbours(faces)
    pairs = {(int(a), int(b)) for a, b in geometry.edges(faces)}
    found = {(v, int(n)) for v in range(12) for n in index[first[v] : first[v + 1]]}
    assert found == pairs | {(b, a) for a, b in pairs}


def test_spatial_order_keeps_near_points_near():
    points = np.random.default_rng(0).random((512, 3))
    order = geometry.spatial_order(points)
    np.testing.assert_array_equal(np.sort(order), np.arange(512))
    steps = np.linalg.norm(np.diff(points[order], axis=0), axis=1).mean()
    assert steps < 0.5 * np.linalg.norm(np.diff(points, axis=0), axis=1).mean()


@pytest.mark.parametrize("make", FACED)
def test_samples_lie_on_the_surface(make):
    mesh = make()
    chosen, weights = sample_surface(mesh.vertices, mesh.faces, 200, np.random.default_rng(0))
    points = at_barycentric(mesh.vertices, mesh.faces, chosen, weights)
    _, found, distance = geometry.closest_on_mesh(points, mesh.vertices, mesh.faces)
    assert distance.max() < 1e-12
    np.testing.assert_allclose(found.sum(axis=1), 1)


def test_samples_are_uniform_by_area():
    mesh = zoo.grid(3)
    chosen, _ = sample_surface(mesh.vertices, mesh.faces, 8000, np.random.default_rng(0))
    np.testing.assert_allclose(np.bincount(chosen), 1000, rtol=0.15)


def test_closest_point_against_a_dense_search():
    rng = np.random.default_rng(1)
    triangle, points = rng.normal(size=(1, 3, 3)), rng.normal(size=(40, 3))
    weights = geometry.closest_barycentric(points, np.repeat(triangle, 40, axis=0))
    found = np.linalg.norm(weights @ triangle[0] - points, axis=1)
    u, v = np.meshgrid(np.linspace(0, 1, 200), np.linspace(0, 1, 200))
    inside = np.stack([1 - u - v, u, v], -1)[u + v <= 1]
    dense = np.linalg.norm((inside @ triangle[0])[None] - points[:, None], axis=-1).min(axis=1)
    assert (found <= dense + 1e-12).all()
    np.testing.assert_allclose(found, dense, atol=0.02)


def test_rotate_between_rotates_old_to_new():
    rng = np.random.default_rng(2)
    old, new = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, 30, 3)))
    np.testing.assert_allclose(geometry.rotate_between(old, new, old), new, atol=1e-12)
    np.testing.assert_allclose(geometry.rotate_between(old, -old, old), -old, atol=1e-12)
    assert np.linalg.det(geometry.rotation_between(old[0], -old[0])) == pytest.approx(1.0)


def custom_normals(mesh, rng):
    """Random mix of flat and smooth normals, each with an offset from the geometric normal."""
    smooth = geometry.vertex_normals(mesh.vertices, mesh.faces)[mesh.faces]
    flat = geometry.face_vectors(mesh.vertices, mesh.faces)[:, None]
    flat = np.repeat(flat / np.linalg.norm(flat, axis=-1, keepdims=True), 3, axis=1)
    normals = np.where(rng.random((len(mesh.faces), 1, 1)) < 0.5, flat, smooth) + [0.3, 0.1, 0.0]
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


@pytest.mark.parametrize("make", FACED)
def test_a_rigid_motion_rotates_custom_normals_and_none_changes_no_bit_of_them(make):
    rng = np.random.default_rng(3)
    mesh, rotation = make(), random_rotation(rng)
    normals = custom_normals(mesh, rng)
    turn = geometry.normal_turner(normals, mesh.faces, mesh.vertices)
    np.testing.assert_allclose(turn(mesh.vertices @ rotation.T + [1, 2, 3]), normals @ rotation.T, atol=1e-9)
    np.testing.assert_array_equal(turn(mesh.vertices.copy()), normals)


def test_smooth_normals_follow_a_bent_surface():
    body = load_body()
    smooth = geometry.vertex_normals(body.vertices, body.faces)[body.faces]
    bent = body.vertices * [1, 1, 1] + 0.2 * np.sin(2 * body.vertices[:, [1, 2, 0]])
    moved = geometry.normal_turner(smooth, body.faces, body.vertices)(bent)
    np.testing.assert_allclose(np.linalg.norm(moved, axis=-1), 1, atol=1e-9)
    expected = geometry.vertex_normals(bent, body.faces)[body.faces]
    assert np.quantile((moved * expected).sum(-1), 0.01) > 0.999


@pytest.mark.parametrize("make", FACED)
def test_the_gradient_of_a_linear_function_is_its_tangential_part(make):
    mesh, direction = make(), np.array([0.3, -2.0, 0.7])
    gradient = (geometry.gradient_operator(mesh.vertices, mesh.faces) @ (mesh.vertices @ direction)).reshape(-1, 3)
    normals = geometry.face_normals(mesh.vertices, mesh.faces)
    np.testing.assert_allclose(gradient, direction - normals * (normals @ direction)[:, None], atol=1e-12)


def test_faces_with_opposite_normals_are_ignored_by_the_closest_point():
    sheet = zoo.grid(3)
    up = np.tile([0.0, 0, 1], (9, 1))
    assert (geometry.closest_on_mesh(sheet.vertices, sheet.vertices, sheet.faces, normals=up)[2] == 0).all()
    assert np.isinf(geometry.closest_on_mesh(sheet.vertices, sheet.vertices, sheet.faces, normals=-up)[2]).all()


def test_a_rigid_motion_is_found_from_points_of_any_weight():
    rng = np.random.default_rng(0)
    points, turn = rng.normal(size=(9, 3)), random_rotation(rng)
    target = points @ turn.T + [1.0, -2.0, 0.5]
    noisy = np.concatenate([target, rng.normal(size=(4, 3))])
    weights = np.r_[np.full(9, 1 / 9), np.zeros(4)]
    for found, offset in (
        geometry.rigid_motion(points, target),
        geometry.rigid_motion(np.concatenate([points, points[:4]]), noisy, weights),
    ):
        np.testing.assert_allclose(found, turn, atol=1e-12)
        np.testing.assert_allclose(offset, [1.0, -2.0, 0.5], atol=1e-12)


@pytest.mark.parametrize("dtype", [np.int32, np.int64])
def test_edges_are_the_distinct_sides_of_faces(dtype):
    faces = np.random.default_rng(0).integers(60_000, size=(3000, 3)).astype(dtype)
    faces[:1000] %= 30  # shared edges, and faces with equal corners; indices whose product exceeds 32 bits
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    rows, count = np.unique(sides, axis=0, return_counts=True)
    np.testing.assert_array_equal(geometry.edges(faces), rows)
    np.testing.assert_array_equal(geometry.border_edges(faces), rows[count == 1])
    assert geometry.edges(faces).dtype == dtype
    assert geometry.edges(faces[:0]).shape == (0, 2)


def test_distinct_rows_are_those_of_unique():
    rng = np.random.default_rng(0)
    rows = rng.integers(-2, 2, size=(4000, 5)) * 0.25
    rows[rng.random(4000) < 0.1] *= -1.0  # negative zeros are zeros
    _, first, number = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    found = geometry.distinct_rows(list(rows.T))
    np.testing.assert_array_equal(found[0], first)
    np.testing.assert_array_equal(found[1], number.reshape(-1))
    assert [len(array) for array in geometry.distinct_rows(list(rows[:0].T))] == [0, 0]


def test_positions_have_the_order_of_their_ranks():
    rng = np.random.default_rng(0)
    points = rng.integers(5, size=(500, 3)) * 0.3 + rng.choice([0.0, 3e-7, -3e-7], size=(500, 3))
    merged, index = geometry.weld(points)
    rank = np.argsort(rank_order(merged))
    ranked = canonical_order(points)
    np.testing.assert_array_equal(ranked.group, rank[index])
    np.testing.assert_array_equal(ranked.group[ranked.order[ranked.start]], np.arange(len(merged)))
    np.testing.assert_array_equal(ranked.merge(points)[ranked.group], points)
