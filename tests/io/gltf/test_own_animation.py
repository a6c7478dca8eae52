"""New animations of own nodes: matrices, frames above the joints, channels without use, files without scenes."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import rigs
from foreign_names import renamed
from networks import write_mime_network

from mimesh.io import load_clip
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.draft import Draft
from mimesh.pipeline import animate

EXACT = 1e-5
"""Largest distance of a vertex, over the size of the mesh, that counts as exact."""
PERSON = rigs.figure()
FIRST = 2
"""Node of the first joint."""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    pytest.importorskip("onnx")
    return str(write_mime_network(tmp_path_factory.mktemp("network") / "mime.onnx"))


@pytest.fixture(scope="module")
def driving(tmp_path_factory) -> Path:
    return rigs.of_kind(tmp_path_factory.mktemp("driving") / "move.glb", "T-pose")[0]


def distance(vertices: np.ndarray, expected: np.ndarray) -> float:
    """Largest distance of a vertex over the size of the mesh."""
    return float(np.linalg.norm(vertices - expected, axis=-1).max() / np.ptp(expected[0], axis=0).max())


def truth() -> np.ndarray:
    return np.stack([rigs.posed(PERSON, frame) for frame in rigs.exercise(PERSON)])


def json_of(path: Path) -> dict:
    content = path.read_bytes()
    return json.loads(content[20 : 20 + struct.unpack_from("<I", content, 12)[0]])


def test_nodes_with_a_matrix_move_in_memory_as_in_the_written_file(model, driving, tmp_path):
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), frames=3)
    assert all("matrix" in node for node in json_of(path)["nodes"][FIRST:])
    result = animate(str(path), str(driving), model)
    assert distance(np.stack(list(result.own.vertices())), result.clip.vertices) < EXACT
    result.save_skinned(tmp_path / "out.glb")
    assert distance(load_clip(tmp_path / "out.glb").vertices, result.clip.vertices) < EXACT


def test_a_copy_onto_nodes_with_a_matrix_moves(model, driving, tmp_path):
    result = animate(str(rigs.character(tmp_path / "a.glb")), str(driving), model)
    assert result.report["copied"]
    assert distance(result.clip.vertices, truth()) < EXACT


def test_a_vrm_animation_of_nodes_with_a_matrix_moves(model, driving, tmp_path):
    frames = []
    for clips in (None, {"still": rigs.exercise(PERSON, 2, size=0.0)}):
        path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), clips=clips)
        animate(str(path), str(driving), model).save_skinned(tmp_path / "out.vrma")
        frames.append(load_clip(tmp_path / "out.vrma").vertices)
    assert np.ptp(frames[0], axis=0).max() > 0.1
    assert distance(*frames) < EXACT


def wrapped(transform: np.ndarray, inside: np.ndarray | None = None):
    """Put a node with a transform above the whole file, after the skin was bound."""

    def change(draft: Draft) -> None:
        gltf = draft.gltf
        roots = gltf["scenes"][0]["nodes"]
        for matrix in (transform,) if inside is None else (inside, transform):
            gltf["nodes"].append({"name": "wrap", "matrix": matrix.T.ravel().tolist(), "children": list(roots)})
            roots = [len(gltf["nodes"]) - 1]
        gltf["scenes"][0]["nodes"] = roots

    return change


TURN = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
GOOD = {"tiny": (np.diag([0.01, 0.01, 0.01, 1.0]), None), "turned and back": (TURN, TURN.T)}
BAD = {"mirrored": ([-1.0, 1.0, 1.0, 1.0], "mirrored"), "stretched": ([1.0, 1.3, 1.0, 1.0], "scaled equally")}


@pytest.mark.parametrize("frame", GOOD)
def test_frames_above_the_joints_that_node_transforms_can_undo(frame, model, driving, tmp_path):
    transform, inside = GOOD[frame]
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), change=wrapped(transform, inside))
    result = animate(str(path), str(driving), model)
    assert result.own is not None
    result.save_skinned(tmp_path / "out.glb")
    assert distance(load_clip(tmp_path / "out.glb").vertices, result.clip.vertices) < EXACT
    expected = truth() * np.cbrt(np.linalg.det(transform))
    shift = (result.clip.vertices[0] - expected[0]).mean(axis=0)
    assert distance(result.clip.vertices - shift, expected) < EXACT


@pytest.mark.parametrize("frame", BAD)
def test_frames_above_the_joints_that_node_transforms_cannot_undo_give_a_note(frame, model, driving, tmp_path):
    scale, message = BAD[frame]
    change = wrapped(np.diag(scale))
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), change=change, armature=np.eye(4))
    result = animate(str(path), str(driving), model)
    assert result.own is None
    notes = [note for note in result.notes if "is not used" in note]
    assert len(notes) == 1
    assert message in notes[0]
    result.save_skinned(tmp_path / "out.glb")
    assert distance(load_clip(tmp_path / "out.glb").vertices, result.clip.vertices) < 1e-3


def add_pointer(draft: Draft) -> None:
    pointer = {"KHR_animation_pointer": {"pointer": "/materials/0/emissiveFactor"}}
    draft.gltf["materials"] = [{"name": "glow", "emissiveFactor": [0, 0, 0]}]
    draft.gltf["extensionsUsed"] = ["KHR_animation_pointer"]
    times = draft.add_floats(np.array([[0.0], [1.0]]), bounds=True)
    sampler = {"input": times, "output": draft.add_floats(np.eye(3)[:2]), "interpolation": "LINEAR"}
    channel = {"sampler": 0, "target": {"path": "pointer", "extensions": pointer}}
    draft.gltf["animations"] = [{"name": "glow", "samplers": [sampler], "channels": [channel]}]


def test_animation_pointers_stay_with_the_animations_of_the_file(model, driving, tmp_path):
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), change=add_pointer)
    animate(str(path), str(driving), model).save_skinned(tmp_path / "out.glb")
    gltf = json_of(tmp_path / "out.glb")
    assert gltf["extensionsUsed"] == ["KHR_animation_pointer"]
    assert gltf["animations"][-1]["channels"] == json_of(path)["animations"][0]["channels"]


def test_weights_of_a_node_without_morph_targets_are_no_motion(model, driving, tmp_path):
    def change(draft: Draft) -> None:
        times = draft.add_floats(np.array([[0.0], [1.0]]), bounds=True)
        sampler = {"input": times, "output": draft.add_floats(np.eye(2)[:, :1]), "interpolation": "LINEAR"}
        channels = [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in (0, 1)]
        draft.gltf["animations"] = [{"name": "odd", "samplers": [sampler], "channels": channels}]

    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), change=change)
    result = animate(str(path), str(driving), model)
    result.save_skinned(tmp_path / "out.glb")
    assert distance(load_clip(tmp_path / "out.glb").vertices, result.clip.vertices) < EXACT


@pytest.mark.parametrize("rig", ["own", "mimesh"])
def test_a_file_without_scenes_is_written_skinned(rig, model, driving, tmp_path):
    def change(draft: Draft) -> None:
        del draft.gltf["scenes"]
        draft.gltf["nodes"].append({"name": "beside"})

    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), change=change)
    result = animate(str(path), str(driving), model, rig=rig, skinned=True)
    result.save_skinned(tmp_path / "out.glb")
    assert distance(load_clip(tmp_path / "out.glb").vertices, result.clip.vertices) < 1e-3
    if rig == "mimesh":
        names = [node.get("name") for node in open_document(tmp_path / "out.glb").gltf["nodes"]]
        assert len(open_document(tmp_path / "out.glb").gltf["scenes"][0]["nodes"]) == 4, names
