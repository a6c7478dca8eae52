"""OFF: a file is written again with only points and vertex normals changed."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import zoo
from nasty import bend, fan_triangles, rotation, triangle_soup

from mimesh.io import load_mesh, save_mesh

PLAIN = b"""OFF
# a roof
5 3 0   # vertices faces edges

0 0 0
1.00 0 0 255 0 0
1 1 0   # corner
0\t1 0
  0.5 0.5 1e0

4 3 2 1 0
3  0 1 4 1.0 0.5 0.25
5 1 2 3 0 4 7"""
COLOURED_ON_ONE_LINE = b"COFF 3 1 0\n0 0 0 1 0 0 1\n1 0 0 0 1 0 1\n0 1 0 0 0 1 1\n3 0 1 2\n"
NORMALS = b"NOFF\n3 1 0\n0 0 0  0 0 2  9\n1 0 0  0 0 2  9\n0 1 0  0 0 2  9\n3 0 1 2 8\n"
MODELNET = b"OFF3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
NO_KEYWORD = b"3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
FILES = {"plain": PLAIN, "coff": COLOURED_ON_ONE_LINE, "noff": NORMALS, "modelnet": MODELNET, "bare": NO_KEYWORD}


@pytest.fixture(params=[(name, end) for name in FILES for end in (b"\n", b"\r\n")], ids=str)
def off(request, tmp_path):
    path = tmp_path / "a.off"
    path.write_bytes(FILES[request.param[0]].replace(b"\n", request.param[1]))
    return path


def test_unmoved_mesh_gives_the_same_bytes(off, tmp_path):
    save_mesh(load_mesh(off), tmp_path / "b.off")
    assert (tmp_path / "b.off").read_bytes() == off.read_bytes()


def test_moved_points_read_back_exactly_and_faces_stay(off, tmp_path):
    mesh = load_mesh(off)
    save_mesh(mesh.with_vertices(bend(mesh.vertices)), tmp_path / "b.off")
    reread = load_mesh(tmp_path / "b.off")
    np.testing.assert_array_equal(reread.vertices, bend(mesh.vertices))
    np.testing.assert_array_equal(reread.faces, mesh.faces)


def test_only_coordinates_change(tmp_path):
    (tmp_path / "a.off").write_bytes(PLAIN)
    mesh = load_mesh(tmp_path / "a.off")
    np.testing.assert_array_equal(
        mesh.faces, [t for polygon in ([3, 2, 1, 0], [0, 1, 4], [1, 2, 3, 0, 4]) for t in fan_triangles(polygon)]
    )
    moved = mesh.vertices.copy()
    moved[1:4] += 0.25
    save_mesh(mesh.with_vertices(moved), tmp_path / "b.off")
    expected = PLAIN.replace(b"1.00 0 0 255", b"1.25 0.25 0.25 255").replace(b"1 1 0   # c", b"1.25 1.25 0.25   # c")
    assert (tmp_path / "b.off").read_bytes() == expected.replace(b"0\t1 0", b"0.25\t1.25 0.25")


def test_vertex_normals_rotate_with_the_surface(tmp_path):
    (tmp_path / "a.off").write_bytes(NORMALS)
    mesh = load_mesh(tmp_path / "a.off")
    save_mesh(mesh.with_vertices(mesh.vertices @ rotation().T), tmp_path / "b.off")
    np.testing.assert_allclose(load_mesh(tmp_path / "b.off").corner_normals[0], [rotation()[:, 2]] * 3, atol=1e-12)
    assert b"  9\n" in (tmp_path / "b.off").read_bytes()


@pytest.mark.parametrize("make", zoo.ZOO)
def test_new_file_of_any_mesh_reads_back_exactly(make, tmp_path):
    mesh = make()
    save_mesh(mesh, tmp_path / "new.off")
    reread = load_mesh(tmp_path / "new.off")
    np.testing.assert_array_equal(reread.vertices, mesh.vertices)
    np.testing.assert_array_equal(reread.faces, mesh.faces)
    if len(mesh.faces):
        other = trimesh.load(tmp_path / "new.off", process=False)
        np.testing.assert_array_equal(
            triangle_soup(other.vertices, other.faces), triangle_soup(mesh.vertices, mesh.faces)
        )
