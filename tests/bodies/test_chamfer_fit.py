"""Fitting a body to points: exact gradients, then people found again from shuffled points."""

import dataclasses
import itertools
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.body_parameters import (
    BodyParameters,
    _levels,
    descendants,
    fit_of,
    posed_and_pullback,
    rotvec_pullback,
    thin_body,
    unknowns_of,
)
from mimesh.bodies.chamfer_fit import GOOD, chamfer, cloud_of, fit_points
from mimesh.bodies.sampling import rotvec_to_rotmat, sample_pose
from mimesh.core.mesh import permute_vertices
from mimesh.core.normalization import Normalization
from mimesh.core.surface_points import at_barycentric, sample_surface

COMPONENTS = 4


@cache
def thin(count=600):
    return thin_body(load_body(), count, COMPONENTS)


def some_fit(seed=0, angle=0.5) -> BodyParameters:
    rng = np.random.default_rng(seed)
    rotvec = angle * rng.normal(size=(len(thin().parents), 3))
    return BodyParameters(0.7, rng.normal(size=3), rng.normal(size=COMPONENTS), rotvec)


def slopes(function, at, step=1e-6):
    return np.stack([(function(at + e) - function(at - e)) / (2 * step) for e in step * np.eye(len(at))])


def test_the_points_of_a_fit_are_those_of_the_body():
    body, fit = thin(), some_fit()
    posed = body.posed(fit.shape, rotvec_to_rotmat(fit.rotvec))
    points = posed_and_pullback(body, unknowns_of(fit))[0]
    assert np.allclose(points, fit.scale * posed + fit.translation, rtol=0, atol=1e-12)
    assert np.allclose(points, fit.points(body), rtol=0, atol=1e-12)


def test_unknowns_round_trip():
    fit, again = some_fit(), fit_of(thin(), unknowns_of(some_fit()))
    for field in ("scale", "translation", "shape", "rotvec"):
        assert np.allclose(getattr(fit, field), getattr(again, field), rtol=1e-14)


def test_the_joints_of_a_rest_fit_are_the_bodys():
    body = thin()
    fit = BodyParameters(2.0, np.array([1.0, 2, 3]), np.zeros(COMPONENTS), np.zeros((len(body.parents), 3)))
    assert np.allclose(fit.joints(body), 2 * body.joints + [1, 2, 3])
    assert np.allclose(fit.rotations(body), np.eye(3))


@pytest.mark.parametrize("angle", [0.5, 1e-5, 0.0, 2.0])
def test_the_gradient_of_the_points_is_that_of_finite_differences(angle):
    body = thin_body(load_body(), 40, COMPONENTS)
    unknowns = unknowns_of(some_fit(1, angle))
    push = np.random.default_rng(2).normal(size=(40, 3))
    expected = slopes(lambda u: (posed_and_pullback(body, u)[0] * push).sum(), unknowns)
    assert np.allclose(posed_and_pullback(body, unknowns)[1](push), expected, rtol=0, atol=1e-6)


def test_the_gradient_of_a_rotation_vector_is_that_of_finite_differences():
    rng = np.random.default_rng(0)
    rotvec = np.concatenate([rng.normal(size=(5, 3)), [[0, 0, 0], [1e-6, 0, 0], [0, 3.1, 0], [0, 0, 1e-3]]])
    torque = rng.normal(size=rotvec.shape)

    def turn_after(moved, r):
        return (Rotation.from_rotvec(moved) * Rotation.from_rotvec(r).inv()).as_rotvec()

    expected = [slopes(lambda x, r=r, t=t: turn_after(x, r) @ t, r) for r, t in zip(rotvec, torque, strict=True)]
    assert np.allclose(rotvec_pullback(rotvec, torque), np.array(expected), rtol=0, atol=1e-7)


@pytest.mark.parametrize("slide", [1.0, 0.1])
def test_chamfer_is_that_of_a_naive_twin_and_its_gradient_that_of_finite_differences(slide):
    rng = np.random.default_rng(0)
    cloud, others = cloud_of(rng.normal(size=(30, 3)), slide), rng.normal(size=(20, 3))
    squared = np.square(others[:, None] - cloud.points).sum(-1)
    matches = cloud.matches(others)
    assert np.array_equal(matches[0], squared.argmin(axis=1))
    assert np.array_equal(matches[1], squared.argmin(axis=0))
    error, gradient = chamfer(cloud, others, matches)
    if slide == 1:
        assert np.isclose(error, squared.min(axis=1).mean() + squared.min(axis=0).mean())
    expected = slopes(lambda x: chamfer(cloud, x.reshape(-1, 3), matches)[0], others.ravel())
    assert np.allclose(gradient.ravel(), expected, rtol=0, atol=1e-8)


def test_across_a_plane_a_distance_counts_in_full_and_along_it_little():
    grid = np.stack([*np.meshgrid(np.arange(5.0), np.arange(5.0)), np.zeros((5, 5))], -1).reshape(-1, 3)
    cloud = cloud_of(grid, slide=0.1)
    matches = np.arange(25), np.arange(25)
    assert np.isclose(chamfer(cloud, grid + [0, 0, 0.2], matches)[0], 2 * 0.2**2)
    assert np.isclose(chamfer(cloud, grid + [0.2, 0, 0], matches)[0], 2 * 0.1 * 0.2**2)


@pytest.mark.parametrize("pose", [0, 1])
def test_a_person_is_found_again_from_shuffled_vertices(pose):
    """Made of the free components only; other points of the surface than those that the body is thinned to."""
    body, rotvec = load_body(), sample_pose(load_body(), 11, pose)
    truth = BodyParameters(1.0, np.zeros(3), np.array([0.5, -1.0, 0.8, 0.4]), rotvec)
    mesh = permute_vertices(body.mesh(truth.points(body)), np.random.default_rng(5).permutation(len(body.vertices)))
    mesh = dataclasses.replace(mesh, faces=np.random.default_rng(6).permutation(mesh.faces))
    frame = Normalization.fit(mesh, "+y", "+z")
    chosen = sample_surface(mesh.vertices, mesh.faces, 2000, np.random.default_rng(7))
    fit = fit_points(thin(2000), frame.apply(at_barycentric(mesh.vertices, mesh.faces, *chosen)))
    found = frame.undo(fit.joints(thin()))
    names = [
        f"{side}{bone}" for side in ("Left", "Right") for bone in ("UpLeg", "Leg", "Foot", "Arm", "ForeArm", "Hand")
    ]
    millimetres = 1e3 * np.linalg.norm(found - truth.joints(body), axis=1)[[body.joint(name) for name in names]]
    assert millimetres.max() < 18
    assert millimetres.mean() < 8


def test_somebody_who_sits_is_found():
    body, rotvec = thin(4000), np.zeros((len(thin().parents), 3))
    for side in ("Left", "Right"):
        rotvec[body.joint(f"{side}UpLeg"), 0] = -1.4
        rotvec[body.joint(f"{side}Leg"), 0] = 0.7
    points = BodyParameters(1.0, np.zeros(3), np.zeros(COMPONENTS), rotvec).points(body)
    fit = fit_points(body, points[::-1])
    assert fit.error < GOOD
    assert fit.lost == max(3 * fit.error, GOOD)
    assert np.abs(fit.rotvec - rotvec)[[body.joint("LeftUpLeg"), body.joint("RightUpLeg")]].max() < 0.15


def test_a_followed_frame_keeps_size_and_shape_and_finds_the_pose():
    body = thin()
    first = BodyParameters(1.0, np.zeros(3), np.zeros(COMPONENTS), np.zeros((len(body.parents), 3)), error=1e-3)
    bent = first.rotvec.copy()
    bent[body.joint("LeftForeArm"), 1] = -0.4
    points = dataclasses.replace(first, rotvec=bent).points(body)
    fit = fit_points(body, points, first)
    assert fit.scale == first.scale
    assert np.array_equal(fit.shape, first.shape)
    assert np.abs(fit.rotvec - bent)[body.joint("LeftForeArm")].max() < 0.1


def test_a_frame_that_was_lost_is_fitted_anew():
    body = thin()
    first = BodyParameters(
        1.0, np.zeros(3), np.zeros(COMPONENTS), np.zeros((len(body.parents), 3)), error=1e-9, lost=GOOD
    )
    turned = first.rotvec.copy()
    turned[0, 1] = np.radians(40)
    fit = fit_points(body, 0.5 * dataclasses.replace(first, rotvec=turned).points(body), first)
    assert fit.scale != first.scale
    assert np.isclose(fit.scale, 0.5, rtol=0.1)


def test_points_that_worsen_little_by_little_are_fitted_anew_and_the_better_fit_counts(monkeypatch):
    body = thin(100)
    anew = dataclasses.replace(some_fit(), error=np.inf, lost=7.0)
    monkeypatch.setattr("mimesh.bodies.chamfer_fit._fitted_anew", lambda *_: anew)
    rest = BodyParameters(1.0, np.zeros(3), np.zeros(COMPONENTS), np.zeros((len(body.parents), 3)), lost=5e-3)
    noise = np.random.default_rng(0).normal(size=body.vertices.shape)
    clip = [rest.points(body) + 0.04 * np.sqrt(2) ** t * noise for t in range(4)]
    fits = [rest]
    for points in clip:
        fits.append(fit_points(body, points, fits[-1]))
    errors = [fit.error for fit in fits[1:]]
    assert all(1 < after / before < 3 for before, after in itertools.pairwise(errors))
    assert errors[0] < rest.lost < errors[-1]
    assert all(fit.lost == rest.lost for fit in fits)  # no fresh fit is better than the followed one
    anew = dataclasses.replace(anew, error=0.0)  # now any is
    assert fit_points(body, clip[0], rest).error == errors[0]
    assert fit_points(body, clip[-1], fits[-2]) is anew


def test_what_is_kept_between_fits_of_a_body_cannot_be_changed():
    parents = load_body().parents
    for kept in (descendants(parents), *itertools.chain(*_levels(parents))):
        with pytest.raises(ValueError, match="read-only"):
            kept[...] = 0


def test_a_single_point_gives_some_finite_fit():
    assert np.isfinite(unknowns_of(fit_points(thin(), np.array([[0.1, 0.2, 0.3]])))).all()


@pytest.mark.parametrize("count", [1, 2, 5])
def test_few_points_have_some_normals(count):
    normals = cloud_of(np.random.default_rng(0).normal(size=(count, 3)), slide=0.1).normals
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
