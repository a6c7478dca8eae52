"""Folders of STL and OFF frames: triangle soups are welded as the first frame."""

from __future__ import annotations

import re

import numpy as np
import pytest
import zoo
from nasty import bend, rotation

from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.io import load_clip, load_mesh, save_mesh


def write_text(path, mesh: Mesh) -> None:
    lines = ["solid a"]
    for triangle in mesh.vertices[mesh.faces]:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x:.9g} {y:.9g} {z:.9g}" for x, y, z in triangle]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid a", ""]))


def single(vertices: np.ndarray) -> np.ndarray:
    return vertices.astype(np.float32).astype(np.float64)


@pytest.mark.parametrize("write", [lambda path, mesh: save_mesh(mesh, path), write_text], ids=["binary", "text"])
def test_vertices_that_touch_in_a_later_frame_stay_separate(write, tmp_path):
    both = zoo.two_parts()
    frames = [both.vertices.copy() for _ in range(4)]
    frames[1][4:] -= [2, 0, 0]  # the cube touches the tetrahedron's corner
    frames[2][7] = frames[2][5]  # an edge has no length
    frames[3] = single(bend(both.vertices))
    for t, vertices in enumerate(frames):
        write(tmp_path / f"{t}.stl", both.with_vertices(vertices))
    assert len(load_mesh(tmp_path / "1.stl").vertices) == 11
    clip = load_clip(tmp_path)
    assert len(clip.mesh.vertices) == 12
    np.testing.assert_allclose(clip.vertices[:, clip.mesh.faces], np.stack(frames)[:, both.faces], atol=1e-6)


def test_vertex_split_after_the_first_frame_is_explained(tmp_path):
    both = zoo.two_parts()
    touching = both.vertices.copy()
    touching[4:] -= [2, 0, 0]
    save_mesh(both.with_vertices(touching), tmp_path / "0.stl")
    save_mesh(both, tmp_path / "1.stl")
    words = (
        r"1\.stl: expected triangles that meet in the first frame to stay together, found vertex 2 apart in triangle"
    )
    with pytest.raises(InputError, match=words):
        load_clip(tmp_path)


def test_corners_of_one_vertex_may_differ_by_rounding(tmp_path):
    mesh = zoo.cube().with_vertices(zoo.cube().vertices + 100)
    write_text(tmp_path / "0.stl", mesh)
    turned = mesh.vertices @ rotation().T
    text = ["solid a"]
    rng = np.random.default_rng(0)
    for triangle in turned[mesh.faces]:
        text += ["facet normal 0 0 0", "outer loop"]
        text += [f"vertex {x} {y} {z}" for x, y, z in triangle + 1e-5 * rng.random((3, 3))]
        text += ["endloop", "endfacet"]
    (tmp_path / "1.stl").write_text("\n".join([*text, "endsolid a", ""]))
    clip = load_clip(tmp_path)
    np.testing.assert_allclose(clip.vertices[1, clip.mesh.faces], turned[mesh.faces], atol=2e-5)


def test_frame_with_another_number_of_triangles_is_named(tmp_path):
    save_mesh(zoo.cube(), tmp_path / "0.stl")
    save_mesh(zoo.two_parts(), tmp_path / "1.stl")
    with pytest.raises(InputError, match=re.escape("1.stl: expected 12 triangles as in the first frame, found 16")):
        load_clip(tmp_path)


def test_off_frames_keep_vertices_that_touch(tmp_path):
    both = zoo.two_parts()
    frames = np.stack([both.vertices, both.vertices, single(bend(both.vertices))])
    frames[1, 4:] -= [2, 0, 0]
    for t, vertices in enumerate(frames):
        save_mesh(both.with_vertices(vertices), tmp_path / f"{t}.off")
    np.testing.assert_array_equal(load_clip(tmp_path).vertices, frames)
    np.testing.assert_array_equal(load_clip(tmp_path).mesh.faces, both.faces)
