"""Files with small mistakes are read where their content is clear; values that no format holds are refused."""

from __future__ import annotations

import codecs
import dataclasses
import json
import os
import zipfile

import numpy as np
import pytest
import zoo
from motion_files import write_bvh

from mimesh.__main__ import run
from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Mesh, check_clip, check_mesh
from mimesh.core.options import FrameRange
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh
from mimesh.motions import load_motion, window
from mimesh.pipeline import animate, transfer

CUBE = "# Größe\no cube\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
ODD_NAME = os.fsdecode(b"h\xffro")
"""A file name with a byte that is no text, as Python decodes it: with a lone surrogate."""


@pytest.mark.parametrize("mark", [codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE])
def test_obj_in_utf16_is_read_and_written_as_utf8(mark, tmp_path):
    encoding = "utf-16-le" if mark == codecs.BOM_UTF16_LE else "utf-16-be"
    (tmp_path / "a.obj").write_bytes(mark + CUBE.encode(encoding))
    (tmp_path / "b.obj").write_text(CUBE, "utf-8")
    mesh, same = load_mesh(tmp_path / "a.obj"), load_mesh(tmp_path / "b.obj")
    assert np.array_equal(mesh.vertices, same.vertices)
    assert np.array_equal(mesh.faces, same.faces)
    save_mesh(mesh, tmp_path / "c.obj")
    assert (tmp_path / "c.obj").read_text("utf-8") == CUBE


def test_frames_in_utf16_are_a_clip(tmp_path):
    for t in range(3):
        (tmp_path / f"{t}.obj").write_text(CUBE.replace("v 1 0 0", f"v {1 + t} 0 0"), "utf-16")
    assert load_clip(tmp_path).vertices[:, 1, 0].tolist() == [1, 2, 3]


def test_damaged_utf16_is_refused(tmp_path):
    (tmp_path / "a.obj").write_bytes(codecs.BOM_UTF16_LE + b"v \x00\xd8x")
    with pytest.raises(InputError, match="expected text in UTF-8 or UTF-16"):
        load_mesh(tmp_path / "a.obj")


@pytest.mark.parametrize("corners", ["1/1 3/2 2/3", "1/1/1 3/2/2 2/3/3", "1//1 3//2 2//3"])
def test_obj_that_lists_no_texture_coordinates_or_normals_is_read_without_them(corners, tmp_path):
    text = CUBE.replace("1 3 2", corners)
    (tmp_path / "a.obj").write_text(text, "utf-8")
    mesh = load_mesh(tmp_path / "a.obj")
    assert mesh.faces[0].tolist() == [0, 2, 1]
    assert mesh.corner_uv is None
    assert mesh.corner_normals is None
    save_mesh(mesh.with_vertices(mesh.vertices + 1), tmp_path / "b.obj")
    assert [line for line in (tmp_path / "b.obj").read_text("utf-8").splitlines() if line.startswith("f")] == [
        line for line in text.splitlines() if line.startswith("f")
    ]


@pytest.mark.parametrize("nan", ["nan", "-nan(ind)", "-1.#IND", "1.#QNAN0", "inf"])
def test_normals_and_texture_coordinates_that_are_no_numbers_are_zero(nan, tmp_path):
    """Exporters write them for faces without area."""
    values = f"vt 0.5 1\nvt {nan} 0\nvn 0 0 1\nvn {nan} {nan} {nan}\n"
    text = CUBE.replace("f 1 3 2", f"{values}f 1/1/1 3/2/2 2/1/1")
    (tmp_path / "a.obj").write_text(text, "utf-8")
    mesh = load_mesh(tmp_path / "a.obj")
    assert mesh.corner_uv is not None
    assert mesh.corner_normals is not None
    assert mesh.corner_uv[0].tolist() == [[0.5, 1], [0, 0], [0.5, 1]]
    assert mesh.corner_normals[0].tolist() == [[0, 0, 1], [0, 0, 0], [0, 0, 1]]
    save_mesh(mesh.with_vertices(mesh.vertices + 1), tmp_path / "b.obj")
    assert np.array_equal(load_mesh(tmp_path / "b.obj").vertices, mesh.vertices + 1)
    for suffix in (".glb", ".ply"):
        save_mesh(mesh, tmp_path / f"c{suffix}")
        assert len(load_mesh(tmp_path / f"c{suffix}").faces) == 4
    (tmp_path / "a.obj").write_text(text.replace("v 1 0 0", f"v {nan} 0 0"), "utf-8")
    with pytest.raises(InputError, match="expected finite coordinates, found NaN or infinity in 1 of 4"):
        load_mesh(tmp_path / "a.obj")


@pytest.mark.slow
def test_bvh_with_a_row_more_than_it_states_is_read_with_a_note(tmp_path, capsys):
    path = tmp_path / "a.bvh"
    motion = window(load_motion("jump"), 0.0, 0.2)
    write_bvh(path, load_body(), motion)
    whole = load_clip(path)
    assert whole.notes == ()
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines, lines[-1], ""]))
    clip = load_clip(path)
    assert np.array_equal(clip.vertices, whole.vertices)
    note = f"a.bvh has {len(clip) + 1} rows and states {len(clip)} frames: the first {len(clip)} are read"
    assert clip.notes == (note,)
    assert run(["look", str(path)]) == 0
    assert note in capsys.readouterr().out
    assert run(["convert", str(path), str(tmp_path / "b.npz")]) == 0
    assert f"note: {note}" in capsys.readouterr().out
    assert note in animate(clip.mesh, clip, "copy").notes


def test_two_points_or_a_triangle_are_no_mesh_to_move(tmp_path, capsys):
    for points, faces in ((2, []), (3, []), (3, [[0, 1, 2]])):
        mesh = Mesh(np.eye(3)[:points], np.array(faces, int).reshape(-1, 3), name="scrap")
        for move, driving in ((transfer, zoo.cube()), (animate, Clip.still(zoo.cube()))):
            with pytest.raises(InputError, match=f"^scrap: expected at least 4 vertices .* found {points}"):
                move(mesh, driving)
    save_mesh(mesh, tmp_path / "scrap.ply")
    save_mesh(zoo.cube(), tmp_path / "cube.obj")
    assert run(["transfer", str(tmp_path / "scrap.ply"), str(tmp_path / "cube.obj")]) == 2
    assert "expected at least 4 vertices" in capsys.readouterr().err


def test_file_with_a_name_that_is_no_text_is_converted(tmp_path):
    source = tmp_path / f"{ODD_NAME}.obj"
    try:
        source.write_text(CUBE, "utf-8")
    except OSError:
        pytest.skip("a file system that has no such names")
    for suffix in (".gltf", ".ply"):
        assert run(["convert", str(source), str(tmp_path / f"{ODD_NAME}{suffix}")]) == 0
        assert len(load_mesh(tmp_path / f"{ODD_NAME}{suffix}").faces) == 4


@pytest.mark.parametrize(
    ("attribute", "shape"), [("corner_uv", (12, 3, 2)), ("corner_normals", (12, 3, 3)), ("vertex_colors", (8, 4))]
)
def test_other_values_are_checked_like_positions(attribute, shape):
    mesh = dataclasses.replace(zoo.cube(), **{attribute: np.ones(shape)})
    check_mesh(mesh, "a")
    for value in (np.nan, np.inf, 1e30):
        getattr(mesh, attribute)[5, 1] = value
        with pytest.raises(InputError, match=r"^a: expected .*finite.*; delete or repair them"):
            check_mesh(mesh, "a")


def test_every_frame_is_checked_for_large_numbers():
    cube = zoo.cube()
    frames = np.stack([cube.vertices] * 3)
    frames[2] *= 1e200
    with pytest.raises(InputError, match="larger ones in frame 2"):
        check_clip(Clip(cube, frames), "a")
    with pytest.raises(InputError, match="expected a frame rate from"):
        check_clip(Clip(cube, frames[:2], np.inf), "a")


def test_positions_too_large_for_the_type_of_a_file_are_kept(tmp_path):
    """Half precision ends at 65,504."""
    np.savez(tmp_path / "a.npz", vertices=zoo.cube().vertices.astype(np.float16), faces=zoo.cube().faces)
    mesh = load_mesh(tmp_path / "a.npz")
    save_mesh(mesh.with_vertices(mesh.vertices * 1e6), tmp_path / "b.npz")
    assert np.array_equal(load_mesh(tmp_path / "b.npz").vertices, mesh.vertices * 1e6)


def test_numbers_that_gltf_cannot_hold_are_refused(tmp_path):
    """A node's scale of 1e-30 makes coordinates of 1e8 to 1e38, which float32 has not."""
    save_mesh(zoo.cube(), tmp_path / "a.gltf")
    gltf = json.loads((tmp_path / "a.gltf").read_text())
    gltf["nodes"][0]["scale"] = [1e-30] * 3
    (tmp_path / "a.gltf").write_text(json.dumps(gltf))
    mesh = load_mesh(tmp_path / "a.gltf")
    for path in (tmp_path / "b.gltf", tmp_path / "c.glb"):
        save_mesh(mesh.with_vertices(zoo.cube().vertices * 1e10), path)  # shown by a node without that scale
        assert np.allclose(load_mesh(path).vertices, zoo.cube().vertices * 1e10)
    frames = np.stack([mesh.vertices, zoo.cube().vertices * 1e17])
    clip = Clip(mesh, frames)
    with pytest.raises(InputError, match=r"expected numbers up to 3\.4e38"):
        save_clip(clip, tmp_path / "d.glb")
    assert not (tmp_path / "d.glb").exists()


@pytest.mark.parametrize("name", ["a.zip", "a.obj", "a.glb", "a.bvh"])
def test_an_archive_is_to_be_unpacked(name, tmp_path):
    with zipfile.ZipFile(tmp_path / name, "w") as archive:
        archive.writestr("hero.obj", "v 0 0 0")
    for load in (load_mesh, load_clip):
        with pytest.raises(InputError, match="found a packed archive; unpack it, and give a file in it"):
            load(tmp_path / name)


@pytest.mark.parametrize("name", ["a.glb", "a.obj", "a.fbx", "a.stl", "a.npz"])
def test_what_downloads_leave_in_place_of_a_file_is_named(name, tmp_path):
    for text, found in (
        (f"version https://git-lfs.github.com/spec/v1\noid sha256:{'0' * 64}\nsize 9\n", "a Git LFS pointer; run"),
        ("<!DOCTYPE html>\n<html><body>Not found</body></html>\n", "a web page; download the file itself"),
    ):
        (tmp_path / name).write_text(text)
        for load in (load_mesh, load_clip):
            with pytest.raises(InputError, match=f"found {found}"):
                load(tmp_path / name)


@pytest.mark.parametrize("frames", [{"start": -5}, {"stop": -1}])
def test_frames_count_from_the_first_one(frames):
    with pytest.raises(InputError, match=f"{next(iter(frames))}: expected a frame counted from 0, found -"):
        FrameRange(**frames)
