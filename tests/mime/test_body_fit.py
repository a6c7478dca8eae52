"""Fits find joints from rough predictions, in any unit, position and heading; limbs in wrong poses are searched."""

import dataclasses

import numpy as np
import pytest
from grouped_options import grouped
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.hands import hand_joints
from mimesh.bodies.joint_ranges import joint_ranges
from mimesh.bodies.quadruped import LIMITS
from mimesh.bodies.sampled_body import PosedBody
from mimesh.bodies.sampling import sample_pose, sample_shape
from mimesh.core.geometry import face_normals
from mimesh.core.rig import Rig, descendants
from mimesh.core.surface_points import at_barycentric, sample_surface
from mimesh.evaluate.measure import AXES
from mimesh.evaluate.metrics import pmd_aligned
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.mime import body_fit
from mimesh.mime.body_fit import (
    LIES_ON,
    BodyFit,
    Effort,
    LimbPoses,
    SurfaceSample,
    fit_body,
    fit_predictions,
    limb_gaps,
    limbs,
    sampled_body,
    search_limbs,
)
from mimesh.pipeline import transfer
from mimesh.rigs.confidence import mean_angle

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


@dataclasses.dataclass(frozen=True, eq=False)
class Trial:
    """A person, rough predictions of the joints, and the body fitted from these."""

    surface: SurfaceSample
    true: tuple[np.ndarray, np.ndarray]
    prediction: tuple[np.ndarray, np.ndarray]
    fit: BodyFit


@pytest.fixture(scope="module")
def trial():
    surface, *true = person()
    prediction = predicted(*true)
    return Trial(surface, tuple(true), prediction, fit_body(surface, *prediction))


def test_joints_are_found(trial):
    degrees, metres = errors(trial.fit, trial.true)
    before = errors(trial.prediction, trial.true)
    assert max(trial.fit.unmatched_body.values()) < 0.01
    assert degrees < 4 < before[0]
    assert metres < 0.01 < 0.04 < before[1]


def test_weights_are_the_bodys_where_it_has_the_shape_of_the_surface(trial):
    """Predictions of the thigh alone become the body's weights, but for those of the hands."""
    surface, fit = trial.surface, trial.fit
    nearest = fit.nearest(surface.points)
    thigh = np.tile(np.eye(len(BODY.parents))[BODY.joint("LeftUpLeg")], (len(surface.points), 1))
    close, far = (dataclasses.replace(fit, distance=d).blended_weights(thigh, nearest) for d in (1e-4, 4e-3))
    hand = nearest.weights[:, [j for side in ("Left", "Right") for j in hand_joints(BODY.joint_names, side)]].sum(
        axis=1
    )
    np.testing.assert_allclose(close[hand == 0], nearest.weights[hand == 0], atol=0.01)
    np.testing.assert_allclose(close[hand > 0.999], thigh[hand > 0.999], atol=0.01)
    np.testing.assert_allclose(far, thigh, atol=0.01)


def test_nearest_points_are_the_same_in_chunks(trial, monkeypatch):
    whole = trial.fit.nearest(trial.surface.points)
    monkeypatch.setattr(body_fit, "CHUNK", 100)
    chunked = trial.fit.nearest(trial.surface.points)
    np.testing.assert_array_equal(chunked.distance, whole.distance)
    np.testing.assert_array_equal(chunked.weights, whole.weights)


def test_joints_are_found_without_normals(trial):
    fit = fit_body(SurfaceSample(trial.surface.points, 0 * trial.surface.normals), *trial.prediction)
    degrees, metres = errors(fit, trial.true)
    assert degrees < 6.5 < errors(trial.prediction, trial.true)[0]
    assert metres < 0.02


def test_inverted_normals_are_flipped(trial):
    inverted = fit_body(SurfaceSample(trial.surface.points, -trial.surface.normals), *trial.prediction)
    assert np.array_equal(inverted.joints, trial.fit.joints)


@pytest.mark.slow
def test_joints_are_found_in_a_one_sided_scan(trial):
    front = trial.surface.normals[:, 2] > 0
    fit = fit_body(SurfaceSample(trial.surface.points[front], trial.surface.normals[front]), *trial.prediction)
    degrees, metres = errors(fit, trial.true)
    assert degrees < 5
    assert metres < 0.015


@pytest.mark.slow
def test_unit_position_and_heading_do_not_matter(trial):
    surface, fit, (rotation, joints) = trial.surface, trial.fit, trial.prediction
    turn, shift = Rotation.from_rotvec([0.4, 2.0, -1.0]).as_matrix(), np.array([3.0, -2.0, 50.0])
    moved = SurfaceSample(100 * surface.points @ turn.T + shift, surface.normals @ turn.T)
    moved_fit = fit_body(moved, turn @ rotation, 100 * joints @ turn.T + shift)
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


@pytest.mark.parametrize("flat", [[1, 0, 0], [1e-9, 1e-9, 1e-9]])
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


@pytest.mark.slow
def test_fits_to_the_shipped_animal_go_on_from_rough_predictions(monkeypatch):
    surface, rough, true = animal()
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


@pytest.mark.slow
def test_a_leg_that_is_off_the_surface_is_searched_or_another_prediction_is_taken(monkeypatch):
    surface, good, true = animal(1, noise=0.05)
    bad = with_leg_turned(good)
    searched = fit_predictions(surface, bad, (), "quadruped")
    monkeypatch.setattr(body_fit, "SEARCHES", 0)
    alone, other = (fit_predictions(surface, bad, others, "quadruped") for others in ((), (good,)))
    assert searched.gaps["left hind leg"] < 0.5 * alone.gaps["left hind leg"]
    assert max(other.gaps.values()) <= body_fit.STILL_OFF < max(alone.gaps.values())
    assert alone.unmatched_body["left hind leg"] > 0.1
    for found in (searched, other):
        assert mean_angle(found.rotation, true) < 0.7 * mean_angle(alone.rotation, true)


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_fit_improves_on_the_network_alone():
    trial = PROTOCOLS["human-npt"].pair("val", "unseen", 1)
    with_fit, network_alone = (
        pmd_aligned(transfer(trial.identity, trial.driving, model, **grouped(AXES)).vertices, trial.truth)
        for model in ("mime", "mime-network")
    )
    assert with_fit < 0.5e-4 < network_alone


QUADRUPED, RANGES = sampled_body("quadruped"), joint_ranges("quadruped")


def standing(size=1.0):
    state = QUADRUPED.mean_person(size, np.zeros(3), np.tile(np.eye(3), (len(QUADRUPED.names), 1, 1)))
    return PosedBody(QUADRUPED, state)


def surface_of(posed):
    """Points of the body's surface that are not those that are matched."""
    vertices = (ANIMAL.vertices - ANIMAL.joints[0]) * posed.state.size
    face, barycentric = sample_surface(vertices, ANIMAL.faces, 2560, np.random.default_rng(5))
    points = at_barycentric(vertices, ANIMAL.faces, face, barycentric)
    return SurfaceSample(points, face_normals(vertices, ANIMAL.faces)[face])


def with_turned(posed, joint, vector):
    """Turn a joint and all below it."""
    rotation, below = posed.state.rotation.copy(), QUADRUPED.below[QUADRUPED.names.index(joint)] > 0
    rotation[below] = Rotation.from_rotvec(vector).as_matrix() @ rotation[below]
    return PosedBody(QUADRUPED, dataclasses.replace(posed.state, rotation=rotation))


@pytest.mark.parametrize("size", [1.0, 40.0])
def test_a_turned_limb_has_a_gap(size):
    right = standing(size)
    surface = surface_of(right)
    gaps = limb_gaps(right, surface)
    assert max(gaps.values()) < 0.012
    turned = limb_gaps(with_turned(right, "LeftThigh", [-0.8, 0, 0]), surface)
    assert turned["left hind leg"] > 5 * gaps["left hind leg"]
    assert turned["right foreleg"] == pytest.approx(gaps["right foreleg"], rel=0.05)


@pytest.mark.slow
def test_a_turned_limb_is_found():
    right = standing(40.0)
    surface, wrong = surface_of(right), with_turned(right, "LeftThigh", [-0.8, 0, 0])
    found = search_limbs(wrong, surface, [wrong.state.rotation], RANGES, lambda state: state)
    before, after = limb_gaps(wrong, surface), limb_gaps(PosedBody(QUADRUPED, found), surface)
    assert after["left hind leg"] < 0.4 * before["left hind leg"]
    others = [j for j in range(len(QUADRUPED.names)) if j not in limbs("quadruped")["left hind leg"]]
    assert sum(after.values()) < sum(before.values())
    assert np.allclose(found.rotation[others][: QUADRUPED.names.index("LeftThigh")], np.eye(3))


def test_a_predicted_pose_of_a_limb_is_taken(monkeypatch):
    monkeypatch.setattr("mimesh.mime.body_fit.LONG", Effort(16, 1, 8, 4))
    right = standing()
    surface, wrong = surface_of(right), with_turned(right, "LeftThigh", [-0.8, 0, 0])
    found = search_limbs(wrong, surface, [wrong.state.rotation, right.state.rotation], RANGES, lambda state: state)
    assert limb_gaps(PosedBody(QUADRUPED, found), surface)["left hind leg"] < LIES_ON + 0.005


def test_no_search_where_limbs_lie_on_the_surface(monkeypatch):
    right = standing()
    monkeypatch.setattr("mimesh.mime.body_fit.LIES_ON", 0.02)

    def refused(state):
        raise AssertionError("nothing was to be fitted again")

    assert search_limbs(right, surface_of(right), [right.state.rotation], RANGES, refused) is right.state


def test_points_of_poses_are_those_of_the_posed_body():
    posed = with_turned(standing(), "RightUpperArm", [0.3, 0.05, 0])
    limb = LimbPoses.of(posed, limbs("quadruped")["right foreleg"])
    index = np.array(limb.joints) - 1
    same = RANGES.local(posed.state.rotation)[None, index]
    assert np.allclose(limb.points(same)[0], posed.points[limb.mask], atol=1e-9)
    bent = same.copy()
    bent[0, 1, 0] -= 0.7
    rotation = posed.state.rotation.copy()
    rotation[limb.joints] = limb.world(bent)[0]
    other = PosedBody(QUADRUPED, dataclasses.replace(posed.state, rotation=rotation))
    assert np.allclose(limb.points(bent)[0], other.points[limb.mask], atol=1e-9)
