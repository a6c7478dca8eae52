"""Joint tracks: smoothing keeps resting joints, root paths are scaled, and options of `animate` change both."""

import dataclasses

import numpy as np
import pytest
from grouped_options import grouped
from people import person, walk
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.errors import InputError
from mimesh.core.joint_tracks import JointTrack, root_path
from mimesh.core.options import MotionOptions
from mimesh.pipeline import animate

BODY = load_body()


def squat(count=12):
    """A squat: knees bend, and the hips move forward and down over the left ankle."""
    turns = np.zeros((count, len(BODY.parents), 3))
    bend = 0.6 * np.sin(np.pi * np.arange(count) / (count - 1))
    for side in ("Left", "Right"):
        turns[:, BODY.joint(f"{side}UpLeg"), 0], turns[:, BODY.joint(f"{side}Leg"), 0] = -bend, 2 * bend
    rotation, translation = BODY.skinning_transforms(BODY.joints, rotvec_to_rotmat(turns))
    positions = (rotation @ BODY.joints[..., None])[..., 0] + translation
    ankle = BODY.joint("LeftFoot")
    return JointTrack(rotation, positions + (BODY.joints[ankle] - positions[:, ankle])[:, None], 30.0)


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
    walking = JointTrack(still.rotation, still.positions + 0.1 * np.arange(9)[:, None, None] * [0, 0, 1], 30.0)
    assert np.allclose(walking.smoothed(0.3).positions, walking.positions)
    rng = np.random.default_rng(0)
    noise = Rotation.from_rotvec(0.1 * rng.normal(size=(12 * len(BODY.parents), 3))).as_matrix()
    noisy = JointTrack(noise.reshape(track.rotation.shape) @ track.rotation, track.positions, 30.0)
    smooth = noisy.smoothed(0.05)
    assert np.allclose(np.linalg.det(smooth.rotation), 1)
    assert np.abs(np.diff(smooth.rotation, 2, axis=0)).mean() < 0.3 * np.abs(np.diff(noisy.rotation, 2, axis=0)).mean()


@pytest.mark.slow
@pytest.mark.usefixtures("kept")
def test_options_of_animate_change_path_contacts_and_noise():
    identity, clip = person(0), dataclasses.replace(walk(faces=600), fps=2.0)  # slow enough to plant feet
    options = ({"root": "scale", "ground": True}, {"ground": False}, {"root": "keep"}, {"root": "drop"})
    planted, sliding, kept, dropped = (animate(identity, clip, **grouped(**chosen)) for chosen in options)
    way = [np.ptp(moved.vertices.mean(axis=1)[:, 2]) for moved in (planted.clip, kept.clip, dropped.clip, clip)]
    assert way[2] < 0.3 * way[0]
    assert abs(way[1] / way[3] - 1) < 0.1
    assert planted.report["foot_skate"] < sliding.report["foot_skate"]
    assert planted.report["foot_skate"] < 1.5 * planted.report["foot_skate_driving"]
    noise = np.random.default_rng(0).normal(scale=0.01, size=clip.vertices.shape)
    noisy = dataclasses.replace(clip, fps=10.0, vertices=clip.vertices[:1] + noise)
    rough, smooth = (acceleration(animate(identity, noisy, motion=MotionOptions(smooth=s)).clip) for s in (0.0, 0.2))
    assert smooth < 0.2 * acceleration(noisy) < 0.2 * rough


def acceleration(clip):
    """Mean second difference of the vertices, over the size."""
    second = np.diff(np.asarray(clip.vertices, float), 2, axis=0)
    return np.linalg.norm(second, axis=-1).mean() / np.ptp(clip.vertices[0], axis=0).max()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"root": "stay"}, "^root: expected one of scale, keep, drop"),
        ({"smooth": -1.0}, "^smooth: expected seconds"),
        ({"model": "copy", "skinned": True}, "^skinned: expected a model with joints"),
        ({"model": "copy", "root": "drop"}, "^root: expected a model with joints"),
    ],
)
def test_invalid_options_are_refused(options, message):
    with pytest.raises(InputError, match=message):
        animate(person(0), walk(faces=600), **grouped(**options))


@pytest.mark.parametrize("ground", [True, False])
def test_planting_feet_is_nothing_that_a_model_without_joints_refuses(ground):
    clip = walk(faces=600)
    assert animate(person(0, faces=600), clip, model="copy", motion=MotionOptions(ground=ground)).skeleton is None
