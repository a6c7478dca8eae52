"""three.js and the Khronos validator on files of identities that keep their rigs: root bones, new names, poses."""

import json
import subprocess

import numpy as np
import pytest
import rigs
from client_programs import three, validator
from foreign_names import renamed

from mimesh.pipeline import animate, transfer

pytestmark = pytest.mark.client


@pytest.fixture(scope="module")
def driving(tmp_path_factory):
    return rigs.of_kind(tmp_path_factory.mktemp("driving") / "move.glb", "T-pose")[0]


def issues(path):
    """List what the validator finds, hints and information left out."""
    answer = subprocess.run([*validator(), str(path)], capture_output=True, text=True, check=True)
    return {message["code"] for message in json.loads(answer.stdout)["issues"]["messages"] if message["severity"] < 2}


def play(path, *times):
    answer = subprocess.run([*three(), str(path), *map(str, times)], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    return json.loads(answer.stdout)


def assert_close(found, expected):
    """Compare vertices. three.js takes four joints of a vertex, of which files of `rigs` have up to eight."""
    distance = np.linalg.norm(np.array(found) - expected, axis=1) / np.ptp(expected, axis=0).max()
    assert np.median(distance) < 1e-5
    assert distance.max() < 5e-3


@pytest.mark.parametrize("kind", ["T-pose", "feet on roots", "metres, y up", "nodes in another pose"])
@pytest.mark.parametrize("names", ["own", "unreal"])
def test_files_with_a_root_bone(kind, names, model, driving, tmp_path):
    identity = rigs.of_kind(tmp_path / "a.glb", kind, name=renamed("mixamo"), frames=2)[0]
    result = animate(str(identity), str(driving), model)
    result.save_skinned(tmp_path / "out.glb", names=names, root_bone=True)
    assert issues(tmp_path / "out.glb") <= issues(identity)
    frames = (0, 2, 4)  # at the end of the last one, the clip starts again
    played = play(tmp_path / "out.glb", *(t / result.fps for t in frames))
    for t, vertices in zip(frames, played["frames"], strict=True):
        assert_close(vertices, result.clip.vertices[t])
    assert played["bones"][-1] == ("root" if names == "unreal" else "Root")
    assert played["warnings"] == []


def test_a_pose_is_played_on_opening_a_file_with_animations(model, tmp_path):
    person = rigs.figure()
    driving = rigs.character(tmp_path / "pose.glb", moved=rigs.exercise(person)[-1])
    identity = rigs.of_kind(tmp_path / "a.glb", "T-pose", name=renamed("godot"))[0]
    result = transfer(str(identity), str(driving), model)
    result.save(tmp_path / "out.glb")
    assert issues(tmp_path / "out.glb") <= issues(identity)
    played = play(tmp_path / "out.glb", 0, 0.01, 3)
    for vertices in (played["rest"], *played["frames"]):
        assert_close(vertices, result.vertices)
