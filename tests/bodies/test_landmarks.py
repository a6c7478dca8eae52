"""Landmarks lie where their names say, on the side they say."""

import numpy as np
import pytest

from mimesh.bodies import load_body
from mimesh.bodies.body_model import LANDMARKS, landmarks

BODY = load_body()
FOUND = landmarks(BODY)


def test_there_are_13_and_all_differ():
    assert tuple(FOUND) == LANDMARKS
    assert len(set(FOUND.values())) == 13


@pytest.mark.parametrize("name", LANDMARKS)
def test_sides_mirror(name):
    place = BODY.vertices[FOUND[name]]
    if name == "head":
        assert abs(place[0]) < 0.03
        return
    side, what = name.split()
    assert place[0] > 0 if side == "left" else place[0] < 0
    other = BODY.vertices[FOUND[f"{'right' if side == 'left' else 'left'} {what}"]]
    assert np.linalg.norm(place - other * [-1, 1, 1]) < 0.05


def test_ends_are_ends():
    x, y, z = BODY.vertices.T
    assert BODY.vertices[FOUND["head"], 1] > y.max() - 0.02
    assert BODY.vertices[FOUND["left hand"], 0] > x.max() - 0.02
    assert BODY.vertices[FOUND["left foot"], 2] > z[y < 0.1].max() - 0.03
    assert BODY.vertices[FOUND["left elbow"], 1] == pytest.approx(BODY.joints[BODY.joint("LeftForeArm"), 1], abs=0.06)
