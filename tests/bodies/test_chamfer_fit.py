"""Fits of a body to points: gradients agree with finite differences, and people are recovered from shuffled points."""

import dataclasses
import itertools
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.chamfer_fit import (
    GOOD_ERROR,
    BodyParameters,
    chamfer,
    fit_points,
    posed_and_pullback,
    rotvec_pullback,
    target_cloud,
    thin_body,
    to_vector,
)
from mimesh.bodies.sampling import pose_of, sample_pose
from mimesh.core.mesh import permute_vertices
from mimesh.core.normalization import Normalization
from mimesh.core.surface_points import at_barycentric, sample_surface
from mimesh.motions.retarget import BONES

COMPONENTS = 4


@cache
def thin(count=600):
    return thin_body(load_body(), count, COMPONENTS)


def random_fit(seed=0, angle=0.5) -> BodyParameters:
    rng = np.random.default_rng(seed)
    rotvec = angle * rng.normal(size=(len(thin().parents), 3))
    return BodyParameters(0.7, rng.normal(size=3), rng.normal(size=COMPONENTS), rotvec)


def rest(**changes) -> BodyParameters:
    """Somebody of the mean shape in a T-pose, with some changes."""
    rotvec = np.zeros((len(thin().parents), 3))
    return dataclasses.replace(BodyParameters(1.0, np.zeros(3), np.zeros(COMPONENTS), rotvec), **changes)


def finite_differences(function, x, step=1e-6):
    return np.stack([(function(x + e) - function(x - e)) / (2 * step) for e in step * np.eye(len(x))])


@pytest.mark.parametrize("angle", [0.5, 1e-5, 0.0, 2.0])
def test_gradient_of_points_agrees_with_finite_differences(angle):
    body = thin_body(load_body(), 40, COMPONENTS)
    vector = to_vector(random_fit(1, angle))
    gradient = np.random.default_rng(2).normal(size=(40, 3))
    expected = finite_differences(lambda u: (posed_and_pullback(body, u)[0] * gradient).sum(), vector)
    assert np.allclose(posed_and_pullback(body, vector)[1](gradient), expected, rtol=0, atol=1e-6)


def test_gradient_of_rotation_vectors_agrees_with_finite_differences():
    rng = np.random.default_rng(0)
    rotvec = np.concatenate([rng.normal(size=(5, 3)), [[0, 0, 0], [1e-6, 0, 0], [0, 3.1, 0], [0, 0, 1e-3]]])
    torque = rng.normal(size=rotvec.shape)

    def rotation_after(x, r):
        return (Rotation.from_rotvec(x) * Rotation.from_rotvec(r).inv()).as_rotvec()

    expected = [
        finite_differences(lambda x, r=r, t=t: rotation_after(x, r) @ t, r) for r, t in zip(rotvec, torque, strict=True)
    ]
    assert np.allclose(rotvec_pullback(rotvec, torque), np.array(expected), rtol=0, atol=1e-7)


@pytest.mark.parametrize("tangential_weight", [1.0, 0.1])
def test_chamfer_agrees_with_a_naive_sum_and_its_gradient_with_finite_differences(tangential_weight):
    rng = np.random.default_rng(0)
    cloud, others = target_cloud(rng.normal(size=(30, 3)), tangential_weight), rng.normal(size=(20, 3))
    squared = np.square(others[:, None] - cloud.points).sum(-1)
    matches = cloud.matches(others)
    assert np.array_equal(matches[0], squared.argmin(axis=1))
    assert np.array_equal(matches[1], squared.argmin(axis=0))
    error, gradient = chamfer(cloud, others, matches)
    if tangential_weight == 1:
        assert np.isclose(error, squared.min(axis=1).mean() + squared.min(axis=0).mean())
    expected = finite_differences(lambda x: chamfer(cloud, x.reshape(-1, 3), matches)[0], others.ravel())
    assert np.allclose(gradient.ravel(), expected, rtol=0, atol=1e-8)


def test_distances_along_a_plane_have_the_tangential_weight():
    grid = np.stack([*np.meshgrid(np.arange(5.0), np.arange(5.0)), np.zeros((5, 5))], -1).reshape(-1, 3)
    cloud = target_cloud(grid, tangential_weight=0.1)
    matches = np.arange(25), np.arange(25)
    assert np.isclose(chamfer(cloud, grid + [0, 0, 0.2], matches)[0], 2 * 0.2**2)
    assert np.isclose(chamfer(cloud, grid + [0.2, 0, 0], matches)[0], 2 * 0.1 * 0.2**2)


@pytest.mark.slow
@pytest.mark.parametrize("pose", [0, 1])
def test_a_person_is_recovered_from_shuffled_vertices(pose):
    """The shape has the free components only; the points differ from those of the thinned body."""
    body, rotvec = load_body(), sample_pose(load_body(), 11, pose)
    truth = BodyParameters(1.0, np.zeros(3), np.array([0.5, -1.0, 0.8, 0.4]), rotvec)
    mesh = permute_vertices(body.mesh(truth.points(body)), np.random.default_rng(5).permutation(len(body.vertices)))
    mesh = dataclasses.replace(mesh, faces=np.random.default_rng(6).permutation(mesh.faces))
    normalization = Normalization.fit(mesh, "+y", "+z")
    chosen = sample_surface(mesh.vertices, mesh.faces, 2000, np.random.default_rng(7))
    fit = fit_points(thin(2000), normalization.apply(at_barycentric(mesh.vertices, mesh.faces, *chosen)))
    found = normalization.undo(fit.joints(thin()))
    limbs = [body.joint(name) for name in {*BONES, *BONES.values()}]
    millimetres = 1e3 * np.linalg.norm(found - truth.joints(body), axis=1)[limbs]
    assert millimetres.max() < 18
    assert millimetres.mean() < 8


@pytest.mark.slow
def test_a_sitting_person_is_recovered():
    body = thin(1500)
    sits = {
        f"{side}{bone}": (x, 0.0, 0.0) for side in ("Left", "Right") for bone, x in (("UpLeg", -80.0), ("Leg", 40.0))
    }
    rotvec = pose_of(body, sits)
    points = rest(rotvec=rotvec).points(body)
    fit = fit_points(body, points[::-1])
    assert fit.error < GOOD_ERROR
    assert fit.restart_error == max(3 * fit.error, GOOD_ERROR)
    assert np.abs(fit.rotvec - rotvec)[[body.joint("LeftUpLeg"), body.joint("RightUpLeg")]].max() < 0.15


def test_a_fit_from_the_previous_frame_keeps_scale_and_shape():
    body = thin()
    first = rest(error=1e-3)
    bent = first.rotvec.copy()
    bent[body.joint("LeftForeArm"), 1] = -0.4
    points = dataclasses.replace(first, rotvec=bent).points(body)
    fit = fit_points(body, points, first)
    assert fit.scale == first.scale
    assert np.array_equal(fit.shape, first.shape)
    assert np.abs(fit.rotvec - bent)[body.joint("LeftForeArm")].max() < 0.1


@pytest.mark.slow
def test_a_frame_with_a_large_error_is_fitted_from_the_start_poses():
    body = thin()
    first = rest(error=1e-9, restart_error=GOOD_ERROR)
    turned = first.rotvec.copy()
    turned[0, 1] = np.radians(40)
    fit = fit_points(body, 0.5 * dataclasses.replace(first, rotvec=turned).points(body), first)
    assert fit.scale != first.scale
    assert np.isclose(fit.scale, 0.5, rtol=0.1)


@pytest.mark.slow
def test_errors_that_grow_slowly_restart_the_fit_and_the_better_fit_is_returned(monkeypatch):
    body = thin(100)
    restarted = dataclasses.replace(random_fit(), error=np.inf, restart_error=7.0)
    monkeypatch.setattr("mimesh.bodies.chamfer_fit._fit_from_start_poses", lambda *_: restarted)
    still = rest(restart_error=5e-3)
    noise = np.random.default_rng(0).normal(size=body.vertices.shape)
    clip = [still.points(body) + size * noise for size in (0.05, 0.07, 0.095)]
    fits = [still]
    for points in clip:
        fits.append(fit_points(body, points, fits[-1]))
    errors = [fit.error for fit in fits[1:]]
    assert all(1 < after / before < 3 for before, after in itertools.pairwise(errors))
    assert errors[0] < still.restart_error < errors[-1]
    # No restarted fit is better than the tracked one.
    assert all(fit.restart_error == still.restart_error for fit in fits)
    restarted = dataclasses.replace(restarted, error=0.0)  # now every restarted fit is better
    assert fit_points(body, clip[0], still).error == errors[0]
    assert fit_points(body, clip[-1], fits[-2]) is restarted


@pytest.mark.parametrize("count", [1, 2, 5])
def test_clouds_of_few_points_have_unit_normals(count):
    normals = target_cloud(np.random.default_rng(0).normal(size=(count, 3)), tangential_weight=0.1).normals
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
