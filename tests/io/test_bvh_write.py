"""A motion written as BVH is read back equal."""

import dataclasses

import numpy as np
import pytest

from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.io import load_clip, save_bvh
from mimesh.motions import load_motion, motion_clip, window
from mimesh.motions.bvh import load_bvh

BODY, MOTION = load_body(), window(load_motion("turn"), 0.0, 0.3)


def test_bvh_round_trip_keeps_joints_rotations_and_root(tmp_path):
    read = load_bvh(save_bvh(MOTION, BODY, tmp_path / "turn.bvh"))
    order = [read.joint_names.index(name) for name in BODY.joint_names]
    assert read.fps == 30.0
    assert np.abs(read.rotmat[:, order] - MOTION.rotmat).max() < 1e-6
    assert np.abs(read.root / 100 - BODY.joints[0] - MOTION.root).max() < 1e-6
    assert np.abs(np.diff(read.rest()[order] / 100 - BODY.joints, axis=0)).max() < 1e-5


def test_written_bvh_moves_the_default_body_as_the_motion_does(tmp_path):
    played = load_clip(save_bvh(MOTION, BODY, tmp_path / "turn.bvh")).vertices
    truth = motion_clip(BODY, None, MOTION).vertices
    error = (played - played.mean(axis=(0, 1))) - (truth - truth.mean(axis=(0, 1)))
    assert np.linalg.norm(error, axis=-1).mean() < 0.02


def test_motion_of_another_skeleton_is_refused(tmp_path):
    stranger = dataclasses.replace(MOTION, joint_names=("Tail", *MOTION.joint_names[1:]))
    with pytest.raises(InputError, match="retarget"):
        save_bvh(stranger, BODY, tmp_path / "x.bvh")
