"""The skeleton baseline: exact or near the truth; heat weights on any mesh, against a naive dense implementation."""

import dataclasses

import numpy as np
import pytest
from people import person, walk
from zoo import ZOO, grid

from mimesh.bodies import load_body
from mimesh.bodies.chamfer_fit import BodyParameters, thin_body
from mimesh.core.canonical_order import canonical_order
from mimesh.core.geometry import face_areas
from mimesh.core.mesh import Clip, Mesh, permute_vertices
from mimesh.core.normalization import Normalization
from mimesh.evaluate.metrics import pmd_aligned
from mimesh.methods.skeleton import (
    HEAT,
    SkeletonBaseline,
    bind,
    bone_segments,
    bone_transforms,
    cotangent_laplacian,
    heat_weights,
    heated_areas,
    nearest_segments,
    outward_normals,
)

BODY = thin_body(load_body(), 500, 8)
IDENTITY = person(0, pose=3)


def random_fit(seed: int, turn: float = 0.3) -> BodyParameters:
    rng = np.random.default_rng(seed)
    return BodyParameters(
        0.9, np.array([0.0, -0.9, 0.0]), rng.normal(size=8), turn * rng.normal(size=(len(BODY.parents), 3))
    )


def normalised(mesh: Mesh) -> Mesh:
    return dataclasses.replace(mesh, vertices=Normalization.fit(mesh, "+y", "+z").apply(mesh.vertices))


def shuffled(mesh: Mesh, order) -> Mesh:
    mesh = permute_vertices(mesh, order)
    return dataclasses.replace(mesh, faces=np.random.default_rng(1).permutation(mesh.faces))


def random_order(mesh: Mesh):
    return np.random.default_rng(0).permutation(len(mesh.vertices))


def bound(mesh: Mesh, fit: BodyParameters):
    ranked = canonical_order(mesh.vertices)
    return bind(mesh, ranked, BODY, fit)[ranked.group]


def moved(identity: Mesh, driving: Mesh):
    identity, driving = normalised(identity), normalised(driving)
    return next(iter(SkeletonBaseline().prepare(identity, Clip.still(driving))([driving.vertices])))


@pytest.mark.slow
@pytest.mark.usefixtures("quick_fits")
def test_identity_as_driving_returns_the_identity():
    mesh = normalised(person(0, pose=1))
    assert np.allclose(moved(mesh, mesh), mesh.vertices, rtol=0, atol=1e-12)


def test_weights_do_not_depend_on_order_and_agree_at_seams():
    mesh, fit = normalised(IDENTITY), random_fit(0, 0.0)
    weights, order = bound(mesh, fit), random_order(mesh)
    assert np.array_equal(bound(shuffled(mesh, order), fit), weights[order])
    split = Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))
    assert np.allclose(bound(split, fit), weights[mesh.faces.ravel()], rtol=0, atol=1e-12)


def test_segments_join_the_joints_and_every_joint_owns_one():
    fit = random_fit(1)
    segments, owners = bone_segments(BODY, fit)
    assert set(owners) == set(range(len(BODY.parents)))
    assert np.allclose(segments[:, 0], fit.joints(BODY)[owners])
    knee, foot = BODY.joint("LeftLeg"), BODY.joint("LeftFoot")
    assert np.allclose(segments[owners == knee][0], fit.joints(BODY)[[knee, foot]])
    top = segments[owners == BODY.joint("Head")][0, 1] - fit.joints(BODY)[BODY.joint("Head")]
    assert np.linalg.norm(top) > 0.05


def test_bones_keep_their_length_and_take_the_rotations_of_the_fits():
    identity_fit, driving_fit = random_fit(1), random_fit(2)
    rotation, offset = bone_transforms(BODY, identity_fit, driving_fit)
    assert np.allclose(rotation @ identity_fit.rotations(BODY), driving_fit.rotations(BODY), rtol=0, atol=1e-12)
    joints, parents = identity_fit.joints(BODY), np.array(BODY.parents)
    positions = np.einsum("jkl,jl->jk", rotation, joints) + offset
    ends = np.einsum("jkl,jl->jk", rotation[parents[1:]], joints[1:]) + offset[parents[1:]]
    assert np.allclose(ends, positions[1:], rtol=0, atol=1e-12)  # the maps of parent and child agree at the joint
    lengths, expected = (np.linalg.norm(x[1:] - x[parents[1:]], axis=1) for x in (positions, joints))
    assert np.allclose(lengths, expected, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_result_is_near_the_truth():
    truth, size = person(0, pose=1).vertices, Normalization.fit(IDENTITY, "+y", "+z").radius
    error = pmd_aligned(size * moved(IDENTITY, person(1, pose=1)), truth)
    assert error < 5e-4  # the paper reports 27e-4
    assert pmd_aligned(IDENTITY.vertices, truth) > 10 * error


@pytest.mark.slow
def test_frames_of_a_clip_are_near_the_truth():
    identity, clip = person(0), walk(1, frames=2)
    size, frame = Normalization.fit(identity, "+y", "+z").radius, Normalization.fit(clip.mesh, "+y", "+z")
    drive = SkeletonBaseline().prepare(normalised(identity), Clip.still(normalised(clip.mesh)))
    results = drive(frame.apply(vertices) for vertices in clip.vertices)
    for result, truth in zip(results, walk(0, frames=2).vertices, strict=True):
        assert pmd_aligned(size * result, truth) < 2e-4


BONES = np.array([[[0.0, 0, 0], [1, 0, 0]], [[1, 0, 0], [2, 0, 0]]])
OWNERS = np.array([0, 1])


def tube(rings: int = 21, around: int = 12, radius: float = 0.1) -> Mesh:
    """A closed cylinder along x from 0 to 2 with outward faces."""
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
    assert not weights[:, 2].any()  # a bone without segments has no heat


def test_weight_is_one_far_along_a_bone_and_half_at_the_joint():
    mesh = tube()
    weights = heat_weights(mesh.vertices, mesh.faces, BONES, OWNERS, 2)
    x = mesh.vertices[:, 0]
    assert weights[x < 0.4, 0].min() > 0.999
    assert weights[x > 1.6, 1].min() > 0.999
    assert np.allclose(weights[np.isclose(x, 1)], 0.5, rtol=0, atol=1e-9)
    along = [weights[np.isclose(x, at), 0].mean() for at in np.linspace(0, 2, 21)]
    assert (np.diff(along) <= 1e-12).all()


def elbow(vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The tube's second half turned by 90 degrees about z at x = 1, and its bones."""
    x, y, z = vertices.T
    turned = np.where(x[:, None] > 1, np.stack([1 - y, x - 1, z], axis=1), vertices)
    return turned, np.array([[[0.0, 0, 0], [1, 0, 0]], [[1, 0, 0], [1, 1, 0]]])


def test_both_bones_have_equal_weights_outside_a_bend():
    mesh = tube(around=16)
    vertices, bones = elbow(mesh.vertices)
    wedge = (vertices[:, 0] >= 1) & (vertices[:, 1] <= 0)
    assert wedge.sum() > 5
    nearest, distance = nearest_segments(vertices, mesh.faces, bones)
    assert nearest[wedge].all()
    assert np.allclose(distance[wedge], np.linalg.norm(vertices[wedge] - [1, 0, 0], axis=1), rtol=0, atol=1e-12)
    points = np.array([[1.3, -0.4, 0.2], [1.01, -0.7, 0.0], [0.5, -0.1, 0.0]])
    weights = heat_weights(points, np.zeros((0, 3), int), bones, OWNERS, 2)
    assert np.allclose(weights, [[0.5, 0.5], [0.5, 0.5], [1, 0]], rtol=0, atol=1e-12)


def test_rounding_errors_do_not_choose_a_bone():
    mesh, rng = tube(around=16), np.random.default_rng(0)
    vertices, bones = elbow(mesh.vertices)
    expected = heat_weights(vertices, mesh.faces, bones, OWNERS, 2)
    for _ in range(3):
        noisy = vertices + rng.uniform(-1e-9, 1e-9, vertices.shape)
        moved = bones + rng.uniform(-1e-9, 1e-9, bones.shape)
        weights = heat_weights(noisy, mesh.faces, moved, OWNERS, 2)
        assert np.allclose(weights, expected, rtol=0, atol=1e-5)


def test_k_equal_bones_heat_k_times_as_fast():
    """Two owners of one bone together have the weights of one bone with twice the heat."""
    mesh = tube(rings=9, around=6)
    area, stiffness = heated_areas(mesh.vertices, mesh.faces), cotangent_laplacian(mesh.vertices, mesh.faces)
    twice = heat_weights(mesh.vertices, mesh.faces, BONES[[0, 0, 1]], np.arange(3), 3)
    nearest, distance = nearest_segments(mesh.vertices, mesh.faces, BONES)
    rate = area * HEAT * (nearest @ [2, 1]) / distance**2
    heated = nearest * [2, 1] / (nearest @ [2, 1])[:, None]
    expected = np.linalg.solve(stiffness.toarray() + np.diag(rate), rate[:, None] * heated)
    assert np.allclose(twice[:, 0], twice[:, 1], rtol=0, atol=1e-12)
    assert np.allclose(twice[:, :2].sum(axis=1), expected[:, 0], rtol=0, atol=1e-10)


def test_weights_equal_a_naive_dense_solve():
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
    nearest, distance = nearest_segments(vertices, mesh.faces, BONES)
    assert set(nearest.sum(axis=1)) == {1, 2}
    share = nearest / nearest.sum(axis=1, keepdims=True)
    rate = area * HEAT * nearest.sum(axis=1) / np.maximum(distance, 2e-3) ** 2
    expected = np.linalg.solve(stiffness + np.diag(rate), rate[:, None] * share)
    assert np.allclose(cotangent_laplacian(vertices, mesh.faces).toarray(), stiffness, rtol=0, atol=1e-12)
    assert np.allclose(heat_weights(vertices, mesh.faces, BONES, OWNERS, 2), expected, rtol=0, atol=1e-10)


def test_bone_in_front_of_the_surface_is_ignored():
    """Two tubes side by side: the second bone is the nearer one for none of the first tube's vertices."""
    mesh = tube()
    bones = np.array([[[0.0, 0, 0], [2, 0, 0]], [[0, 0.15, 0], [2, 0.15, 0]]])
    nearest, distance = nearest_segments(mesh.vertices, mesh.faces, bones)
    side = np.isclose(mesh.vertices[:, 1], 0.1)
    assert side.any()
    assert (nearest[side] == [True, False]).all()
    assert np.allclose(distance[side & (mesh.vertices[:, 0] > 0)], 0.1)
    cloud = nearest_segments(mesh.vertices, mesh.faces[:0], bones)[0]
    assert (cloud[side] == [False, True]).all()  # without faces nothing is in front


def test_inverted_mesh_has_the_same_weights():
    mesh = tube()
    expected = heat_weights(mesh.vertices, mesh.faces, BONES, OWNERS, 2)
    turned = heat_weights(mesh.vertices, mesh.faces[:, [0, 2, 1]], BONES, OWNERS, 2)
    assert np.allclose(turned, expected, rtol=0, atol=1e-12)


def test_weights_with_degenerate_faces_sum_to_one():
    mesh = tube()
    faces = np.concatenate([mesh.faces, [[0, 0, 1], [0, 12, 24]]])
    weights = heat_weights(mesh.vertices, faces, BONES, OWNERS, 2)
    assert np.isfinite(weights).all()
    assert np.allclose(weights.sum(axis=1), 1)


def test_cancelling_faces_have_no_normal_and_ignore_no_bone():
    mesh = tube()
    both = np.concatenate([mesh.faces, np.roll(mesh.faces[:, ::-1], 1, axis=1)])
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[
        0
    ]  # so that rounding makes the sums differ from zero
    assert not outward_normals(mesh.vertices @ turn, both).any()
    bones = np.concatenate([BONES[:1], [[[0.0, 0.15, 0], [2, 0.15, 0]]]])
    nearest, _ = nearest_segments(mesh.vertices @ turn, both, bones @ turn)
    cloud, _ = nearest_segments(mesh.vertices @ turn, both[:0], bones @ turn)
    assert np.array_equal(nearest, cloud)


def test_bone_in_the_surface_is_not_in_front_of_it():
    sheet = grid()
    middle = sheet.vertices[:, :1].mean()
    low, high = sheet.vertices.min(axis=0), sheet.vertices.max(axis=0)
    bones = np.array([[low, [low[0], high[1], low[2]]], [[middle, low[1], -9], [middle, high[1], -9]]])
    bones[0] += [0, 0, 1e-12]
    for faces in (sheet.faces, sheet.faces[:, ::-1]):
        nearest, _ = nearest_segments(sheet.vertices, faces, bones)
        assert nearest[:, 0].all()


def test_normals_of_one_inverted_component_are_flipped():
    mesh = tube()
    count = len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, mesh.vertices + [0, 1, 0]])
    expected = outward_normals(vertices, np.concatenate([mesh.faces, mesh.faces + count]))
    for first, second in ((mesh.faces[:, ::-1], mesh.faces), (mesh.faces, mesh.faces[:, ::-1])):
        normals = outward_normals(vertices, np.concatenate([first, second + count]))
        assert np.allclose(normals, expected, rtol=0, atol=1e-12)
    assert np.allclose(expected[:count], expected[count:], rtol=0, atol=1e-12)
    assert np.allclose(expected[:count], outward_normals(mesh.vertices, mesh.faces), rtol=0, atol=1e-12)
