"""The features that research/recipes/fit_orientation.py trains and measures on: upright figures that face +z."""

import sys
from pathlib import Path

import numpy as np
import pytest
from pools import write_character

from mimesh.bodies import load_body
from mimesh.bodies.character_pool import read_pool
from mimesh.core import normalization

sys.path.append(str(Path(__file__).resolve().parent / "recipes"))

import fit_orientation

SHIPPED = Path(normalization.__file__).with_name("frame_orientation.npz")


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pool")
    write_character(folder, "a", split="train")
    write_character(folder, "b", shape=1, split="val")
    return folder


def test_figures_are_drawn_again_alike_and_stand_upright(pool):
    pytest.importorskip("torch")
    features, packs = fit_orientation.draw_figures(pool, 40, 3)
    again, _ = fit_orientation.draw_figures(pool, 30, 3)
    assert np.array_equal(features[:30], again)
    assert features.shape == (40, normalization.GRID**3)
    assert {"ours", "primitives"} == set(packs)
    np.testing.assert_allclose((features.astype(float) ** 2).sum(axis=1), 1, atol=1e-5)
    scores = normalization.orientation_scores(features.astype(float), fit_orientation.load_detector(SHIPPED))
    up = [normalization.ORIENTATIONS[r][0] for r in scores.argmax(axis=1)]
    assert up.count("+y") > 30


def test_characters_of_a_pool_are_measured_in_the_pose_of_their_mesh(pool):
    (character,) = read_pool(pool, "val").characters
    rest, clips = fit_orientation.character_features(character)
    np.testing.assert_allclose(rest[0], normalization.mesh_occupancy(character.rig.mesh))
    assert len(clips) > 0
    features = fit_orientation.pool_features(pool, "val")
    assert {name: len(rows) for name, rows in features.items()} == {"ours rest": 1, "ours clips": len(clips)}


def test_standing_poses_face_the_front_and_leave_out_those_that_lie():
    pytest.importorskip("torch")
    body = load_body()
    poses = np.zeros((3, len(body.parents), 3))
    poses[1, 0] = [0, 2.5, 0]  # turned
    poses[2, 0] = [1.5, 0, 0]  # lying
    local, turns, standing = fit_orientation.standing_poses(body, poses)
    assert standing.tolist() == [True, True, False]
    np.testing.assert_allclose(local[:, 0], np.tile(np.eye(3), (2, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(turns[1][:, 2], [np.sin(-2.5), 0, np.cos(-2.5)], atol=1e-12)
