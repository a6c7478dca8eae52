"""STL: corners are welded, and a new file has the triangles in the same order, with their normals."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import trimesh
import zoo
from nasty import rotation

from mimesh.core.mesh import Mesh
from mimesh.io import load_mesh, save_mesh


def binary(mesh: Mesh, header: bytes = b"solid but binary", tail: bytes = b"") -> bytes:
    """A binary STL with another attribute on each facet."""
    data = header.ljust(80, b"\0") + struct.pack("<I", len(mesh.faces))
    for i, triangle in enumerate(mesh.vertices[mesh.faces]):
        data += struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 1000 + i)
    return data + tail


def text(mesh: Mesh, end: str = "\n") -> bytes:
    """A text STL of two solids, with numbers that a program would not write this way."""
    lines = ["solid first half"]
    for i, triangle in enumerate(mesh.vertices[mesh.faces]):
        lines += ["endsolid", "solid second"] if i == 2 else []
        lines += ["  FACET normal 0 0 0.00", "    outer loop"]
        lines += [f"\tvertex  {x:.4f} {y:e} {z:g}" for x, y, z in triangle]
        lines += ["    endloop", "  endfacet"]
    return end.join([*lines, "endsolid second", ""]).encode()


FILES = {
    "binary": binary(zoo.two_parts()),
    "tail": binary(zoo.two_parts(), b"made by hand", b"more"),
    "text": text(zoo.two_parts()),
    "text crlf": text(zoo.two_parts(), "\r\n"),
}


@pytest.fixture(params=FILES)
def stl(request, tmp_path):
    path = tmp_path / "a.stl"
    path.write_bytes(FILES[request.param])
    return path


def test_corners_are_welded_and_moved_triangles_keep_their_order_and_get_normals(stl, tmp_path):
    mesh = load_mesh(stl)
    soup = zoo.two_parts().vertices[zoo.two_parts().faces]
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], soup)
    assert len(mesh.vertices) == 12
    first_seen = list(dict.fromkeys(mesh.faces.ravel().tolist()))
    assert first_seen == list(range(12))
    solids = [("first half", 0, 2), ("second", 2, 16)] if b"FACET" in stl.read_bytes() else []
    assert [(part.name, part.start, part.stop) for part in mesh.parts] == solids
    moved = mesh.with_vertices((mesh.vertices @ rotation().T).astype(np.float32).astype(np.float64))
    save_mesh(moved, tmp_path / "b.stl")
    reread = load_mesh(tmp_path / "b.stl")
    np.testing.assert_array_equal(reread.vertices, moved.vertices)
    np.testing.assert_array_equal(reread.faces, mesh.faces)
    other = trimesh.load(tmp_path / "b.stl", process=False, force="mesh")
    np.testing.assert_allclose(other.triangles, moved.vertices[moved.faces], atol=1e-6)
    cross = other.triangles_cross
    np.testing.assert_allclose(other.face_normals, cross / np.linalg.norm(cross, axis=1)[:, None], atol=1e-5)


def test_minus_zero_is_welded_with_zero(tmp_path):
    mesh = Mesh(
        np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-0.0, 0, 0], [0, -1, 0]], float), np.array([[0, 1, 2], [3, 4, 1]])
    )
    (tmp_path / "a.stl").write_bytes(binary(mesh))
    assert len(load_mesh(tmp_path / "a.stl").vertices) == 4
