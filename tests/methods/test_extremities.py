"""Ends of limbs are found on surfaces, and correspond between meshes of other shapes and triangles."""

from __future__ import annotations

import numpy as np
import pytest
from animals import FEET, Animal, animal, bones, coefficients, random_turns
from creatures import BIRD, SPIDER, Boxes

from mimesh import animate
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Mesh, permute_vertices
from mimesh.core.normalization import Normalization
from mimesh.core.options import Hints
from mimesh.methods.extremities import find_ends, match_ends
from mimesh.pipeline.look import normalised

FRAMES = 4


def normal(mesh: Mesh) -> Mesh:
    return normalised(mesh, Normalization.fit(mesh, "+y", "+z"))


def slender() -> Animal:
    return Animal(coefficients(0, 0.5), bones())


def shuffled(mesh: Mesh) -> tuple[Mesh, np.ndarray]:
    """Renumber the vertices, so that nothing corresponds by index."""
    order = np.random.default_rng(0).permutation(len(mesh.vertices))
    return permute_vertices(mesh, order), order


def test_the_ends_of_a_spider_are_its_feet():
    mesh = Boxes.of(SPIDER).mesh
    ends = find_ends(normal(mesh))
    places = mesh.vertices[ends.vertices]
    feet = [end for name, (_, _, end) in SPIDER.items() if "Foot" in name]
    distance = np.linalg.norm(places[:, None] - np.array(feet), axis=-1)
    assert (distance.min(axis=0) < 0.15).all()


def test_a_mesh_matches_itself_whatever_its_order_and_size():
    mesh = animal().mesh
    other, order = shuffled(Mesh(3 * mesh.vertices, mesh.faces, name="other"))
    marks = match_ends(find_ends(normal(mesh)), find_ends(normal(other)))
    assert marks.confidence > 0.9
    assert marks.ends == 5  # four feet and the tail
    apart = np.linalg.norm(mesh.vertices[marks.pairs[:, 0]] - mesh.vertices[order[marks.pairs[:, 1]]], axis=1)
    assert apart.max() < 0.05 * np.ptp(mesh.vertices[:, 2])


def test_feet_of_two_animals_correspond():
    one, two = animal(), slender()
    marks = match_ends(find_ends(normal(one.mesh)), find_ends(normal(two.mesh)))
    assert marks.confidence > 0.7
    first, second = (normal(a.mesh).vertices[marks.pairs[: marks.ends, k]] for k, a in enumerate((one, two)))
    assert (np.sign(first[:, 2]) == np.sign(second[:, 2])).all()
    aside = np.abs(first[:, 0]) > 0.1
    assert (np.sign(first[aside, 0]) == np.sign(second[aside, 0])).all()


def test_what_is_not_alike_has_no_confidence():
    bird, spider, beast = (
        find_ends(normal(mesh)) for mesh in (Boxes.of(BIRD).mesh, Boxes.of(SPIDER).mesh, animal().mesh)
    )
    assert max(match_ends(bird, spider).confidence, match_ends(spider, beast).confidence) < 0.5


def test_an_animal_moves_by_another_mesh_from_the_ends_of_its_limbs():
    """As a creature without rigs. Measured: 0.0025 from the truth, the still identity 0.13."""
    one, two = animal(), slender()
    moving = [name for name in bones() if name not in FEET and name != "Hips"]
    turns = [{}, *(random_turns(t, moving) for t in range(1, FRAMES))]
    identity, order = shuffled(one.mesh)
    frames = np.stack([two.posed(turn) for turn in turns])
    driving = Clip(Mesh(frames[0], two.mesh.faces, name="two"), frames, 30.0)
    result = animate(
        identity, driving, hints=Hints(body="other", up="+y", front="+z", driving_up="+y", driving_front="+z")
    )
    assert result.report["reference"]["frame"] == 0
    truth = np.stack([one.posed(turn)[order] for turn in turns])

    def error(vertices: np.ndarray) -> float:
        offset = (vertices - vertices.mean(axis=1, keepdims=True)) - (truth - truth.mean(axis=1, keepdims=True))
        return float(np.linalg.norm(offset[1:], axis=-1).mean())

    assert error(result.clip.vertices) < 0.1 * error(np.stack([identity.vertices] * FRAMES))
    assert any("ends of limbs were found" in note for note in result.notes)


def test_too_few_ends_are_refused():
    bird, beast = Boxes.of(BIRD).mesh, animal().mesh
    clip = Clip(beast, np.stack([beast.vertices] * 2), 30.0)
    with pytest.raises(InputError, match="limbs whose ends correspond"):
        animate(bird, clip, hints=Hints(body="other"))
    with pytest.raises(InputError, match=r"give reference=... and markers"):
        animate(bird, Clip.still(beast), hints=Hints(body="other"))
