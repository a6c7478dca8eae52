"""Joint tracks: smoothing keeps resting joints, root paths are scaled, and planted feet do not slide."""

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


def scaled_body(scale=1.0):
    """Rig and packed mesh of the body, scaled by a factor."""
    vertices, joints = scale * BODY.vertices, scale * BODY.joints
    rig = Rig(np.tile(np.eye(3), (len(joints), 1, 1)), joints, BODY.weights)
    return vertices, rig, SkinnedMesh.of(vertices, rig, BODY.parents)


def squat(count=12):
    """A squat with the left ankle at rest: knees bend and the hips move forward and down."""
    _, rig, skinned = scaled_body()
    rotation = np.tile(rig.rotation, (count, 1, 1, 1))
    directions = {"UpLeg": -1.0, "Leg": 1.0, "Foot": 0.0, "ToeBase": 0.0}
    for t in range(count):
        bend = 0.6 * np.sin(np.pi * t / (count - 1))
        for side in ("Left", "Right"):
            for name, turn in directions.items():
                rotation[t, BODY.joint(side + name)] = Rotation.from_rotvec([turn * bend, 0, 0]).as_matrix()
    positions = np.stack([skinned.joint_positions(frame, np.zeros(3)) for frame in rotation])
    root = BODY.joints[FEET[0]] - positions[:, FEET[0]]
    return JointTrack(rotation, positions + root[:, None], 30.0)


def feet_of(scale):
    """Feet of an identity scaled by a factor, driven by the body, and the identity's packed mesh."""
    vertices, rig, skinned = scaled_body(scale)
    driving_vertices, driving_rig, _ = scaled_body()
    return FootJoints(
        FEET,
        leg_length(BODY.joints, LEGS),
        sole_depths(rig, vertices, FEET),
        sole_depths(driving_rig, driving_vertices, FEET),
    ), skinned


def test_planted_feet_of_a_larger_identity_do_not_slide():
    track, (feet, skinned) = squat(), feet_of(1.3)
    # The unscaled root path does not fit longer legs: feet slide and float.
    raw = root_path(track, 1.0, 1.0, in_place=False)
    path = grounded_path(track, raw, skinned, feet, 1.3)
    assert foot_skate(track, path, skinned, feet) < 1e-6 < 0.01 < foot_skate(track, raw, skinned, feet)
    ankles = np.stack([skinned.joint_positions(*frame)[FEET[0]] for frame in zip(track.rotation, path, strict=True)])
    assert np.allclose(ankles[:, 1], feet.identity_height[0], atol=0.02)
    assert np.abs(ankles - ankles[0]).max() < 0.02


def translated(track, path):
    return JointTrack(track.rotation, track.positions + path[:, None], track.fps)


def test_the_displacement_of_a_leap_is_kept():
    """Standing, a leap forward, standing: the correction does not change the leap's length."""
    up = 0.6 * np.sin(np.linspace(0, np.pi, 8)).clip(0)[1:-1]
    still = np.zeros((10, 3))
    leap = np.stack([0 * up, up, 0.3 * np.arange(1, 7)], axis=1)
    moved = np.concatenate([still, leap, still + [0, 0, 2.1]])
    track = translated(
        JointTrack(*(a[:1].repeat(26, axis=0) for a in (squat().rotation, squat().positions)), 30.0), moved
    )
    feet, skinned = feet_of(1.2)
    planted = track.planted(feet).any(axis=1)
    assert planted[:9].all()
    assert not planted[11:15].any()
    assert planted[18:].all()
    path = root_path(track, 1.2, 1.2, in_place=False)
    found = grounded_path(track, path, skinned, feet, 1.2)
    assert np.allclose(np.diff(found[10:16], axis=0)[:, [0, 2]], np.diff(path[10:16], axis=0)[:, [0, 2]])
    assert np.ptp(found[18:], axis=0).max() < 1e-2


def test_a_raised_foot_is_not_planted():
    """A foot that rests in the air does not change the root path of a person who stands on the other leg."""
    _, rig, skinned = scaled_body()
    rotation = np.tile(rig.rotation, (10, 1, 1, 1))
    for t in range(10):
        bend = Rotation.from_rotvec([-1.2 + 0.1 * (t // 5), 0, 0]).as_matrix()
        for name in ("UpLeg", "Leg", "Foot", "ToeBase"):
            rotation[t, BODY.joint(f"Right{name}")] = bend
    positions = np.stack([skinned.joint_positions(frame, BODY.joints[0]) for frame in rotation])
    track, (feet, _) = JointTrack(rotation, positions, 30.0), feet_of(1.0)
    assert track.planted(feet)[:, :2].all()
    assert not track.planted(feet)[:, 2:].any()
    path = root_path(track, 1.0, 1.0, in_place=False)
    assert np.abs(grounded_path(track, path, skinned, feet, 1.0) - path).max() < 0.02


def test_sole_depths_are_the_heights_of_the_foot_joints():
    feet, _ = feet_of(1.0)
    floor = BODY.vertices[:, 1].min()
    assert np.allclose(feet.identity_height, BODY.joints[list(FEET), 1] - floor, atol=0.02)


def test_the_root_path_is_scaled_or_in_place():
    track = squat()
    assert np.allclose(root_path(track, 2.0, 3.0, in_place=False), [2, 3, 2] * track.positions[:, 0])
    in_place = root_path(track, 2.0, 3.0, in_place=True)
    assert np.ptp(in_place[:, [0, 2]], axis=0).max() == 0
    assert np.allclose(in_place[:, 1], 3 * track.positions[:, 0, 1])


def test_smoothing_keeps_constant_and_linear_tracks_and_reduces_noise():
    track = squat()
    still = JointTrack(track.rotation[:1].repeat(9, axis=0), track.positions[:1].repeat(9, axis=0), 30.0)
    assert np.allclose(still.smoothed(0.1).rotation, still.rotation)
    walking = translated(still, 0.1 * np.arange(9)[:, None] * [0, 0, 1])
    assert np.allclose(walking.smoothed(0.3).positions, walking.positions)
    rng = np.random.default_rng(0)
    noise = Rotation.from_rotvec(0.1 * rng.normal(size=(12 * len(BODY.parents), 3))).as_matrix()
    noisy = JointTrack(noise.reshape(track.rotation.shape) @ track.rotation, track.positions, 30.0)
    smooth = noisy.smoothed(0.05)
    assert np.allclose(np.linalg.det(smooth.rotation), 1)
    assert np.abs(np.diff(smooth.rotation, 2, axis=0)).mean() < 0.3 * np.abs(np.diff(noisy.rotation, 2, axis=0)).mean()


def centroids(result):
    return result.clip.vertices.mean(axis=1)


def test_options_of_animate_change_path_contacts_and_noise():
    identity, clip = person(0), walk(faces=600)
    scaled, kept, dropped = (centroids(animate(identity, clip, root=root)) for root in ("scale", "keep", "drop"))
    assert np.ptp(dropped[:, 2]) < 0.3 * np.ptp(scaled[:, 2])
    driven = clip.vertices.mean(axis=1)
    assert abs(np.ptp(kept[:, 2]) / np.ptp(driven[:, 2]) - 1) < 0.1
    slow = dataclasses.replace(clip, fps=0.5)  # slow enough for feet to count as planted
    skates = [animate(identity, slow, ground=ground).report["foot_skate"] for ground in (True, False)]
    assert skates[0] < 0.6 * skates[1]
    noise = np.random.default_rng(0).normal(scale=0.01, size=clip.vertices.shape)
    noisy = dataclasses.replace(clip, vertices=clip.vertices[:1] + noise)
    acceleration = [animate(identity, noisy, smooth=s).report["acceleration"] for s in (0.0, 0.2)]
    assert acceleration[1]["result"] < 0.2 * acceleration[0]["driving"] < 0.2 * acceleration[0]["result"]


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
def test_invalid_options_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        animate(person(0), walk(faces=600), **options)
