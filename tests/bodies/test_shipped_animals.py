"""Shipped animals stand on four feet, are coloured, and differ in their proportions."""

import numpy as np
import pytest

from mimesh.bodies import load_body
from mimesh.bodies.animals import ANIMALS, animal, animal_body
from mimesh.core.errors import InputError
from mimesh.core.mesh import check_mesh


@pytest.mark.parametrize("name", ANIMALS)
def test_an_animal_stands_on_four_feet(name):
    mesh, body = check_mesh(animal(name), name), load_body("quadruped")
    height = np.ptp(mesh.vertices[:, 1])
    assert mesh.vertices[:, 1].min() == 0.0
    for joint in ("LeftFingers", "RightFingers", "LeftToes", "RightToes"):
        foot = mesh.vertices[body.weights[:, body.joint(joint)] > 0.5]
        assert foot[:, 1].min() < 0.03 * height
    assert (mesh.parts[0].start, mesh.parts[0].stop) == (0, len(mesh.faces))
    assert mesh.parts[0].material is not None


def test_animals_have_the_proportions_of_their_species():
    def share(name: str, first: str, last: str) -> float:
        """Length of a chain of two joints over the length of the trunk."""
        body = animal_body(name)
        ends = [body.joints[body.joint(joint)] for joint in (first, last, "Hips", "Chest")]
        return float(np.linalg.norm(ends[1] - ends[0]) / np.linalg.norm(ends[3] - ends[2]))

    legs = {name: share(name, "LeftUpperArm", "LeftHand") for name in ANIMALS}
    assert min(legs, key=lambda name: legs[name]) == "rhino"
    necks = {name: share(name, "Neck1", "Head") for name in ANIMALS}
    assert sorted(necks, key=lambda name: necks[name])[-2:] == ["horse", "camel"]
    sizes = {name: float(np.ptp(animal(name).vertices[:, 1])) for name in ANIMALS}
    in_order = ("cat", "dog", "lion", "cow", "rhino", "camel", "horse")
    assert sorted(sizes, key=lambda name: sizes[name]) == list(in_order)


def test_errors_of_unknown_animals_list_the_known_ones():
    with pytest.raises(InputError, match="rhino"):
        animal("unicorn")
