"""User mistakes: each raises one line that says what was expected, what was found and what to do."""

from __future__ import annotations

import os
import struct

import numpy as np
import pytest
import zoo

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Mesh
from mimesh.io import clip_suffixes, load_clip, load_mesh, mesh_suffixes, save_clip, save_mesh
from mimesh.io.formats import CLIP_WRITERS, MESH_WRITERS

FORMATS = (".npz", ".obj", ".ply", ".stl")
ASCII_PLY = (
    "ply\nformat ascii 1.0\nelement vertex {v}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {f}\nproperty list uchar int vertex_indices\nend_header\n"
)
THREE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
PLY_POINTS = ASCII_PLY.format(v=3, f=1) + "0 0 0 1 0 0 0 1 0\n"


def input_error_of(call, *arguments, **options) -> str:
    """Return the message of the InputError that a call raises, after checking its form."""
    with pytest.raises(InputError) as caught:
        call(*arguments, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith(str(arguments[-1])) or message.startswith(str(arguments[0])), message
    before, _, remedy = message.rpartition("; ")
    assert " expected " in before, message
    assert " found " in before, message
    assert remedy
    return message


@pytest.fixture(params=FORMATS)
def suffix(request):
    return request.param


def good_file(folder, suffix: str):
    save_mesh(zoo.cube(), folder / f"good{suffix}")
    return folder / f"good{suffix}"


@pytest.mark.parametrize("load", [load_mesh, load_clip])
def test_missing_empty_and_unknown_files_are_refused(load, tmp_path):
    assert "found nothing of that name; check the path" in input_error_of(load, tmp_path / "none.obj")
    for suffix in (".obj", ".vrm", ".usda", ".pc2"):
        (tmp_path / f"a{suffix}").write_bytes(b"")
        assert "found an empty file of 0 bytes" in input_error_of(load, tmp_path / f"a{suffix}")
    for name in ("a.blend", "a", "a.obj.zip", "a.OBJ.txt"):
        (tmp_path / name).write_bytes(b"x")
        message = input_error_of(load, tmp_path / name)
        assert all(suffix in message for suffix in mesh_suffixes())
    (tmp_path / "skin.PNG").write_bytes(b"x")
    assert "skin.PNG: expected a mesh, found a picture" in input_error_of(load, tmp_path / "skin.PNG")


def test_folder_is_refused_as_a_mesh(tmp_path):
    assert "found a folder; name one file in it" in input_error_of(load_mesh, tmp_path)


def test_folder_without_meshes_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    assert "found no mesh in the folder" in input_error_of(load_clip, tmp_path)
    save_mesh(zoo.cube(), tmp_path / "hero.obj")
    assert "found 1 meshes without a number" in input_error_of(load_clip, tmp_path)


def test_frame_rates_are_possible_ones(tmp_path):
    for fps in (0.0, -1.0, np.nan, 1e-300, 1e300):
        assert "expected a frame rate from" in input_error_of(load_clip, good_file(tmp_path, ".obj"), fps=fps)
        np.savez(tmp_path / "a.npz", vertices=np.eye(3)[None], fps=fps)
        assert "expected a frame rate from" in input_error_of(load_clip, tmp_path / "a.npz")


@pytest.mark.parametrize("suffix", sorted({*FORMATS} - {".obj"}))  # an OBJ file does not say how long it is
def test_truncated_files_are_refused(suffix, tmp_path):
    data = good_file(tmp_path, suffix).read_bytes()
    for fraction in (0.2, 0.5, 0.8, 0.97):
        (tmp_path / f"cut{suffix}").write_bytes(data[: int(fraction * len(data))])
        input_error_of(load_mesh, tmp_path / f"cut{suffix}")


def test_nan_and_infinity_are_refused(suffix, tmp_path, monkeypatch):
    monkeypatch.setattr("mimesh.io.save.check_numbers", lambda *_: None)  # so that such a file is written
    for value in (np.nan, np.inf):
        mesh = zoo.cube()
        mesh.vertices[3, 1] = value
        with np.errstate(invalid="ignore"):  # the writers are not the ones to check
            save_mesh(mesh, tmp_path / f"a{suffix}")
        assert "found NaN or infinity in" in input_error_of(load_mesh, tmp_path / f"a{suffix}")


def test_face_index_out_of_range_is_refused(suffix, tmp_path, monkeypatch):
    monkeypatch.setattr("mimesh.io.save.check_numbers", lambda *_: None)  # so that such a file is written
    for index in {".stl": (), ".obj": (8, 70000)}.get(suffix, (8, -9, 70000)):  # OBJ counts back, STL has no indices
        faces = zoo.cube().faces.copy()
        faces[4, 2] = index
        save_mesh(Mesh(zoo.cube().vertices, faces), tmp_path / f"a{suffix}")
        input_error_of(load_mesh, tmp_path / f"a{suffix}")


MISTAKES = {
    ".obj": [
        ("v 0 0 0\nv 1 0\n", "expected 3 numbers in line 2, found 'v 1 0'"),
        ("v 0 0 0\n\n# x\nv 1 0 zero\n", "expected 3 numbers in line 4, found 'v 1 0 zero'"),
        ("v 0 0 \\\n 0\nv 1 0 1.0.0\n", "in line 3, found 'v 1 0 1.0.0'"),
        (THREE + "f 1 2 3\nvn 0 1\n", "in line 5, found 'vn 0 1'"),
        (THREE + "vt a b\nf 1/1 2/1 3/1\n", "in line 4, found 'vt a b'"),
        (THREE + "f 1 2 x\n", "in line 4, found '1 2 x'"),
        (THREE + "f 1 2 3/4/5/6\n", "in line 4, found '1 2 3/4/5/6'"),
        (THREE + "f 1 2 /3\n", "in line 4, found '1 2 /3'"),
        (THREE + "f 1 2 1.5\n", "in line 4, found '1 2 1.5'"),
        (THREE + "f 1 2 4\n", "expected indices in 1..3, found 4 in line 4"),
        (THREE + "f 1 2 3\nf 1 2 -4\n", "expected indices in 1..3, found -4 in line 5"),
        (THREE + "f 0 1 2\n", "found 0 in line 4"),
        (THREE + "vt 0 0\nf 1/1 2/1 3/2\n", "expected indices in 1..1, found 2 in line 5"),
        (THREE + "vn 0 0 1\nf 1//1 2//1 3//2\n", "found 2 in line 5"),
        ("# nothing\n", "found no vertices"),
        ("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n", "all 3 vertices at one point"),
        ("v inf 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3\n", "found NaN or infinity in 1 of 3"),
        ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "found only zero-area ones"),
    ],
    ".ply": [
        ("plyformat", "expected a PLY header"),
        ("ply\nformat ascii 1.0\nelement vertex 3\n", "expected a PLY header"),
        ("ply\nformat text 1.0\nend_header\n", "found 'text'"),
        ("ply\nelement vertex 1\nend_header\n", "found no format"),
        ("ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "'many'"),
        ("ply\nformat ascii 1.0\nelement vertex -3\nend_header\n", "an element of -3 rows"),
        ("ply\nformat ascii 1.0\nproperty float x\nend_header\n", "known format, elements"),
        ("ply\nformat ascii 1.0\nelement vertex 1\nproperty half x\nend_header\n0", "found 'half'"),
        (
            "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0",
            "expected an element 'vertex' with",
        ),
        (
            "ply\nformat ascii 1.0\nelement face 0\nproperty list uchar int a\nend_header\n",
            "expected an element 'vertex'",
        ),
        (ASCII_PLY.format(v=0, f=0), "found no vertices"),
        (ASCII_PLY.format(v=10**9, f=1) + "0 0 0\n", "expected 1000000000 rows of element 'vertex'"),
        (ASCII_PLY.format(v=3, f=10**9) + "0 0 0 1 0 0 0 1 0\n3 0 1 2\n", "rows of element 'face'"),
        (ASCII_PLY.format(v=3, f=1) + "0 0 0 1 0 0 0 1 zero\n3 0 1 2\n", "expected numbers after the header"),
        (PLY_POINTS + "-3 0 1 2\n", "found the file cut short"),
        (PLY_POINTS + "nan 0 1 2\n", "found the file cut short"),
        (PLY_POINTS + "3 0 1 3\n", "expected face indices in 0..2, found 3"),
        (PLY_POINTS + "3 0 1 nan\n", "expected face indices in 0..2, found -"),
        (PLY_POINTS + "3 0 1 1e300\n", "expected face indices in 0..2, found -"),
        (
            ASCII_PLY.replace("vertex_indices", "corners").format(v=3, f=1) + "0 0 0 1 0 0 0 1 0\n3 0 1 2",
            "found corners",
        ),
        (
            ASCII_PLY.replace("face", "tristrips").format(v=3, f=1) + "0 0 0 1 0 0 0 1 0\n3 0 1 2",
            "found triangle strips",
        ),
    ],
    ".stl": [
        (b"solid x\n facet normal 0 0 1\n outer loop\n vertex 0 0 0\n vertex 1 0 0\n", "for each of 1 facets"),
        (
            b"solid x\nfacet normal 0 0 1\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 a 0\nendfacet\n",
            "in line 5, found 'vertex 0 a",
        ),
        (b"solid x\nfacet normal 0 0\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendfacet\n", "in line 2, found 'facet"),
        (b"solid nothing\nendsolid nothing\n", "found no vertices"),
        (bytes(80) + struct.pack("<I", 2) + bytes(60), "expected an STL file of 184 bytes (2 triangles), found 144"),
        (bytes(84), "found no vertices"),
        (b"not an STL", "expected an STL file of 84 bytes"),
    ],
}
"""Suffix -> contents of files, and a part of what is said of each."""


@pytest.mark.parametrize(
    ("suffix", "content", "found"), [(suffix, *case) for suffix, cases in MISTAKES.items() for case in cases]
)
def test_mistakes_are_explained_and_their_line_named(suffix, content, found, tmp_path):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert found in input_error_of(load_mesh, path)


def test_ply_with_integer_coordinates_is_read_and_written_with_others(tmp_path):
    text = ASCII_PLY.replace("float", "short").format(v=3, f=1) + "0 0 0 1 0 0 0 1 0\n3 0 1 2\n"
    (tmp_path / "a.ply").write_text(text)
    mesh = load_mesh(tmp_path / "a.ply")
    save_mesh(mesh.with_vertices(mesh.vertices + 0.5), tmp_path / "b.ply")
    np.testing.assert_array_equal(load_mesh(tmp_path / "b.ply").vertices, mesh.vertices + 0.5)


def test_point_cloud_is_refused_as_stl(tmp_path):
    assert "found a point cloud; write .ply or .obj" in input_error_of(save_mesh, zoo.point_cloud(), tmp_path / "a.stl")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["a.max", "a"])
def test_unsupported_mesh_output_is_refused(name, tmp_path):
    message = input_error_of(save_mesh, zoo.cube(), tmp_path / name)
    assert all(suffix in message for suffix in MESH_WRITERS)


def test_clip_in_a_mesh_format_is_refused(tmp_path):
    clip = Clip(zoo.cube(), zoo.cube().vertices[None])
    assert all(suffix in input_error_of(save_clip, clip, tmp_path / "a.obj") for suffix in clip_suffixes())
    assert "found '.stl'; choose one of them" in input_error_of(
        lambda path: save_clip(clip, path, suffix=".stl"), tmp_path / "out"
    )
    (tmp_path / "file").write_text("x")
    assert "found a file; choose another name" in input_error_of(save_clip, clip, tmp_path / "file")


@pytest.mark.parametrize("suffix", [".obj", ".glb", ".usda"])
def test_unwritable_path_is_refused(suffix, tmp_path):
    (tmp_path / "file").write_text("x")
    input_error_of(save_mesh, zoo.cube(), tmp_path / "file" / f"a{suffix}")
    if suffix in CLIP_WRITERS:
        input_error_of(save_clip, Clip.still(zoo.cube()), tmp_path / "file" / f"a{suffix}")
    (tmp_path / f"folder{suffix}").mkdir()
    input_error_of(save_mesh, zoo.cube(), tmp_path / f"folder{suffix}")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", f"folder{suffix}"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_file_without_read_permission_is_refused(tmp_path):
    good_file(tmp_path, ".obj").chmod(0)
    assert "check its permissions" in input_error_of(load_mesh, tmp_path / "good.obj")


def test_failed_write_keeps_the_old_file(tmp_path):
    path = good_file(tmp_path, ".obj")
    before = path.read_bytes()
    mesh = load_mesh(path)
    grown = mesh.__class__(np.zeros((9, 3)), mesh.faces, source=mesh.source)
    with pytest.raises(ValueError, match="the file has"):
        save_mesh(grown, path)
    assert path.read_bytes() == before
    assert [path] == list(tmp_path.iterdir())
