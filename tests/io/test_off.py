"""OFF and its variants are read; a new file has the points and polygons."""

from __future__ import annotations

import numpy as np
import pytest
from nasty import bend, fan_triangles

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


def test_moved_points_read_back_exactly_and_faces_stay(off, tmp_path):
    mesh = load_mesh(off)
    save_mesh(mesh.with_vertices(bend(mesh.vertices)), tmp_path / "b.off")
    reread = load_mesh(tmp_path / "b.off")
    np.testing.assert_array_equal(reread.vertices, bend(mesh.vertices))
    np.testing.assert_array_equal(reread.faces, mesh.faces)


def test_polygons_are_fans_in_memory_and_polygons_in_a_new_file_and_normals_are_read(tmp_path):
    (tmp_path / "a.off").write_bytes(PLAIN)
    mesh = load_mesh(tmp_path / "a.off")
    np.testing.assert_array_equal(
        mesh.faces, [t for polygon in ([3, 2, 1, 0], [0, 1, 4], [1, 2, 3, 0, 4]) for t in fan_triangles(polygon)]
    )
    save_mesh(mesh, tmp_path / "b.off")
    assert (tmp_path / "b.off").read_text().splitlines()[-3:] == ["4 3 2 1 0", "3 0 1 4", "5 1 2 3 0 4"]
    (tmp_path / "c.off").write_bytes(NORMALS)
    np.testing.assert_array_equal(load_mesh(tmp_path / "c.off").corner_normals, [[[0, 0, 1]] * 3])
