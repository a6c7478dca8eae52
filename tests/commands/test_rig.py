"""The command `mimesh rig`: its output, what it prints, and what it refuses."""

import json

import numpy as np
import pytest
import rigs
from people import person

from mimesh.io import load_mesh, save_mesh
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.own_rig import has_rig
from mimesh.io.gltf.scene import world_matrices
from mimesh.io.gltf.vrm import vrm_bones


@pytest.fixture
def hero(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_mesh(person(0), tmp_path / "hero.obj")
    return tmp_path


def test_a_mesh_gets_bones_a_picture_and_the_next_step(hero, call):
    ended = call("rig hero.obj --no-fingers --save-joints hero-found.json")
    assert ended.code == 0
    assert ended.out.startswith("hero-rigged.glb: 31 joints of a person, found, confidence 0.")
    assert "next: mimesh animate hero-rigged.glb" in ended.out
    assert (hero / "hero-rigged.preview.png").read_bytes()[1:4] == b"PNG"
    assert has_rig(load_mesh(hero / "hero-rigged.glb"))
    found = json.loads((hero / "hero-found.json").read_text())
    assert len(found["joints"]) > 20
    moved = json.loads(call("rig hero.obj -o same.glb --joints hero-found.json --no-fingers --no-preview --json").out)
    assert (moved["source"], moved["joints"], moved["replaced"]) == ("corrected", 31, False)
    assert moved["report"]["pictures"] == []


def test_the_picture_and_the_count_are_those_of_the_file_that_is_written(hero, call, monkeypatch):
    drawn = []
    monkeypatch.setattr("mimesh.tools.preview.bones_picture", lambda *args, **axes: drawn.append(args) or 1 / 0)
    found = json.loads(call("rig hero.obj -o t.glb --no-fingers --rest A --names unreal --root-bone --json").out)
    (skin,) = open_document(hero / "t.glb").gltf["skins"]
    assert found["joints"] == len(skin["joints"]) != 31
    mesh, joints, *_ = drawn[0]
    assert len(joints) == found["joints"]
    np.testing.assert_allclose(mesh.vertices, load_mesh(hero / "t.glb").vertices, atol=1e-5)
    assert np.abs(mesh.vertices - load_mesh(hero / "hero.obj").vertices).max() > 0.1
    again = json.loads(call("rig t.glb -o again.glb --no-preview --json").out)
    assert (again["source"], again["joints"]) == ("file", found["joints"])


def test_the_picture_of_a_vrm_of_an_own_rig_is_that_of_the_t_pose(tmp_path, call, monkeypatch):
    drawn = []
    monkeypatch.setattr("mimesh.tools.preview.bones_picture", lambda *args, **axes: drawn.append(args) or 1 / 0)
    own, _, _ = rigs.of_kind(tmp_path / "own.glb", "A-pose", moving=False)
    made_by = "--author A --license https://vrm.dev/licenses/1.0/"
    call(f"rig {own} -o {tmp_path / 'own.vrm'} {made_by}")
    call(f"rig {tmp_path / 'own.vrm'} -o {tmp_path / 'again.vrm'}")
    (mesh, joints, *_), (again, *_) = drawn
    written = load_mesh(tmp_path / "own.vrm")
    size = np.ptp(written.vertices, axis=0).max()
    for drawn_mesh, tolerance in ((mesh, 1e-5), (again, 1e-3)):  # files have the ground below the hips at their origin
        placed = drawn_mesh.vertices + (written.vertices - drawn_mesh.vertices)[0]
        np.testing.assert_allclose(placed, written.vertices, atol=tolerance * size)
    document = open_document(tmp_path / "own.vrm")
    places = world_matrices(document)[:, :3, 3]
    joints = joints + (written.vertices - mesh.vertices)[0]
    apart = np.linalg.norm(joints[:, None] - places[list(vrm_bones(document).values())], axis=2).min(axis=0)
    assert apart.max() < 1e-5 * size


def test_what_cannot_be_is_refused_before_any_work(hero, refuses):
    refuses("rig hero.obj -o hero.obj", "")
    refuses("rig hero.obj -o out.ply", "out.ply: expected an output in one of .fbx .glb .gltf .vrm, found '.ply'")
    refuses("rig hero.obj -o out.vrm --author A", "expected --author and --license for a .vrm, found no --license")
    refuses("rig missing.obj", "missing.obj")
    (hero / "hero-rigged.glb").write_text("mine")
    refuses("rig hero.obj --no-clobber", "hero-rigged.glb")
    assert (hero / "hero-rigged.glb").read_text() == "mine"
