"""OBJ: a file is written again with only points and normals changed, and any mesh as a new file."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
import trimesh
import zoo
from nasty import (
    CUBE_SHARED_NORMALS,
    NASTY_OBJ,
    SHEETS_SHARED_NORMALS,
    bend,
    naive_obj,
    rotation,
    triangle_soup,
    triangles_of,
)
from PIL import Image

from mimesh.core.errors import InputError
from mimesh.core.geometry import face_vectors
from mimesh.core.mesh import Material, Part
from mimesh.io import load_mesh, save_mesh
from mimesh.pipeline.parts import named_parts

FILES = {"nasty": NASTY_OBJ, "cube": CUBE_SHARED_NORMALS, "sheets": SHEETS_SHARED_NORMALS}


@pytest.fixture(params=[(name, end) for name in FILES for end in (b"\n", b"\r\n")], ids=str)
def obj(request, tmp_path):
    name, end = request.param
    path = tmp_path / f"{name}.obj"
    path.write_bytes(FILES[name].replace(b"\n", end))
    return path


def lines_without(data: bytes, *keywords: bytes) -> list[bytes]:
    """Return the lines that begin with none of the keywords; a continued line is joined with the next."""
    lines = re.sub(rb"(?<!twice )\\\r?\n", b"\\\\", data).splitlines(keepends=True)
    return [line for line in lines if (line.split() or [b""])[0] not in keywords]


def bend_and_save(source, target):
    """Bend the mesh of a file and save it; return the original mesh, the bent mesh and the mesh read again."""
    mesh = load_mesh(source)
    moved = mesh.with_vertices(bend(mesh.vertices))
    save_mesh(moved, target)
    return mesh, moved, load_mesh(target)


def test_moved_points_read_back_exactly_with_their_normals_and_only_normal_indices_change(obj, tmp_path):
    mesh, moved, reread = bend_and_save(obj, tmp_path / "moved.obj")
    np.testing.assert_array_equal(reread.vertices, moved.vertices)
    np.testing.assert_array_equal(reread.faces, mesh.faces)
    assert reread.parts == mesh.parts
    if mesh.corner_uv is not None:
        np.testing.assert_array_equal(reread.corner_uv, mesh.corner_uv)
    before, after = (lines_without(path.read_bytes(), b"v", b"vn") for path in (obj, tmp_path / "moved.obj"))
    assert after != before
    assert [re.sub(rb"(\d/\d*/)-?\d+", rb"\1", line) for line in after] == [
        re.sub(rb"(\d/\d*/)-?\d+", rb"\1", line) for line in before
    ]
    _, polygons, file_normals = naive_obj((tmp_path / "moved.obj").read_bytes())
    assert file_normals.keys() == naive_obj(obj.read_bytes())[2].keys()
    checked = 0
    for face, polygon in enumerate(triangles_of(polygons)[1]):
        for corner, vertex in enumerate(mesh.faces[face]):
            if (polygon, vertex) in file_normals:
                np.testing.assert_allclose(file_normals[polygon, vertex], moved.corner_normals[face, corner], atol=3e-6)
                checked += 1
    assert checked >= 12


def test_shared_normal_is_split_and_only_normal_indices_change(tmp_path):
    (tmp_path / "a.obj").write_bytes(SHEETS_SHARED_NORMALS)
    bend_and_save(tmp_path / "a.obj", tmp_path / "b.obj")
    before, after = (lines_without((tmp_path / name).read_bytes(), b"v", b"vn") for name in ("a.obj", "b.obj"))
    corners = [[re.sub(rb"//-?\d+", b"//", line, count=3) for line in lines] for lines in (before, after)]
    assert corners[0] == corners[1]
    assert before != after
    lines = (tmp_path / "b.obj").read_bytes().splitlines()
    words = [line.split()[0] for line in lines]
    first_face = words.index(b"f")
    used = [int(word.split(b"//")[1]) for line in lines[first_face : first_face + 2] for word in line.split()[1:]]
    assert max(used) <= words[:first_face].count(b"vn"), "a face refers to a normal that comes later"


def test_rigid_motion_rotates_shared_normals_in_place(tmp_path):
    (tmp_path / "cube.obj").write_bytes(CUBE_SHARED_NORMALS)
    mesh = load_mesh(tmp_path / "cube.obj")
    turn = rotation()
    save_mesh(mesh.with_vertices(mesh.vertices @ turn.T + [1, 2, 3]), tmp_path / "turned.obj")
    turned = load_mesh(tmp_path / "turned.obj")
    normals = face_vectors(turned.vertices, turned.faces)
    np.testing.assert_allclose(
        turned.corner_normals,
        np.repeat(normals[:, None] / np.linalg.norm(normals, axis=1)[:, None, None], 3, 1),
        atol=1e-5,
    )
    text = (tmp_path / "turned.obj").read_bytes()
    assert lines_without(text, b"v", b"vn") == lines_without(CUBE_SHARED_NORMALS, b"v", b"vn")


def test_unmoved_vertices_keep_their_text_and_colours_stay(tmp_path):
    (tmp_path / "a.obj").write_bytes(NASTY_OBJ)
    mesh = load_mesh(tmp_path / "a.obj")
    vertices = mesh.vertices.copy()
    vertices[2] = [0.1, -2.0, 1 / 3]
    save_mesh(mesh.with_vertices(vertices), tmp_path / "b.obj")
    text = (tmp_path / "b.obj").read_bytes()
    assert b"v\t0.1 -2.0 0.3333333333333333\t0.1 0.2 0.3   # corner\n" in text
    assert b"v 1.000000 0 0 0 0 0\n" in text
    assert b"v 1 1 \\\n  1\n" in text


def test_cr_line_ends_and_byte_order_mark_are_kept(tmp_path):
    data = b"\xef\xbb\xbf" + CUBE_SHARED_NORMALS.split(b"\n", 1)[1].replace(b"\n", b"\r")
    (tmp_path / "mac.obj").write_bytes(data)
    mesh, moved, reread = bend_and_save(tmp_path / "mac.obj", tmp_path / "moved.obj")
    assert len(mesh.vertices) == 8
    np.testing.assert_array_equal(reread.vertices, moved.vertices)
    assert (tmp_path / "moved.obj").read_bytes().startswith(b"\xef\xbb\xbfv ")


def test_parts_and_uv_of_the_unusual_file(tmp_path):
    (tmp_path / "a.obj").write_bytes(NASTY_OBJ)
    mesh = load_mesh(tmp_path / "a.obj")
    runs = [(part.name, part.material and part.material.name, part.start, part.stop) for part in mesh.parts]
    assert runs == [
        ("walls front", "Brick", 0, 4),
        ("walls front", "Plaster", 4, 9),
        ("Lid", "Plaster", 9, 15),
        ("Lid", None, 15, 16),
    ]
    np.testing.assert_array_equal(mesh.corner_uv[0], [[0, 0], [0, 1], [1, 1]])
    np.testing.assert_array_equal(mesh.corner_uv[6], np.zeros((3, 2)))  # 1//4: no texture coordinate
    np.testing.assert_array_equal(mesh.corner_normals[0], [[0, 0, -1]] * 3)  # the file says 0 0 -2
    assert mesh.parts[0].material == Material("Brick")  # its library is missing


@pytest.fixture
def painted(tmp_path):
    """An OBJ with a library in its folder and an image in a folder below, named the Windows way."""
    folder = tmp_path / "in"
    (folder / "maps").mkdir(parents=True)
    Image.new("RGB", (2, 2), (250, 10, 10)).save(folder / "maps" / "red wall.png")
    (folder / "looks.mtl").write_text(
        "# comment\nnewmtl Brick\nKd 0.5 0.25 0.125\nTr 0.25\nmap_Kd -s 1 1 1 -clamp on maps\\red wall.png\n"
        "\tnewmtl Plaster\n\tKd spectral x.rfl\n\td 0.5\n\tmap_Kd ../outside.png\n"
    )
    (folder / "my looks.mtl").write_text("newmtl Other\nKd 0 0 0\n")
    (tmp_path / "outside.png").write_bytes((folder / "maps" / "red wall.png").read_bytes())
    (folder / "house.obj").write_bytes(NASTY_OBJ)
    return folder / "house.obj"


def test_groups_know_the_object_that_they_are_in(tmp_path):
    path = tmp_path / "a.obj"
    points = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    path.write_text(f"{points}f 1 2 3\no hero\nf 1 2 3\ng legs\nf 1 2 3\ng arms\nf 1 2 3\n{points}o crate\nf 4 5 6\n")
    mesh = load_mesh(path)
    found = [(part.name, part.object) for part in mesh.parts]
    assert found == [("", ""), ("hero", "hero"), ("legs", "hero"), ("arms", "hero"), ("crate", "crate")]
    assert named_parts(mesh)["hero"].tolist() == [False, True, True, True, False]


def test_materials_are_read_from_the_library(painted):
    brick, plaster = (load_mesh(painted).parts[k].material for k in (0, 1))
    assert brick.base_color == (0.5, 0.25, 0.125, 0.75)
    assert brick.texture == (painted.parent / "maps" / "red wall.png").read_bytes()
    assert plaster.base_color == (0.8, 0.8, 0.8, 0.5)


def test_library_and_images_are_copied_without_overwriting(painted, tmp_path):
    out = tmp_path / "deep" / "out"
    out.mkdir(parents=True)
    (out / "my looks.mtl").write_text("mine")
    save_mesh(load_mesh(painted), out / "moved.obj")
    files = sorted(
        str(path.relative_to(tmp_path / "deep")) for path in (tmp_path / "deep").rglob("*") if path.is_file()
    )
    assert files == ["out/looks.mtl", "out/maps/red wall.png", "out/moved.obj", "out/my looks.mtl"]
    assert (out / "my looks.mtl").read_text() == "mine"
    assert load_mesh(out / "moved.obj").parts[0] == load_mesh(painted).parts[0]


@pytest.mark.parametrize("with_uv", [False, True])
@pytest.mark.parametrize("with_normals", [False, True])
def test_new_file_keeps_corner_data_and_parts(with_uv, with_normals, tmp_path):
    texture = tmp_path / "t.png"
    Image.new("RGB", (1, 1)).save(texture)
    cube = zoo.cube()
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(12, 3, 3))
    red = Material("deep red", (1.0, 0.0, 0.0, 0.5), texture.read_bytes())
    mesh = dataclasses.replace(
        cube,
        corner_uv=rng.random((12, 3, 2)) if with_uv else None,
        corner_normals=normals / np.linalg.norm(normals, axis=-1, keepdims=True) if with_normals else None,
        parts=(Part("low", 0, 4, red), Part("high", 4, 12, Material("b"))),
    )
    save_mesh(mesh, tmp_path / "out" / "cube.obj")
    reread = load_mesh(tmp_path / "out" / "cube.obj")
    assert [(p.name, p.start, p.stop) for p in reread.parts] == [("low", 0, 4), ("high", 4, 12)]
    assert reread.parts[0].material == dataclasses.replace(red, name="deep_red")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["cube.mtl", "cube.obj", "cube_deep_red.png"]
    assert (reread.corner_uv is not None, reread.corner_normals is not None) == (with_uv, with_normals)
    if with_uv:
        np.testing.assert_array_equal(reread.corner_uv, mesh.corner_uv)
    if with_normals:
        np.testing.assert_allclose(reread.corner_normals, mesh.corner_normals, atol=2e-6)
    other = trimesh.load(tmp_path / "out" / "cube.obj", process=False, force="mesh")
    np.testing.assert_array_equal(triangle_soup(other.vertices, other.faces), triangle_soup(mesh.vertices, mesh.faces))


def test_saving_a_mesh_of_another_size_over_its_source_is_refused(tmp_path):
    (tmp_path / "a.obj").write_bytes(CUBE_SHARED_NORMALS)
    mesh = load_mesh(tmp_path / "a.obj")
    more = np.concatenate([mesh.vertices, mesh.vertices[:1]])
    with pytest.raises(ValueError, match=r"the file has vertices \(8, 3\)"):
        save_mesh(dataclasses.replace(mesh, vertices=more), tmp_path / "b.obj")
    assert not (tmp_path / "b.obj").exists()


def test_texture_coordinates_may_have_one_two_or_three_numbers(tmp_path):
    triangle = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n%bf 1/1 2/2 3/3\n"
    mixed = (b"vt 0.5\nvt 0.25 0.75\nvt 1 0.125 0\n", [[0.5, 0], [0.25, 0.75], [1, 0.125]])
    for lines, expected in (mixed, (b"vt .5\nvt .25 # u\nvt 1\n", [[0.5, 0], [0.25, 0], [1, 0]])):
        (tmp_path / "a.obj").write_bytes(triangle % lines)
        np.testing.assert_array_equal(load_mesh(tmp_path / "a.obj").corner_uv, [expected])
    (tmp_path / "a.obj").write_bytes(triangle % b"vt 0.5\nvt\nvt 1\n")
    with pytest.raises(InputError, match=r"expected 2 numbers in line 5, found 'vt'"):
        load_mesh(tmp_path / "a.obj")
