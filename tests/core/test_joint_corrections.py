"""Corrected joints are checked against the mesh and the model before they are used."""

import numpy as np
import pytest

from mimesh.core.errors import InputError
from mimesh.core.joint_corrections import JointCorrections

NAMES = ("Hips", "LeftLeg", "LeftFoot")
BOX = np.array([[0.0, 0, 0], [1, 2, 1]])


def test_positions_in_and_near_the_mesh_pass():
    corrections = JointCorrections.of({"LeftLeg": (0.5, 0.5, 0.5), "Hips": [-0.9, 1, 1.9]}, vertices=2)
    corrections.check(BOX, NAMES, "hero")
    assert corrections.positions["LeftLeg"].dtype == np.float64


@pytest.mark.parametrize("value", [(1, 2), (1, 2, np.nan), ("a", 2, 3), None, 5, [[1, 2, 3]], (1, 2, 1e999)])
def test_positions_are_three_finite_numbers(value):
    with pytest.raises(InputError, match="three finite numbers for LeftLeg"):
        JointCorrections.of({"LeftLeg": value})


@pytest.mark.parametrize(
    ("positions", "fields", "message"),
    [
        ({"LeftLegg": (0, 0, 0)}, {}, "did you mean LeftLeg"),
        ({"Tail": (0, 0, 0)}, {}, "use one of Hips, LeftLeg, LeftFoot"),
        ({"Hips": (0, 0, 0)}, {"vertices": 3}, "hero with 2 vertices, found those of a mesh with 3"),
        ({"Hips": (0, 3.1, 0)}, {}, "expected Hips near hero, .* found it at 0 3.1 0"),
        ({"Hips": (0, 0, -1.1)}, {}, "axes and unit of the mesh's file"),
    ],
)
def test_corrections_that_do_not_belong_to_the_mesh_are_refused(positions, fields, message):
    with pytest.raises(InputError, match=message):
        JointCorrections.of(positions, "hero.joints.json", **fields).check(BOX, NAMES, "hero")


PERSON = 1.7 * np.array([[-0.5, 0, -0.1], [0.5, 1, 0.1]])
"""Corners of the box of a person in metres."""


@pytest.mark.parametrize("names", [("LeftLeg", "LeftFoot"), ("LeftFoot",)])
@pytest.mark.parametrize("known", [True, False])
def test_joints_in_another_unit_are_refused(names, known):
    positions = {
        name: place for name, place in (("LeftLeg", (0.1, 0.5, 0)), ("LeftFoot", (0.1, 0.1, 0))) if name in names
    }
    found = JointCorrections.found_on(PERSON, JointCorrections.of(positions).positions)
    corrections = found if known else JointCorrections(found.positions)
    corrections.check(PERSON, NAMES, "hero")
    with pytest.raises(
        InputError, match=r"longest side is 170, found .*; give positions in the unit of the mesh's file"
    ):
        corrections.check(100 * PERSON, NAMES, "hero")
    crouching = PERSON * [0.8, 0.55, 3]
    corrections.check(crouching, NAMES, "hero")


def test_hips_may_be_at_the_origin():
    JointCorrections.of({"Hips": (0, 0.001, 0)}).check(PERSON - [0, 0.9, 0], NAMES, "hero")
