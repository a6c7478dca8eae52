"""Primitives and people made of them: points on the surface, normals outwards, weights of joints that people have."""

import numpy as np
import pytest

from mimesh.bodies import load_body
from mimesh.learn.data.primitives import SHAPES, primitive_person, sample_primitive

BODY = load_body()
HALF = np.array([0.5, 2.0, 1.0])


@pytest.mark.parametrize("shape", SHAPES)
def test_points_fill_the_box_and_lie_on_the_surface(shape):
    points, normals = sample_primitive(shape, HALF, 4000, np.random.default_rng(0))
    unit = points / HALF
    flat = shape == "disc"
    assert np.abs(unit).max() <= 1 + 1e-9
    assert np.allclose(np.abs(unit).max(axis=0)[[0, 2]], 1, atol=0.05)
    assert np.isclose(np.abs(unit[:, 1]).max(), 0 if flat else 1, atol=0.05)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    x, y, z = unit.T
    around = np.hypot(x, z)
    distance = {
        "box": np.abs(np.abs(unit).max(axis=1) - 1),
        "ellipsoid": np.abs(np.linalg.norm(unit, axis=1) - 1),
        "cylinder": np.minimum(np.abs(around - 1), np.abs(np.abs(y) - 1)),
        "cone": np.minimum(np.abs(around - (1 - y) / 2), np.abs(y + 1)),
        "disc": np.abs(y),
    }[shape]
    assert distance.max() < 1e-9
    if not flat:
        assert (points * normals).sum(axis=1).min() > -1e-9


@pytest.mark.parametrize("seed", range(6))
def test_people_have_weights_of_their_own_joints_only(seed):
    person = primitive_person(BODY, np.random.default_rng(seed))
    np.testing.assert_allclose(person.weights.sum(axis=1), 1)
    used = person.weights.any(axis=0)
    assert person.turning[used].all()
    assert used[[BODY.joint(name) for name in ("Hips", "Head", "LeftArm", "RightUpLeg")]].all()
    assert person.alignment[BODY.joint("LeftUpLeg")] == pytest.approx(np.eye(3))
    # Left and right are alike, and a limb's points are around its bone.
    for name, tail in (("UpLeg", "Leg"), ("Arm", "ForeArm")):
        for side, sign in (("Left", 1), ("Right", -1)):
            own = person.points[person.weights[:, BODY.joint(side + name)] == 1]
            bone = person.joints[[BODY.joint(side + name), BODY.joint(side + tail)]]
            assert sign * (own[:, 0].mean() - person.joints[0, 0]) > 0
            assert np.linalg.norm(np.median(own, axis=0) - bone.mean(axis=0)) < 0.3


def test_figures_of_blocks_are_boxes_with_short_limbs():
    people = [primitive_person(BODY, np.random.default_rng(seed)) for seed in range(60)]
    arm, forearm, hips, head = (BODY.joint(name) for name in ("LeftArm", "LeftForeArm", "Hips", "Head"))
    length = np.array([np.linalg.norm(person.joints[forearm] - person.joints[arm]) for person in people])
    short = length < 0.999 * np.linalg.norm(BODY.joints[forearm] - BODY.joints[arm])
    assert 0.2 < short.mean() < 0.6
    for person, is_short in zip(people, short, strict=True):
        # Trunk and head stay where they are; a box has six directions of normals, each limb in its own frame.
        np.testing.assert_allclose(person.joints[head] - person.joints[hips], BODY.joints[head] - BODY.joints[hips])
        of_head = person.normals[person.weights[:, head] > 0.5]
        assert not is_short or len(np.unique(of_head.round(6), axis=0)) <= 6
