"""Keys of new animations of a file's nodes: fewer of them move no vertex farther than their limit."""

from __future__ import annotations

import dataclasses
import zlib
from pathlib import Path

import numpy as np
import pytest
import rigs
from scipy.spatial.transform import Rotation

from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.animation import read_channels
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.keys import COPY_LIMIT, KEY_LIMIT, node_keys
from mimesh.io.gltf.own_animation import OwnAnimation, write_own_animations

FRAMES = 90
FLOAT32 = 5e-7
"""Rounding of the vertices of a written file, over the size of the mesh."""


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


@pytest.mark.parametrize("limit", [KEY_LIMIT, 1e-3])
def test_vertices_stay_within_the_limit_though_errors_add_up(limit, animation, tmp_path):
    write_own_animations([dataclasses.replace(animation, key_limit=limit)], tmp_path / "out.glb")
    kept = sum(len(channel.times) for channel in read_channels(open_document(tmp_path / "out.glb"), 0))
    assert kept < 0.6 * FRAMES * len(animation.tracks)
    error = deviation(animation, tmp_path / "out.glb")
    assert 0.02 * limit < error <= limit


def test_copies_are_exact(animation, tmp_path):
    write_own_animations([dataclasses.replace(animation, key_limit=COPY_LIMIT)], tmp_path / "out.glb")
    assert deviation(animation, tmp_path / "out.glb") <= COPY_LIMIT + FLOAT32


def deviation(animation: OwnAnimation, path: Path) -> float:
    """Measure the largest distance of a vertex in a written file from the animation, over the size of the mesh."""
    distances = np.linalg.norm(load_clip(path, animation="0").vertices - np.stack([*animation.vertices()]), axis=-1)
    return distances.max() / np.ptp(animation.source.vertices, axis=0).max()


@pytest.mark.parametrize(
    ("path", "still", "noise"),
    [
        ("translation", [0.0, 0.0, 0.0], 4e-19),
        ("translation", [0.0, 1e-3, 0.0], 1e-11),
        ("rotation", [0.0, 0.6, 0.0, 0.8], 1e-9),
        ("scale", [1.0, 1.0, 1.0], 3e-8),
    ],
)
def test_rounding_is_no_motion(path, still, noise, animation):
    """The file's joints are in hundredths of a unit, so the second one is a billionth of the size."""
    node = animation.source.document.gltf["skins"][0]["joints"][3]
    values = np.tile(still, (FRAMES, 1)) + np.random.default_rng(0).normal(scale=noise, size=(FRAMES, len(still)))
    assert node_keys(animation.source, {(node, path): values}, COPY_LIMIT)[node, path].sum() == 1


def test_small_motions_are_kept(animation):
    """A hundred-thousandth of the size is more than rounding."""
    node = animation.source.document.gltf["skins"][0]["joints"][3]
    values = np.outer(np.arange(FRAMES) / FRAMES, [0.0, 1.8e-7, 0.0])
    assert node_keys(animation.source, {(node, "translation"): values}, KEY_LIMIT)[node, "translation"].all()
