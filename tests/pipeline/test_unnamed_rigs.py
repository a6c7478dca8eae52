"""Rigs whose names say nothing: the shipped network finds their joints by the surface that they move."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
import rigs
from foreign_names import renamed
from matrix import matrix
from networks import write_mime_network
from scipy.spatial.transform import Rotation

from mimesh.core.errors import InputError
from mimesh.core.options import Hints, MotionOptions
from mimesh.core.rig import homogeneous
from mimesh.io.gltf.draft import Draft
from mimesh.pipeline import animate
from mimesh.pipeline.capturing import capture
from mimesh.pipeline.rigging import rig
from mimesh.tools.inspect import inspect_file

FACES = 3000
"""Triangles of the characters: fewer are not taken for a person."""
FOUND = "have names that say nothing"
STUBS = [f"{side}{stub}" for side in ("Left", "Right") for stub in ("HandFinger1", "FingerBase")]
STRAIGHT = MotionOptions(contacts=False)
"""Arms keep away from the surface, and a tail is part of it."""


def stubless() -> rigs.Figure:
    """Make a person without the stubs of fingers: without names they are found as mittens."""
    return rigs.figure().without(*STUBS, "LThumb", "RThumb")


def nameless(joint: str) -> str:
    return f"joint_{rigs.figure().names.index(joint) * 7 % 31}"


@pytest.fixture(scope="module")
def driving(tmp_path_factory):
    clips = {"move": rigs.exercise(rigs.figure(1))}
    return str(rigs.character(tmp_path_factory.mktemp("driving") / "move.glb", 1, clips=clips, name=renamed("unreal")))


@pytest.fixture(scope="module")
def named(driving, tmp_path_factory) -> np.ndarray:
    path = rigs.character(
        tmp_path_factory.mktemp("named") / "a.glb", faces=FACES, name=renamed("mixamo"), person=stubless()
    )
    return animate(str(path), driving, motion=STRAIGHT).clip.vertices


@pytest.mark.slow
@matrix("quarters", [0, 1, 2], quick=[1])
def test_an_identity_moves_as_if_its_joints_had_names(quarters, driving, named, tmp_path):
    turn = Rotation.from_euler("y", 90 * quarters, degrees=True).as_matrix()
    path = rigs.character(tmp_path / "a.glb", faces=FACES, name=nameless, turn=turn, person=stubless())
    result = animate(str(path), driving, motion=STRAIGHT)
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
    first, second = (animate(identity, of, motion=STRAIGHT) for of in (driving, str(path)))
    assert any(FOUND in note for note in second.notes)
    apart = second.clip.vertices - first.clip.vertices
    assert np.abs(apart - apart.mean(axis=(0, 1))).max() < 1e-4
    assert np.abs(apart).max() < 0.004  # the soles of a mesh that was found and of one that is named


@pytest.mark.slow
def test_rigs_and_captures_are_those_of_joints_with_names(tmp_path):
    clips = {"move": rigs.exercise(stubless())}
    first, second = (
        rigs.character(tmp_path / f"{k}.glb", faces=FACES, clips=clips, name=name, person=stubless())
        for k, name in enumerate((renamed("mixamo"), nameless))
    )
    rigged = rig(second)
    assert rigged.source == "file"
    assert any(FOUND in note for note in rigged.notes)
    joints = rig(first).joints
    assert rigged.joints.keys() <= joints.keys()
    for name, place in rigged.joints.items():
        np.testing.assert_allclose(place, joints[name], atol=1e-5)
    captured, expected = capture(second), capture(first)
    assert any(FOUND in note for note in captured.notes)
    shared = [expected.names.index(name) for name in captured.names]
    np.testing.assert_allclose(captured.rotation, expected.rotation[:, shared], atol=1e-4)


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


def test_facts_are_those_of_the_joints_that_the_surface_shows(tmp_path):
    """What a surface alone is taken for does not count: that of a skeleton of bones is that of no person."""
    turn = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    path = rigs.character(tmp_path / "a.glb", faces=FACES, name=nameless, turn=turn, person=stubless())
    facts = inspect_file(path)
    assert re.match(r"\d+ joints whose names say nothing, \d+ of a person", dict(facts.details)["rig"])
    assert facts.stands == "up +y, front +x, a person by its rig"


@pytest.mark.slow
def test_facts_tell_that_no_joints_are_found(tmp_path):
    person = rigs.figure()
    flat = dataclasses.replace(person, vertices=person.vertices * [1, 0.05, 1], joints=person.joints * [1, 0.05, 1])
    facts = inspect_file(rigs.character(tmp_path / "a.glb", name=nameless, person=flat))
    assert dict(facts.details)["rig"].startswith("not used: ")


def with_tail(length: float):
    """Add a straight tail of a length behind the hips: five joints with a skin of their own, and a ring at each."""

    def change(draft: Draft) -> None:
        person, gltf = rigs.figure(), draft.gltf
        hips, first = 2 + person.names.index("Hips"), len(gltf["nodes"])
        places = (
            person.joints[person.names.index("Hips")] - [0, 0, 0.1] - np.outer(np.linspace(0, length, 5), [0, 0, 1])
        )
        above = rigs.ARMATURE @ np.array(gltf["nodes"][hips]["matrix"]).reshape(4, 4).T
        gltf["nodes"][hips].setdefault("children", []).append(first)
        for k, place in enumerate(places):
            world = homogeneous(np.eye(3), place)
            local = (np.linalg.inv(above) @ world).T.ravel().tolist()
            gltf["nodes"].append(
                {"name": f"joint_{90 + k}", "matrix": local} | ({"children": [first + k + 1]} if k < 4 else {})
            )
            above = world
        ring = 0.05 * np.stack([np.cos(np.arange(6)), np.sin(np.arange(6)), np.zeros(6)], axis=1)
        points = (places[:, None] + ring).reshape(-1, 3)
        sides = np.array(
            [
                [a, b, a + 6, b, b + 6, a + 6]
                for k in range(4)
                for a, b in zip(range(6 * k, 6 * k + 6), [*range(6 * k + 1, 6 * k + 6), 6 * k], strict=True)
            ]
        )
        joints = np.repeat(np.arange(5), 6)[:, None] * [1, 0, 0, 0]
        place = {"bufferView": draft.add_view(joints.astype("<u1")), "componentType": 5121, "count": 30, "type": "VEC4"}
        attributes = {"POSITION": draft.add_floats(points, bounds=True), "JOINTS_0": draft.add_accessor(place)}
        attributes["WEIGHTS_0"] = draft.add_floats(np.tile([1.0, 0, 0, 0], (30, 1)))
        inverse = draft.add_matrices(homogeneous(np.tile(np.eye(3), (5, 1, 1)), -places))
        gltf["skins"].append({"joints": list(range(first, first + 5)), "inverseBindMatrices": inverse})
        gltf["meshes"].append({"primitives": [{"attributes": attributes, "indices": draft.add_indices(sides)}]})
        gltf["nodes"].append({"name": "tail", "mesh": 1, "skin": 1})
        gltf["scenes"][0]["nodes"].append(first + 5)

    return change


@pytest.mark.slow
@matrix(("length", "body"), [(0.8, "auto"), (2.5, "auto"), (2.5, "human")], quick=[(0.8, "auto")])
def test_a_person_with_a_long_tail_keeps_its_rig(length, body, driving, named, tmp_path):
    """Whose names say nothing; the tail hides its shape, which is found without it."""
    path = rigs.character(tmp_path / "a.glb", faces=FACES, name=nameless, change=with_tail(length), person=stubless())
    result = animate(str(path), driving, hints=Hints(body=body), motion=STRAIGHT)
    assert result.own is not None
    person = np.asarray(result.clip.vertices)[:, : named.shape[1]]
    shift = (person[0] - named[0]).mean(axis=0)
    assert np.abs(person - named - shift).max() < 1e-4
