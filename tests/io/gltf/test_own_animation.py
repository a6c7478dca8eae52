"""New animations of own nodes: matrices, frames above the joints, channels without use, copied keys."""

from __future__ import annotations

import dataclasses
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import rigs
from foreign_names import renamed
from gltf_reference import json_of
from matrix import matrix
from scipy.spatial.transform import Rotation

from mimesh.core.mesh import cut_clip
from mimesh.io import load_clip
from mimesh.io.gltf.animation import read_channels
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.draft import Draft
from mimesh.pipeline import animate

EXACT = 1e-5
"""Largest distance of a vertex, over the size of the mesh, that counts as exact."""
PERSON = rigs.figure()
FIRST = 2
"""Node of the first joint."""


@pytest.fixture(scope="module")
def driving(tmp_path_factory) -> Path:
    return rigs.of_kind(tmp_path_factory.mktemp("driving") / "move.glb", "T-pose")[0]


def distance(vertices: np.ndarray, expected: np.ndarray) -> float:
    """Largest distance of a vertex over the size of the mesh."""
    return float(np.linalg.norm(vertices - expected, axis=-1).max() / np.ptp(expected[0], axis=0).max())


def truth() -> np.ndarray:
    return np.stack([rigs.posed(PERSON, frame) for frame in rigs.exercise(PERSON)])


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
        for each in (transform,) if inside is None else (inside, transform):
            gltf["nodes"].append({"name": "wrap", "matrix": each.T.ravel().tolist(), "children": list(roots)})
            roots = [len(gltf["nodes"]) - 1]
        gltf["scenes"][0]["nodes"] = roots

    return change


TURN = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
GOOD = {"tiny": (np.diag([0.01, 0.01, 0.01, 1.0]), None), "turned and back": (TURN, TURN.T)}
BAD = {"mirrored": ([-1.0, 1.0, 1.0, 1.0], "mirrored"), "stretched": ([1.0, 1.3, 1.0, 1.0], "scaled equally")}


@matrix("frame", GOOD, quick=["turned and back"])
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


@matrix("unit", [1.0, 100.0, 0.01], quick=[100.0])
def test_small_differences_from_the_bind_pose_are_undone_in_any_unit(unit, model, driving, tmp_path):
    """Nodes of a limb are 4e-5 of the size beside their places in the bind pose, and turned by 4e-5 radians."""

    def change(draft: Draft) -> None:
        for joint in ("LeftArm", "LeftForeArm", "LeftHand"):
            entry = draft.gltf["nodes"][FIRST + PERSON.names.index(joint)]
            matrix = np.array(entry["matrix"]).reshape(4, 4).T
            offset = np.eye(4)
            offset[:3, :3] = Rotation.from_rotvec([4e-5, 0, 0]).as_matrix()
            offset[:3, 3] = 4e-5 * 1.7 / unit
            entry["matrix"] = (matrix @ offset).T.ravel().tolist()

    armature = np.diag([unit, unit, unit, 1.0])
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), change=change, armature=armature)
    result = animate(str(path), str(driving), model)
    assert distance(np.stack(list(result.own.vertices())), result.clip.vertices) < 1e-6
    result.save_skinned(tmp_path / "out.glb")
    assert distance(load_clip(tmp_path / "out.glb").vertices, result.clip.vertices) < 1e-6


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


@matrix("rig", ["own", "mimesh"], quick=["own"])
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


def with_keys(interpolation: str, times: np.ndarray):
    """Give the channels of a file's animation other keys; each third quaternion has the other sign."""

    def change(draft: Draft) -> None:
        rng, count = np.random.default_rng(0), len(times)
        taken = draft.add_floats(times[:, None], bounds=True)
        animation = draft.gltf["animations"][0]
        for channel in animation["channels"]:
            entry = draft.gltf["nodes"][channel["target"]["node"]]
            path = channel["target"]["path"]
            rest = np.array(entry[path])
            if path == "rotation":
                turns = Rotation.from_quat(rest) * Rotation.from_rotvec(rng.normal(scale=0.3, size=(count, 3)))
                values = turns.as_quat() * np.where(np.arange(count) % 3 == 1, -1.0, 1.0)[:, None]
                values = turns.as_quat() if interpolation == "CUBICSPLINE" else values
            else:
                values = rest + rng.normal(scale=0.05 * np.linalg.norm(rest), size=(count, 3))
            if interpolation == "CUBICSPLINE":
                tangents = rng.normal(scale=0.1, size=(2, *values.shape)) * np.abs(values).max()
                values = np.stack([tangents[0], values, tangents[1]], axis=1).reshape(-1, values.shape[1])
            sampler = {"input": taken, "interpolation": interpolation, "output": draft.add_floats(values)}
            animation["samplers"][channel["sampler"]] = sampler

    return change


INTERPOLATIONS = ("STEP", "LINEAR", "CUBICSPLINE")
TIMES = {
    "every frame": np.arange(12) / 24,
    "sparse": np.array([0, 3, 4, 9]) / 30,
    "off the grid": np.array([0.0137, 0.1, 0.2222, 0.6011]),
    "later": 1.0 + np.arange(6) / 24,
}


@matrix(
    ("interpolation", "times"),
    product(INTERPOLATIONS, TIMES),
    quick=[("STEP", "sparse"), ("LINEAR", "off the grid"), ("CUBICSPLINE", "later")],
)
def test_copies_between_files_of_one_skeleton_are_exact_between_frames_too(interpolation, times, model, tmp_path):
    change = with_keys(interpolation, TIMES[times])
    path, *_ = rigs.of_kind(tmp_path / "move.glb", "T-pose", change=change)
    clip = load_clip(path)
    result = animate(str(rigs.of_kind(tmp_path / "a.glb", "T-pose")[0]), clip, model)
    assert result.report["copied"]
    result.save_skinned(tmp_path / "out.glb")
    written = load_clip(tmp_path / "out.glb")
    assert (len(written), written.fps) == (len(clip), clip.fps)
    fine, expected = (load_clip(file, fps=480.0).vertices for file in (tmp_path / "out.glb", path))
    assert distance(fine, expected) < 5e-7
    for channel in read_channels(open_document(tmp_path / "out.glb"), 0):
        if channel.path == "rotation" and channel.interpolation == "LINEAR":
            assert ((channel.values[1:] * channel.values[:-1]).sum(axis=1) > 0).all()


@matrix("cut", ["frames", "rate", "speed"], quick=["frames"])
def test_keys_of_a_part_or_of_other_frames_are_not_copied(cut, model, tmp_path):
    path, *_ = rigs.of_kind(tmp_path / "move.glb", "T-pose", change=with_keys("STEP", TIMES["every frame"]))
    clip = load_clip(path, fps=60.0 if cut == "rate" else None)
    if cut == "frames":
        clip = cut_clip(clip, 2, 9, 1)
    if cut == "speed":
        clip = dataclasses.replace(clip, fps=2 * clip.fps)
    result = animate(str(rigs.of_kind(tmp_path / "a.glb", "T-pose")[0]), clip, model)
    assert result.report["copied"]
    result.save_skinned(tmp_path / "out.glb")
    written = load_clip(tmp_path / "out.glb")
    assert (len(written), written.fps) == (len(clip), clip.fps)
    assert distance(written.vertices, clip.vertices) < EXACT
    assert {channel.interpolation for channel in read_channels(open_document(tmp_path / "out.glb"), 0)} == {"LINEAR"}


def test_copied_quaternions_do_not_change_their_sign(model, tmp_path):
    path, *_ = rigs.of_kind(tmp_path / "move.glb", "T-pose", change=with_keys("LINEAR", TIMES["every frame"]))
    clip = cut_clip(load_clip(path), 1, 11, 1)
    result = animate(str(rigs.of_kind(tmp_path / "a.glb", "T-pose")[0]), clip, model)
    for (_, target), values in result.own.tracks.items():
        if target == "rotation":
            assert ((values[1:] * values[:-1]).sum(axis=1) > 0).all()


OPTIONS = ({}, {"root_bone": True}, {"names": "mixamo"}, {"fps": 60.0})


@matrix(("copied", "options"), product([True, False], OPTIONS), quick=[(True, OPTIONS[1]), (False, OPTIONS[3])])
def test_the_deviation_of_a_written_file_is_in_the_report(copied, options, model, driving, tmp_path):
    name = str if copied else renamed("mixamo")
    result = animate(str(rigs.of_kind(tmp_path / "a.glb", "T-pose", name=name)[0]), str(driving), model)
    assert result.report.get("copied", False) == copied
    result.save_skinned(tmp_path / "out.glb", **options)
    assert 0 <= result.report["keys_deviation"] < 2e-4
    assert 0 < result.report["skinned_deviation"] < 2e-4
    if "fps" not in options:
        vertices = load_clip(tmp_path / "out.glb").vertices
        size = np.ptp(result.own.source.vertices, axis=0).max()
        expected = np.linalg.norm(vertices - result.clip.vertices, axis=-1).max() / size
        assert abs(result.report["skinned_deviation"] - expected) < 2e-7


def test_the_deviation_shows_what_is_wrong_in_the_file(model, driving, tmp_path):
    result = animate(str(rigs.character(tmp_path / "a.glb", name=renamed("mixamo"))), str(driving), model)
    moved = dataclasses.replace(
        result, clip=dataclasses.replace(result.clip, vertices=result.clip.vertices + [0.1, 0, 0])
    )
    moved.save_skinned(tmp_path / "out.glb")
    size = np.ptp(result.own.source.vertices, axis=0).max()
    assert moved.report["skinned_deviation"] == pytest.approx(0.1 / size, rel=1e-3)
    assert moved.report["keys_deviation"] < 2e-4
