"""Shipped and procedural motions, and operations on motions."""

import itertools

import numpy as np
import pytest

from mimesh.bodies import load_body
from mimesh.bodies.sampling import JOINT_LIMITS, limits_rotvec, rotvec_to_rotmat, sample_shape
from mimesh.core.errors import InputError
from mimesh.motions import DEMO, load_motion, mirror, motion_clip, motion_names, pose_bank, resample, window
from mimesh.motions.clips import SPLITS, TAKES
from mimesh.motions.motion import joint_tracks, leg_length, lowest, rotmat_to_rotvec
from mimesh.motions.procedural import spline_motion, walk_motion


@pytest.fixture(scope="module")
def body():
    return load_body()


def test_shipped_motions_fit_the_body_and_splits_are_disjoint_in_time_without_the_t_pose(body):
    assert DEMO in motion_names()
    for name in motion_names():
        motion = load_motion(name)
        assert motion.joint_names == body.joint_names
        assert motion.fps == 30
        np.testing.assert_allclose(np.linalg.det(motion.rotmat[::20]), 1, atol=1e-9)
    for take in TAKES:
        spans = sorted((start, stop) for windows in SPLITS.values() for name, start, stop in windows if name == take)
        assert spans[0][0] >= 0.5
        assert all(a[1] <= b[0] for a, b in itertools.pairwise(spans))


def test_feet_of_a_shipped_motion_are_on_the_floor(body):
    motion = load_motion("jump")
    heights = lowest(body, motion.rotmat, motion.root)
    assert abs(np.median(heights)) < 0.05
    assert heights.min() > -0.1
    assert heights.max() > 0.15  # the jump
    vertices = body.posed(np.zeros(0), motion.rotmat[::9], motion.root[::9])
    np.testing.assert_allclose(heights[::9], vertices[..., 1].min(axis=1), atol=1e-12)


def test_a_frame_of_a_clip_does_not_depend_on_the_others_and_the_path_is_scaled_by_leg_length(body):
    motion, shape = load_motion(DEMO), sample_shape(body, 0, 0)
    clip = motion_clip(body, shape, motion)
    frame = motion_clip(body, shape, window(motion, 1.0, 1.0 + 1 / 30))
    np.testing.assert_allclose(clip.vertices[30], frame.vertices[0])
    assert (len(clip), clip.fps) == (len(motion), 30)
    scale = leg_length(body.shaped(shape)[1], body.joint_names) / leg_length(body.joints, body.joint_names)
    _, position = joint_tracks(body, motion, shape)
    np.testing.assert_allclose(position[-1, 0] - position[0, 0], scale * (motion.root[-1] - motion.root[0]), atol=1e-12)


def test_poses_of_the_bank_face_front():
    for split in ("train", "val", "test"):
        bank = pose_bank(split)
        assert bank.shape[1:] == (31, 3)
        front = rotvec_to_rotmat(bank[:, 0].astype(float))[..., 2]
        assert np.abs(front[:, 0]).max() < 1e-4
        assert front[:, 2].min() > 0


def test_mirroring_twice_is_the_identity(body):
    motion = load_motion("walk")
    twice = mirror(mirror(motion))
    np.testing.assert_allclose(twice.rotmat, motion.rotmat, atol=1e-12)
    np.testing.assert_allclose(twice.root, motion.root)
    left, right = body.joint("LeftArm"), body.joint("RightArm")
    flip = np.diag([-1.0, 1, 1])
    np.testing.assert_allclose(mirror(motion).rotmat[:, left], flip @ motion.rotmat[:, right] @ flip, atol=1e-12)


def test_resampling_keeps_common_frames():
    motion = load_motion("walk")
    fast = resample(motion, 60.0)
    np.testing.assert_allclose(fast.rotmat[::2], motion.rotmat[: len(fast.rotmat[::2])], atol=1e-9)
    assert abs(fast.seconds - motion.seconds) < 1 / 30
    with pytest.raises(InputError, match="expected a frame rate from"):
        resample(motion, 0.0)


@pytest.mark.parametrize("make", [spline_motion, walk_motion])
def test_procedural_motion_is_reproducible_smooth_and_on_the_floor(make, body):
    motion = make(body, 4, 2, seconds=1.0)
    again, other = make(body, 4, 2, seconds=1.0), make(body, 4, 3, seconds=1.0)
    np.testing.assert_array_equal(motion.rotmat, again.rotmat)
    assert not np.array_equal(motion.rotmat, other.rotmat)
    assert len(motion) == 30
    np.testing.assert_allclose(lowest(body, motion.rotmat, motion.root), 0, atol=1e-9)
    vertices = motion_clip(body, None, motion).vertices
    assert np.linalg.norm(np.diff(vertices, axis=0), axis=-1).max() < 0.35  # metres per frame


def test_a_spline_stays_within_the_joint_limits(body):
    motion = spline_motion(body, 1, 0, seconds=1.0, reach=1.0)
    low, high = limits_rotvec(body, JOINT_LIMITS)
    rotvec = rotmat_to_rotvec(motion.rotmat)[:, 1:]  # the root carries the heading as well
    # Rotation vectors longer than half a turn are not unique.
    assert (np.linalg.norm(np.maximum(-low, high), axis=1)[1:] > np.pi).sum() == 0
    assert (rotvec >= low[1:] - 1e-9).all()
    assert (rotvec <= high[1:] + 1e-9).all()


def test_a_walk_moves_forward_and_its_planted_foot_does_not_slide(body):
    motion = walk_motion(body, 0, 1)
    step = np.diff(motion.root[:, [0, 2]], axis=0)
    front = motion.rotmat[:-1, 0][:, [0, 2], 2]
    assert (step * front).sum() / np.linalg.norm(step, axis=1).sum() > 0.9
    vertices = motion_clip(body, None, motion).vertices
    rows = np.arange(len(vertices) - 1)
    lowest_vertex = (vertices[1:] + vertices[:-1])[..., 1].argmin(axis=1)
    slip = np.linalg.norm((vertices[rows + 1, lowest_vertex] - vertices[rows, lowest_vertex])[:, [0, 2]], axis=1)
    assert np.median(slip) < 0.003  # metres per frame; the root moves ten times as far
    assert np.median(np.linalg.norm(step, axis=1)) > 0.02


def test_windows_and_names_are_checked():
    motion = load_motion("walk")
    with pytest.raises(InputError, match=r"expected a window within 0\.\."):
        window(motion, 1.0, 99.0)
    with pytest.raises(InputError, match="cmu_01_01"):
        load_motion("moonwalk")
    with pytest.raises(InputError, match="retarget it first"):
        motion_clip(load_body(), None, type(motion)("a", ("Hips",), motion.rotmat[:, :1], motion.root))
