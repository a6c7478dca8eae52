"""Characters in scenes: which part is meant, what stays, and figures on bases."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import rigs
from people import person, walk

import mimesh
from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh, Part
from mimesh.core.normalization import Normalization, flat_side
from mimesh.core.options import Hints
from mimesh.io import load_clip, load_mesh, save_mesh
from mimesh.io.gltf.draft import Draft
from mimesh.pipeline import animate, prepare, transfer
from mimesh.pipeline.parts import find_part

CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 0) for z in (-1, 1)], float)
SIDES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4]]
BASE = np.array([*SIDES, [1, 5, 7], [1, 7, 3]])
"""Triangles of a box, whose top is at y = 0."""


def on_base(figure: Mesh, half: float = 0.6, height: float = 0.2) -> Mesh:
    """Put a figure on a box, as a file of two parts."""
    standing = figure.vertices - [0, figure.vertices[:, 1].min(), 0]
    vertices = np.concatenate([standing, CORNERS * [half, height, half]])
    count = len(figure.faces)
    parts = Part("hero", 0, count), Part("base", count, count + len(BASE))
    return Mesh(vertices, np.concatenate([figure.faces, BASE + len(standing)]), "scene", parts=parts)


def with_props(draft: Draft) -> None:
    """Add a pedestal that nothing moves, and a second person who has no joints, larger than the first."""
    for name, mesh in (("pedestal", Mesh(CORNERS, BASE)), ("statue", person(1, faces=1000))):
        positions = draft.add_floats(mesh.vertices + [2, 0, 0], 34962, bounds=True)
        primitive = {"attributes": {"POSITION": positions}, "indices": draft.add_indices(mesh.faces)}
        draft.gltf["meshes"].append({"primitives": [primitive]})
        draft.gltf["nodes"].append({"name": name, "mesh": len(draft.gltf["meshes"]) - 1})
        draft.gltf["scenes"][0]["nodes"].append(len(draft.gltf["nodes"]) - 1)


def with_second(draft: Draft) -> None:
    """Add the same character again, two metres aside, below a node called "twin"."""
    nodes, old = draft.gltf["nodes"], len(draft.gltf["nodes"])
    draft.gltf["skins"].append(
        {**draft.gltf["skins"][0], "joints": [j + old for j in draft.gltf["skins"][0]["joints"]]}
    )
    for node in list(nodes):
        children = {"children": [child + old for child in node["children"]]} if "children" in node else {}
        nodes.append({**node, **children} | ({"skin": 1} if "skin" in node else {}))
    nodes.append({"name": "twin", "translation": [2.0, 0, 0], "children": [old]})
    draft.gltf["scenes"][0]["nodes"].append(len(nodes) - 1)


def with_gear(draft: Draft) -> None:
    """Add a second character, and to the first a coat with the same skin and a box in the left hand."""
    with_second(draft)
    nodes, meshes = draft.gltf["nodes"], draft.gltf["meshes"]
    body = next(node for node in nodes if "mesh" in node)
    meshes.append({**meshes[body["mesh"]], "name": "coat"})
    positions = draft.add_floats(0.001 * CORNERS, 34962, bounds=True)
    meshes.append({"primitives": [{"attributes": {"POSITION": positions}, "indices": draft.add_indices(BASE)}]})
    hand = next(node for node in nodes if node.get("name") == "LeftHand")
    hand["children"] = [*hand.get("children", []), len(nodes) + 1]
    nodes += [{**body, "name": "coat", "mesh": len(meshes) - 2}, {"name": "sword", "mesh": len(meshes) - 1}]
    draft.gltf["scenes"][0]["nodes"].append(len(nodes) - 2)


@pytest.fixture(scope="module")
def driving(tmp_path_factory) -> Path:
    return rigs.of_kind(tmp_path_factory.mktemp("driving") / "move.glb", "T-pose")[0]


def test_static_parts_stay_and_the_rig_is_used(model, driving, tmp_path):
    scene = rigs.character(tmp_path / "scene.glb", 1, change=with_props)
    alone = animate(str(rigs.character(tmp_path / "alone.glb", 1)), str(driving), model)
    moved = animate(str(scene), str(driving), model)
    assert moved.report["rig"] == "own"
    said = "scene has parts that no joint and no animation moves, which stay where they are: pedestal, statue"
    assert [note for note in moved.notes if note not in alone.notes] == [said]
    assert said not in animate(str(driving), str(scene), model).notes
    count, rest = len(alone.mesh.vertices), load_mesh(scene).vertices
    assert moved.clip.vertices.shape == (6, len(rest), 3)
    np.testing.assert_allclose(moved.clip.vertices[:, :count], alone.clip.vertices, atol=1e-5)
    np.testing.assert_allclose(moved.clip.vertices[:, count:], np.tile(rest[count:], (6, 1, 1)), atol=1e-6)
    moved.save_skinned(tmp_path / "out.glb")
    np.testing.assert_allclose(load_clip(tmp_path / "out.glb").vertices, moved.clip.vertices, atol=2e-5)


def test_several_characters_are_named_and_one_can_be_taken(model, driving, tmp_path):
    scene = rigs.character(tmp_path / "scene.glb", 1, change=with_second)
    with pytest.raises(InputError, match=r"^scene: expected one character, found 2: body 1, twin; say which with part"):
        animate(str(scene), str(driving), model)
    moved = transfer(str(scene), str(driving), model, hints=Hints(part="TWIN"))
    count, rest = len(load_mesh(scene).vertices) // 2, load_mesh(scene).vertices
    assert moved.report["rig"] == "own"
    np.testing.assert_allclose(moved.vertices[:count], rest[:count], atol=1e-6)
    assert np.linalg.norm(moved.vertices[count:] - rest[count:], axis=1).max() > 1e-3
    message = r"scene: expected one of its parts \(.*twin.*\) for part=\"hat\"; name one of them"
    with pytest.raises(InputError, match=message):
        transfer(str(scene), str(driving), model, hints=Hints(part="hat"))
    first = transfer(str(scene), str(driving), model, hints=Hints(part="body 1"))
    np.testing.assert_allclose(first.vertices[count:], rest[count:], atol=1e-6)
    np.testing.assert_allclose(first.vertices[:count] + [2, 0, 0], moved.vertices[count:], atol=1e-5)
    # As a driving, both are still, and the one that is taken is that at 2 m.
    taken = find_part(load_mesh(scene), "twin")
    assert taken is not None
    assert np.median(taken.mesh.vertices[:, 0]) == pytest.approx(2, abs=0.05)
    captured = mimesh.capture(str(scene), model, hints=Hints(part="twin"))
    assert captured.root[0, 0] == pytest.approx(2, abs=0.05)


def test_a_mesh_of_a_character_stands_for_all_that_its_joints_move(model, driving, tmp_path):
    scene = rigs.character(tmp_path / "scene.glb", 1, change=with_gear)
    rest = load_mesh(scene)
    span = {part.name: np.unique(rest.faces[part.start : part.stop]) for part in rest.parts}
    assert {"coat", "sword"} <= span.keys()
    moved = animate(str(scene), str(driving), model, hints=Hints(part="coat"))
    assert np.ptp(moved.clip.vertices[:, span["sword"]], axis=0).min() > 0.01
    moved.save_skinned(tmp_path / "out.glb")
    np.testing.assert_allclose(load_clip(tmp_path / "out.glb").vertices, moved.clip.vertices, atol=2e-5)
    person, coat, sword = (find_part(rest, name) for name in ("armature 1", "coat", "sword"))
    assert person is not None
    assert coat is not None
    assert sword is not None
    assert set(person.index) == set(coat.index)
    assert set(span["sword"]) < set(coat.index)
    assert len(sword.index) == len(CORNERS)


def test_a_part_of_any_file_is_moved_and_written(model, tmp_path):
    scene, clip = on_base(person(0)), walk()
    save_mesh(scene, tmp_path / "scene.obj")
    hints = Hints(part="hero", body="human")
    moved = animate(str(tmp_path / "scene.obj"), clip, model, hints=hints)
    alone = animate(find_part(scene, "hero").mesh, clip, model, hints=Hints(body="human"))
    np.testing.assert_allclose(moved.clip.vertices[:, :-8], alone.clip.vertices, atol=1e-5)
    np.testing.assert_array_equal(moved.clip.vertices[:, -8:], np.tile(scene.vertices[-8:], (4, 1, 1)).astype("f4"))
    assert moved.mesh.faces.shape == scene.faces.shape
    moved.save_skinned(tmp_path / "out.glb")
    written = load_clip(tmp_path / "out.glb")
    still = np.ptp(np.asarray(written.vertices), axis=0).max(axis=1) < 1e-6
    assert still.sum() == 8
    live = prepare(scene, clip, model, hints=hints)
    np.testing.assert_array_equal(live.pose(clip.vertices[2])[-8:], scene.vertices[-8:])
    rigged = mimesh.rig(scene, model, hints=hints)
    assert len(rigged.mesh.vertices) == len(scene.vertices)
    assert (rigged.skeleton.group[-8:] == -1).all()


def test_a_part_of_the_driving_is_followed(model):
    both, clip = on_base(person(2)), walk(2)
    frames = np.concatenate([clip.vertices, np.tile(both.vertices[-8:], (4, 1, 1))], axis=1)
    scene = mimesh.Clip(dataclasses.replace(both, vertices=frames[0]), frames, clip.fps)
    hints = Hints(driving_part="hero", body="human")
    moved = animate(person(0), scene, model, hints=hints)
    alone = animate(person(0), clip, model, hints=Hints(body="human"))
    np.testing.assert_allclose(moved.clip.vertices, alone.clip.vertices, atol=1e-5)


@pytest.mark.parametrize(("half", "height"), [(0.4, 0.05), (0.6, 0.2), (0.7, 0.5), (3.0, 0.02)])
def test_a_figure_on_a_base_stands_on_it(half, height):
    scene = on_base(person(0, faces=2000), half, height)
    for up, vertices in (("+y", scene.vertices), ("+z", scene.vertices[:, [0, 2, 1]] * [1, -1, 1])):
        turned = dataclasses.replace(scene, vertices=vertices, parts=())
        assert Normalization.fit(turned).up == up
        part = find_part(turned, None)
        assert part is not None
        np.testing.assert_array_equal(part.index, np.arange(len(scene.vertices) - 8))
        assert part.notes[0].startswith("the base of scene stays where it is")


def test_shoes_that_are_pieces_of_their_own_are_no_base():
    """As flat below as the floor that they stand on."""
    figure = person(0, faces=2000)
    figure = figure.with_vertices(figure.vertices - [0, figure.vertices[:, 1].min(), 0])
    shoes = np.concatenate([(CORNERS + [0, 1, 0]) * [0.05, 0.08, 0.13] + [x, -0.01, 0.04] for x in (-0.12, 0.12)])
    faces = [figure.faces, *(BASE + len(figure.vertices) + start for start in (0, 8))]
    shod = Mesh(np.concatenate([figure.vertices, shoes]), np.concatenate(faces), "shod")
    for half, height in ((2.0, 0.0), (0.6, 0.2)):
        part = find_part(on_base(shod, half, height), None)
        assert part is not None
        np.testing.assert_array_equal(part.index, np.arange(len(shod.vertices)))


def test_people_have_no_base():
    for mesh in (person(0), person(1, pose=3)):
        assert flat_side(mesh)[0] is None
        assert find_part(mesh, None) is None


def test_a_flat_side_alone_is_no_base():
    """Of a slender cone it has more of the surface than a person's soles, and less of it than a base has."""
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)
    faces = [(k, (k + 1) % 24, 24) for k in range(24)] + [((k + 1) % 24, k, 25) for k in range(24)]
    cone = Mesh(np.concatenate([ring, [[0, 9.8, 0], [0, 0, 0]]]), np.array(faces), "cone")
    assert flat_side(cone)[0] == "-y"
    assert find_part(cone, None) is None
