"""Landmarks are at the ends and sides of the body that their names say."""

import numpy as np
import pytest

from mimesh.bodies import load_body
from mimesh.bodies.body_model import LANDMARKS, landmarks

BODY = load_body()
FOUND = landmarks(BODY)


def test_there_are_13_distinct_landmarks():
    assert tuple(FOUND) == LANDMARKS
    assert len(set(FOUND.values())) == 13


@pytest.mark.parametrize("name", LANDMARKS)
def test_landmarks_of_both_sides_are_mirror_images(name):
    position = BODY.vertices[FOUND[name]]
    if name == "head":
        assert abs(position[0]) < 0.03
        return
    side, part = name.split()
    assert position[0] > 0 if side == "left" else position[0] < 0
    other = BODY.vertices[FOUND[f"{'right' if side == 'left' else 'left'} {part}"]]
    assert np.linalg.norm(position - other * [-1, 1, 1]) < 0.05


def test_landmarks_of_ends_are_extreme_vertices():
    x, y, z = BODY.vertices.T
    assert BODY.vertices[FOUND["head"], 1] > y.max() - 0.02
    assert BODY.vertices[FOUND["left hand"], 0] > x.max() - 0.02
    assert BODY.vertices[FOUND["left foot"], 2] > z[y < 0.1].max() - 0.03
    assert BODY.vertices[FOUND["left elbow"], 1] == pytest.approx(BODY.joints[BODY.joint("LeftForeArm"), 1], abs=0.06)
