"""Notes on written files, and on the pose that was taken of a moving one."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import zoo
from motion_files import write_bvh

from mimesh.bodies import load_body
from mimesh.io import load_mesh, save_clip, save_mesh
from mimesh.motions import load_motion, window
from mimesh.tools.convert import convert
from mimesh.tools.notes import LARGE, not_kept, posed_vrm_note, size_note, skinned_note, taken_pose_note

pytestmark = pytest.mark.usefixtures("in_process")


def test_large_files_are_noted(tmp_path):
    for name in ("a.glb", "a.usdc"):
        with (tmp_path / name).open("wb") as file:
            file.truncate(LARGE)  # a sparse file: it takes no space on disk
    assert "256 MiB: --step takes fewer frames, and --skinned" in size_note(tmp_path / "a.glb")[0]
    assert "--skinned" not in size_note(tmp_path / "a.usdc")[0]
    (tmp_path / "b.glb").write_bytes(b"small")
    assert size_note(tmp_path / "b.glb") == size_note(tmp_path) == ()


def test_notes_tell_which_pose_of_a_moving_file_was_taken(tmp_path):
    path = write_bvh(tmp_path / "a.bvh", load_body(), window(load_motion("jump"), 0.0, 0.1))
    assert "own body in its first frame is taken" in taken_pose_note(load_mesh(path), path)[0]
    save_clip(zoo.moving_cube(), tmp_path / "a.glb")
    (note,) = taken_pose_note(load_mesh(tmp_path / "a.glb"), tmp_path / "a.glb")
    assert note.startswith("a.glb has an animation: its mesh at rest is taken")
    save_mesh(zoo.cube(), tmp_path / "a.obj")
    assert taken_pose_note(load_mesh(tmp_path / "a.obj"), tmp_path / "a.obj") == ()


def test_a_person_in_centimetres_without_a_unit_is_noted_in_formats_in_metres(tmp_path):
    unitless = zoo.cube()
    high = 182.5 / np.ptp(unitless.vertices, axis=0).max()
    save_mesh(dataclasses.replace(unitless, vertices=unitless.vertices * high, name="man"), tmp_path / "man.obj")
    noted = "man measures 182.5, which man.glb has in metres: a person, if its unit is cm; scale by 0.01 on import"
    assert noted in convert(tmp_path / "man.obj", tmp_path / "man.glb").notes
    mesh = load_mesh(tmp_path / "man.obj")
    assert not_kept(mesh, tmp_path / "man.glb", "human") == (noted,)
    assert not_kept(mesh, tmp_path / "man.usdc", "human")[0] == noted.replace(".glb", ".usdc")
    in_centimetres = dataclasses.replace(mesh, source=SimpleNamespace(suffix=".usda", meters_per_unit=0.01))
    assert not any("metres" in note for note in not_kept(in_centimetres, tmp_path / "man.usdc", "human"))
    assert not_kept(mesh, tmp_path / "man.glb", "other") == not_kept(mesh, tmp_path / "man.ply") == ()
    of_animals = {size: not_kept(mesh.with_vertices(size / 182.5 * mesh.vertices), tmp_path / "a.glb", "quadruped")
                  for size in (1.5, 120, 1200)}  # fmt: skip
    assert [note[0].partition("an animal, if ")[2] for note in of_animals.values() if note] == [
        "its unit is cm; scale by 0.01 on import",
        "its unit is mm; scale by 0.001 on import",
    ]
    large, small = (mesh.with_vertices(size / 182.5 * mesh.vertices) for size in (11.35, 0.6))
    assert not_kept(large, tmp_path / "man.vrm", "human")[0].endswith("no person's size; scale it")
    assert not_kept(large, tmp_path / "man.glb") == not_kept(small, tmp_path / "man.vrm", "human") == ()
    in_metres = load_mesh(tmp_path / "man.glb")
    assert not_kept(in_metres, tmp_path / "man.gltf") == ()
    assert "man.vrm has in metres" in not_kept(in_metres, tmp_path / "man.vrm")[0]


def test_a_vrm_in_a_pose_has_a_note(tmp_path):
    (note,) = posed_vrm_note(tmp_path / "posed.vrm")
    assert note.startswith("posed.vrm rests in the pose")
    assert posed_vrm_note(tmp_path / "posed.glb") == ()


def test_notes_tell_large_deviations_of_skinned_files():
    assert skinned_note({}) == skinned_note({"influence_deviation": 0.019, "skinned_deviation": 1e-5}) == ()
    (note,) = skinned_note({"influence_deviation": 0.031, "skinned_deviation": 1e-5})
    assert note.startswith("the few weights a vertex that files of joints have move a vertex by up to 0.031")
    for cause, text in (("fingers", "frame: fingers that only"), ("rest", "frame: the mesh is bound in another pose")):
        (note,) = skinned_note({"skinned_deviation": 0.012, "deviation_cause": cause})
        assert f"up to 0.012 of the mesh's size from its {text}" in note
    (note,) = skinned_note({"skinned_deviation": 0.012})
    assert note.endswith("from its frame")
