"""The up axis that a file defines comes before any detection, and the user's comes before the file's."""

import dataclasses
import json

import numpy as np
import pytest
from matrix import matrix
from people import boxes_person, person, walk

from mimesh import animate, transfer
from mimesh.core.mesh import Clip, Mesh, permute_vertices
from mimesh.core.normalization import ROTATIONS, Normalization
from mimesh.core.options import Hints
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh
from mimesh.methods.find import find_model
from mimesh.pipeline.look import reorient
from mimesh.rigs.confidence import Confidence
from mimesh.studio.operations import detect_facing
from mimesh.tools.inspect import inspect_file

UPSIDE_DOWN = np.diag([-1.0, -1.0, 1.0])
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
NOT_RECOGNISED = Confidence(40.0, 2.0, {})


def turned(mesh: Mesh, rotation: np.ndarray) -> Mesh:
    return dataclasses.replace(mesh, vertices=mesh.vertices @ rotation.T)


def saved(mesh: Mesh, path) -> Mesh:
    save_mesh(mesh, path)
    return load_mesh(path)


@matrix("suffix", [".glb", ".gltf", ".usda", ".usdc", ".usdz"], quick=[".glb"])
@pytest.mark.parametrize("mesh", [boxes_person(0.5), turned(person(0), UPSIDE_DOWN)], ids=["large head", "headstand"])
def test_the_up_axis_of_a_file_is_believed(mesh, suffix, tmp_path):
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr")
    norm = Normalization.fit(saved(mesh, tmp_path / f"a{suffix}"))
    assert (norm.up, norm.up_from, norm.detected) == ("+y", "file", True)


@matrix("suffix", [".obj", ".ply", ".stl", ".npz"], quick=[".obj", ".npz"])
def test_formats_without_an_up_axis_leave_it_to_the_shape(suffix, tmp_path):
    mesh = saved(turned(person(0), UPSIDE_DOWN), tmp_path / f"a{suffix}")
    norm = Normalization.fit(mesh)
    assert mesh.up is None
    assert (norm.up, norm.up_from) == ("-y", "shape")


@pytest.mark.slow
@matrix(("authored", "up"), [("Y", "+y"), ("Z", "+z"), (None, None)], quick=[("Z", "+z")])
def test_usd_says_up_where_the_stage_does(authored, up, tmp_path):
    pytest.importorskip("pxr")
    from pxr import Usd
    from usd_stages import add_cube, new_stage

    path = tmp_path / "a.usda"
    stage = Usd.Stage.CreateNew(str(path)) if authored is None else new_stage(path, up=authored)
    add_cube(stage)
    stage.Save()
    assert load_mesh(path).up == up
    assert load_clip(path).mesh.up == up


def test_a_given_axis_comes_before_that_of_the_file(tmp_path):
    mesh = saved(boxes_person(0.5), tmp_path / "a.glb")
    given = Normalization.fit(mesh, up="-z")
    assert (given.up, given.up_from) == ("-z", "given")
    both = Normalization.fit(mesh, up="x", front="-y")
    assert (both.up, both.front, both.up_from, both.detected, both.margin) == ("+x", "-y", "given", False, 1.0)
    # A front along the file's up axis contradicts the file.
    front = Normalization.fit(mesh, front="y")
    assert (front.front, front.up_from) == ("+y", "shape")
    assert front.up[1] != "y"


def test_a_given_front_and_the_up_axis_of_the_file_need_no_detection(tmp_path):
    norm = Normalization.fit(saved(boxes_person(0.5), tmp_path / "a.glb"), front="x")
    assert (norm.up, norm.front, norm.up_from, norm.detected, norm.margin) == ("+y", "+x", "file", False, 1.0)


@pytest.mark.slow
def test_results_of_files_stand_upright_and_the_report_says_why(tmp_path):
    mesh = saved(boxes_person(0.5), tmp_path / "a.glb")
    report = transfer(mesh, mesh, "copy").report
    for which in ("identity", "driving"):
        assert (report[which]["up"], report[which]["up_from"]) == ("+y", "file")
    given = transfer(mesh, mesh, "copy", hints=Hints(up="-y", driving_up="-y")).report
    for which in ("identity", "driving"):
        assert (given[which]["up"], given[which]["up_from"]) == ("-y", "given")
    assert "up +y (by the file)" in inspect_file(tmp_path / "a.glb").text()
    json.dumps(report)


def test_a_shape_that_contradicts_its_file_gets_a_note(tmp_path):
    """A z-up person in a glTF file, which is y up by definition: the file is believed, and the user is told."""
    mesh = dataclasses.replace(saved(turned(person(0), Z_UP), tmp_path / "a.glb"), name="scan")
    result = transfer(mesh, person(0), "copy")
    assert result.report["identity"]["up"] == "+y"
    expected = 'the file of scan defines up +y, its shape looks like up +z; give up="+z" if the file is wrong'
    assert expected in result.notes
    given = transfer(mesh, person(0), "copy", hints=Hints(up="+z"))
    assert given.report["identity"]["up"] == "+z"
    assert not any("defines" in note for note in given.notes)
    assert not any("defines" in note for note in transfer(person(0), mesh, "copy", hints=Hints(driving_up="+z")).notes)
    assert 'give driving_up="+z" if' in " ".join(transfer(person(0), mesh, "copy").notes)


def test_baked_animations_keep_the_up_axis_of_their_file(tmp_path):
    clip = walk()
    headstand = Clip(turned(clip.mesh, UPSIDE_DOWN), (clip.vertices @ UPSIDE_DOWN.T).astype(np.float32), clip.fps)
    save_clip(headstand, tmp_path / "a.glb")
    read = load_clip(tmp_path / "a.glb")
    assert (len(read), read.mesh.up) == (4, "+y")
    report = animate(read.mesh, read, "copy").report
    assert (report["driving"]["up"], report["driving"]["up_from"]) == ("+y", "file")
    assert detect_facing(read, (None, None))["up"] == "+y"
    assert detect_facing(read, ("-y", None))["up"] == "-y"


def test_point_caches_beside_a_file_define_no_up_axis(tmp_path):
    save_mesh(person(0), tmp_path / "a.glb")
    mesh = load_mesh(tmp_path / "a.glb")
    save_clip(Clip.still(mesh.with_vertices(mesh.vertices @ ROTATIONS[5].T)), tmp_path / "a.pc2")
    assert load_clip(tmp_path / "a.pc2").mesh.up is None


def test_the_up_axis_stays_with_a_mesh(tmp_path):
    mesh = saved(person(0), tmp_path / "a.glb")
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    assert mesh.with_vertices(mesh.vertices * 2).up == permute_vertices(mesh, order).up == "+y"


@pytest.mark.slow
def test_a_mesh_that_is_not_recognised_keeps_the_up_axis_of_its_file(monkeypatch):
    mesh = dataclasses.replace(person(0, pose=3), up="+z")
    norm = Normalization.fit(mesh)
    tried, mime = [], find_model("mime")
    fit = Normalization.fit
    monkeypatch.setattr(Normalization, "fit", lambda mesh, *axes: tried.append(axes) or fit(mesh, *axes))
    corrected = reorient(mime, mesh, norm, (None, None), NOT_RECOGNISED)
    assert {up for up, _ in tried} == {"+z"}
    assert (corrected.up, corrected.up_from) == ("+z", "file")
    tried.clear()
    reorient(mime, mesh, fit(mesh, up="-y"), ("-y", None), NOT_RECOGNISED)
    assert {up for up, _ in tried} == {"-y"}
