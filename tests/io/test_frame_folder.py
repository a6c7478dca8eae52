"""Clips are read from and written to folders of numbered meshes; soups of STL are welded as the first frame."""

from __future__ import annotations

import dataclasses
import io
import shutil
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
import zoo
from nasty import CUBE_SHARED_NORMALS, NASTY_OBJ, bend
from PIL import Image

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Material, Part
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh
from mimesh.io import obj as obj_module

NAMES = ("{}", "walk.{:04d}", "id3_{:02d}_mesh")
FORMATS = (".obj", ".ply", ".stl", ".npz", ".glb")


def frames_of(vertices: np.ndarray, count: int = 12) -> np.ndarray:
    """Frames of a smooth motion, exact in float32."""
    steps = [(1 - t) * vertices + t * bend(vertices) for t in np.linspace(0, 1, count)]
    return np.stack(steps).astype(np.float32).astype(np.float64)


def write_frames(folder, suffix: str, frames: np.ndarray, name: str = "{}", mesh=None) -> None:
    for t, vertices in enumerate(frames):
        save_mesh((mesh or zoo.cube()).with_vertices(vertices), folder / f"{name.format(t)}{suffix}")


@pytest.mark.parametrize(("name", "suffix"), list(zip(cycle(NAMES), FORMATS, strict=False)))
def test_frames_are_read_in_the_order_of_their_numbers(suffix, name, tmp_path):
    frames = frames_of(zoo.cube().vertices)
    write_frames(tmp_path / "clip", suffix, frames, name)
    for other in ("notes.txt", "preview_0001.png", f".hidden_0001{suffix}", f"rest{suffix}"):
        (tmp_path / "clip" / other).write_bytes(b"not a mesh")
    clip = load_clip(tmp_path / "clip", fps=24.0)
    assert (len(clip), clip.fps) == (12, 24)
    np.testing.assert_array_equal(clip.vertices[:, clip.mesh.faces], frames[:, zoo.cube().faces])


def test_a_mesh_file_is_a_clip_of_one_frame_at_30_a_second(tmp_path):
    save_mesh(zoo.cube(), tmp_path / "a.obj")
    clip = load_clip(tmp_path / "a.obj")
    assert (len(clip), clip.fps) == (1, 30)
    np.testing.assert_array_equal(clip.vertices[0], zoo.cube().vertices)


@pytest.mark.parametrize("data", [NASTY_OBJ, CUBE_SHARED_NORMALS], ids=["nasty", "cube"])
def test_each_frame_is_the_original_file_with_other_points(data, tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "looks.mtl").write_text("newmtl Brick\n")
    (tmp_path / "in" / "hero.obj").write_bytes(data)
    mesh = load_mesh(tmp_path / "in" / "hero.obj")
    frames = frames_of(mesh.vertices, 3)
    save_clip(Clip(mesh, frames), tmp_path / "out")
    assert (tmp_path / "out" / "0000.obj").read_bytes() == data
    for t in range(3):
        save_mesh(mesh.with_vertices(frames[t]), tmp_path / "single.obj")
        assert (tmp_path / "out" / f"{t:04d}.obj").read_bytes() == (tmp_path / "single.obj").read_bytes()
    np.testing.assert_array_equal(load_clip(tmp_path / "out").vertices, frames)
    assert (tmp_path / "out" / "looks.mtl").exists() == (data is NASTY_OBJ)
    if data is NASTY_OBJ:  # a library that is there is not overwritten
        (tmp_path / "out" / "looks.mtl").write_text("mine")
        save_clip(Clip(mesh, frames), tmp_path / "out")
        assert (tmp_path / "out" / "looks.mtl").read_text() == "mine"


def test_new_frames_share_one_library(tmp_path):
    png = io.BytesIO()
    Image.new("RGB", (1, 1)).save(png, "PNG")
    cube = zoo.cube()
    painted = dataclasses.replace(cube, parts=(Part("all", 0, 12, Material("skin", texture=png.getvalue())),))
    save_clip(Clip(painted, frames_of(cube.vertices, 3)), tmp_path / "out")
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["0000.mtl", "0000.obj", "0000_skin.png", "0001.obj", "0002.obj"]
    assert load_mesh(tmp_path / "out" / "0002.obj").parts == painted.parts


def test_later_obj_frames_are_read_by_the_fast_path_with_equal_result(tmp_path, monkeypatch):
    save_clip(Clip(zoo.grid(), frames_of(zoo.grid().vertices)), tmp_path / "out", suffix=".obj")
    slow = np.stack([load_mesh(path).vertices for path in sorted((tmp_path / "out").glob("*.obj"))])
    calls, original = [], obj_module._read_source
    monkeypatch.setattr(obj_module, "_read_source", lambda *a: (calls.append(a), original(*a))[1])
    np.testing.assert_array_equal(load_clip(tmp_path / "out").vertices, slow)
    assert len(calls) == 1


def test_continued_lines_of_vertices_are_read_in_all_frames(tmp_path):
    for t in range(3):
        (tmp_path / f"{t}.obj").write_text(f"v 0 0 \\\n0\nv 1 0 0\nv 0 1 {t}\nf 1 2 3\n")
    np.testing.assert_array_equal(load_clip(tmp_path).vertices[:, 2, 2], [0, 1, 2])


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".npz"])
def test_frame_of_another_topology_is_named(suffix, tmp_path):
    cube = zoo.cube()
    write_frames(tmp_path, suffix, frames_of(cube.vertices, 5), "f_{:03d}")
    save_mesh(dataclasses.replace(cube, faces=cube.faces[::-1]), tmp_path / f"f_003{suffix}")
    save_mesh(zoo.grid(), tmp_path / f"f_004{suffix}")
    with pytest.raises(InputError, match=rf"f_003{suffix}: expected the topology of f_000.*in another order; "):
        load_clip(tmp_path)
    shutil.copy(tmp_path / f"f_000{suffix}", tmp_path / f"f_003{suffix}")
    with pytest.raises(InputError, match=rf"f_004{suffix}: .* found 25 vertices and 32 triangles; "):
        load_clip(tmp_path)


def test_relative_indices_are_compared_as_absolute_ones(tmp_path):
    lines = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    (tmp_path / "0.obj").write_text(lines + "f -3 -2 -1\nv 1 1 1\n")
    (tmp_path / "1.obj").write_text(lines + "v 1 1 1\nf -3 -2 -1\n")
    with pytest.raises(InputError, match="in another order"):
        load_clip(tmp_path)
    (tmp_path / "1.obj").write_text(lines + "f -3 -2 -1\nv 1 1 5\n")
    assert load_clip(tmp_path).vertices[1, 3, 2] == 5


def test_longest_series_is_read_and_a_tie_is_an_error(tmp_path):
    write_frames(tmp_path, ".obj", frames_of(zoo.cube().vertices, 3), "a{}")
    write_frames(tmp_path, ".ply", frames_of(zoo.cube().vertices, 2), "a{}")
    write_frames(tmp_path, ".obj", frames_of(zoo.cube().vertices, 2), "b{}")
    assert len(load_clip(tmp_path)) == 3
    write_frames(tmp_path, ".obj", frames_of(zoo.cube().vertices, 3), "b{}")
    with pytest.raises(InputError, match=r"found a#.obj and b#.obj with 3 each; move one"):
        load_clip(tmp_path)


def test_stale_frames_in_the_output_folder_are_an_error(tmp_path):
    cube = zoo.cube()
    save_clip(Clip(cube, frames_of(cube.vertices, 5)), tmp_path / "out")
    save_clip(Clip(cube, frames_of(cube.vertices, 6)), tmp_path / "out")
    with pytest.raises(InputError, match=r"found 0004.obj; choose a new folder"):
        save_clip(Clip(cube, frames_of(cube.vertices, 4)), tmp_path / "out")
    assert len(load_clip(tmp_path / "out")) == 6


def test_frames_of_another_format_in_the_output_folder_are_an_error(tmp_path):
    clip = Clip(zoo.cube(), np.stack([zoo.cube().vertices] * 2))
    save_clip(clip, tmp_path / "walk", suffix=".obj")
    with pytest.raises(InputError, match=r"without frames in another format, found 0000.obj"):
        save_clip(clip, tmp_path / "walk", suffix=".ply")
    assert len(load_clip(tmp_path / "walk")) == 2


def test_existing_output_folder_needs_no_writable_parent(tmp_path, monkeypatch):
    (tmp_path / "disk").mkdir()
    made, make = [], Path.mkdir
    monkeypatch.setattr(Path, "mkdir", lambda path, *args, **options: made.append(path) or make(path, *args, **options))
    save_clip(Clip.still(zoo.cube()), tmp_path / "disk")
    assert {path.parent for path in made if path.name.startswith(".")} == {tmp_path / "disk"}
    assert [path.name for path in (tmp_path / "disk").iterdir()] == ["0000.obj"]


def test_nan_in_a_later_frame_is_named_by_its_file(tmp_path):
    write_frames(tmp_path, ".obj", frames_of(zoo.cube().vertices, 3))
    (tmp_path / "2.obj").write_text((tmp_path / "0.obj").read_text().replace("v 0.0 0.0 1.0", "v 0.0 nan 1.0"))
    with pytest.raises(InputError, match=r"2\.obj: .* found NaN or infinity in 1 of 8"):
        load_clip(tmp_path)


def test_stl_frames_are_read_while_the_same_vertices_touch(tmp_path):
    both = zoo.two_parts()
    frames = [
        both.vertices,
        frames_of(both.vertices, 2)[1],
        both.vertices - np.repeat([[0, 0, 0], [2, 0, 0]], [4, 8], 0),
    ]
    for t, vertices in enumerate(frames[:2]):
        save_mesh(both.with_vertices(vertices), tmp_path / f"{t}.stl")
    clip = load_clip(tmp_path)
    np.testing.assert_allclose(clip.vertices[:, clip.mesh.faces], np.stack(frames[:2])[:, both.faces], atol=1e-6)
    save_mesh(both.with_vertices(frames[2]), tmp_path / "2.stl")  # the cube touches the tetrahedron's corner
    with pytest.raises(InputError, match=r"2\.stl: expected the topology of 0\.stl \(12 vertices"):
        load_clip(tmp_path)


def test_ply_frames_keep_vertices_that_touch(tmp_path):
    both = zoo.two_parts()
    frames = np.stack([both.vertices, both.vertices, frames_of(both.vertices, 2)[1]])
    frames[1, 4:] -= [2, 0, 0]
    for t, vertices in enumerate(frames):
        save_mesh(both.with_vertices(vertices), tmp_path / f"{t}.ply")
    np.testing.assert_array_equal(load_clip(tmp_path).vertices, frames)
    np.testing.assert_array_equal(load_clip(tmp_path).mesh.faces, both.faces)
