"""Thinned keys: interpolation stays within the tolerance, and the surface of a written file within the limit."""

from __future__ import annotations

import dataclasses
import zlib

import numpy as np
import pytest
import rigs
from scipy.spatial.transform import Rotation, Slerp

from mimesh.core.rig import Rig
from mimesh.core.skinning import skin_points, skinning_transforms
from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.animation import read_channels
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.keys import COPY_LIMIT, KEY_LIMIT, choose_keys, node_keys, played_values, rotation_tolerances
from mimesh.io.gltf.own_animation import OwnAnimation, write_own_animations

FRAMES = 90
FLOAT32 = 5e-7
"""Rounding of the vertices of a written file, over the size of the mesh."""


def smooth_rotations(joints, frames=FRAMES, seed=0):
    """Tracks of quaternions that turn smoothly, each in the hemisphere of the one before."""
    phase, axis = np.random.default_rng(seed).uniform(0, 6, (2, joints, 3))
    seconds = np.arange(frames)[:, None, None] / 30
    rotvec = 0.7 * np.sin(seconds + phase) * np.cos(axis)
    return Rotation.from_rotvec(rotvec.reshape(-1, 3)).as_quat().reshape(frames, joints, 4).swapaxes(0, 1).copy()


def angles(a, b):
    return (Rotation.from_quat(a.reshape(-1, 4)).inv() * Rotation.from_quat(b.reshape(-1, 4))).magnitude()


def test_rotations_between_keys_are_within_the_tolerance_by_slerp_and_by_components():
    tracks, counts = smooth_rotations(5), []
    for tolerance in (1e-1, 1e-3, 1e-5):
        is_key = choose_keys(tracks, np.full(5, tolerance))
        assert angles(tracks, played_values(tracks, is_key)).max() <= 1.001 * tolerance
        for track, keys in zip(tracks, is_key, strict=True):
            frames = np.flatnonzero(keys)
            by_slerp = Slerp(frames, Rotation.from_quat(track[frames]))(np.arange(FRAMES)).as_quat()
            by_component = np.stack([np.interp(np.arange(FRAMES), frames, track[frames, k]) for k in range(4)], axis=1)
            assert max(angles(track, by_slerp).max(), angles(track, by_component).max()) <= 1.001 * tolerance
        counts.append(is_key.sum())
    assert counts[2] > 2 * counts[1] > 4 * counts[0], "a larger tolerance takes fewer keys"


def test_tracks_that_stay_or_turn_evenly_have_one_and_two_keys():
    still = np.tile([0.0, 0.6, 0.0, 0.8], (FRAMES, 1))
    even = Rotation.from_rotvec(np.linspace(0, 0.01, FRAMES)[:, None] * [1.0, 0.0, 0.0]).as_quat()
    held = np.where(np.arange(FRAMES)[:, None] < 60, still, Rotation.from_rotvec([0.0, 1.0, 0.0]).as_quat())
    is_key = choose_keys(np.stack([still, even, held]), np.full(3, 1e-6))
    assert [np.flatnonzero(keys).tolist() for keys in is_key] == [[0], [0, FRAMES - 1], [0, 59, 60, FRAMES - 1]]
    assert choose_keys(smooth_rotations(2, frames=1), np.zeros(2)).tolist() == [[True], [True]]


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


def swaying(person: rigs.Figure) -> list[np.ndarray]:
    """Make a slow motion of all joints of a person: keys are interpolated linearly, so faster ones need all of them."""
    axes = {name: np.random.default_rng(zlib.crc32(name.encode())).normal(scale=0.3, size=3) for name in person.names}
    seconds = np.arange(FRAMES) / rigs.FPS
    return [
        person.pose(
            {
                name: Rotation.from_rotvec(np.sin(0.1 * t + k) * axis).as_matrix()
                for k, (name, axis) in enumerate(axes.items())
            },
            np.array([0.02 * t, 0.01 * np.sin(t), 0.3 * t]),
        )
        for t in seconds
    ]


@pytest.fixture(scope="module")
def animation(tmp_path_factory) -> OwnAnimation:
    """A motion of a person with toes and finger stubs, that is a chain of nine joints."""
    person = rigs.figure()
    path = rigs.character(tmp_path_factory.mktemp("rig") / "a.glb", clips={"sway": swaying(person)}, person=person)
    mesh, clip = load_mesh(path), load_clip(path)
    return OwnAnimation(mesh.source, "new", clip.skeleton.values(), clip.fps, len(clip), {})


@pytest.mark.parametrize(("limit", "rounding"), [(KEY_LIMIT, 0.0), (1e-3, 0.0), (COPY_LIMIT, FLOAT32)])
def test_vertices_stay_within_the_limit_though_errors_add_up(limit, rounding, animation, tmp_path):
    write_own_animations([dataclasses.replace(animation, key_limit=limit)], tmp_path / "out.glb")
    moved = load_clip(tmp_path / "out.glb", animation="0").vertices
    distances = np.linalg.norm(moved - np.stack([*animation.vertices()]), axis=-1)
    error = distances.max() / np.ptp(animation.source.vertices, axis=0).max()
    assert 0.02 * limit < error <= limit + rounding
    kept = sum(len(channel.times) for channel in read_channels(open_document(tmp_path / "out.glb"), 0))
    assert rounding or kept < 0.6 * FRAMES * len(animation.tracks)


STILL = [
    ("translation", [0.0, 0.0, 0.0], 4e-19),
    ("translation", [0.0, 1e-3, 0.0], 1e-11),
    ("rotation", [0.0, 0.6, 0.0, 0.8], 1e-9),
    ("scale", [1.0, 1.0, 1.0], 3e-8),
]


def test_rounding_is_no_motion_but_small_motions_are(animation):
    """The file's joints are in hundredths of a unit: 1e-11 is a billionth of the size, 1.8e-7 a hundred-thousandth."""
    node = animation.source.document.gltf["skins"][0]["joints"][3]
    for path, still, noise in STILL:
        values = np.tile(still, (FRAMES, 1)) + np.random.default_rng(0).normal(scale=noise, size=(FRAMES, len(still)))
        assert node_keys(animation.source, {(node, path): values}, COPY_LIMIT)[node, path].sum() == 1
    values = np.outer(np.arange(FRAMES) / FRAMES, [0.0, 1.8e-7, 0.0])
    assert node_keys(animation.source, {(node, "translation"): values}, KEY_LIMIT)[node, "translation"].all()
