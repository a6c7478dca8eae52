"""Facts of the test meshes, and a mesh for each warning."""

import dataclasses
import json

import gltf_samples as samples
import numpy as np
import pytest
import rigs
import zoo
from people import person, walk

import mimesh
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.io.beside import missing_images_notes
from mimesh.tools.convert import convert
from mimesh.tools.inspect import facts_of, inspect_file

COLUMNS = ("vertices", "positions", "faces", "components", "watertight", "boundary_edges", "non_manifold_edges")
COLUMNS += ("consistent_winding", "inside_out")
GOLDEN = {
    "tetrahedron": (4, 4, 4, 1, True, 0, 0, True, False),
    "cube": (8, 8, 12, 1, True, 0, 0, True, False),
    "grid": (25, 25, 32, 1, False, 16, 0, True, None),
    "two_parts": (12, 12, 16, 2, True, 0, 0, True, False),
    "bow_tie": (7, 7, 4, 1, False, 9, 1, True, None),
    "point_cloud": (50, 50, 0, 0, False, 0, 0, True, None),
}


@pytest.fixture(autouse=True)
def no_way_it_stands(monkeypatch):
    """Leave out how a mesh stands, which a network finds in seconds."""
    monkeypatch.setattr("mimesh.tools.inspect._stance", lambda mesh: None)


def test_the_way_a_person_stands_is_told(monkeypatch):
    monkeypatch.undo()
    assert facts_of(person(0)).stands.startswith("up +y, front +z, taken for")


def split(mesh):
    """Give every face its own three vertices."""
    return Mesh(mesh.vertices[mesh.faces.ravel()], np.arange(mesh.faces.size).reshape(-1, 3), name=mesh.name)


@pytest.mark.parametrize("make", zoo.ZOO)
def test_golden_facts(make):
    facts = facts_of(make())
    assert tuple(getattr(facts, name) for name in COLUMNS) == GOLDEN[make.__name__]
    assert facts.name == make.__name__
    assert json.loads(json.dumps(facts.as_dict()))["vertices"] == facts.vertices
    lines = facts.text().splitlines()
    assert lines[0] == facts.name
    assert len({line[2:].index(line.split(maxsplit=1)[1]) for line in lines[1:]}) == 1  # aligned


@pytest.mark.parametrize("make", [m for m in zoo.ZOO if m is not zoo.point_cloud])
def test_order_and_split_vertices_do_not_matter(make):
    mesh, rng = make(), np.random.default_rng(0)
    whole = dataclasses.asdict(facts_of(mesh))
    shuffled = dataclasses.replace(mesh, faces=np.roll(rng.permutation(mesh.faces), 1, axis=1))
    assert dataclasses.asdict(facts_of(shuffled)) == whole
    split_facts = dataclasses.asdict(facts_of(split(mesh)))
    different = {key for key in whole if split_facts[key] != whole[key]}
    assert different <= {"vertices"}


def test_inverted_and_mixed_faces_are_warned_of():
    cube = zoo.cube()
    facts = facts_of(dataclasses.replace(cube, faces=cube.faces[:, ::-1]))
    assert facts.inside_out
    assert facts.warnings() == ["the faces look inwards; flip them"]
    assert "warning" in facts.text()
    faces = cube.faces.copy()
    faces[0] = faces[0, ::-1]
    facts = facts_of(dataclasses.replace(cube, faces=faces))
    assert (facts.consistent_winding, facts.inside_out, facts.watertight) == (False, None, True)
    assert "recalculate the winding" in facts.warnings()[0]


def test_mostly_closed_mesh_has_an_inside():
    n = 24
    angle = np.arange(n) * 2 * np.pi / n
    rings = [np.stack([np.cos(angle), np.full(n, y), -np.sin(angle)], axis=1) for y in np.linspace(0, 4, 30)]
    corner = np.arange(29 * n)
    after = corner // n * n + (corner + 1) % n
    faces = np.concatenate([np.stack([corner, after, after + n], 1), np.stack([corner, after + n, corner + n], 1)])
    tube = Mesh(np.concatenate(rings), faces)
    assert facts_of(tube).inside_out is False
    assert facts_of(dataclasses.replace(tube, faces=faces[:, ::-1])).inside_out is True


def test_degenerate_duplicate_and_loose_elements_are_counted():
    cube = zoo.cube()
    vertices = np.concatenate([cube.vertices, [[9.0, 9, 9], [0.5, 0.0, 0.0], [0.25, 0.0, 0.0]]])
    faces = np.concatenate([cube.faces, cube.faces[:1, [1, 2, 0]], [[0, 9, 10], [3, 3, 4]]])
    facts = facts_of(Mesh(vertices, faces))
    assert (facts.degenerate_faces, facts.duplicate_faces, facts.loose_vertices) == (2, 1, 1)
    text = " ".join(facts.warnings())
    assert "2 faces without area" in text
    assert "1 face drawn twice" in text
    assert "1 vertex of no face" in text
    assert "of three or more faces" in text


@pytest.mark.parametrize(
    ("height", "unit"),
    [(1.75, "m"), (17.5, "dm"), (175.0, "cm"), (1750.0, "mm"), (68.9, "inch"), (1.0, None), (5.0, None)],
)
def test_unit_is_guessed_from_the_longest_side(height, unit):
    cube = zoo.cube()
    facts = facts_of(cube.with_vertices(cube.vertices * [0.5 * height, height, 0.2 * height]))
    assert facts.unit_guess == unit
    assert facts.size == pytest.approx((0.5 * height, height, 0.2 * height))
    assert (f"if the unit is {unit}" in facts.text()) == (unit is not None)


def test_attributes_parts_and_materials_are_listed():
    cube = zoo.cube()
    paint = Material("paint", texture=b"png")
    mesh = dataclasses.replace(
        cube,
        corner_uv=np.zeros((12, 3, 2)),
        corner_normals=np.zeros((12, 3, 3)),
        parts=(Part("head", 0, 4, paint), Part("body", 4, 9, paint), Part("rest", 9, 12, Material("skin"))),
    )
    facts = facts_of(mesh)
    assert (facts.parts, facts.materials, facts.textures) == (("head", "body", "rest"), ("paint", "skin"), 1)
    assert "UVs, normals, 1 texture" in facts.text()
    assert "3: head, body, rest" in facts.text()


def test_materials_of_one_name_are_counted_each_and_long_lists_cut():
    parts = (Part("a", 0, 4, Material("skin", texture=b"one")), Part("b", 4, 12, Material("skin", texture=b"two")))
    facts = facts_of(dataclasses.replace(zoo.cube(), parts=parts))
    assert (facts.materials, facts.textures) == (("skin", "skin"), 2)
    parts = tuple(Part(f"p{k}", k, k + 1) for k in range(12))
    assert "12: p0, p1, p2, p3, p4, p5 and 6 more" in facts_of(dataclasses.replace(zoo.cube(), parts=parts)).text()


def test_clip_has_frames_and_seconds_and_a_mesh_has_none(tmp_path):
    mesh = zoo.cube()
    clip = Clip(mesh, np.repeat(mesh.vertices[None], 48, axis=0), 24.0)
    facts = facts_of(mesh, clip, tmp_path)
    assert (facts.frames, facts.fps, facts.seconds, facts.format) == (48, 24.0, 2.0, "folder")
    assert "48 frames at 24 per second, 2.00 s" in facts.text()
    still = facts_of(mesh, Clip(mesh, mesh.vertices[None], 24.0), tmp_path / "a.OBJ")
    assert (still.frames, still.fps, still.seconds, still.format) == (1, None, None, "obj")
    assert "fps" not in still.text()


def test_polygons_of_a_file_are_counted(tmp_path):
    path = tmp_path / "house.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 2 0\nf 1 2 3 4\nf 4 3 5\n")
    facts = inspect_file(path)
    assert (facts.name, facts.format, facts.polygons, facts.faces, facts.frames) == ("house.obj", "obj", 2, 3, 1)
    assert "3 triangles from 2 polygons" in facts.text()
    with pytest.raises(InputError, match=r"nothing\.obj"):
        inspect_file(tmp_path / "nothing.obj")


def test_notes_of_the_file_are_passed_on():
    class Source:
        suffix = ".glb"
        notes = ("dropped 1 skin",)

        def write(self, mesh, path): ...

    facts = facts_of(dataclasses.replace(zoo.cube(), source=Source()))
    assert facts.notes == ("dropped 1 skin",)
    assert "on writing" in facts.text()


@pytest.mark.slow
def test_missing_images_are_a_warning_also_with_a_rig(tmp_path):
    sample = samples.hero()
    sample.gltf["images"] = [{"uri": f"maps/{name}.png"} for name in ("a%20b", "c", "c", "d", "e")]
    sample.glb(tmp_path / "hero.glb")
    texts = inspect_file(tmp_path / "hero.glb").warnings()
    assert texts[0].startswith("maps/a b.png, maps/c.png, maps/d.png and 1 more, which the file names, are not beside")
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n")
    (tmp_path / "a.mtl").write_text("newmtl red\nmap_Kd -s 1 1 1 C:\\maps\\red wall.png\nbump\n")
    texts = inspect_file(tmp_path / "a.obj").warnings()
    assert texts[0].startswith("red wall.png, which the file names, is not beside it: ")
    notes = convert(tmp_path / "a.obj", tmp_path / "a.ply").notes
    assert any(note.startswith("red wall.png, which the file names") for note in notes)


def test_notes_show_the_names_of_missing_images():
    """Paths of another machine are cut, at their beginning; those below the file's folder say where to put them."""
    long, odd = "..\\..\\temp\\Humans\\without_opacity_version\\textures\\m023_body_color.tga", "x" * 100 + ".png"
    for name, shown in {
        long: "m023_body_color.tga",
        "C:/maps/red wall.png": "red wall.png",
        "/home/a/skin.jpg": "skin.jpg",
        "maps/skin.png": "maps/skin.png",
        odd: "x" * 76 + ".png",
    }.items():
        assert missing_images_notes([name])[0].startswith(f"{shown}, which the file names, is not beside it")
    (note,) = missing_images_notes(["C:\\a\\skin.png", "D:\\b\\skin.png"])
    assert note.startswith("skin.png, which the file names, is not beside it")


@pytest.mark.slow
def test_animate_says_which_images_are_missing(tmp_path):
    def lose_image(draft):
        draft.gltf["images"] = [{"uri": "skin.png"}]

    for clip in (walk(1, frames=2, faces=900), None):
        path = rigs.character(tmp_path / "hero.glb", frames=1, change=lose_image)
        notes = mimesh.animate(path, clip or path).notes
        assert any(note.startswith("skin.png, which the file names, is not beside it") for note in notes)
