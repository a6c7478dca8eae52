"""Characters stand on the floor, have materials on all faces, and bones scaled by the given factors."""

import numpy as np
import pytest

from mimesh.bodies import CHARACTERS, character, load_body
from mimesh.bodies.characters import proportioned
from mimesh.core.errors import InputError
from mimesh.core.mesh import check_mesh

BODY = load_body()


@pytest.mark.parametrize("name", CHARACTERS)
def test_every_character_stands_on_the_floor_with_materials_on_all_faces(name):
    mesh = check_mesh(character(name), name)
    assert mesh.vertices[:, 1].min() == 0.0
    assert [part.start for part in mesh.parts[1:]] == [part.stop for part in mesh.parts[:-1]]
    assert (mesh.parts[0].start, mesh.parts[-1].stop) == (0, len(mesh.faces))
    assert all(part.material for part in mesh.parts)


def test_errors_of_unknown_characters_list_the_known_ones():
    with pytest.raises(InputError, match="slim"):
        character("nobody")


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
