"""Deformation transfer is exact where the answer is known, accurate on people, and refuses bad input."""

import dataclasses
import functools

import numpy as np
import pytest
import scipy.spatial
import zoo
from matrix import matrix
from people import person
from scipy.spatial.transform import Rotation

from mimesh.core.errors import InputError
from mimesh.core.geometry import edges, face_areas, weld
from mimesh.core.mesh import Clip, Mesh, permute_vertices
from mimesh.core.normalization import bbox_centre, radius
from mimesh.evaluate.metrics import pmd, resized
from mimesh.methods.deformation_transfer import (
    DeformationTransfer,
    component_labels,
    deformation_solver,
    spanning_ties,
    triangle_frames,
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
def test_same_pose_returns_the_identity(markers):
    identity, _, driving, _ = trio()
    assert np.abs(run(identity, driving, driving, markers) - identity.vertices).max() < 1e-6


@WITH_AND_WITHOUT
@pytest.mark.parametrize("scale", [1.0, 0.3, 4.0])
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


@pytest.mark.parametrize("size", [1, 2, 7, 40])
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


def test_missing_reference_is_refused():
    identity, _, driving, _ = trio()
    with pytest.raises(InputError, match="--reference"):
        run(identity, None, driving)


@pytest.mark.parametrize("change", ["count", "faces"])
def test_reference_of_another_topology_is_refused(change):
    identity, reference, driving, _ = trio()
    other = trio(1500)[1] if change == "count" else dataclasses.replace(reference, faces=reference.faces[:, [1, 2, 0]])
    with pytest.raises(InputError, match="export both poses from one file"):
        run(identity, other, driving)


@pytest.mark.parametrize("factor", [100.0, 0.01])
def test_reference_in_another_unit_is_refused(factor):
    identity, reference, driving, _ = trio()
    with pytest.raises(InputError, match="times the driving's size; export both poses from one file, in one unit"):
        run(identity, moved(reference, reference.vertices * factor), driving)


@pytest.mark.parametrize("change", ["count", "faces"])
def test_other_topology_without_markers_is_refused(change):
    identity, reference, driving, _ = trio()
    other = trio(1500)[0] if change == "count" else dataclasses.replace(identity, faces=identity.faces[::-1])
    with pytest.raises(InputError, match="--markers FILE"):
        run(other, reference, driving)


def test_point_cloud_is_refused():
    cloud = zoo.point_cloud()
    with pytest.raises(InputError, match="give a surface mesh"):
        run(cloud, cloud, cloud)


def test_identity_that_is_the_reference_becomes_the_driving():
    _, reference, driving, _ = trio()
    assert np.abs(centred(run(reference, reference, driving)) - centred(driving.vertices)).max() < 1e-6


def test_components_at_equal_distances_are_tied_into_a_tree():
    lattice = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), axis=-1).reshape(-1, 3)
    ties = spanning_ties(lattice, np.zeros((0, 2), np.int64))
    assert len(ties) == 63
    assert not component_labels(ties, 64).any()
    assert np.allclose(np.linalg.norm(lattice[ties[:, 0]] - lattice[ties[:, 1]], axis=1), 1)
