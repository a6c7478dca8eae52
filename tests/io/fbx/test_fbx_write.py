"""Writing FBX: what Blender is given, how it is found, and what happens where it is missing or fails."""

import json
import runpy
import stat
import sys
import types
from pathlib import Path

import gltf_samples as samples
import numpy as np
import pytest
from rigs import character, quantized

from mimesh.core.errors import InputError
from mimesh.io import load_clip, load_mesh, save_mesh, save_whole
from mimesh.io.fbx import write
from mimesh.io.fbx.write import GAP, find_blender, joined_animations
from mimesh.io.gltf.animation import animation_names
from mimesh.io.gltf.document import open_document
from mimesh.tools.convert import convert


def program(folder: Path, body: str, name: str = "blender") -> Path:
    """Write a Python program that stands for Blender: `job` is what it is asked for."""
    path = folder / name
    head = f"#!{sys.executable}\nimport json, sys, time\njob = json.load(open(sys.argv[sys.argv.index('--') + 1]))\n"
    path.write_text(head + body)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def fbx_surfaces(folder: Path) -> Path:
    """Write a .gltf with materials and images of many names: equal, none, with a path, of a file that is not there."""
    sample = samples.hero()
    (folder / "colour map.png").write_bytes(samples.png())
    sample.gltf["images"] = [
        {"uri": "colour%20map.png"},
        {"name": "skin:1.PNG", "mimeType": "image/png", "bufferView": sample.view(samples.png())},
        {"name": "textures/Skin_1", "mimeType": "image/png", "bufferView": sample.view(samples.png())},
        {"uri": "textures/gone.tga"},
    ]
    sample.gltf["textures"] = [{"source": number} for number in range(4)]
    diffuse = {"diffuseTexture": {"index": 0}, "specularGlossinessTexture": {"index": 3}}
    sample.gltf["materials"] = [
        {"name": "coat", "pbrMetallicRoughness": {"baseColorFactor": [0.1, 0.2, 0.3, 0.5]}},
        {
            "name": "coat",
            "alphaMode": "BLEND",
            "pbrMetallicRoughness": {"baseColorFactor": [0.4, 0.5, 0.6, 0.5], "baseColorTexture": {"index": 1}},
        },
        {"extensions": {"KHR_materials_pbrSpecularGlossiness": diffuse}, "normalTexture": {"index": 3}},
    ]
    return sample.text(folder / "hero.gltf")


@pytest.fixture
def no_blender(monkeypatch):
    monkeypatch.delenv("BLENDER", raising=False)
    monkeypatch.setattr(write.shutil, "which", lambda name: None)
    monkeypatch.setattr(write.importlib.util, "find_spec", lambda name: None)


@pytest.fixture
def copier(tmp_path, monkeypatch):
    """A program that gives back the .glb with its job: `read(path)` returns both."""
    body = "open(job['fbx'], 'w').write(json.dumps(job))\n"
    body += "open(sys.argv[0] + '.glb', 'wb').write(open(job['glb'], 'rb').read())\n"
    monkeypatch.setenv("BLENDER", str(program(tmp_path, body)))

    def read(path):
        return json.loads(path.read_text()), open_document(tmp_path / "blender.glb")

    return read


def test_missing_blender_is_said_before_the_work(no_blender, tmp_path):
    with pytest.raises(InputError, match=r"out\.fbx: expected Blender .* found none; pip install bpy==.* BLENDER, or"):
        convert(tmp_path / "not there.glb", tmp_path / "out.fbx")


def test_named_program_comes_first_then_the_package_then_the_search_path(monkeypatch, tmp_path):
    monkeypatch.setenv("BLENDER", str(program(tmp_path, "")))
    assert find_blender(tmp_path)[0] == str(tmp_path / "blender")
    monkeypatch.setenv("BLENDER", sys.executable)
    assert find_blender(tmp_path)[:2] == [sys.executable, "-P"]
    monkeypatch.setenv("BLENDER", "nothing of that name")
    with pytest.raises(InputError, match="BLENDER=nothing of that name, found no program"):
        find_blender(tmp_path)
    monkeypatch.delenv("BLENDER")
    monkeypatch.setattr(write.importlib.util, "find_spec", lambda name: name == "bpy")
    assert find_blender(tmp_path)[0] == sys.executable
    monkeypatch.setattr(write.importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(write.shutil, "which", lambda name: "/usr/bin/blender")
    assert find_blender(tmp_path)[:2] == ["/usr/bin/blender", "--background"]


@pytest.mark.parametrize(
    ("body", "found"),
    [
        ("open(job['errors'], 'w').write('Error: no such operator')\nsys.exit(1)", "found 'Error: no such operator'"),
        ("print('Saved session recovery')\nsys.exit(0)", "found 'Saved session recovery'"),
        ("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)", "found 'exit code -11'"),
    ],
)
def test_failure_of_blender_is_one_line_and_writes_nothing(body, found, monkeypatch, tmp_path):
    monkeypatch.setenv("BLENDER", str(program(tmp_path, body)))
    path = samples.hero().glb(tmp_path / "hero.glb")
    with pytest.raises(InputError, match=found) as caught:
        save_mesh(load_mesh(path), tmp_path / "out.fbx")
    assert "\n" not in str(caught.value)
    assert "or write a .glb" in str(caught.value)
    assert not list(tmp_path.glob("*.fbx"))


def test_reason_of_a_failure_is_the_type_and_the_message_of_the_error(monkeypatch, tmp_path):
    """Errors of Blender's operators have a traceback, and end with where the operator was called."""
    monkeypatch.setitem(sys.modules, "bpy", types.ModuleType("bpy"))
    script = runpy.run_path(str(write.SCRIPT))
    traceback = 'Error: Python: Traceback (most recent call last):\n  File "a.py", line 2, in b\n    c()\n'
    error = RuntimeError(f"{traceback}KeyError: 'key \"hips\" not found'\nLocation: /bpy/ops.py:109\n")
    assert script["reason"](error) == "KeyError: 'key \"hips\" not found'"
    assert script["reason"](MemoryError()) == "MemoryError"


@pytest.mark.parametrize(("unit", "kept"), [(1.0, True), (1e-5, False)])
def test_skeleton_of_a_skin_that_is_bound_in_another_unit_is_left_out(unit, kept, copier, tmp_path):
    path = quantized(character(tmp_path / "plain.glb"), tmp_path / "hero.glb", unit)
    save_whole(path, tmp_path / "out.fbx")
    document = copier(tmp_path / "out.fbx")[1]
    assert ["skeleton" in skin for skin in document.gltf["skins"]] == [kept]
    np.testing.assert_allclose(load_mesh(path).vertices, load_mesh(tmp_path / "plain.glb").vertices, atol=1e-5)


def test_blender_that_does_not_end_is_stopped(monkeypatch, tmp_path):
    monkeypatch.setenv("BLENDER", str(program(tmp_path, "time.sleep(60)")))
    monkeypatch.setattr(write, "SECONDS", 0.5)
    monkeypatch.setattr(write, "SECONDS_PER_MIB", 0.0)
    with pytest.raises(InputError, match="in 0 s, found it still running"):
        save_whole(samples.hero().glb(tmp_path / "hero.glb"), tmp_path / "out.fbx")


def test_all_animations_become_parts_of_one_and_the_first_frame_is_at_rest(copier, tmp_path):
    path = samples.hero().glb(tmp_path / "hero.glb")
    save_whole(path, tmp_path / "out.fbx")
    job, document = copier(tmp_path / "out.fbx")
    names = animation_names(open_document(path))
    assert tuple(clip["name"] for clip in job["clips"]) == names
    joined = load_clip(tmp_path / "blender.glb", fps=job["fps"]).vertices
    assert np.abs(joined[0] - load_mesh(path).vertices).max() < 1e-6
    first = GAP
    for clip in job["clips"]:
        alone = load_clip(path, fps=job["fps"], animation=clip["name"]).vertices
        assert (clip["first"], clip["last"]) == (first, first + len(alone) - 1)
        assert np.abs(joined[clip["first"] : clip["last"] + 1] - alone).max() < 1e-6
        first = clip["last"] + GAP
    assert len(document.gltf["animations"]) == 1


def test_nodes_that_move_and_are_no_joints_get_a_skin(tmp_path):
    sample = samples.hero()
    joints = {joint for skin in sample.gltf["skins"] for joint in skin["joints"]}
    other = next(node for node in range(len(sample.gltf["nodes"])) if node not in joints)
    sample.gltf["animations"][0]["channels"][0]["target"]["node"] = other
    draft, timeline = joined_animations(open_document(sample.glb(tmp_path / "hero.glb")))
    assert {other} | joints == set(draft.gltf["skins"][-1]["joints"])
    assert len(timeline["clips"]) == len(sample.gltf["animations"])
    draft.save(tmp_path / "again.glb")
    before, after = (load_mesh(tmp_path / name).vertices for name in ("hero.glb", "again.glb"))
    assert np.array_equal(before, after)


def test_bones_that_move_no_vertex_stay_bones(tmp_path):
    """Those of faces, and places for props, in packs whose meshes do not use them all; props stay what they are."""
    sample = samples.hero()
    nodes, (joint, *_) = sample.gltf["nodes"], sample.gltf["skins"][0]["joints"]
    nodes[joint].setdefault("children", []).extend([len(nodes), len(nodes) + 2])
    nodes += [{"name": "jaw", "children": [len(nodes) + 1]}, {"name": "chin"}, {"name": "hat", "mesh": 0}]
    draft, _ = joined_animations(open_document(sample.glb(tmp_path / "hero.glb")))
    bones = {draft.gltf["nodes"][bone].get("name") for bone in draft.gltf["skins"][-1]["joints"]}
    assert {"jaw", "chin"} <= bones
    assert "hat" not in bones


def test_file_without_animations_has_no_parts(tmp_path):
    path = samples.hero().glb(tmp_path / "hero.glb")
    document = open_document(path)
    document.gltf.pop("animations", None)
    draft, timeline = joined_animations(document)
    assert timeline["clips"] == []
    assert "animations" not in draft.gltf or draft.gltf["animations"] == []


def test_materials_and_images_are_listed_with_their_names(copier, tmp_path):
    sample = fbx_surfaces(tmp_path)
    save_whole(sample, tmp_path / "out.fbx")
    job, document = copier(tmp_path / "out.fbx")
    assert Path(job["fbx"]).name == "out.fbx"
    found = [(entry["name"], entry["color"], entry["alpha"], entry["image"]) for entry in job["materials"]]
    assert found == [
        ("coat", [0.1, 0.2, 0.3], 1.0, None),
        ("coat", [0.4, 0.5, 0.6], 0.5, job["images"][1]["key"]),
        ("material2", [1.0, 1.0, 1.0], 1.0, job["images"][0]["key"]),
    ]
    assert [image["name"] for image in job["images"]] == ["colour map.png", "skin_1.png", "Skin_1-2.png", "gone.tga"]
    keys = [entry["key"] for entry in (*job["materials"], *job["images"])]
    assert len(set(keys)) == len(keys)
    # Blender's importer fails at such a texture of an image that is not there.
    assert "normalTexture" not in document.gltf["materials"][2]
    gloss = document.gltf["materials"][2]["extensions"]["KHR_materials_pbrSpecularGlossiness"]
    assert gloss == {"diffuseTexture": {"index": 0}}
    assert [entry["name"] for entry in (*document.gltf["materials"], *document.gltf["images"])] == keys
