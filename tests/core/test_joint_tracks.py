"""Tracks of joints: smoothing keeps what is still, the root goes as asked, and feet that stand do not slide."""

import dataclasses

import numpy as np
import pytest
from people import person, walk
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.core.joint_tracks import FootJoints, JointTrack, foot_skate, grounded_path, root_path, sole_depths
from mimesh.core.rig import Rig, leg_length
from mimesh.core.skinning import SkinnedMesh
from mimesh.pipeline import animate

BODY = load_body()
LEGS = tuple(tuple(BODY.joint(f"{side}{name}") for name in ("UpLeg", "Leg", "Foot")) for side in ("Left", "Right"))
FEET = tuple(BODY.joint(f"{side}{name}") for side in ("Left", "Right") for name in ("Foot", "ToeBase"))


def standing(longer=1.0):
    """The body with longer bones, ready to be posed."""
    vertices, joints = longer * BODY.vertices, longer * BODY.joints
    rig = Rig(np.tile(np.eye(3), (len(joints), 1, 1)), joints, BODY.weights)
    return vertices, rig, SkinnedMesh.of(vertices, rig, BODY.parents)


def squat(count=12):
    """Someone whose left foot stays while the knees bend and the hips go forward."""
    _, rig, skinned = standing()
    rotation = np.tile(rig.rotation, (count, 1, 1, 1))
    below = {"UpLeg": -1.0, "Leg": 1.0, "Foot": 0.0, "ToeBase": 0.0}
    for t in range(count):
        bend = 0.6 * np.sin(np.pi * t / (count - 1))
        for side in ("Left", "Right"):
            for name, turn in below.items():
                rotation[t, BODY.joint(side + name)] = Rotation.from_rotvec([turn * bend, 0, 0]).as_matrix()
    places = np.stack([skinned.joint_positions(turned, np.zeros(3)) for turned in rotation])
    fixed = BODY.joints[FEET[0]] - places[:, FEET[0]]
    return JointTrack(rotation, places + fixed[:, None], 30.0)


def feet_of(longer):
    vertices, rig, skinned = standing(longer)
    theirs, rest, _ = standing()
    return FootJoints(
        FEET, leg_length(BODY.joints, LEGS), sole_depths(rig, vertices, FEET), sole_depths(rest, theirs, FEET)
    ), skinned


def test_feet_of_longer_legs_stand_still_on_the_ground():
    track, (feet, skinned) = squat(), feet_of(1.3)
    # In a squat the body goes down by legs that are as they are: the same way for longer ones slides and floats.
    way = root_path(track, 1.0, 1.0, drop=False)
    path = grounded_path(track, way, skinned, feet, 1.3)
    assert foot_skate(track, path, skinned, feet) < 1e-6 < 0.01 < foot_skate(track, way, skinned, feet)
    ankles = np.stack([skinned.joint_positions(*frame)[FEET[0]] for frame in zip(track.rotation, path, strict=True)])
    assert np.allclose(ankles[:, 1], feet.soles[0], atol=0.02)
    assert np.abs(ankles - ankles[0]).max() < 0.02


def moved_by(track, way):
    return JointTrack(track.rotation, track.places + way[:, None], track.fps)


def test_what_is_in_the_air_keeps_its_way():
    """Someone stands, leaps forward and stands: the leap is as long as it was."""
    up = 0.6 * np.sin(np.linspace(0, np.pi, 8)).clip(0)[1:-1]
    still = np.zeros((10, 3))
    leap = np.stack([0 * up, up, 0.3 * np.arange(1, 7)], axis=1)
    way = np.concatenate([still, leap, still + [0, 0, 2.1]])
    track = moved_by(JointTrack(*(a[:1].repeat(26, axis=0) for a in (squat().rotation, squat().places)), 30.0), way)
    feet, skinned = feet_of(1.2)
    stands = track.standing(feet).any(axis=1)
    assert stands[:9].all()
    assert not stands[11:15].any()
    assert stands[18:].all()
    path = root_path(track, 1.2, 1.2, drop=False)
    found = grounded_path(track, path, skinned, feet, 1.2)
    assert np.allclose(np.diff(found[10:16], axis=0)[:, [0, 2]], np.diff(path[10:16], axis=0)[:, [0, 2]])
    assert np.ptp(found[18:], axis=0).max() < 1e-2


def test_a_foot_that_is_held_up_does_not_stand():
    """Whoever stands on one leg is not pulled down by the other, however still that is."""
    _, rig, skinned = standing()
    rotation = np.tile(rig.rotation, (10, 1, 1, 1))
    for t in range(10):
        bend = Rotation.from_rotvec([-1.2 + 0.1 * (t // 5), 0, 0]).as_matrix()
        for name in ("UpLeg", "Leg", "Foot", "ToeBase"):
            rotation[t, BODY.joint(f"Right{name}")] = bend
    places = np.stack([skinned.joint_positions(turned, BODY.joints[0]) for turned in rotation])
    track, (feet, _) = JointTrack(rotation, places, 30.0), feet_of(1.0)
    assert track.standing(feet)[:, :2].all()
    assert not track.standing(feet)[:, 2:].any()
    path = root_path(track, 1.0, 1.0, drop=False)
    assert np.abs(grounded_path(track, path, skinned, feet, 1.0) - path).max() < 0.02


def test_soles_are_as_deep_as_the_ankle_is_high():
    feet, _ = feet_of(1.0)
    floor = BODY.vertices[:, 1].min()
    assert np.allclose(feet.soles, BODY.joints[list(FEET), 1] - floor, atol=0.02)


def test_the_way_is_scaled_or_dropped():
    track = squat()
    assert np.allclose(root_path(track, 2.0, 3.0, drop=False), [2, 3, 2] * track.places[:, 0])
    dropped = root_path(track, 2.0, 3.0, drop=True)
    assert np.ptp(dropped[:, [0, 2]], axis=0).max() == 0
    assert np.allclose(dropped[:, 1], 3 * track.places[:, 0, 1])


def test_smoothing_keeps_what_is_still_and_calms_what_is_not():
    track = squat()
    still = JointTrack(track.rotation[:1].repeat(9, axis=0), track.places[:1].repeat(9, axis=0), 30.0)
    assert np.allclose(still.smoothed(0.1).rotation, still.rotation)
    walking = moved_by(still, 0.1 * np.arange(9)[:, None] * [0, 0, 1])
    assert np.allclose(walking.smoothed(0.3).places, walking.places)
    rng = np.random.default_rng(0)
    shaken = Rotation.from_rotvec(0.1 * rng.normal(size=(12 * len(BODY.parents), 3))).as_matrix()
    noisy = JointTrack(shaken.reshape(track.rotation.shape) @ track.rotation, track.places, 30.0)
    calm = noisy.smoothed(0.05)
    assert np.allclose(np.linalg.det(calm.rotation), 1)
    assert np.abs(np.diff(calm.rotation, 2, axis=0)).mean() < 0.3 * np.abs(np.diff(noisy.rotation, 2, axis=0)).mean()


def middle(result):
    return result.clip.vertices.mean(axis=1)


def test_options_of_animate():
    identity, clip = person(0), walk(faces=600)
    near, far, none = (middle(animate(identity, clip, root=root)) for root in ("scale", "keep", "drop"))
    assert np.ptp(none[:, 2]) < 0.3 * np.ptp(near[:, 2])
    driven = clip.vertices.mean(axis=1)
    assert abs(np.ptp(far[:, 2]) / np.ptp(driven[:, 2]) - 1) < 0.1
    slow = dataclasses.replace(clip, fps=0.5)  # slow enough for feet that stand
    skates = [animate(identity, slow, ground=ground).report["foot_skate"] for ground in (True, False)]
    assert skates[0] < 0.6 * skates[1]
    noise = np.random.default_rng(0).normal(scale=0.01, size=clip.vertices.shape)
    noisy = dataclasses.replace(clip, vertices=clip.vertices[:1] + noise)
    lively = [animate(identity, noisy, smooth=s).report["acceleration"] for s in (0.0, 0.2)]
    assert lively[1]["result"] < 0.2 * lively[0]["driving"] < 0.2 * lively[0]["result"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"root": "stay"}, "--root: expected one of scale, keep, drop"),
        ({"smooth": -1.0}, "--smooth: expected seconds"),
        ({"model": "copy", "ground": True}, "--ground: expected a model with joints"),
        ({"model": "copy", "skinned": True}, "--skinned: expected a model with joints"),
        ({"model": "copy", "root": "drop"}, "--root: expected a model with joints"),
    ],
)
def test_options_that_cannot_be_used(options, message):
    with pytest.raises(InputError, match=message):
        animate(person(0), walk(faces=600), **options)
