"""Clips of driving files: which frames are taken, and what is said about them."""

import dataclasses

import gltf_samples as samples
import numpy as np
import pytest
import zoo
from motion_files import write_bvh

from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.io import load_clip, save_clip
from mimesh.motions import load_motion, window
from mimesh.tools.driving import DrivingClip, read_driving, taken_rate_note

pytestmark = pytest.mark.usefixtures("in_process")


def test_assumed_frame_rate_is_noted(tmp_path):
    moving = zoo.moving_cube()
    assert "--fps" in taken_rate_note(moving, tmp_path)[0]
    assert "--fps" in taken_rate_note(moving, tmp_path / "a.pc2")[0]
    assert taken_rate_note(moving, tmp_path / "a.glb") == taken_rate_note(Clip.still(moving.mesh), tmp_path) == ()


def test_chosen_frames_of_driving_files_have_the_notes_of_the_whole(tmp_path):
    body, motion = load_body(), window(load_motion("jump"), 0.0, 1.0)
    rotmat = motion.rotmat.copy()  # shipped motions are loaded once
    rotmat[0] = np.eye(3)  # a calibration pose
    motion = dataclasses.replace(motion, rotmat=rotmat)
    save_clip(zoo.moving_cube(30), tmp_path / "a.npz")
    path = write_bvh(tmp_path / "a.bvh", body, motion)
    for file, whole in ((tmp_path / "a.npz", load_clip(tmp_path / "a.npz")), (path, load_clip(path))):
        chosen = DrivingClip(file, None, "a")
        cut, notes = read_driving(chosen, None, None, slice(0, 9, 4))
        np.testing.assert_array_equal(cut.vertices, whole.vertices[0:9:4])
        assert cut.fps == whole.fps / 4
        assert any("frame 0 differs" in note for note in notes) == (file == path)
        assert len(read_driving(chosen, None, None, slice(3, 9, 4), whole=True)[0]) == len(whole)
        for every in (False, True):
            with pytest.raises(InputError, match="which leaves none"):
                read_driving(chosen, None, None, slice(500, None, 1), whole=every)
    assert not any("frame 0 differs" in note for note in read_driving(chosen, None, None, slice(1, 3, 1))[1])


def test_animations_that_are_taken_together_are_no_alternatives(tmp_path):
    """Blender writes one animation for each object that moves: bones and blend shapes of one action are two."""
    sample = samples.hero()
    walking = {**sample.gltf["animations"][0], "name": "Walk"}
    moved = {channel["target"]["node"] for channel in walking["channels"]}
    others = [node for node in range(len(sample.gltf["nodes"])) if node not in moved][:2]
    face, tail = (
        {**walking, "name": name, "channels": [{"target": {"node": node, "path": "rotation"}, "sampler": 0}]}
        for name, node in zip(("Face", "Tail"), others, strict=True)
    )
    found = {}
    for name, animations in {
        "one": [walking],
        "together": [walking, face, tail],
        "second": [walking, {**walking, "name": "Run"}],
        "third": [walking, {**walking, "name": "Run"}, face],
    }.items():
        sample.gltf["animations"] = animations
        path = sample.glb(tmp_path / f"{name}.glb")
        notes = read_driving(DrivingClip(path, None, name), None, None, slice(0, None, 1))[1]
        found[name] = [note.partition(";")[0] for note in notes if "animations" in note]
    assert found == {
        "one": [],
        "together": [],
        "second": ["second.glb has 2 animations: the first, Walk, is taken"],
        "third": ["third.glb has 3 animations: Walk, Face are taken"],
    }
