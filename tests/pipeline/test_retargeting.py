"""`mimesh.retarget`: what it makes is what `animate` makes, whatever the two meshes are, and each is looked at once."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from people import person, walk

import mimesh
from mimesh.bodies.animals import animal
from mimesh.core.errors import RefusedMeshError
from mimesh.motions.animal_clips import animal_clip

pytestmark = pytest.mark.usefixtures("kept")


@pytest.fixture(scope="module")
def captured() -> mimesh.CapturedClip:
    return mimesh.capture(walk(faces=600))


def own_rig(folder) -> str:
    """Write a person with a rig of its own, in a walk, and return the path."""
    return str(mimesh.animate(person(1), walk(faces=600)).save_skinned(folder / "own.glb", names="mixamo"))


def difference(captured: mimesh.CapturedClip, clip, mesh, **motion) -> float:
    """Return how far the results of both ways are apart."""
    options = mimesh.MotionOptions(**motion)
    direct = mimesh.animate(mesh, clip, motion=options)
    retargeted = mimesh.retarget(captured, mimesh.rig(mesh), motion=options)
    assert retargeted.report["driving"] == direct.report["driving"]
    assert retargeted.skeleton.names == direct.skeleton.names
    return float(np.abs(direct.clip.vertices - retargeted.clip.vertices).max())


@pytest.mark.slow
@pytest.mark.parametrize("motion", [{}, {"root": "drop", "ground": False}, {"smooth": 0.1}])
def test_a_bare_mesh_moves_as_by_animate(captured, motion):
    assert difference(captured, walk(faces=600), person(0), **motion) == 0.0


@pytest.mark.slow
def test_a_mesh_with_a_rig_moves_on_it(captured, tmp_path):
    path = own_rig(tmp_path)
    assert difference(captured, walk(faces=600), path) == 0.0
    moved = mimesh.retarget(captured, mimesh.rig(path))
    assert moved.report["rig"] == "own"
    assert moved.save_skinned(tmp_path / "moved.glb").is_file()


def test_joints_of_a_file_are_followed(tmp_path):
    path = own_rig(tmp_path)
    assert difference(mimesh.capture(path), path, person(0)) < 1e-6


def test_what_other_processes_send_is_the_same(captured):
    """Frames that are made when they are asked for are made to be pickled."""
    rigged, again = mimesh.rig(person(0)), pickle.loads(pickle.dumps(captured))
    moved = mimesh.retarget(captured, rigged)
    sent = pickle.loads(pickle.dumps(moved))
    np.testing.assert_array_equal(sent.clip.vertices, moved.clip.vertices)
    assert (sent.report, sent.notes) == (moved.report, moved.notes)
    followed = mimesh.retarget(again, pickle.loads(pickle.dumps(rigged)))
    np.testing.assert_array_equal(followed.clip.vertices, moved.clip.vertices)


@pytest.mark.slow  # a network, 9 s
def test_what_the_capture_has_said_of_the_clip_is_said_once():
    """With the options of `capture`: those of `animate` on the driving are none here."""
    clip = walk(faces=600)
    thin = mimesh.Clip(clip.mesh, clip.vertices * [0.3, 1, 0.3], clip.fps)
    captured = mimesh.capture(thin)  # which looks like an animal, and may face anywhere
    assert sum("uncertain" in note or "limbs were not found" in note for note in captured.notes) == 2
    moved = mimesh.retarget(captured, mimesh.rig(animal("cow")))
    assert [note for note in moved.notes if "walk" in note] == [note for note in captured.notes if "walk" in note]
    assert not any("driving_front" in note for note in moved.notes)


def test_filters_of_capture_and_retarget_add_up(captured):
    """Two Gaussian filters are one, whose variance is the sum of theirs."""
    rigged, clip = mimesh.rig(person(0)), walk(faces=600)
    twice = mimesh.retarget(mimesh.capture(clip, smooth=0.03), rigged, motion=mimesh.MotionOptions(smooth=0.04))
    once = mimesh.animate(person(0), clip, motion=mimesh.MotionOptions(smooth=0.05))
    np.testing.assert_allclose(twice.clip.vertices, once.clip.vertices, atol=1e-6)


@pytest.mark.slow
def test_animals_follow_animals_and_no_people(captured):
    gallop, cow = animal_clip("horse gallop"), mimesh.rig(animal("cow"))
    assert mimesh.retarget(mimesh.capture(gallop), cow).report["body"] == "quadruped"
    with pytest.raises(RefusedMeshError, match="expected two people or two four-legged animals, found a person and"):
        mimesh.retarget(captured, cow)
