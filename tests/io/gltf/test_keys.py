"""Thinned keys: interpolation stays within the tolerance, and the surface within the limit."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from mimesh.core.rig import Rig
from mimesh.core.skinning import skin_points, skinning_transforms
from mimesh.io.gltf.keys import choose_keys, played_values, rotation_tolerances

FRAMES = 120


def smooth_rotations(joints, frames=FRAMES, seed=0):
    """Tracks of quaternions that turn smoothly, each in the hemisphere of the one before."""
    phase, axis = np.random.default_rng(seed).uniform(0, 6, (2, joints, 3))
    seconds = np.arange(frames)[:, None, None] / 30
    rotvec = 0.7 * np.sin(seconds + phase) * np.cos(axis)
    return Rotation.from_rotvec(rotvec.reshape(-1, 3)).as_quat().reshape(frames, joints, 4).swapaxes(0, 1).copy()


def angles(a, b):
    return (Rotation.from_quat(a.reshape(-1, 4)).inv() * Rotation.from_quat(b.reshape(-1, 4))).magnitude()


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-5])
def test_rotations_between_keys_are_within_the_tolerance_by_slerp_and_by_components(tolerance):
    tracks = smooth_rotations(5)
    is_key = choose_keys(tracks, np.full(5, tolerance), rotations=True)
    assert angles(tracks, played_values(tracks, is_key, rotations=True)).max() <= 1.001 * tolerance
    for track, keys in zip(tracks, is_key, strict=True):
        frames = np.flatnonzero(keys)
        by_slerp = Slerp(frames, Rotation.from_quat(track[frames]))(np.arange(FRAMES)).as_quat()
        by_component = np.stack([np.interp(np.arange(FRAMES), frames, track[frames, k]) for k in range(4)], axis=1)
        assert max(angles(track, by_slerp).max(), angles(track, by_component).max()) <= 1.001 * tolerance


def test_a_larger_tolerance_takes_fewer_keys():
    counts = [choose_keys(smooth_rotations(3), np.full(3, t), rotations=True).sum() for t in (1e-5, 1e-3, 1e-1)]
    assert counts[0] > 2 * counts[1] > 4 * counts[2]


def test_tracks_that_stay_or_turn_evenly_have_one_and_two_keys():
    still = np.tile([0.0, 0.6, 0.0, 0.8], (FRAMES, 1))
    even = Rotation.from_rotvec(np.linspace(0, 0.01, FRAMES)[:, None] * [1.0, 0.0, 0.0]).as_quat()
    held = np.where(np.arange(FRAMES)[:, None] < 60, still, Rotation.from_rotvec([0.0, 1.0, 0.0]).as_quat())
    is_key = choose_keys(np.stack([still, even, held]), np.full(3, 1e-6), rotations=True)
    assert [np.flatnonzero(keys).tolist() for keys in is_key] == [[0], [0, FRAMES - 1], [0, 59, 60, FRAMES - 1]]


def test_positions_are_within_the_tolerance():
    seconds = np.linspace(0, 3, 80)
    tracks = np.stack([np.sin([seconds, 2 * seconds, 3 * seconds]).T, np.outer(seconds, [1, 2, 3])])
    is_key = choose_keys(tracks, np.array([5e-2, 1e-9]), rotations=False)
    assert np.linalg.norm(played_values(tracks, is_key, rotations=False) - tracks, axis=-1).max() <= 5e-2
    assert (is_key[0].sum() < 40, is_key[1].sum()) == (True, 2)


def test_one_frame_has_one_key():
    assert choose_keys(smooth_rotations(2, frames=1), np.zeros(2), rotations=True).tolist() == [[True], [True]]


def test_rotation_tolerances_bound_the_distance_of_every_vertex():
    rng = np.random.default_rng(3)
    parents = (-1, 0, 1, 2, 1, 4, 0)
    joints = np.cumsum(rng.normal(size=(7, 3)), axis=0)
    vertices = joints[rng.integers(7, size=200)] + rng.normal(size=(200, 3))
    rig = Rig(np.tile(np.eye(3), (7, 1, 1)), joints, rng.dirichlet(np.full(7, 0.2), 200))
    limit = 1e-4
    tolerance = rotation_tolerances(vertices, rig, parents, limit)
    largest = 0.0
    for _ in range(50):
        pose = Rotation.random(7, rng)
        axes = rng.normal(size=(7, 3))
        error = Rotation.from_rotvec(axes / np.linalg.norm(axes, axis=1, keepdims=True) * tolerance[:, None])
        moved = [
            skin_points(vertices, rig.weights, *skinning_transforms(joints, rotation.as_matrix(), parents))
            for rotation in (pose, pose * error)
        ]
        largest = max(largest, np.linalg.norm(moved[0] - moved[1], axis=1).max())
    assert limit / 10 < largest <= limit
