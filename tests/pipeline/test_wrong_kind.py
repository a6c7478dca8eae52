"""What is neither a person nor a four-legged animal is said to be so, and networks of people say it of animals."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from animals import small
from grouped_options import grouped
from matrix import matrix
from people import person
from zoo import ring

from mimesh.bodies.animals import animal
from mimesh.cli import run
from mimesh.core.mesh import Mesh
from mimesh.io import save_mesh
from mimesh.methods.find import INDEX_PAIRED, find_mime
from mimesh.pipeline import transfer
from mimesh.pipeline.look import Subject, second_look

pytestmark = pytest.mark.usefixtures("kept")

UP = ("+y", None)


MESHES = {"man": replace(person(0), name="man"), "cow": replace(small(animal("cow")), name="cow"), "ring": ring()}


@pytest.fixture
def files(tmp_path):
    """A person, a cow and a ring as .obj, which says neither axes nor joints."""
    for name, mesh in MESHES.items():
        save_mesh(Mesh(mesh.vertices, mesh.faces, name=name), tmp_path / f"{name}.obj")
    return {name: str(tmp_path / f"{name}.obj") for name in MESHES}


def report_of(words, capsys) -> dict:
    capsys.readouterr()
    assert run([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


FITS = [
    ("human", "man", "human"),
    ("quadruped", "man", "human"),
    ("human", "cow", "quadruped"),
    ("human", "ring", None),
]


@matrix(("taken", "name", "found"), FITS, quick=FITS[1:2])
def test_a_fit_finds_the_body_that_a_mesh_has(taken, name, found):
    assert second_look(find_mime("mime"), taken, Subject(MESHES[name], UP)) == found


@pytest.mark.slow
def test_a_thing_moved_as_a_person_is_noted_with_a_large_error(files, tmp_path, capsys):
    """Whoever says that it is a person gets a result, and the note."""
    words = ["transfer", files["ring"], files["man"], "--body", "human", "-o", str(tmp_path / "out.obj")]
    found = report_of(words, capsys)
    assert any("ring does not look like a person, as far as can be told" in note for note in found["report"]["notes"])
    assert found["report"]["identity"]["expected_error"] >= 0.15
    assert not any("man does not look" in note for note in found["report"]["notes"])


@pytest.mark.slow
def test_a_thing_beside_a_person_is_never_moved_without_a_word(files, tmp_path, capsys):
    """It is refused where it is taken for an animal, else noted; the person is not blamed."""
    code = run(["transfer", files["ring"], files["man"], "-o", str(tmp_path / "out.obj")])
    said = "".join(capsys.readouterr())
    assert code in (0, 2)
    assert "ring does not look like a person" in said or "ring: expected a person or a four-legged animal" in said
    assert "man does not" not in said


@pytest.mark.slow
@pytest.mark.parametrize("model", ["npt-maxpool", "aniformer"])
def test_networks_of_people_say_that_an_animal_is_none(model):
    axes = {"up": "+y", "driving_up": "+y"}
    notes = transfer(MESHES["cow"], MESHES["cow"], model, **grouped(**axes)).notes
    weights = INDEX_PAIRED.get(model, model)  # a cow and itself have the same triangles
    said = f"cow looks like a four-legged animal, as far as can be told, and the weights of {weights} were trained on "
    assert sum(said in note for note in notes) == 2
    for mesh, options in ((MESHES["cow"], {"body": "human"}), (MESHES["man"], {})):
        assert "trained on people" not in " ".join(transfer(mesh, mesh, model, **grouped(**axes, **options)).notes)


@pytest.mark.slow
def test_look_says_what_a_mesh_without_a_rig_is_taken_for(files, capsys):
    for name, said in (
        ("man", "taken for a person"),
        ("cow", "taken for a four-legged animal"),
        ("ring", "looks neither like a person nor like a four-legged animal"),
    ):
        assert run(["look", files[name]]) == 0
        assert said in capsys.readouterr().out
