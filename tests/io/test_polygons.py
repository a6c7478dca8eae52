"""Polygons are triangulated as fans, and written as polygons again."""

import struct

import numpy as np
import pytest

from mimesh.io import load_mesh, save_mesh
from mimesh.io.obj import write_obj
from mimesh.io.polygons import fan_corners, polygon_corners, polygons_of


def test_polygon_corners_inverts_fan_corners():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        sizes = rng.integers(3, 9, rng.integers(1, 40))
        corners = rng.integers(0, 1000, sizes.sum())
        triangles, _ = fan_corners(sizes)
        assert np.array_equal(corners[triangles].reshape(-1)[polygon_corners(sizes)], corners)


MIXED = (
    "o thing\n"
    + "".join(f"v {x} {y} {x * y}\nvt {x / 4} {y / 4}\n" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1), (2, 0), (2, 2)))
    + "usemtl red\nf 1/1 2/2 3/3 4/4\nf 2/2 5/5 6/6\nusemtl blue\nf 1/1 2/2 5/5 6/6 3/3\nf 4/1 3/2 2/3 1/4\n"
)
POLYGONS = [[0, 1, 2, 3], [1, 4, 5], [0, 1, 4, 5, 2], [3, 2, 1, 0]]


@pytest.mark.parametrize("steps", [("ply",), ("off",), ("ply", "obj"), ("off", "ply", "obj", "off"), ("obj", "ply")])
def test_polygons_and_seams_survive_conversion(steps, tmp_path):
    path = tmp_path / "0.obj"
    path.write_text(MIXED)
    mesh = first = load_mesh(path)
    for number, suffix in enumerate(steps, 1):
        path = tmp_path / f"{number}.{suffix}"
        save_mesh(mesh, path)
        mesh = load_mesh(path)
        assert polygons_of(mesh, mesh.faces) == POLYGONS
        assert np.array_equal(mesh.vertices, first.vertices)
        assert mesh.corner_uv is None or np.array_equal(mesh.corner_uv, first.corner_uv)
    assert mesh.corner_uv is not None or "off" in steps


def test_polygons_stay_in_their_parts(tmp_path):
    (tmp_path / "a.obj").write_text(MIXED)
    mesh = load_mesh(tmp_path / "a.obj")
    write_obj(mesh, tmp_path / "b.obj")
    reread = load_mesh(tmp_path / "b.obj")
    assert [(p.start, p.stop, p.material.name) for p in reread.parts] == [(0, 3, "red"), (3, 8, "blue")]
    assert polygons_of(reread, reread.faces) == POLYGONS


@pytest.mark.parametrize("corners", [127, 128, 300])
def test_polygons_with_more_corners_than_a_byte_counts_are_written(corners, tmp_path):
    angle = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    points = "".join(f"v {x} {y} 0\nvt {x} {y}\n" for x, y in zip(np.cos(angle), np.sin(angle), strict=True))
    (tmp_path / "a.obj").write_text(points + "f " + " ".join(f"{k}/{k}" for k in range(1, corners + 1)) + "\nf 1 2 3\n")
    save_mesh(load_mesh(tmp_path / "a.obj"), tmp_path / "b.ply")
    reread = load_mesh(tmp_path / "b.ply")
    assert polygons_of(reread, reread.faces) == [list(range(corners)), [0, 1, 2]]
    body = (tmp_path / "b.ply").read_bytes().partition(b"end_header\n")[2][12 * corners :]
    one, two = ("<B", "<i")[corners > 127], []
    while body:  # a naive reader of the faces
        for kind in ("<i", "<f"):
            (count,) = struct.unpack_from(one, body)
            two.append(list(struct.unpack_from(f"<{count}{kind[1]}", body, struct.calcsize(one))))
            body = body[struct.calcsize(one) + 4 * count :]
    assert (two[0], two[2]) == (list(range(corners)), [0, 1, 2])
    assert np.array_equal(np.reshape(two[1], (-1, 2)), np.float32(np.stack([np.cos(angle), np.sin(angle)], axis=1)))
