"""PLY is read in three encodings and with every type; a new file has what was read of another."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import zoo
from nasty import bend, fan_triangles, rotation
from PIL import Image

from mimesh.core.errors import InputError
from mimesh.core.geometry import vertex_normals
from mimesh.core.mesh import Clip
from mimesh.io import load_mesh, save_clip, save_mesh

ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")
CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint32": "I", "float": "f", "double": "d"}
POLYGONS = [(0, 1, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def encode(encoding: str, elements: list, comments: tuple[str, ...] = (), end: str = "\n") -> bytes:
    """A PLY file, written value by value: `elements` are (name, [property lines], [rows])."""
    header = ["ply", f"format {encoding} 1.0", *comments]
    body = b""
    for name, properties, rows in elements:
        header += [f"element {name} {len(rows)}", *(f"property {text}" for text in properties)]
        for row in rows:
            body += encode_row(encoding, properties, row, end)
    return end.join([*header, "end_header", ""]).encode() + body


def encode_row(encoding: str, properties: list[str], row: tuple, end: str) -> bytes:
    values: list[tuple[str, float]] = []
    for text, value in zip(properties, row, strict=True):
        words = text.split()
        values += [(words[1], len(value))] if words[0] == "list" else []
        values += [(words[2], item) for item in value] if words[0] == "list" else [(words[0], value)]
    if encoding == "ascii":
        return " ".join(f"{value:g}" for _, value in values).encode() + end.encode()
    order = "<" if encoding == "binary_little_endian" else ">"
    return b"".join(struct.pack(order + CODES[kind], value) for kind, value in values)


def everything(encoding: str, end: str = "\n", polygons=POLYGONS, coordinate: str = "float", index: str = "uchar int"):
    """Build a cube with every feature of PLY: an element before the vertices, lists of several types, an edge."""
    cube = zoo.cube()
    normals = cube.vertices - 0.5
    vertices = [
        (*(v / 4).tolist(), *(n * 2).tolist(), 10 * i, 255, 0.125 * i, (i, 3))
        for i, (v, n) in enumerate(zip(cube.vertices, normals, strict=True))
    ]
    faces = [(7, polygon, [k / 8 for k in range(2 * len(polygon))], -i) for i, polygon in enumerate(polygons)]
    colours = ["uchar red", "uchar green", "double confidence", "list uchar short rings"]
    axes = [f"{coordinate} {axis}" for axis in ("x", "y", "z")]
    return encode(
        encoding,
        [
            ("camera", ["list uchar float view", "int id"], [((1, 2), 3), ((4, 5, 6), 7)]),
            ("vertex", [*axes, *(f"float n{axis}" for axis in "xyz"), *colours], vertices),
            ("face", ["uchar flag", f"list {index} vertex_indices", "list uchar float texcoord", "char q"], faces),
            ("edge", ["uint32 a", "ushort b"], [(0, 1), (70000, 2)]),
        ],
        ("comment made by hand", "obj_info and more"),
        end,
    )


@pytest.fixture(params=[(e, end) for e in ENCODINGS for end in ("\n", "\r\n")], ids=str)
def ply(request, tmp_path):
    path = tmp_path / "all.ply"
    path.write_bytes(everything(*request.param))
    return path


def test_points_polygons_normals_and_uv_are_read_and_written(ply, tmp_path):
    mesh = load_mesh(ply)
    np.testing.assert_array_equal(mesh.vertices, zoo.cube().vertices / 4)
    np.testing.assert_array_equal(mesh.faces, [t for polygon in POLYGONS for t in fan_triangles(list(polygon))])
    np.testing.assert_allclose(mesh.corner_normals, ((zoo.cube().vertices - 0.5) / np.sqrt(0.75))[mesh.faces])
    np.testing.assert_array_equal(mesh.corner_uv[1], [[0, 1 / 8], [4 / 8, 5 / 8], [6 / 8, 7 / 8]])
    turned = mesh.with_vertices(mesh.vertices @ rotation().T)
    save_mesh(turned, tmp_path / "turned.ply")
    reread = load_mesh(tmp_path / "turned.ply")
    np.testing.assert_array_equal(reread.vertices, turned.vertices.astype(np.float32))
    np.testing.assert_array_equal(reread.faces, mesh.faces)
    np.testing.assert_array_equal(reread.source.sizes, mesh.source.sizes)
    np.testing.assert_array_equal(reread.corner_uv, mesh.corner_uv)
    np.testing.assert_allclose(reread.corner_normals, turned.corner_normals, atol=1e-6)


def plain(
    encoding: str, polygons, coordinate: str = "float", index: str = "uchar int", name: str = "vertex_index"
) -> bytes:
    vertex = ("vertex", [f"{coordinate} {axis}" for axis in "xyz"], [tuple(v) for v in zoo.cube().vertices.tolist()])
    return encode(encoding, [vertex, ("face", [f"list {index} {name}"], [(polygon,) for polygon in polygons])])


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("index", ["uchar int", "int uint32", "ushort short", "char uchar"])
def test_every_count_and_index_type_is_read(encoding, index, tmp_path):
    for polygons in (POLYGONS, POLYGONS[3:], [*POLYGONS, (), (0,)]):  # mixed, quads, and with too few corners
        (tmp_path / "a.ply").write_bytes(plain(encoding, polygons, index=index))
        mesh = load_mesh(tmp_path / "a.ply")
        np.testing.assert_array_equal(mesh.faces, [t for p in polygons for t in fan_triangles(list(p))])


def test_mesh_far_from_the_origin_is_written_in_double_precision(tmp_path):
    (tmp_path / "a.ply").write_bytes(plain("ascii", POLYGONS, coordinate="double"))
    mesh = load_mesh(tmp_path / "a.ply")
    for number, offset in enumerate((0.0, 4e5)):
        moved = bend(mesh.vertices) + offset
        save_mesh(mesh.with_vertices(moved), tmp_path / f"{number}.ply")
        expected = moved if offset else moved.astype(np.float32)
        np.testing.assert_array_equal(load_mesh(tmp_path / f"{number}.ply").vertices, expected)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_file_without_faces_is_a_point_cloud(encoding, tmp_path):
    rows = [tuple(row) for row in zoo.point_cloud().vertices.round(3).tolist()]
    (tmp_path / "a.ply").write_bytes(encode(encoding, [("vertex", ["double x", "double y", "double z"], rows)]))
    mesh = load_mesh(tmp_path / "a.ply")
    assert mesh.faces.shape == (0, 3)
    np.testing.assert_allclose(mesh.vertices, rows, atol=1e-5)


def test_vertex_normals_rotate_with_the_surface(tmp_path):
    grid = zoo.grid()
    normals = vertex_normals(grid.vertices, grid.faces)
    rows = [(*v, *n) for v, n in zip(grid.vertices.tolist(), normals.tolist(), strict=True)]
    faces = [(tuple(face),) for face in grid.faces.tolist()]
    properties = [f"double {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    data = encode("binary_big_endian", [("vertex", properties, rows), ("face", ["list uchar int vertex_index"], faces)])
    (tmp_path / "a.ply").write_bytes(data)
    mesh = load_mesh(tmp_path / "a.ply")
    save_mesh(mesh.with_vertices(bend(mesh.vertices)), tmp_path / "b.ply")
    reread = load_mesh(tmp_path / "b.ply")
    np.testing.assert_allclose(
        reread.corner_normals, vertex_normals(reread.vertices, reread.faces)[reread.faces], atol=1e-6
    )


def test_texture_and_uv_per_vertex_are_read(tmp_path):
    Image.new("RGB", (1, 1)).save(tmp_path / "skin.png")
    rows = [(*v, *v[:2]) for v in zoo.cube().vertices.tolist()]
    properties = [f"float {name}" for name in ("x", "y", "z", "s", "t")]
    faces = ("face", ["list uchar int vertex_index"], [(polygon,) for polygon in POLYGONS])
    data = encode("binary_little_endian", [("vertex", properties, rows), faces], ("comment TextureFile skin.png",))
    (tmp_path / "a.ply").write_bytes(data)
    mesh = load_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.corner_uv, mesh.vertices[mesh.faces][..., :2])
    assert mesh.parts[0].material.texture == (tmp_path / "skin.png").read_bytes()
    save_mesh(mesh, tmp_path / "out" / "b.ply")
    reread = load_mesh(tmp_path / "out" / "b.ply")
    np.testing.assert_array_equal(reread.corner_uv, mesh.corner_uv)
    assert reread.parts[0].material == mesh.parts[0].material
    assert (tmp_path / "out" / "skin.png").read_bytes() == (tmp_path / "skin.png").read_bytes()
    save_clip(Clip(mesh, np.stack([mesh.vertices, bend(mesh.vertices)])), tmp_path / "clip", suffix=".ply")
    assert sorted(path.name for path in (tmp_path / "clip").iterdir()) == ["0000.ply", "0001.ply", "skin.png"]


def test_a_gaussian_splat_is_named_in_its_refusal(tmp_path):
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    names += [f"rot_{k}" for k in range(4)]
    header = ["ply", "format binary_little_endian 1.0", "element vertex 5", *(f"property float {n}" for n in names)]
    path = tmp_path / "splat.ply"
    path.write_bytes("\n".join([*header, "end_header\n"]).encode() + np.zeros((5, len(names)), "<f4").tobytes())
    with pytest.raises(InputError, match="found a Gaussian splat, no mesh; make a mesh"):
        load_mesh(path)
