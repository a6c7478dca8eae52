"""Deformation transfer is exact where the answer is known, accurate on people, and refuses bad input.

Its energies and matches are compared with naive implementations, its registration with shapes of a known answer.
"""

import dataclasses
import functools

import numpy as np
import pytest
import scipy.spatial
import zoo
from matrix import matrix
from people import person
from scipy.spatial.transform import Rotation

from mimesh.core.canonical_order import canonical_faces
from mimesh.core.errors import InputError
from mimesh.core.geometry import closest_barycentric, edges, face_areas, face_normals, vertex_normals, weld
from mimesh.core.mesh import Clip, Mesh, permute_vertices
from mimesh.core.normalization import bbox_centre, radius
from mimesh.evaluate.metrics import pmd, resized
from mimesh.methods import deformation_transfer
from mimesh.methods.deformation_transfer import (
    IDENTITY_WEIGHT,
    REST_WEIGHT,
    DeformationTransfer,
    closest_valid,
    component_labels,
    deformation_solver,
    faces_at_edges,
    match_by_index,
    match_by_markers,
    matching_triangles,
    quarter_turn,
    register,
    registration_terms,
    spanning_ties,
    triangle_frames,
    vertex_pairs,
    well_shaped_faces,
)

SEEN_POSE, UNSEEN_POSE = 3, 5
TURN = Rotation.from_euler("xyz", [20, 70, -130], degrees=True).as_matrix()


def normalised(mesh: Mesh) -> Mesh:
    centred = mesh.vertices - bbox_centre(mesh.vertices)
    return dataclasses.replace(mesh, vertices=centred / radius(centred))


@functools.cache
def trio(faces: int = 1000) -> tuple[Mesh, Mesh, Mesh, np.ndarray]:
    """Identity, reference and driving as the method gets them, and the truth in metres."""
    identity, truth = person(0, SEEN_POSE, faces), person(0, UNSEEN_POSE, faces).vertices
    reference, driving = person(1, SEEN_POSE, faces), person(1, UNSEEN_POSE, faces)
    size = radius(driving.vertices - bbox_centre(driving.vertices))
    reference = moved(reference, (reference.vertices - bbox_centre(driving.vertices)) / size)
    return normalised(identity), reference, normalised(driving), truth


@functools.cache
def markers_of(faces: int = 1000) -> np.ndarray:
    """Head, hands and feet, by position at rest."""
    vertices = person(0, None, faces).vertices
    toes = [np.where(side * vertices[:, 0] > 0, vertices[:, 2] - 3 * vertices[:, 1], -9).argmax() for side in (1, -1)]
    return np.array([vertices[:, 1].argmax(), vertices[:, 0].argmax(), vertices[:, 0].argmin(), *toes])


def pairs_of(marked: np.ndarray) -> np.ndarray:
    return np.stack([marked, marked], axis=1)


def moved(mesh: Mesh, vertices: np.ndarray) -> Mesh:
    return dataclasses.replace(mesh, vertices=vertices)


def run(identity: Mesh, reference: Mesh | None, driving: Mesh, markers=None) -> np.ndarray:
    drive = DeformationTransfer(reference, markers).prepare(identity, Clip.still(driving))
    return next(iter(drive([driving.vertices])))


def centred(vertices: np.ndarray) -> np.ndarray:
    return vertices - vertices.mean(axis=0)


def joined(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


WITH_AND_WITHOUT = pytest.mark.parametrize("markers", [None, pairs_of(markers_of())], ids=["index", "markers"])


@WITH_AND_WITHOUT
@pytest.mark.parametrize("scale", [1.0, 0.3])
def test_rigid_motion_and_scaling_are_reproduced(markers, scale):
    identity, _, driving, _ = trio()
    motion = driving.vertices @ TURN.T * scale + [3, -2, 1]
    result = run(identity, driving, moved(driving, motion), markers)
    assert np.abs(centred(result) - centred(identity.vertices @ TURN.T * scale)).max() < 1e-6 * scale


@pytest.mark.parametrize("make", [zoo.tetrahedron, zoo.cube, zoo.grid, zoo.two_parts, zoo.bow_tie])
def test_meshes_of_any_topology_follow_a_rigid_motion(make):
    identity, reference = normalised(make()), normalised(make())
    stretched = moved(identity, identity.vertices * [1.0, 1.3, 0.8])
    result = run(stretched, reference, moved(reference, reference.vertices @ TURN.T + 1))
    assert np.abs(centred(result) - centred(stretched.vertices @ TURN.T)).max() < 1e-6


@WITH_AND_WITHOUT
def test_error_on_an_unseen_pose_is_below_the_papers_and_the_drivings(markers):
    identity, reference, driving, truth = trio()
    result = pmd(resized(run(identity, reference, driving, markers), truth), truth)
    assert result < 6.7e-4
    assert result < pmd(resized(driving.vertices, truth), truth) / 2


def test_markers_match_meshes_of_different_counts():
    identity, _, _, truth = trio()
    _, reference, driving, _ = trio(1500)
    markers = np.stack([markers_of(), markers_of(1500)], axis=1)
    assert pmd(resized(run(identity, reference, driving, markers), truth), truth) < 6.7e-4


def test_permuted_meshes_permute_the_result_to_the_last_bit():
    meshes = trio()[:3]
    order = np.random.default_rng(2).permutation(len(meshes[0].vertices))
    result = run(*(shuffled_faces(permute_vertices(mesh, order)) for mesh in meshes))
    assert np.array_equal(result, run(*meshes)[order])


def shuffled_faces(mesh: Mesh) -> Mesh:
    """Faces in another order, each begun at another corner."""
    rng = np.random.default_rng(7)
    turned = np.take_along_axis(mesh.faces, (rng.integers(3, size=(len(mesh.faces), 1)) + np.arange(3)) % 3, axis=1)
    return dataclasses.replace(mesh, faces=turned[rng.permutation(len(turned))])


@WITH_AND_WITHOUT
def test_seams_do_not_tear(markers):
    meshes = trio()[:3]
    corners = meshes[0].faces.ravel()
    split = [Mesh(mesh.vertices[corners], np.arange(len(corners)).reshape(-1, 3)) for mesh in meshes]
    first = np.unique(corners, return_index=True)[1]
    split_markers = None if markers is None else first[markers]
    result = run(*split, split_markers)
    assert np.abs(result - run(*meshes, markers)[corners]).max() < 1e-9
    assert len(weld(result)[0]) == len(weld(meshes[0].vertices)[0])


def test_separate_component_moves_with_the_nearest_limb():
    """A bracelet that only the identity has turns with the hand and keeps its distance."""
    identity, reference, driving, _ = trio()
    hand, size = markers_of()[1], 0.02
    bracelet = Mesh(zoo.cube().vertices * size + identity.vertices[hand] + [size, 0, 0], zoo.cube().faces)
    markers = pairs_of(markers_of())
    result = run(joined(identity, bracelet), reference, driving, markers)
    count = len(identity.vertices)
    assert np.abs(centred(result[:count]) - centred(run(identity, reference, driving, markers))).max() < 1e-3
    gap = np.linalg.norm(result[count:] - result[hand], axis=1).min()
    assert 0.5 * size < gap < 2 * size


@pytest.mark.parametrize("scale", [1.0, 1.7])
def test_touching_components_separate_as_the_drivings_do(scale):
    """A hand at the hip, each a component, moves away and turns: ties do not hold it back."""
    hip, hand = zoo.grid(), Mesh(zoo.cube().vertices * 0.3 + [0.35, 0.35, 0.05], zoo.cube().faces)
    identity = normalised(joined(hip, hand))
    reference = moved(identity, identity.vertices * scale)
    driving = reference.vertices.copy()
    driving[25:] = (driving[25:] - driving[25]) @ TURN.T + [0.4, -0.2, 2]
    result = run(identity, reference, moved(reference, driving))
    assert np.abs(centred(result) - centred(driving) / scale).max() < 1e-6


def naive_ties(points: np.ndarray, links: np.ndarray) -> list[tuple[int, int]]:
    """Kruskal's tree over all pairs of points, shortest first."""
    label, ties = component_labels(links, len(points)), []
    distance = np.linalg.norm(points[:, None] - points, axis=-1)
    for pair in np.argsort(distance, axis=None, kind="stable"):
        i, j = divmod(int(pair), len(points))
        if label[i] != label[j]:
            ties.append((i, j))
            label[label == label[j]] = label[i]
    return ties


@pytest.mark.parametrize("size", [1, 7])
def test_ties_are_a_minimum_spanning_tree(size):
    rng = np.random.default_rng(size)
    points = rng.normal(size=(160, 3)) + np.repeat(rng.normal(size=(160 // size + 1, 3)) * 3, size, axis=0)[:160]
    part = np.arange(160) // size
    links = np.stack([np.arange(159), np.arange(1, 160)], axis=1)[part[1:] == part[:-1]]
    found = spanning_ties(points, links)
    assert len(found) == part.max()
    assert {frozenset(pair) for pair in found.tolist()} == {frozenset(pair) for pair in naive_ties(points, links)}


def test_many_components_need_few_kd_trees(monkeypatch):
    """One for each of 200 components would be slow: their labels have 8 bits, two trees a bit, in rounds that halve."""
    trees = []

    class Counted(scipy.spatial.KDTree):
        def __init__(self, points):
            trees.append(len(points))
            super().__init__(points)

    monkeypatch.setattr(scipy.spatial, "KDTree", Counted)
    points = np.random.default_rng(0).normal(size=(600, 3))
    assert len(spanning_ties(points, edges(np.arange(600).reshape(-1, 3)))) == 199
    assert 0 < len(trees) <= 2 * sum(range(1, 9))


def test_thin_faces_and_loose_vertices_follow_their_neighbours():
    identity, reference, driving, _ = trio()
    expected, count = run(identity, reference, driving), len(identity.vertices)

    def with_thin_faces(mesh):
        a, b, c = mesh.faces[10]
        extra = [[a, a, b], [a, b, count], [count + 1, count + 1, count + 1]]
        added = [(mesh.vertices[a] + mesh.vertices[b]) / 2, mesh.vertices[c] * 1.01]
        return Mesh(np.concatenate([mesh.vertices, added]), np.concatenate([mesh.faces, extra]))

    result = run(*map(with_thin_faces, (identity, reference, driving)))
    assert np.isfinite(result).all()
    assert np.abs(result[:count] - expected).max() < 1e-4
    a, b, _ = identity.faces[10]
    assert np.linalg.norm(result[count] - (result[a] + result[b]) / 2) < 0.02


@pytest.mark.parametrize("make", [zoo.tetrahedron, zoo.cube, zoo.grid])
def test_solver_is_the_papers_least_squares_with_fourth_vertices(make):
    """Naive twin: dense lstsq over vertices and fourth vertices, nine equations a triangle weighted by area."""
    mesh, rng = make(), np.random.default_rng(0)
    rest, triangles = rng.normal(size=(2, len(mesh.faces), 3, 3))
    gradients = triangle_frames(triangles) @ np.linalg.inv(triangle_frames(rest))
    count = len(mesh.vertices)
    matrix, right = np.zeros((3 * len(gradients), count + len(gradients))), np.zeros((3 * len(gradients), 3))
    areas = face_areas(mesh.vertices, mesh.faces)
    for f, (a, b, c) in enumerate(mesh.faces):
        inverse = np.linalg.inv(triangle_frames(mesh.vertices[mesh.faces[f : f + 1]])[0])
        rows, weight = slice(3 * f, 3 * f + 3), np.sqrt(areas[f])
        for column, vertex in enumerate((b, c, count + f)):
            matrix[rows, vertex] += weight * inverse[column]
            matrix[rows, a] -= weight * inverse[column]
        right[rows] = weight * gradients[f].T
    expected = np.linalg.lstsq(matrix, right, rcond=None)[0][:count]
    result = deformation_solver(mesh.vertices, mesh.faces, rest)(triangles)
    assert np.abs(centred(result) - centred(expected)).max() < 1e-9


@pytest.mark.parametrize("make", [zoo.cube, zoo.grid, zoo.two_parts])
def test_face_is_weighted_by_area_whatever_its_number_of_matches(make):
    mesh, rng = make(), np.random.default_rng(0)
    rest, triangles = rng.normal(size=(2, len(mesh.faces), 3, 3))
    repeated = np.concatenate([np.arange(len(mesh.faces)), np.repeat(3, 100)])
    expected = deformation_solver(mesh.vertices, mesh.faces, rest)(triangles)
    result = deformation_solver(mesh.vertices, mesh.faces[repeated], rest[repeated])(triangles[repeated])
    assert np.abs(centred(result) - centred(expected)).max() < 1e-6


def test_offset_of_components_does_not_depend_on_driving_resolution():
    """Two sheets of few triangles driven by two of many: the offset between them has the identity's size."""
    coarse, fine = zoo.grid(3), zoo.grid(17)
    identity, reference = (joined(mesh, Mesh(mesh.vertices + [0, 0, 0.5], mesh.faces)) for mesh in (coarse, fine))
    corners = [np.array([0, n - 1, n * n - n, n * n - 1]) for n in (3, 17)]
    markers = np.stack([np.concatenate([c, c + n * n]) for c, n in zip(corners, (3, 17), strict=True)], axis=1)
    driving = reference.vertices.copy()
    driving[289:] += [0, 0, 1.0]
    result = run(identity, reference, moved(reference, driving), markers)
    expected = identity.vertices + np.repeat([[0, 0, 0], [0, 0, 1.0]], 9, axis=0)
    assert np.abs(centred(result) - centred(expected)).max() < 0.01


@WITH_AND_WITHOUT
@matrix("degrees", [90, 180, 270], quick=[90])
def test_heading_of_the_reference_does_not_matter(markers, degrees):
    identity, reference, driving, _ = trio()
    turn = np.round(Rotation.from_euler("y", degrees, degrees=True).as_matrix())
    result = run(identity, moved(reference, reference.vertices @ turn.T), driving, markers)
    assert np.array_equal(result, run(identity, reference, driving, markers))


def test_clip_frames_equal_single_poses_and_have_root_motion():
    identity, reference, driving, _ = trio()
    drive = DeformationTransfer(reference).prepare(identity, Clip.still(driving))
    first, second = drive([driving.vertices, driving.vertices + [0, 0, 0.5]])
    assert np.array_equal(first, run(identity, reference, driving))
    step = second - first
    assert np.ptp(step, axis=0).max() < 1e-9
    assert step[0, 2] == pytest.approx(0.5 * radius(first - bbox_centre(first)))


REFUSED = {
    "reference=...": lambda identity, reference, driving: (identity, None, driving),
    "export both poses from one file": lambda identity, reference, driving: (identity, trio(1500)[1], driving),
    "expected the vertices and faces of .*export both poses": lambda identity, reference, driving: (
        identity,
        dataclasses.replace(reference, faces=reference.faces[:, [1, 2, 0]]),
        driving,
    ),
    "times the driving's size; export both poses from one file, in one unit": lambda identity, reference, driving: (
        identity,
        moved(reference, reference.vertices * 100),
        driving,
    ),
    "markers=...": lambda identity, reference, driving: (trio(1500)[0], reference, driving),
    "others .*markers=...": lambda identity, reference, driving: (
        dataclasses.replace(identity, faces=identity.faces[::-1]),
        reference,
        driving,
    ),
    "give a surface mesh": lambda *meshes: [zoo.point_cloud()] * 3,
}


@pytest.mark.parametrize("message", REFUSED)
def test_unusable_meshes_are_refused(message):
    with pytest.raises(InputError, match=message):
        run(*REFUSED[message](*trio()[:3]))


def test_identity_that_is_the_reference_becomes_the_driving():
    _, reference, driving, _ = trio()
    assert np.abs(centred(run(reference, reference, driving)) - centred(driving.vertices)).max() < 1e-6


def test_components_at_equal_distances_are_tied_into_a_tree():
    lattice = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), axis=-1).reshape(-1, 3)
    ties = spanning_ties(lattice, np.zeros((0, 2), np.int64))
    assert len(ties) == 63
    assert not component_labels(ties, 64).any()
    assert np.allclose(np.linalg.norm(lattice[ties[:, 0]] - lattice[ties[:, 1]], axis=1), 1)


SURFACES = [make for make in zoo.ZOO if make is not zoo.point_cloud]


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
    maps, x = naive_maps(mesh, vertices, images), np.concatenate([vertices, images])
    assert np.allclose((identity_maps @ x).reshape(-1, 3, 3).transpose(0, 2, 1), maps)
    expected = sum(np.square(maps[i] - maps[j]).sum() for i, j in faces_at_edges(mesh.faces))
    assert np.isclose(np.square(smoothness @ x).sum(), expected)


@pytest.mark.parametrize("make", [zoo.cube, zoo.two_parts])
def test_faces_at_edges_are_those_that_share_two_vertices(make):
    faces = make().faces
    found = {tuple(sorted(pair)) for pair in faces_at_edges(faces).tolist()}
    naive = {(i, j) for i in range(len(faces)) for j in range(i + 1, len(faces)) if len({*faces[i]} & {*faces[j]}) == 2}
    assert found == naive


def test_solve_with_markers_is_the_dense_least_squares(monkeypatch):
    """Naive twin: the quadratic energy of markers, smoothness, identity and rest, by lstsq."""
    monkeypatch.setattr(deformation_transfer, "CLOSEST_WEIGHTS", ())
    mesh, marked = zoo.cube(), np.array([0, 3, 5])
    targets = mesh.vertices[marked] + np.random.default_rng(0).normal(size=(3, 3)) * 0.2
    smoothness, identity_maps = registration_terms(mesh.vertices, mesh.faces)
    marker_rows, rest = np.zeros((3, 20)), np.eye(8, 20)
    marker_rows[np.arange(3), marked] = 1
    weights = np.sqrt([deformation_transfer.MARKER_WEIGHT, IDENTITY_WEIGHT, REST_WEIGHT])
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
    normals = vertex_normals(mesh.vertices, mesh.faces)
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
    monkeypatch.setattr(deformation_transfer, "CLOSEST_WEIGHTS", ())
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
