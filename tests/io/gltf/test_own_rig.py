"""A rigged file that is animated by its own clip gives that clip, and keeps all of its contents to the byte."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import numpy as np
import rigs
from foreign_names import SCHEMES, renamed
from matrix import matrix

from mimesh.io import load_clip
from mimesh.io.gltf.document import Document, open_document
from mimesh.io.gltf.draft import Draft
from mimesh.pipeline import animate

EXACT = 1e-5
"""Largest distance of a vertex, over the size of the mesh, that counts as exact."""
APPENDED = ("animations", "accessors", "bufferViews")


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


def assert_plays_itself(path: Path, model: str, output: Path) -> None:
    clip = load_clip(path)
    result = animate(str(path), clip, model, skinned=None)
    assert result.own is not None
    size = np.ptp(clip.vertices[0], axis=0).max()
    np.testing.assert_allclose(result.clip.vertices, clip.vertices, atol=EXACT * size)
    result.save_skinned(output)
    np.testing.assert_allclose(load_clip(output).vertices, clip.vertices, atol=EXACT * size)
    assert_untouched(open_document(path), open_document(output))


@matrix("scheme", SCHEMES, quick=["mixamo"])
def test_own_clip_through_own_rig(scheme, model, tmp_path):
    path, *_ = rigs.of_kind(tmp_path / "own.glb", "T-pose", name=renamed(scheme), change=furnish)
    assert_plays_itself(path, model, tmp_path / "out.glb")


@matrix("kind", rigs.KINDS, quick=["A-pose"])
def test_own_clip_through_rigs_of_any_kind(kind, model, tmp_path):
    path, *_ = rigs.of_kind(tmp_path / "own.gltf", kind, change=furnish)
    assert_plays_itself(path, model, tmp_path / "out.gltf")


def test_the_clip_that_tests_write_is_the_figure_posed(tmp_path):
    path, person, rest = rigs.of_kind(tmp_path / "own.glb", "A-pose")
    expected = np.stack([rigs.posed(person, frame, rest) for frame in rigs.exercise(person)])
    np.testing.assert_allclose(load_clip(path).vertices, expected, atol=1e-5)
