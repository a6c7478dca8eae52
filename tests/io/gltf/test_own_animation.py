"""New animations of own nodes: matrices, frames above the joints, channels without use, copied keys, and own clips.

A rigged file that is animated by its own clip gives that clip, and keeps all of its contents to the byte.
"""

from __future__ import annotations

import copy
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import rigs
from foreign_names import renamed
from gltf_reference import json_of
from matrix import matrix
from scipy.spatial.transform import Rotation

from mimesh.core.frame_buffer import LazyFrames
from mimesh.core.mesh import cut_clip
from mimesh.core.options import Hints, MotionOptions
from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.animation import read_channels
from mimesh.io.gltf.document import Document, open_document
from mimesh.io.gltf.draft import Draft
from mimesh.io.gltf.own_animation import key_count
from mimesh.pipeline import animate

EXACT = 1e-5
"""Largest distance of a vertex, over the size of the mesh, that counts as exact."""
PERSON = rigs.figure()
FIRST = 2
"""Node of the first joint."""
APPENDED = ("animations", "accessors", "bufferViews")
"""Lists of a file that a new animation adds to."""


@pytest.fixture(scope="module")
def driving(tmp_path_factory) -> Path:
    return rigs.of_kind(tmp_path_factory.mktemp("driving") / "move.glb", "T-pose")[0]


def distance(vertices: np.ndarray, expected: np.ndarray) -> float:
    """Largest distance of a vertex over the size of the mesh."""
    return float(np.linalg.norm(vertices - expected, axis=-1).max() / np.ptp(expected[0], axis=0).max())


def truth() -> np.ndarray:
    return np.stack([rigs.posed(PERSON, frame) for frame in rigs.exercise(PERSON)])


def saved_as_computed(result, path: Path, limit: float = EXACT, **options) -> np.ndarray:
    """Write a skinned result, and check that it is read as it was computed; returns the vertices in all frames."""
    result.save_skinned(path, **options)
    vertices = load_clip(path).vertices
    assert distance(vertices, result.clip.vertices) < limit
    return vertices


def test_nodes_with_a_matrix_move_in_memory_as_in_the_written_file(model, driving, tmp_path):
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), frames=3)
    assert all("matrix" in node for node in json_of(path)["nodes"][FIRST:])
    result = animate(str(path), str(driving), model)
    assert distance(np.stack(list(result.own.vertices())), result.clip.vertices) < EXACT
    saved_as_computed(result, tmp_path / "out.glb")
    moved = dataclasses.replace(result, frames=LazyFrames.stored(result.clip.vertices + 0.1))
    (deviations,) = moved.save_skinned(tmp_path / "out.glb").deviations
    size = np.ptp(result.own.source.vertices, axis=0).max()
    assert deviations["skinned_deviation"] == pytest.approx(0.1 * 3**0.5 / size, rel=1e-3), "it shows what is wrong"


def test_a_copy_onto_nodes_with_a_matrix_moves(model, driving, tmp_path):
    result = animate(str(rigs.character(tmp_path / "a.glb")), str(driving), model)
    assert result.report["copied"]
    assert distance(result.clip.vertices, truth()) < EXACT


@pytest.mark.slow
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
GOOD = {"tiny, turned and back": (np.diag([0.01, 0.01, 0.01, 1.0]) @ TURN, TURN.T)}
STRETCHED = np.diag([1.0, 1.3, 1.0, 1.0])


@pytest.mark.parametrize("frame", GOOD)
def test_frames_above_the_joints_that_node_transforms_can_undo(frame, model, driving, tmp_path):
    transform, inside = GOOD[frame]
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), change=wrapped(transform, inside))
    result = animate(str(path), str(driving), model)
    assert result.own is not None
    saved_as_computed(result, tmp_path / "out.glb")
    expected = truth() * np.cbrt(np.linalg.det(transform))
    shift = (result.clip.vertices[0] - expected[0]).mean(axis=0)
    assert distance(result.clip.vertices - shift, expected) < EXACT


def test_frames_above_the_joints_that_node_transforms_cannot_undo_give_a_note(model, driving, tmp_path):
    change = wrapped(STRETCHED)
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), change=change, armature=np.eye(4))
    result = animate(str(path), str(driving), model)
    assert result.own is None
    notes = [note for note in result.notes if "is not used" in note]
    assert len(notes) == 1
    assert "scaled equally" in notes[0]
    saved_as_computed(result, tmp_path / "out.glb", 1e-3)


@matrix("unit", [100.0, 0.01], quick=[100.0])
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
    saved_as_computed(result, tmp_path / "out.glb", 1e-6)


def add_odd_animations(draft: Draft) -> None:
    """Add an animation of a material, and one of the morph targets of nodes that have none."""
    pointer = {"KHR_animation_pointer": {"pointer": "/materials/0/emissiveFactor"}}
    draft.gltf["materials"] = [{"name": "glow", "emissiveFactor": [0, 0, 0]}]
    draft.gltf["extensionsUsed"] = ["KHR_animation_pointer"]
    times = draft.add_floats(np.array([[0.0], [1.0]]), bounds=True)
    samplers = [
        {"input": times, "output": draft.add_floats(values), "interpolation": "LINEAR"}
        for values in (np.eye(3)[:2], np.eye(2)[:, :1])
    ]
    channel = {"sampler": 0, "target": {"path": "pointer", "extensions": pointer}}
    weights = [{"sampler": 0, "target": {"node": node, "path": "weights"}} for node in (0, 1)]
    draft.gltf["animations"] = [
        {"name": "glow", "samplers": samplers[:1], "channels": [channel]},
        {"name": "odd", "samplers": samplers[1:], "channels": weights},
    ]
    del draft.gltf["scenes"]
    draft.gltf["nodes"].append({"name": "beside"})


@pytest.mark.parametrize("rig", ["own", "mimesh"])
def test_odd_animations_and_files_without_scenes(rig, model, driving, tmp_path):
    """Animation pointers stay with the animations of the file; weights without morph targets are no motion."""
    path = rigs.character(tmp_path / "a.glb", name=renamed("mixamo"), change=add_odd_animations)
    result = animate(str(path), str(driving), model, hints=Hints(rig=rig), motion=MotionOptions(skinned=True))
    saved_as_computed(result, tmp_path / "out.glb", EXACT if rig == "own" else 1e-3)
    gltf = json_of(tmp_path / "out.glb")
    if rig == "own":
        assert gltf["extensionsUsed"] == ["KHR_animation_pointer"]
        assert gltf["animations"][-2:] == json_of(path)["animations"]
    else:
        assert len(gltf["scenes"][0]["nodes"]) == 4, [node.get("name") for node in gltf["nodes"]]


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


@matrix("cut", ["none", "frames", "rate", "speed"], quick=["frames"])
def test_copies_between_files_of_one_skeleton_are_exact_in_frames(cut, model, tmp_path):
    """Quaternions that are sampled do not change their sign either."""
    steps = "LINEAR" if cut == "frames" else "STEP"
    path, *_ = rigs.of_kind(tmp_path / "move.glb", "T-pose", change=with_keys(steps, np.arange(12) / 24))
    clip = load_clip(path, fps=60.0 if cut == "rate" else None)
    if cut == "frames":
        clip = cut_clip(clip, 2, 9, 1)
    if cut == "speed":
        clip = dataclasses.replace(clip, fps=clip.fps / 10)
    result = animate(str(rigs.of_kind(tmp_path / "a.glb", "T-pose")[0]), clip, model)
    assert result.report["copied"]
    for (_, target), values in result.own.tracks.items():
        if target == "rotation":
            assert ((values[1:] * values[:-1]).sum(axis=1) > 0).all()
    result.save_skinned(tmp_path / "out.glb")
    written = load_clip(tmp_path / "out.glb")
    assert (len(written), written.fps) == (len(clip), clip.fps)
    assert distance(written.vertices, clip.vertices) < EXACT
    assert {channel.interpolation for channel in read_channels(open_document(tmp_path / "out.glb"), 0)} == {"LINEAR"}


@pytest.mark.parametrize(
    ("copied", "layouts"), [(True, ({}, {"root_bone": True})), (False, ({"names": "unreal"}, {"fps": 60.0}))]
)
def test_saving_returns_the_deviation_of_the_file(copied, layouts, model, driving, tmp_path):
    name = str if copied else renamed("mixamo")
    result = animate(str(rigs.of_kind(tmp_path / "a.glb", "T-pose", name=name)[0]), str(driving), model)
    assert result.report.get("copied", False) == copied
    size = np.ptp(result.own.source.vertices, axis=0).max()
    for options in layouts:
        (deviations,) = result.save_skinned(tmp_path / "out.glb", **options).deviations
        assert 0 <= deviations["skinned_deviation"] < 1e-6
        if "fps" not in options:
            vertices = load_clip(tmp_path / "out.glb").vertices
            expected = np.linalg.norm(vertices - result.clip.vertices, axis=-1).max() / size
            assert abs(deviations["skinned_deviation"] - expected) < 1e-6


def furnish(draft: Draft) -> None:
    """Add what a file may have beside its rig: material, extras, unknown extensions, a camera, an idle animation."""
    gltf = draft.gltf
    gltf["materials"] = [{"name": "skin", "doubleSided": True, "extras": {"tone": 3}}]
    gltf["cameras"] = [{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}]
    gltf["nodes"] += [{"name": "view", "camera": 0, "extras": {"purpose": "portrait"}}]
    gltf["scenes"][0] |= {"name": "set", "extras": {"season": "winter"}}
    gltf["scenes"][0]["nodes"].append(len(gltf["nodes"]) - 1)
    gltf["extensionsUsed"] = ["VENDOR_cloth"]
    gltf["extensions"] = {"VENDOR_cloth": {"stiffness": [1, 2]}}
    for mesh in gltf["meshes"]:
        primitive = mesh["primitives"][0]
        primitive |= {"material": 0, "extras": {"part": "body"}, "extensions": {"VENDOR_cloth": {"pinned": True}}}
        count = gltf["accessors"][primitive["attributes"]["POSITION"]]["count"]
        smile = np.zeros((count, 3))
        smile[: count // 8] = 0.02
        primitive["targets"] = [{"POSITION": draft.add_floats(smile, bounds=True)}]
        mesh |= {"extras": {"targetNames": ["smile"]}, "weights": [0.0]}
    for node in gltf["nodes"]:
        node.setdefault("extras", {"kept": node["name"]})
    times = draft.add_floats(np.array([[0.0], [1.0]]), bounds=True)
    values = draft.add_floats(np.array([[0.0], [1.0]]))
    sampler = {"input": times, "output": values, "interpolation": "LINEAR"}
    channel = {"sampler": 0, "target": {"node": 1, "path": "weights"}, "extras": {"loop": True}}
    smiling = {"name": "smiling", "samplers": [sampler], "channels": [channel], "extras": {"by": "hand"}}
    gltf.setdefault("animations", []).append(smiling)


def assert_untouched(old: Document, new: Document) -> None:
    """Check that a file has the contents of an old one, and that accessors and animations are only added."""
    assert bytes(new.binary)[: len(old.binary)] == bytes(old.binary)
    kept, now = (copy.deepcopy(document.gltf) for document in (old, new))
    for key in APPENDED:
        before, after = kept.pop(key), now.pop(key)
        assert (after[-len(before) :] if key == "animations" else after[: len(before)]) == before
    for gltf in (kept, now):
        gltf.pop("buffers")
    assert json.dumps(now, sort_keys=True) == json.dumps(kept, sort_keys=True)


@matrix(
    ("kind", "scheme", "suffix"),
    [("T-pose", scheme, "glb") for scheme in ("mixamo", "kaykit", "daz")]
    + [(kind, "ours", "gltf") for kind in rigs.KINDS],
    quick=[("T-pose", "mixamo", "glb"), ("A-pose", "ours", "gltf")],
)
def test_own_clip_through_own_rig(kind, scheme, suffix, model, tmp_path):
    name = str if scheme == "ours" else renamed(scheme)
    path, *_ = rigs.of_kind(tmp_path / f"own.{suffix}", kind, name=name, change=furnish)
    clip = load_clip(path)
    result = animate(str(path), clip, model, motion=MotionOptions(skinned=None))
    assert result.own is not None
    assert distance(result.clip.vertices, clip.vertices) < EXACT
    vertices = saved_as_computed(result, tmp_path / f"out.{suffix}")
    assert distance(vertices, clip.vertices) < EXACT
    assert_untouched(open_document(path), open_document(tmp_path / f"out.{suffix}"))


def test_the_clip_that_tests_write_is_the_figure_posed(tmp_path):
    path, person, rest = rigs.of_kind(tmp_path / "own.glb", "A-pose")
    expected = np.stack([rigs.posed(person, frame, rest) for frame in rigs.exercise(person)])
    np.testing.assert_allclose(load_clip(path).vertices, expected, atol=1e-5)


STILL = [
    ("translation", [0.0, 0.0, 0.0], 4e-19),
    ("translation", [0.0, 1e-3, 0.0], 1e-11),
    ("rotation", [0.0, 0.6, 0.0, 0.8], 1e-9),
    ("scale", [1.0, 1.0, 1.0], 3e-8),
]


def test_rounding_is_no_motion_but_small_motions_are(tmp_path):
    """The file's joints are in hundredths of a unit: 1e-11 is a billionth of the size, 1.8e-7 a hundred-thousandth."""
    source = load_mesh(rigs.character(tmp_path / "a.glb")).source
    node = source.document.gltf["skins"][0]["joints"][3]
    for path, still, noise in STILL:
        values = np.tile(still, (90, 1)) + np.random.default_rng(0).normal(scale=noise, size=(90, len(still)))
        assert key_count(source, (node, path), values) == 1
    values = np.outer(np.arange(90) / 90, [0.0, 1.8e-7, 0.0])
    assert key_count(source, (node, "translation"), values) == len(values)
