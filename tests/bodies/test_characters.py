"""Characters and animals stand on the floor, have materials on all faces, and the proportions that they should."""

import numpy as np
import pytest

from mimesh.bodies import CHARACTERS, character, load_body
from mimesh.bodies.animals import ANIMALS, animal, animal_body
from mimesh.bodies.characters import proportioned
from mimesh.core.errors import InputError
from mimesh.core.mesh import check_mesh

BODY = load_body()


@pytest.mark.parametrize(("make", "name"), [(character, name) for name in CHARACTERS] + [(animal, n) for n in ANIMALS])
def test_each_stands_on_the_floor_with_materials_on_all_faces(make, name):
    mesh = check_mesh(make(name), name)
    assert mesh.vertices[:, 1].min() == 0.0
    assert [part.start for part in mesh.parts[1:]] == [part.stop for part in mesh.parts[:-1]]
    assert (mesh.parts[0].start, mesh.parts[-1].stop) == (0, len(mesh.faces))
    assert all(part.material for part in mesh.parts)
    for joint in ("LeftFingers", "RightFingers", "LeftToes", "RightToes") if make is animal else ():
        body = load_body("quadruped")
        foot = mesh.vertices[body.weights[:, body.joint(joint)] > 0.5]
        assert foot[:, 1].min() < 0.03 * np.ptp(mesh.vertices[:, 1])


def test_animals_have_the_proportions_of_their_species():
    def share(name: str, first: str, last: str) -> float:
        """Length of a chain of two joints over the length of the trunk."""
        body = animal_body(name)
        ends = [body.joints[body.joint(joint)] for joint in (first, last, "Hips", "Chest")]
        return float(np.linalg.norm(ends[1] - ends[0]) / np.linalg.norm(ends[3] - ends[2]))

    assert min(ANIMALS, key=lambda name: share(name, "LeftUpperArm", "LeftHand")) == "rhino"
    assert sorted(ANIMALS, key=lambda name: share(name, "Neck1", "Head"))[-2:] == ["horse", "camel"]
    in_order = sorted(ANIMALS, key=lambda name: float(np.ptp(animal(name).vertices[:, 1])))
    assert in_order == ["cat", "dog", "lion", "cow", "rhino", "camel", "horse"]


@pytest.mark.parametrize(("make", "known"), [(character, "slim"), (animal, "rhino")])
def test_errors_of_unknown_names_list_the_known_ones(make, known):
    with pytest.raises(InputError, match=known):
        make("nobody")


def test_factors_of_one_change_nothing():
    same = proportioned(BODY, {"Leg": 1.0}, {"Head": 1.0})
    assert np.abs(same.vertices - BODY.vertices + [0, BODY.vertices[:, 1].min(), 0]).max() < 1e-12
    assert np.abs(same.components - BODY.components).max() < 1e-12


def test_bones_are_scaled_by_their_factors_on_both_sides_and_for_every_shape():
    scaled, shape = proportioned(BODY, {"UpLeg": 1.5}, {"Spine1": 0.7}, size=2.0), np.linspace(-1, 1, 16)
    for joints, others in ((BODY.joints, scaled.joints), (BODY.shaped(shape)[1], scaled.shaped(shape)[1])):
        for side in ("Left", "Right"):
            hip, knee, foot = (BODY.joint(side + name) for name in ("UpLeg", "Leg", "Foot"))
            before, after = (np.linalg.norm(positions[knee] - positions[hip]) for positions in (joints, others))
            assert after / before == pytest.approx(3.0, rel=0.01)  # shapes turn bones a little
            before, after = (np.linalg.norm(positions[foot] - positions[knee]) for positions in (joints, others))
            assert after / before == pytest.approx(2.0)


def test_unknown_bones_are_refused():
    with pytest.raises(InputError, match="Tail"):
        proportioned(BODY, {"Tail": 2.0}, {})
