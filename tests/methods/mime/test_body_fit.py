"""Fits find the joints of a person from rough predictions, in any unit, position and heading."""

import dataclasses

import numpy as np
import pytest
from matrix import matrix
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.hands import hand_joints
from mimesh.bodies.joint_ranges import joint_ranges
from mimesh.bodies.quadruped import LIMITS
from mimesh.bodies.sampling import sample_pose, sample_shape
from mimesh.core.geometry import face_normals
from mimesh.core.rig import Rig, descendants
from mimesh.core.surface_points import at_barycentric, sample_surface
from mimesh.evaluate.measure import AXES
from mimesh.evaluate.metrics import pmd_aligned
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.methods.confidence import mean_angle
from mimesh.methods.mime import body_fit
from mimesh.methods.mime.body_fit import BodyFit, SurfaceSample, fit_body, fit_predictions
from mimesh.pipeline import transfer

BODY = load_body()


def person(seed=0):
    """Points of a person in a pose of Table 6, and the true rotations and positions of the joints."""
    shape, pose = sample_shape(BODY, seed, 0), Rotation.from_rotvec(sample_pose(BODY, seed, 0)).as_matrix()
    vertices, joints = BODY.posed(shape, pose), BODY.shaped(shape)[1]
    rotation, offset = BODY.skinning_transforms(joints, pose)
    face, barycentric = sample_surface(vertices, BODY.faces, 4096, np.random.default_rng(seed))
    points = at_barycentric(vertices, BODY.faces, face, barycentric)
    surface = SurfaceSample(points, face_normals(vertices, BODY.faces)[face])
    return surface, rotation, offset + (rotation @ joints[..., None])[..., 0]


def predicted(rotation, joints, seed=0, radians=0.1, metres=0.03):
    """The true rotations and joints with noise of these standard deviations."""
    rng = np.random.default_rng(seed)
    noise = Rotation.from_rotvec(radians * rng.normal(size=(31, 3))).as_matrix()
    return noise @ rotation, joints + metres * rng.normal(size=joints.shape)


def errors(pose, true):
    """Mean error of rotations (degrees) and joints (metres)."""
    rotation, joints = (pose.rotation, pose.joints) if isinstance(pose, BodyFit) else pose
    cosine = (np.einsum("jab,jab->j", rotation, true[0]) - 1) / 2
    degrees = np.degrees(np.arccos(cosine.clip(-1, 1))).mean()
    return degrees, np.linalg.norm(joints - true[1], axis=1).mean()


@matrix("seed", range(4), quick=[0])
def test_joints_are_found(seed):
    surface, *true = person(seed)
    prediction = predicted(*true, seed)
    fit = fit_body(surface, *prediction)
    degrees, metres = errors(fit, true)
    before = errors(prediction, true)
    assert max(fit.unmatched_body.values()) < 0.01
    assert degrees < 4 < before[0]
    assert metres < 0.01 < 0.04 < before[1]


def test_weights_are_the_bodys_where_it_has_the_shape_of_the_surface():
    """Predictions of the thigh alone become the body's weights, but for those of the hands."""
    surface, *true = person()
    fit = fit_body(surface, *predicted(*true))
    nearest = fit.nearest(surface.points)
    thigh = np.tile(np.eye(len(BODY.parents))[BODY.joint("LeftUpLeg")], (len(surface.points), 1))
    close, far = (dataclasses.replace(fit, distance=d).blended_weights(thigh, nearest) for d in (1e-4, 4e-3))
    hand = nearest.weights[:, [j for side in ("Left", "Right") for j in hand_joints(BODY.joint_names, side)]].sum(
        axis=1
    )
    np.testing.assert_allclose(close[hand == 0], nearest.weights[hand == 0], atol=0.01)
    np.testing.assert_allclose(close[hand > 0.999], thigh[hand > 0.999], atol=0.01)
    np.testing.assert_allclose(far, thigh, atol=0.01)


def test_nearest_points_are_the_same_in_chunks(monkeypatch):
    surface, *true = person()
    fit = fit_body(surface, *predicted(*true))
    whole = fit.nearest(surface.points)
    monkeypatch.setattr(body_fit, "CHUNK", 100)
    chunked = fit.nearest(surface.points)
    np.testing.assert_array_equal(chunked.distance, whole.distance)
    np.testing.assert_array_equal(chunked.weights, whole.weights)


def test_joints_are_found_without_normals():
    surface, *true = person()
    fit = fit_body(SurfaceSample(surface.points, 0 * surface.normals), *predicted(*true))
    degrees, metres = errors(fit, true)
    assert degrees < 5
    assert metres < 0.02


def test_inverted_normals_are_flipped():
    surface, *true = person()
    prediction = predicted(*true)
    inverted = fit_body(SurfaceSample(surface.points, -surface.normals), *prediction)
    assert np.array_equal(inverted.joints, fit_body(surface, *prediction).joints)


@pytest.mark.slow
def test_joints_are_found_in_a_one_sided_scan():
    surface, *true = person()
    front = surface.normals[:, 2] > 0
    fit = fit_body(SurfaceSample(surface.points[front], surface.normals[front]), *predicted(*true))
    degrees, metres = errors(fit, true)
    assert degrees < 5
    assert metres < 0.015


@pytest.mark.slow
def test_unit_position_and_heading_do_not_matter():
    surface, *true = person()
    rotation, joints = predicted(*true)
    turn, shift = Rotation.from_rotvec([0.4, 2.0, -1.0]).as_matrix(), np.array([3.0, -2.0, 50.0])
    moved = SurfaceSample(100 * surface.points @ turn.T + shift, surface.normals @ turn.T)
    fit, moved_fit = (
        fit_body(surface, rotation, joints),
        fit_body(moved, turn @ rotation, 100 * joints @ turn.T + shift),
    )
    assert np.allclose(moved_fit.rotation, turn @ fit.rotation, atol=1e-5)
    assert np.allclose(moved_fit.joints, 100 * fit.joints @ turn.T + shift, atol=1e-3)
    assert moved_fit.unmatched_body == fit.unmatched_body


@pytest.mark.slow
def test_missing_arm_stays_near_its_prediction():
    surface, *true = person()
    hand, spine = BODY.joint("LeftHand"), BODY.joint("Spine1")
    prediction = predicted(*true, metres=0.01)
    rest = surface.points @ [1, 0, 0] < true[1][BODY.joint("LeftArm"), 0]
    fit = fit_body(SurfaceSample(surface.points[rest], surface.normals[rest]), *prediction)
    assert np.linalg.norm(fit.joints[spine] - true[1][spine]) < 0.02
    assert np.linalg.norm(fit.joints[hand] - prediction[1][hand]) < 0.3
    assert fit.unmatched_body["left arm"] > 0.2 > 0.02 > fit.unmatched_body["right arm"]


@pytest.mark.parametrize("flat", [[1, 1, 0], [1, 0, 0], [1e-9, 1e-9, 1e-9]])
def test_fit_to_a_flat_surface_is_finite(flat):
    surface, *true = person()
    fit = fit_body(SurfaceSample(surface.points * flat, surface.normals), *true)
    assert np.isfinite(fit.joints).all()
    assert np.allclose(fit.rotation @ fit.rotation.mT, np.eye(3), atol=1e-6)


ANIMAL = load_body("quadruped")


def animal(seed=0, noise=0.3):
    """An animal of the shipped body anywhere within its joint limits; a rough prediction, and the true rotations."""
    shape = sample_shape(ANIMAL, seed, 0)
    pose = Rotation.from_rotvec(sample_pose(ANIMAL, seed, 0, LIMITS)).as_matrix()
    vertices, joints = ANIMAL.posed(shape, pose), ANIMAL.shaped(shape)[1]
    rotation, offset = ANIMAL.skinning_transforms(joints, pose)
    face, barycentric = sample_surface(vertices, ANIMAL.faces, 2560, np.random.default_rng(seed))
    normals = face_normals(vertices, ANIMAL.faces)[face]
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(noise * rng.normal(size=(len(joints), 3))).as_matrix()
    places = offset + (rotation @ joints[..., None])[..., 0] + 0.03 * rng.normal(size=joints.shape)
    surface = SurfaceSample(at_barycentric(vertices, ANIMAL.faces, face, barycentric), normals)
    return surface, Rig(turns @ rotation, places, np.zeros((0, len(joints)))), rotation


@matrix("seed", range(3), quick=[0])
def test_fits_to_the_shipped_animal_go_on_from_rough_predictions(seed, monkeypatch):
    surface, rough, true = animal(seed)
    fit = fit_predictions(surface, rough, (), "quadruped")
    monkeypatch.setattr(body_fit, "REFINED", ())
    before = fit_predictions(surface, rough, (), "quadruped")
    assert fit.distance < 0.8 * before.distance
    assert mean_angle(fit.rotation, true) < mean_angle(before.rotation, true)


def with_leg_turned(rig):
    """Turn a hind leg of a prediction forwards by 86 degrees."""
    leg, turn = ANIMAL.joint("LeftThigh"), Rotation.from_rotvec([1.5, 0, 0]).as_matrix()
    below = list(descendants([leg], ANIMAL.parents))
    rotation, joints = rig.rotation.copy(), rig.joints.copy()
    rotation[below] = turn @ rotation[below]
    joints[below] = (joints[below] - joints[leg]) @ turn.T + joints[leg]
    return Rig(rotation, joints, rig.weights)


def test_a_leg_that_is_off_the_surface_is_searched():
    surface, good, true = animal(1, noise=0.05)
    bad = with_leg_turned(good)
    alone = fit_body(surface, bad.rotation, bad.joints, name="quadruped")
    searched = fit_predictions(surface, bad, (), "quadruped")
    assert searched.gaps["left hind leg"] < 0.5 * alone.gaps["left hind leg"]
    assert mean_angle(searched.rotation, true) < 0.7 * mean_angle(alone.rotation, true)


@pytest.mark.slow
def test_another_prediction_is_taken_where_it_fits_better(monkeypatch):
    monkeypatch.setattr(body_fit, "SEARCHES", 0)
    surface, good, true = animal(1, noise=0.05)
    one, best = (fit_predictions(surface, with_leg_turned(good), others, "quadruped") for others in ((), (good,)))
    assert max(best.gaps.values()) <= body_fit.STILL_OFF < max(one.gaps.values())
    assert one.unmatched_body["left hind leg"] > 0.1
    assert mean_angle(best.rotation, true) < 0.7 * mean_angle(one.rotation, true)


@pytest.mark.slow
def test_joints_of_animals_stay_within_their_ranges():
    surface, good, _ = animal(1, noise=0.05)
    twisted, hand = good.rotation.copy(), ANIMAL.joint("LeftHand")
    below = list(descendants([hand], ANIMAL.parents))
    along = good.joints[below[1]] - good.joints[hand]
    twisted[below] = Rotation.from_rotvec(2.6 * along / np.linalg.norm(along)).as_matrix() @ twisted[below]
    fit = fit_predictions(surface, Rig(twisted, good.joints, good.weights), (), "quadruped")
    ranges = joint_ranges("quadruped")
    local = ranges.local(fit.posed.state.rotation)
    assert (np.abs(local - np.clip(local, ranges.low, ranges.high)) < np.radians(12)).all()


@pytest.fixture
def fits(monkeypatch):
    """Collect what the body is fitted from."""
    starts, original = [], body_fit.fit_body

    def collected(surface, rotation, *args, **options):
        starts.append(rotation)
        return original(surface, rotation, *args, **options)

    monkeypatch.setattr(body_fit, "fit_body", collected)
    return starts


def test_a_good_fit_asks_no_other_prediction(fits):
    surface, good, _ = animal(1, noise=0.02)
    _, other, _ = animal(1, noise=0.1)
    assert max(fit_predictions(surface, good, (other,), "quadruped").gaps.values()) <= body_fit.STILL_OFF
    assert len(fits) == 1


@pytest.mark.slow
def test_fits_to_other_shapes_stay_near_their_prediction(monkeypatch, fits):
    surface, rough, _ = animal(noise=0.1)
    wavy = SurfaceSample(surface.points + 0.015 * np.sin(25 * surface.points[:, [1, 2, 0]]), surface.normals)
    fit = fit_predictions(wavy, rough, (rough,), "quadruped")
    assert len(fits) == 1
    assert fit.distance > body_fit.SHIPPED_SHAPE
    assert np.array_equal(fit.rotation, fit_body(wavy, rough.rotation, rough.joints, name="quadruped").rotation)
    monkeypatch.setattr(body_fit, "REFINED", ())
    assert mean_angle(fit.rotation, fit_body(wavy, rough.rotation, rough.joints, name="quadruped").rotation) < 12


def pair():
    return PROTOCOLS["human-npt"].pair("val", "unseen", 1)


@pytest.mark.slow
def test_fit_improves_on_the_network_alone():
    trial = pair()
    with_fit, network_alone = (
        pmd_aligned(transfer(trial.identity, trial.driving, model, **AXES).vertices, trial.truth)
        for model in ("mime", "mime-network")
    )
    assert with_fit < 0.5e-4 < network_alone
