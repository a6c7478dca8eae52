"""Unusual names of materials, images and files: found, copied with the mesh, and unique in new files."""

from __future__ import annotations

import dataclasses
import struct

import gltf_samples as samples
import numpy as np
import pytest
import trimesh
import zoo
from nasty import triangle_soup

from mimesh.core.mesh import Material, Mesh, Part
from mimesh.io import load_mesh, save_mesh

POINTS = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FOLDER = "Größe & 大小 #1 %20"


def materials_of(mesh: Mesh) -> list[tuple]:
    """Return name, face range, colour and image of each part."""
    materials = [part.material or Material("") for part in mesh.parts]
    return [(p.name, p.start, p.stop, m.base_color, m.texture) for p, m in zip(mesh.parts, materials, strict=True)]


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
@pytest.mark.parametrize("library", ["Straße.mtl", "my looks ü.mtl", "sub folder/Größe.mtl"])
def test_names_in_utf8_and_latin1(encoding, library, tmp_path):
    folder = tmp_path / FOLDER
    (folder / library).parent.mkdir(parents=True, exist_ok=True)
    (folder / library).parent.joinpath("Mauer grün (1).png").write_bytes(samples.png())
    text = "# Überschrift\nnewmtl Ziegel süß\nKd 0.5 0.25 1\nmap_Kd Mauer grün (1).png\nnewmtl Größe\nd 0.5\n"
    (folder / library).write_bytes(text.encode(encoding))
    words = f"mtllib {library}\no Häuschen am Wald\nusemtl Ziegel süß\nf 1/1 2/2 3/3\nusemtl Größe\nf 1/1 3/3 4/4\n"
    (folder / "Haus ß.obj").write_bytes(words.encode(encoding) + POINTS)
    mesh = load_mesh(folder / "Haus ß.obj")
    assert materials_of(mesh) == [
        ("Häuschen am Wald", 0, 1, (0.5, 0.25, 1, 1), samples.png()),
        ("Häuschen am Wald", 1, 2, (0.8, 0.8, 0.8, 0.5), None),
    ]
    save_mesh(mesh, tmp_path / "out" / "Haus.obj")
    assert materials_of(load_mesh(tmp_path / "out" / "Haus.obj")) == materials_of(mesh)
    save_mesh(mesh, tmp_path / "Haus.glb")
    assert [p.material.name for p in load_mesh(tmp_path / "Haus.glb").parts] == ["Ziegel süß", "Größe"]


def test_all_images_of_a_material_are_copied(tmp_path):
    names = ["color.png", "bump map.png", "gloss.png", "mirror.png", "holes.png", "normal.png", "high.png"]
    (tmp_path / "in").mkdir()
    for name in names:
        (tmp_path / "in" / name).write_bytes(samples.png())
    statements = "map_Kd color.png\nmap_Bump -bm 0.5 bump map.png\nmap_Ns gloss.png\nrefl -type sphere mirror.png\n"
    library = "newmtl a\n" + statements + "map_d holes.png\nnorm normal.png\ndisp high.png\nmap_Ks lost.png\n"
    (tmp_path / "in" / "a.mtl").write_text(library)
    (tmp_path / "in" / "a.obj").write_bytes(b"mtllib a.mtl\nusemtl a\nf 1/1 2/2 3/3\n" + POINTS)
    save_mesh(load_mesh(tmp_path / "in" / "a.obj"), tmp_path / "out" / "b.obj")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted([*names, "a.mtl", "b.obj"])


def test_materials_of_equal_name_stay_separate_in_new_files(tmp_path):
    other = samples.png() + b"other"
    names = ["red", "red", "Red", "a b", "a_b", "a/b", "a:b", "default"]
    looks = [Material(name, (k / 8, 0.5, 1.0, 1.0), samples.png() + bytes([k])) for k, name in enumerate(names)]
    looks.append(Material("red", (0.0, 0.5, 1.0, 1.0), other))
    parts = tuple(Part(f"p{k}", k, k + 1, look) for k, look in enumerate([*looks, looks[0]]))
    cube = zoo.cube()
    mesh = dataclasses.replace(cube, parts=(*parts, Part("rest", 10, 12)), corner_uv=cube.vertices[cube.faces][..., :2])
    save_mesh(mesh, tmp_path / "a.obj")
    reread = load_mesh(tmp_path / "a.obj")
    assert [look[3:] for look in materials_of(reread)] == [look[3:] for look in materials_of(mesh)]
    assert reread.parts[10].material.name == "default"  # no statement ends a material in an OBJ
    assert len({part.material.name.lower() for part in reread.parts[:9]}) == 9
    assert reread.parts[9].material == reread.parts[0].material


def test_new_files_of_an_unusual_mesh_are_read_by_trimesh(tmp_path):
    mesh = load_mesh(samples.hero().glb(tmp_path / "a.glb"))
    for suffix in ("obj", "off", "stl", "ply"):
        save_mesh(mesh, tmp_path / f"{FOLDER}.{suffix}")
        other = trimesh.load(tmp_path / f"{FOLDER}.{suffix}", process=False, force="mesh")
        soups = [triangle_soup(m.vertices, m.faces) for m in (other, mesh)]
        assert np.allclose(*soups, rtol=1e-6, atol=1e-5)


def test_ply_texture_file_may_have_any_name(tmp_path):
    name = "a  skin  von größe 2.png"
    (tmp_path / name).write_bytes(samples.png())
    header = f"ply\nformat ascii 1.0\ncomment TextureFile {name}\nelement vertex 3\n"
    rows = "0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n"
    properties = "".join(f"property float {name}\n" for name in ("x", "y", "z", "s", "t"))
    faces = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(header + properties + faces + rows, "utf-8")
    mesh = load_mesh(tmp_path / "a.ply")
    assert mesh.parts[0].material.texture == samples.png()
    save_mesh(mesh, tmp_path / "out" / "b.ply")
    assert load_mesh(tmp_path / "out" / "b.ply").parts[0].material.texture == samples.png()


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"], ids=["LF", "CRLF", "CR"])
@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_ply_body_may_begin_with_a_line_feed(order, end, tmp_path):
    """The first byte after the header belongs to the body, whichever line end the header has."""
    encoding = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    lines = ["ply", f"format {encoding} 1.0", "element mark 1", "property uchar first", "element vertex 3"]
    lines += [*(f"property double {axis}" for axis in "xyz"), "end_header", ""]
    points = np.array([[1e9, -0.0, 1e-9], [1.0, 2.0, 3.0], [4.0, 5.0, 7.0]])
    data = end.join(lines).encode() + b"\n" + struct.pack(f"{order}9d", *points.ravel())
    (tmp_path / "a.ply").write_bytes(data)
    mesh = load_mesh(tmp_path / "a.ply")
    assert np.array_equal(mesh.vertices, points)
