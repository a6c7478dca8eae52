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
