"""Rigs whose names say nothing: the shipped network finds their joints by the surface that they move."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import rigs
from foreign_names import renamed
from matrix import matrix
from networks import write_mime_network
from scipy.spatial.transform import Rotation

from mimesh.core.errors import InputError
from mimesh.core.options import Hints
from mimesh.pipeline import animate
from mimesh.tools.inspect import inspect_file

FACES = 3000
"""Triangles of the characters: fewer are not taken for a person."""
FOUND = "have names that say nothing"


def nameless(joint: str) -> str:
    return f"joint_{rigs.figure().names.index(joint) * 7 % 31}"


@pytest.fixture(scope="module")
def driving(tmp_path_factory):
    clips = {"move": rigs.exercise(rigs.figure(1))}
    return str(rigs.character(tmp_path_factory.mktemp("driving") / "move.glb", 1, clips=clips, name=renamed("unreal")))


@pytest.fixture(scope="module")
def named(driving, tmp_path_factory) -> np.ndarray:
    path = rigs.character(tmp_path_factory.mktemp("named") / "a.glb", faces=FACES, name=renamed("mixamo"))
    return animate(str(path), driving).clip.vertices


@matrix("quarters", [0, 1, 2], quick=[1])
def test_an_identity_moves_as_if_its_joints_had_names(quarters, driving, named, tmp_path):
    turn = Rotation.from_euler("y", 90 * quarters, degrees=True).as_matrix()
    path = rigs.character(tmp_path / "a.glb", faces=FACES, name=nameless, turn=turn)
    result = animate(str(path), driving)
    assert result.own is not None
    assert any(FOUND in note for note in result.notes)
    expected = named @ turn.T
    shift = (result.clip.vertices[0] - expected[0]).mean(axis=0)
    assert np.abs(result.clip.vertices - expected - shift).max() < 1e-4


@pytest.mark.slow
def test_the_joints_of_a_driving_are_used_without_names(driving, tmp_path):
    clips = {"move": rigs.exercise(rigs.figure(1))}
    path = rigs.character(tmp_path / "b.glb", 1, faces=FACES, clips=clips, name=nameless)
    identity = str(rigs.character(tmp_path / "a.glb", name=renamed("mixamo")))
    first, second = animate(identity, driving), animate(identity, str(path))
    assert any(FOUND in note for note in second.notes)
    assert np.abs(second.clip.vertices - first.clip.vertices).max() < 1e-4


@pytest.mark.slow
def test_what_is_no_person_is_refused_or_left_to_the_surface(driving, tmp_path):
    person = rigs.figure()
    flat = dataclasses.replace(person, vertices=person.vertices * [1, 0.05, 1], joints=person.joints * [1, 0.05, 1])
    path = str(rigs.character(tmp_path / "a.glb", name=nameless, person=flat))
    with pytest.raises(InputError, match='if a is a person, too, rig="mimesh" body="human"'):
        animate(path, driving)
    assert animate(path, driving, hints=Hints(rig="mimesh", body="human")).own is None


@pytest.mark.slow
def test_a_network_with_other_joints_finds_none(driving, tmp_path):
    pytest.importorskip("onnx")
    model = str(write_mime_network(tmp_path / "mime.onnx"))
    result = animate(str(rigs.character(tmp_path / "a.glb", name=nameless)), driving, model)
    assert result.own is None
    assert any("rename the joints" in note for note in result.notes)


def test_facts_tell_how_the_joints_are_found(tmp_path):
    path = rigs.character(tmp_path / "a.glb", name=nameless)
    assert "names say nothing" in dict(inspect_file(path).details)["rig"]
