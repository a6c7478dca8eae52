"""Legal but unusual text files are read and their meshes come back; of an OBJ, all content is kept, too."""

from __future__ import annotations

import re
from pathlib import Path

import hostile
import numpy as np
import pytest
from matrix import sampled
from nasty import CUBE_SHARED_NORMALS, NASTY_OBJ, SHEETS_SHARED_NORMALS, naive_obj, triangles_of

from mimesh.core.mesh import Clip, Mesh
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh

OBJ = hostile.OBJ | {"nasty": NASTY_OBJ, "cube": CUBE_SHARED_NORMALS, "sheets": SHEETS_SHARED_NORMALS}
TEXTS = {"obj": OBJ, "ply": hostile.PLY, "stl": hostile.STL}
FILES = {(suffix, name): text for suffix, texts in TEXTS.items() for name, text in texts.items()}
ENDS = {"LF": b"\n", "CRLF": b"\r\n", "CR": b"\r"}


CASES = sampled([(*key, end) for key in FILES for end in ENDS], quick=lambda case: case[2] == "LF")


@pytest.fixture(params=CASES, ids=" ".join)
def file(request, tmp_path) -> Path:
    """Write a file with unusual content, name and folder."""
    suffix, name, end = request.param
    folder = tmp_path / "Größe & 大小 #1 %20"
    folder.mkdir()
    path = folder / f"{name} ü.{suffix}"
    path.write_bytes(FILES[suffix, name].replace(b"\n", ENDS[end]))
    return path


def move_every_second_vertex(mesh: Mesh) -> Mesh:
    """Move every second vertex, so that some lines change and others must not."""
    vertices = mesh.vertices.copy()
    vertices[1::2] += np.array([0.125, -3.0, 1 / 3]) * np.maximum(1.0, np.abs(vertices[1::2]))
    return mesh.with_vertices(vertices)


def split_words(data: bytes) -> list[bytes]:
    """Split a file into words and the white space between them."""
    return re.split(rb"([\s\\]+)", data)


def test_moved_points_and_all_else_round_trip(file):
    mesh = load_mesh(file)
    moved = move_every_second_vertex(mesh)
    save_mesh(moved, file.with_stem("moved"))
    reread = load_mesh(file.with_stem("moved"))
    width = np.float32 if file.suffix in (".ply", ".stl") else np.float64
    if file.suffix == ".stl":  # corners that touch are welded anew
        assert np.array_equal(reread.vertices[reread.faces], moved.vertices[mesh.faces].astype(width))
        return
    assert np.array_equal(reread.vertices.astype(width), moved.vertices.astype(width))
    assert np.array_equal(reread.faces, mesh.faces)
    for name in ("corner_uv", "vertex_colors"):
        assert np.array_equal(getattr(reread, name), getattr(mesh, name))
    if file.suffix == ".obj":
        assert [(p.name, p.start, p.stop) for p in reread.parts] == [(p.name, p.start, p.stop) for p in mesh.parts]
        check_text_of_obj(file, mesh)


def check_text_of_obj(file: Path, mesh: Mesh) -> None:
    """An unchanged mesh gives equal bytes; in a moved one only numbers of moved points change."""
    save_mesh(mesh, file.with_stem("same"))
    assert file.with_stem("same").read_bytes() == file.read_bytes()
    # A translation keeps all normals; where they rotate, further `vn` lines may be added.
    moved = mesh.with_vertices(mesh.vertices + 1) if mesh.corner_normals is not None else move_every_second_vertex(mesh)
    save_mesh(moved, file.with_stem("moved"))
    before, after = (split_words(path.read_bytes()) for path in (file, file.with_stem("moved")))
    assert before[1::2] == after[1::2]  # all gaps, line ends included
    changed = sum(old != new for old, new in zip(before, after, strict=True))
    points = (moved.vertices != mesh.vertices).any(axis=1).sum()
    assert 0 < changed <= 3 * points


@pytest.mark.parametrize("name", OBJ)
def test_polygons_equal_those_of_a_naive_reader(name, tmp_path):
    text = OBJ[name]
    (tmp_path / "a.obj").write_bytes(text)
    mesh = load_mesh(tmp_path / "a.obj")
    naive = re.sub(rb"#[^\n]*", b"", text)  # a comment ends with its line, whatever it ends in
    vertices, polygons, _ = naive_obj(re.sub(rb"(?m)^\s*f\s", b"f ", naive))
    assert np.array_equal(mesh.vertices, vertices)
    assert np.array_equal(mesh.faces, triangles_of(polygons)[0])


@pytest.mark.parametrize("key", FILES, ids=" ".join)
def test_clip_keeps_materials_and_names(key, tmp_path):
    file = tmp_path / f"a.{key[0]}"
    file.write_bytes(FILES[key])
    mesh = load_mesh(file)
    moved = move_every_second_vertex(mesh)
    save_clip(Clip(mesh, np.stack([mesh.vertices, moved.vertices])), file.with_name("clip.glb"))
    clip = load_clip(file.with_name("clip.glb"))
    size = np.abs(moved.vertices).max()
    for frame, expected in zip(clip.vertices, (mesh.vertices, moved.vertices), strict=True):
        assert np.allclose(frame[clip.mesh.faces], expected[mesh.faces], atol=1e-6 * size)
    if mesh.corner_uv is not None:
        assert np.allclose(clip.mesh.corner_uv, mesh.corner_uv, atol=1e-6)
    if mesh.vertex_colors is not None:
        colors = clip.mesh.vertex_colors[clip.mesh.faces]
        assert np.allclose(colors, mesh.vertex_colors[mesh.faces], atol=1e-6)
    bare = None if mesh.vertex_colors is None else "default"  # colours need a white material
    names, again = (
        [(p.material.name if p.material else bare, p.start, p.stop) for p in one.parts] for one in (mesh, clip.mesh)
    )
    assert not names or again == names
