"""Correspondence: the energies against naive implementations, the registration on shapes with a known answer."""

import numpy as np
import pytest
import zoo
from people import person
from scipy.spatial.transform import Rotation

from mimesh.core.canonical_order import canonical_faces
from mimesh.core.errors import InputError
from mimesh.core.geometry import closest_barycentric, face_normals
from mimesh.core.mesh import Mesh
from mimesh.core.normalization import bbox_centre, radius
from mimesh.methods import correspondence
from mimesh.methods.deformation_transfer import (
    IDENTITY_WEIGHT,
    REST_WEIGHT,
    closest_valid,
    faces_at_edges,
    match_by_index,
    match_by_markers,
    matching_triangles,
    quarter_turn,
    register,
    registration_terms,
    vertex_pairs,
    well_shaped_faces,
)

SURFACES = [make for make in zoo.ZOO if make is not zoo.point_cloud]


def unknowns(mesh: Mesh, vertices: np.ndarray, normal_images: np.ndarray) -> np.ndarray:
    assert len(mesh.faces) == len(normal_images)
    return np.concatenate([vertices, normal_images])


def naive_maps(mesh: Mesh, vertices: np.ndarray, normal_images: np.ndarray) -> list[np.ndarray]:
    """T of each triangle as the paper has it: deformed edges and fourth vertex times the inverse of those at rest."""
    maps = []
    normals = face_normals(mesh.vertices, mesh.faces)
    for f, (a, b, c) in enumerate(mesh.faces):
        before = np.stack([mesh.vertices[b] - mesh.vertices[a], mesh.vertices[c] - mesh.vertices[a], normals[f]], 1)
        after = np.stack([vertices[b] - vertices[a], vertices[c] - vertices[a], normal_images[f]], 1)
        maps.append(after @ np.linalg.inv(before))
    return maps


@pytest.mark.parametrize("make", SURFACES)
def test_registration_terms_are_the_papers_energies(make):
    mesh, rng = make(), np.random.default_rng(0)
    vertices, images = rng.normal(size=mesh.vertices.shape), rng.normal(size=mesh.faces.shape)
    smoothness, identity_maps = registration_terms(mesh.vertices, mesh.faces)
    maps, x = naive_maps(mesh, vertices, images), unknowns(mesh, vertices, images)
    assert np.allclose((identity_maps @ x).reshape(-1, 3, 3).transpose(0, 2, 1), maps)
    expected = sum(np.square(maps[i] - maps[j]).sum() for i, j in faces_at_edges(mesh.faces))
    assert np.isclose(np.square(smoothness @ x).sum(), expected)


@pytest.mark.parametrize("make", [zoo.tetrahedron, zoo.cube, zoo.grid, zoo.two_parts])
def test_faces_at_edges_are_those_that_share_two_vertices(make):
    faces = make().faces
    found = {tuple(sorted(pair)) for pair in faces_at_edges(faces).tolist()}
    naive = {(i, j) for i in range(len(faces)) for j in range(i + 1, len(faces)) if len({*faces[i]} & {*faces[j]}) == 2}
    assert found == naive


def test_solve_with_markers_is_the_dense_least_squares(monkeypatch):
    """Naive twin: the quadratic energy of markers, smoothness, identity and rest, by lstsq."""
    monkeypatch.setattr(correspondence, "CLOSEST_WEIGHTS", ())
    mesh, marked = zoo.cube(), np.array([0, 3, 5])
    targets = mesh.vertices[marked] + np.random.default_rng(0).normal(size=(3, 3)) * 0.2
    smoothness, identity_maps = registration_terms(mesh.vertices, mesh.faces)
    marker_rows, rest = np.zeros((3, 20)), np.eye(8, 20)
    marker_rows[np.arange(3), marked] = 1
    weights = np.sqrt([correspondence.MARKER_WEIGHT, IDENTITY_WEIGHT, REST_WEIGHT])
    matrix = np.concatenate(
        [smoothness.toarray(), weights[0] * marker_rows, weights[1] * identity_maps.toarray(), weights[2] * rest]
    )
    eyes = np.tile(np.eye(3), (12, 1))
    right = np.concatenate(
        [np.zeros((smoothness.shape[0], 3)), weights[0] * targets, weights[1] * eyes, weights[2] * mesh.vertices]
    )
    expected = np.linalg.lstsq(matrix, right, rcond=None)[0][:8]
    result = register(mesh.vertices, mesh.faces, mesh.vertices[mesh.faces], marked, targets)
    assert np.abs(result - expected).max() < 1e-6


def test_closest_valid_points_are_those_of_an_exhaustive_search():
    mesh, target = person(0, faces=400), person(1, 2, faces=400)
    points, valid = closest_valid(mesh.vertices, mesh.faces, target.vertices[target.faces])
    normals = correspondence.vertex_normals(mesh.vertices, mesh.faces)
    target_normals = face_normals(target.vertices, target.faces)
    assert valid.mean() > 0.9
    best = []
    for v in np.flatnonzero(valid):
        facing = target.vertices[target.faces][target_normals @ normals[v] > 0]
        query = np.repeat(mesh.vertices[v : v + 1], len(facing), axis=0)
        on = np.einsum("gk,gkc->gc", closest_barycentric(query, facing), facing)
        best.append(np.linalg.norm(on - mesh.vertices[v], axis=1).min())
    found = np.linalg.norm(points - mesh.vertices, axis=1)[valid > 0]
    assert (found > np.array(best) - 1e-9).all()
    assert np.mean(found < np.array(best) + 1e-9) > 0.9


def test_points_that_face_the_other_way_are_not_valid():
    sheet = zoo.grid(4)
    back = Mesh(sheet.vertices - [0, 0, 0.1], sheet.faces[:, ::-1])
    far = Mesh(sheet.vertices + [0, 0, 0.3], sheet.faces)
    both = np.concatenate([mesh.vertices[mesh.faces] for mesh in (back, far)])
    points, valid = closest_valid(sheet.vertices, sheet.faces, both)
    assert valid.all()
    assert np.allclose(points, sheet.vertices + [0, 0, 0.3])
    match, same_facing = matching_triangles(sheet.vertices[sheet.faces], both)
    assert same_facing.all()
    assert np.array_equal(match, len(sheet.faces) + np.arange(len(sheet.faces)))
    alone = back.vertices[back.faces]
    assert not closest_valid(sheet.vertices, sheet.faces, alone)[1].any()
    match, same_facing = matching_triangles(sheet.vertices[sheet.faces], alone)
    assert not same_facing.any()
    assert np.array_equal(match, np.arange(len(sheet.faces)))


def test_registration_finds_a_bent_copy():
    sheet = zoo.grid(9)
    x, y = sheet.vertices[:, 0], sheet.vertices[:, 1]
    bent = np.stack([x * 1.2, y * 0.9, 0.2 * x * x], axis=1)
    corners = np.array([0, 8, 72, 80])
    result = register(sheet.vertices, sheet.faces, bent[sheet.faces], corners, bent[corners])
    assert np.abs(result[corners] - bent[corners]).max() < 1e-3
    _, valid = closest_valid(result, sheet.faces, bent[sheet.faces])
    assert valid.all()
    assert np.abs(result[:, 2] - 0.2 * (result[:, 0] / 1.2) ** 2).max() < 5e-3
    assert np.linalg.norm(result - bent, axis=1).mean() < 0.03


def test_component_without_a_marker_is_registered():
    parts = Mesh(zoo.two_parts().vertices / 4, zoo.two_parts().faces)
    target = parts.vertices * 1.1 + [0.01, 0.02, 0]
    marked = np.arange(4)
    result = register(parts.vertices, parts.faces, target[parts.faces], marked, target[marked])
    assert np.abs(result[:4] - target[:4]).max() < 1e-4
    points, valid = closest_valid(result, parts.faces, target[parts.faces])
    assert valid.all()
    assert np.linalg.norm(points - result, axis=1).max() < 0.005
    assert np.linalg.norm(points - result, axis=1).max() < np.abs(parts.vertices[4:] - target[4:]).max() / 5


def test_matches_of_people_are_near_the_true_ones():
    identity, reference = person(0, 3), person(1, 3)
    rest = person(0).vertices
    marked = np.array([rest[:, 1].argmax(), rest[:, 0].argmax(), rest[:, 0].argmin(), rest[:, 1].argmin()])
    size = radius(identity.vertices - bbox_centre(identity.vertices))
    identity = Mesh(identity.vertices / size, identity.faces)
    identity_corners, reference_corners = match_by_markers(
        identity, reference, reference, np.stack([marked, marked], axis=1)
    )
    found, all_of_it = (
        [{tuple(sorted(face)) for face in corners.tolist()} for corners in pair]
        for pair in ((identity_corners, reference_corners), (well_shaped_faces(identity), well_shaped_faces(reference)))
    )
    assert found[0] == all_of_it[0]
    assert found[1] <= all_of_it[1]
    assert len(found[1]) > 0.95 * len(all_of_it[1])
    true, found = (reference.vertices[corners].mean(axis=1) for corners in (identity_corners, reference_corners))
    assert np.linalg.norm(true - found, axis=1).mean() < 0.02
    assert np.mean((np.sort(identity_corners) == np.sort(reference_corners)).all(axis=1)) > 0.5


def test_reference_part_without_counterpart_is_not_matched():
    """The reference has another sheet far away, and one nearby that faces the other way."""
    sheet = zoo.grid(4)
    far, back = sheet.vertices + [0, 0, 0.2], sheet.vertices - [0, 0, 0.01]
    faces = [sheet.faces, sheet.faces + 16, sheet.faces[:, ::-1] + 32]
    reference = Mesh(np.concatenate([sheet.vertices, far, back]), np.concatenate(faces))
    corners = np.array([0, 3, 12, 15])
    identity_corners, reference_corners = match_by_markers(
        sheet, reference, reference, np.stack([corners, corners], axis=1)
    )
    assert {tuple(sorted(face)) for face in identity_corners.tolist()} == {
        tuple(sorted(face)) for face in sheet.faces.tolist()
    }
    assert np.array_equal(identity_corners, reference_corners)


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_quarter_turn_is_found_exactly(degrees):
    mesh, other = person(0, 3), person(1, 3)
    turn = np.round(Rotation.from_euler("y", degrees, degrees=True).as_matrix())
    found = quarter_turn(other.vertices @ turn.T * 3 + [1, 2, 3], mesh.vertices)
    assert np.array_equal(found, turn.T)
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    assert np.array_equal(quarter_turn((other.vertices @ turn.T)[order], mesh.vertices[order]), found)


def test_component_with_slivers_and_no_marker_stays(monkeypatch):
    monkeypatch.setattr(correspondence, "CLOSEST_WEIGHTS", ())
    sheet, small = zoo.grid(5), zoo.grid(4)
    sliver = small.vertices.copy()
    sliver[1::4] = sliver[::4] + 2e-4 * (sliver[1::4] - sliver[::4])
    mesh = Mesh(
        np.concatenate([sheet.vertices, sliver * 0.02 + [0.3, 0.3, 0.5]]),
        np.concatenate([sheet.faces, small.faces + len(sheet.vertices)]),
    )
    marked = np.array([0, 4, 20, 24])
    targets = mesh.vertices[marked] * 1.1
    result = register(mesh.vertices, mesh.faces, mesh.vertices[mesh.faces], marked, targets)
    assert np.abs(result[marked] - targets).max() < 1e-3
    assert np.abs(result - mesh.vertices)[25:].max() < 1e-9


def test_matches_by_index_are_the_faces_themselves():
    identity, reference = person(0, 3), person(1, 3)
    flat = reference.vertices.copy()
    flat[reference.faces[10, 1]] = flat[reference.faces[10, 0]]
    identity_corners, reference_corners = match_by_index(identity, Mesh(flat, reference.faces), reference)
    well_shaped = {tuple(sorted(face)) for face in well_shaped_faces(Mesh(flat, reference.faces)).tolist()}
    for face, match in zip(identity_corners.tolist(), reference_corners.tolist(), strict=True):
        assert tuple(sorted(match)) in well_shaped
        assert match == face or tuple(sorted(face)) not in well_shaped
    assert 1 <= np.sum((identity_corners != reference_corners).any(axis=1)) < 10


def test_canonical_faces_do_not_depend_on_order_or_first_corner():
    mesh, rng = zoo.cube(), np.random.default_rng(0)
    rank = rng.permutation(8)
    turned = np.stack([np.roll(face, rng.integers(3)) for face in mesh.faces])[rng.permutation(12)]
    expected = canonical_faces(mesh.faces, rank)
    assert np.array_equal(canonical_faces(turned, rank), expected)
    assert (rank[expected].argmin(axis=1) == 0).all()


def test_thin_faces_are_left_out():
    turn = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-5, 0], [0.5, 1e-3, 0]]) @ turn.T
    assert well_shaped_faces(Mesh(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 0, 1]]))).tolist() == [[0, 1, 3]]


@pytest.mark.parametrize(
    ("markers", "message"),
    [
        ([[0, 0], [1, 1], [8, 2]], "found 8"),
        ([[0, 0], [1, -1], [2, 2]], "found -1"),
        ([[0, 0], [1, 1]], "3 or more places"),
        ([[0, 0], [1, 1], [1, 2]], "3 or more places"),
        ([[0, 0], [1, 1], [2, 1]], "3 or more places"),
    ],
)
def test_unusable_markers_are_refused(markers, message):
    cube = zoo.cube()
    with pytest.raises(InputError, match=message):
        vertex_pairs(cube, cube, np.array(markers))


def test_smallest_of_equally_good_turns_is_taken():
    ring = np.array([[1, 0, 0], [0, 0, 1], [-1, 0, 0], [0, 0, -1.0]])
    for points in (ring * [0, 1, 0], ring * [1, 1, 0] + [0, 1, 0]):
        assert np.array_equal(quarter_turn(points, ring[[0, 0, 2, 2]] * [0, 1, 0]), np.eye(3))
    middle = ring + ring[[1, 2, 3, 0]]  # as near to the ring as it stands and a quarter further
    assert np.array_equal(quarter_turn(middle, ring), np.eye(3))
