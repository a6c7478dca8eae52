"""A rigged file that is animated by its own clip gives that clip, and keeps all of its contents to the byte."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import numpy as np
import pytest
import rigs
from foreign_names import SCHEMES, renamed
from networks import write_mime_network
from scipy.spatial.transform import Rotation

from mimesh.io import load_clip
from mimesh.io.gltf.document import Document, open_document
from mimesh.io.gltf.draft import Draft
from mimesh.pipeline import animate

EXACT = 1e-5
"""Largest distance of a vertex, over the size of the mesh, that counts as exact."""
APPENDED = ("animations", "accessors", "bufferViews")


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    pytest.importorskip("onnx")
    return str(write_mime_network(tmp_path_factory.mktemp("network") / "mime.onnx"))


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


def arms_down() -> np.ndarray:
    """Rotations of the joints from the T-pose to arms that hang by 50 degrees, and spread legs."""
    names = rigs.figure().names
    rest = np.tile(np.eye(3), (len(names), 1, 1))
    for side, sign in (("Left", -1), ("Right", 1)):
        rest[names.index(f"{side}Arm")] = Rotation.from_euler("z", 50 * sign, degrees=True).as_matrix()
        rest[names.index(f"{side}UpLeg")] = Rotation.from_euler("z", -8 * sign, degrees=True).as_matrix()
    return rest


def bent() -> np.ndarray:
    """World transforms of the joints of person 0 in some pose, in which a file may have its nodes."""
    return rigs.exercise(rigs.figure(), 1, seed=9)[0]


def ik_feet() -> dict[str, str]:
    return {"LeftFoot": "", "RightFoot": ""}


def person(*changes: str) -> rigs.Figure:
    """Make person 0 with other joints."""
    found = rigs.figure()
    for change in changes:
        if change == "no toes":
            found = found.without("LeftToeBase", "RightToeBase")
        elif change == "no hands":
            for side in "LeftL", "RightR":
                long, short = side[:-1], side[-1]
                found = found.without(f"{long}HandFinger1", f"{long}FingerBase", f"{short}Thumb", f"{long}Hand")
        elif change == "twists":
            for side in ("Left", "Right"):
                found = found.with_twist(f"{side}Arm", f"{side}ForeArm").with_twist(f"{side}UpLeg", f"{side}Leg")
        elif change == "spines":
            found = found.between("Spine0", "LowerBack", "Spine").between("SpineHalf", "Spine", "Spine1")
    return found


KINDS = {
    "no toes": dict(person=("no toes",)),
    "no hands": dict(person=("no toes", "no hands")),
    "twists": dict(person=("twists",)),
    "spines": dict(person=("spines",)),
    "feet on roots": dict(hold=ik_feet()),
    "three skins": dict(skins=3),
    "metres, y up": dict(armature=np.eye(4)),
    "A-pose": dict(rest=arms_down()),
    "nodes in another pose": dict(moved=bent()),
}


def write(path: Path, person: tuple[str, ...] = (), **options) -> tuple[Path, rigs.Figure, list[np.ndarray]]:
    """Write a character with a clip; returns its path, joints and motion."""
    found = globals()["person"](*person)
    motion = rigs.exercise(found)
    return rigs.character(path, person=found, clips={"move": motion}, **options), found, motion


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


@pytest.mark.parametrize("scheme", SCHEMES)
def test_own_clip_through_own_rig(scheme, model, tmp_path):
    path, _, _ = write(tmp_path / "own.glb", name=renamed(scheme), change=furnish)
    assert_plays_itself(path, model, tmp_path / "out.glb")


@pytest.mark.parametrize("kind", KINDS)
def test_own_clip_through_rigs_of_any_kind(kind, model, tmp_path):
    path, _, _ = write(tmp_path / "own.gltf", change=furnish, **KINDS[kind])
    assert_plays_itself(path, model, tmp_path / "out.gltf")


def test_the_clip_that_tests_write_is_the_figure_posed(tmp_path):
    path, person, motion = write(tmp_path / "own.glb", rest=arms_down())
    rest = person.pose(dict(zip(person.names, arms_down(), strict=True)))
    expected = np.stack([rigs.posed(person, frame, rest) for frame in motion])
    np.testing.assert_allclose(load_clip(path).vertices, expected, atol=1e-5)
