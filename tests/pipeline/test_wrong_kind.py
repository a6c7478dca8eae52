"""What is neither a person nor a four-legged animal is said to be so, and networks of people say it of animals."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from animals import small
from grouped_options import grouped
from matrix import matrix
from people import person
from zoo import figure, point_cloud, ring, table

from mimesh.__main__ import run
from mimesh.bodies import load_body
from mimesh.bodies.animals import animal
from mimesh.core.errors import RefusedMeshError
from mimesh.core.mesh import Mesh, Part
from mimesh.io import save_mesh
from mimesh.methods.find import INDEX_PAIRED, find_mime
from mimesh.pipeline import transfer
from mimesh.pipeline.look import (
    REJECTION_THRESHOLD,
    Subject,
    fitting_body,
    has_large_parts,
    same_after_half_turn,
    second_look,
)
from mimesh.pipeline.rigging import rig
from mimesh.rigs.confidence import MAX_OTHER_KIND, MAX_SPREAD, OTHER_KIND, Confidence, Standards
from mimesh.tools.inspect import facts_of

pytestmark = pytest.mark.usefixtures("kept")

UP = ("+y", None)


MESHES = {"man": replace(person(0), name="man"), "cow": replace(small(animal("cow")), name="cow"), "ring": ring()}


def test_parts_beside_each_other_may_be_characters():
    man = Mesh(MESHES["man"].vertices, MESHES["man"].faces)
    count, half = len(man.vertices), len(man.faces)

    def joined(shift):
        vertices = np.concatenate([man.vertices, man.vertices + shift])
        parts = tuple(Part(f"part{k}", k * half, (k + 1) * half) for k in range(2))
        return Mesh(vertices, np.concatenate([man.faces, man.faces + count]), parts=parts)

    assert has_large_parts(joined([2.5, 0, 0]))
    assert not has_large_parts(joined([0, 0, 0.01])), "clothes"
    assert not has_large_parts(man)


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


THINGS = {"ring": ring(), "table": table()}


@pytest.mark.slow
@pytest.mark.parametrize("name", THINGS)
@pytest.mark.parametrize("beside", ["man", "cow"])
def test_a_thing_is_refused_in_one_line_unless_the_user_insists(name, beside):
    """In both places, and the person or the animal beside it is not blamed."""
    thing, other = THINGS[name], MESHES[beside]
    for pair in ((thing, other), (other, thing)):
        with pytest.raises(RefusedMeshError, match=f"^{name}: expected a person or a four-legged animal, as {beside}"):
            transfer(*pair, **grouped(up="+y", driving_up="+y"))
    assert (
        transfer(thing, other, **grouped(body="human", up="+y", driving_up="+y")).vertices.shape == thing.vertices.shape
    )
    with pytest.raises(RefusedMeshError, match=f"^{name}: .* say which with body=...(?!.*driving)"):
        rig(thing, **grouped(up="+y"))


@pytest.mark.slow
@pytest.mark.parametrize("scale", [0.01, 1, 100])
def test_a_figure_of_boxes_is_a_person_though_it_has_no_front(scale):
    steve = figure().with_vertices(scale * figure().vertices)
    assert rig(steve, **grouped(up="+y")).body == "human"
    transfer(steve, MESHES["man"], **grouped(up="+y", driving_up="+y"))


def test_tables_rings_and_figures_are_the_same_after_half_a_turn_and_bodies_are_not():
    shift, turn = [3.0, -2, 5], np.eye(3)[[1, 2, 0]]
    for mesh in (*THINGS.values(), figure()):
        for vertices in (mesh.vertices, 1e-3 * mesh.vertices + shift, 50 * mesh.vertices @ turn):
            assert same_after_half_turn(mesh.with_vertices(vertices)), mesh.name
    assert not any(same_after_half_turn(mesh) for mesh in (MESHES["man"], MESHES["cow"], point_cloud()))


def fit(body: str, misfit: float, spread: float = 5.0) -> Confidence:
    """A fit of a body with bent limbs, a spread of the predictions, and the mismatch of a misfit."""
    standards = Standards.of(load_body(body).joint_names)
    mismatch = np.expm1((misfit - OTHER_KIND["constant"] - 0.5 * OTHER_KIND["entropy"]) / OTHER_KIND["fit_distance"])
    return Confidence(spread, 0.5, {}, fit_distance=1e-3 * mismatch, flexion=100.0, standards=standards)


DOUBT, REFUSED = REJECTION_THRESHOLD - 0.1, REJECTION_THRESHOLD + 0.1


@pytest.mark.parametrize(
    ("person", "animal", "spread", "found"),
    [
        (0.5, 1.0, 5.0, "human"),
        (0.5, 0.3, 5.0, "quadruped"),
        (0.5, -1.0, 2 * MAX_SPREAD, "human"),
        (DOUBT, REFUSED, 5.0, "human"),
        (REFUSED, DOUBT, 2 * MAX_SPREAD, "quadruped"),
        (REFUSED, REFUSED + 0.1, 5.0, None),
    ],
)
def test_a_mesh_in_doubt_has_the_body_that_fits_better_and_one_that_fits_none_is_refused(person, animal, spread, found):
    """A mesh taken for a person; the spread is that of the predictions for an animal, which must agree to be better."""
    fits = {"human": fit("human", person), "quadruped": fit("quadruped", animal, spread)}
    assert fits["human"].misfit == pytest.approx(person)
    assert fitting_body("human", fits, turned=False) == found


@pytest.mark.parametrize(("distance", "found"), [(0.02, "human"), (0.08, None)])
def test_a_person_whose_surface_is_away_from_the_fitted_body_is_refused(distance, found, monkeypatch):
    """As people who sit and are read upside down, by predictions that agree."""
    read = replace(fit("human", -1.0), surface_distance=distance)
    monkeypatch.setattr("mimesh.pipeline.look.predicted_body", lambda *_: (None, None, fit("quadruped", 5.0)))
    assert second_look(find_mime("mime"), "human", Subject(MESHES["man"], UP), read) == found


@pytest.mark.parametrize(
    ("misfit", "spread", "found"),
    [(MAX_OTHER_KIND + 0.3, 19.0, "human"), (MAX_OTHER_KIND + 0.3, 23.0, None), (MAX_OTHER_KIND - 0.1, 90.0, "human")],
)
def test_what_hardly_looks_like_a_person_is_refused_where_predictions_contradict_each_other(misfit, spread, found):
    """Figures of blocks, which face both ways, are not."""
    fits = {"human": fit("human", misfit, spread), "quadruped": fit("quadruped", 5.0)}
    assert fitting_body("human", fits, turned=False) == found


@pytest.mark.parametrize(
    ("misfit", "entropy", "flexion", "found"),
    [
        (-0.2, 1.05, 10.0, "human"),
        (-0.2, 1.15, 10.0, None),
        (-0.4, 1.15, 10.0, "human"),
        (-0.2, 1.15, 90.0, "human"),
        (MAX_OTHER_KIND + 0.3, 0.6, 10.0, None),
        (MAX_OTHER_KIND + 0.3, 0.6, 90.0, "human"),
    ],
)
def test_what_has_straight_limbs_and_hardly_looks_like_a_person_is_refused(misfit, entropy, flexion, found):
    """As hands, cats that sit and aeroplanes. People who sit or lie, or are noisy, are harder to read."""
    read = fit("human", misfit - OTHER_KIND["entropy"] * (entropy - 0.5))
    fits = {"human": replace(read, weight_entropy=entropy, flexion=flexion), "quadruped": fit("quadruped", 5.0)}
    assert fits["human"].other_kind == pytest.approx(misfit)
    assert fitting_body("human", fits, turned=False) == found


@pytest.mark.parametrize(
    ("misfit", "enclosed", "found"),
    [(-1.0, 0.875, "human"), (-1.0, 0.75, None), (-3.0, 0.75, "human"), (-3.0, 0.5, None)],
)
def test_a_person_whose_joints_lie_outside_of_the_surface_is_refused(misfit, enclosed, found):
    """As creatures that fly or lack legs. Clothes without a body, which miss neck and hands, fit a person well."""
    fits = {"human": replace(fit("human", misfit), enclosed=enclosed), "quadruped": fit("quadruped", 5.0)}
    assert fitting_body("human", fits, turned=False) == found


def test_animals_with_straight_limbs_are_no_less_accepted():
    straight = replace(fit("quadruped", MAX_OTHER_KIND + 0.3), weight_entropy=1.0, flexion=10.0)
    assert straight.misfit == straight.other_kind


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


@pytest.mark.slow
def test_look_takes_a_mesh_for_what_rig_takes_it_for():
    """A short, high cow looks like a person to the networks alone; the fits tell."""
    cow = Mesh(MESHES["cow"].vertices * [1.3, 1.3, 0.45], MESHES["cow"].faces, name="cow")
    assert rig(cow).body == "quadruped"
    assert "taken for a four-legged animal" in (facts_of(cow).stands or "")
