"""Polygons become fans of triangles, and come back whole."""

import numpy as np
import pytest

from mimesh.io import load_mesh, save_mesh
from mimesh.io.polygons import fan_corners, polygon_corners, polygon_sizes
from mimesh.mesh import Mesh


@pytest.mark.parametrize("seed", range(5))
def test_polygons_come_back_from_their_fans(seed):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(3, 9, rng.integers(1, 40))
    corners = rng.integers(0, 1000, sizes.sum())
    triangles, _ = fan_corners(sizes)
    assert np.array_equal(corners[triangles].reshape(-1)[polygon_corners(sizes)], corners)


def test_a_file_says_how_large_its_polygons_are(tmp_path):
    path = tmp_path / "mixed.obj"
    points = "".join(f"v {x} {y} 0\n" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1), (2, 0), (2, 2)))
    path.write_text(points + "f 1 2 3 4\nl 1 5\nf 2 5 6\nf 1 2 5 6 3\n")
    mesh = load_mesh(path)
    assert polygon_sizes(mesh).tolist() == [4, 3, 5]
    assert mesh.faces.reshape(-1)[polygon_corners(polygon_sizes(mesh))].tolist() == [0, 1, 2, 3, 1, 4, 5, 0, 1, 4, 5, 2]
    moved = mesh.with_vertices(mesh.vertices + 1)
    save_mesh(moved, tmp_path / "moved.obj")
    assert polygon_sizes(load_mesh(tmp_path / "moved.obj")).tolist() == [4, 3, 5]


def test_without_a_file_all_are_triangles():
    mesh = Mesh(np.eye(3), np.array([[0, 1, 2], [2, 1, 0]]))
    assert polygon_sizes(mesh).tolist() == [3, 3]
