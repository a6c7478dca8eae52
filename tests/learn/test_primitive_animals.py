"""Animals of primitives for training: sound surfaces, weights of joints that they have, left and right alike."""

from functools import cache

import numpy as np
import pytest
from animals import BODY, LEGS

from mimesh.bodies.character_limbs import SIDES
from mimesh.learn.data.characters import body_spread
from mimesh.learn.data.primitive_animals import primitive_animal
from mimesh.learn.data.primitives import PACK

SEEDS = range(8)


@cache
def made(seed: int):
    return primitive_animal(BODY, np.random.default_rng(seed))


def legs_of(animal) -> dict[str, tuple[str, ...]]:
    """List the bones that an animal's forelegs and hind legs have."""
    has = [name for name, turning in zip(BODY.joint_names, animal.turning, strict=True) if turning]
    return {kind: tuple(part for part in chain if f"Left{part}" in has) for kind, chain in LEGS.items()}


@pytest.mark.parametrize("seed", SEEDS)
def test_every_point_belongs_to_one_joint_that_the_animal_has(seed):
    animal = made(seed)
    assert animal.pack == PACK
    assert np.isfinite(animal.points).all()
    np.testing.assert_allclose(np.linalg.norm(animal.normals, axis=1), 1)
    assert np.abs(animal.alignment @ animal.alignment.swapaxes(-1, -2) - np.eye(3)).max() < 1e-9
    assert set(np.unique(animal.weights)) == {0.0, 1.0}
    np.testing.assert_array_equal(animal.weights.sum(axis=1), 1)
    used = animal.weights.any(axis=0)
    assert animal.turning[used].all()
    for name in ("Head", "LeftUpperArm", "RightUpperArm", "LeftThigh", "RightThigh"):
        assert used[BODY.joint(name)], name
    low, high = animal.points.min(axis=0), animal.points.max(axis=0)
    own, margin = animal.joints[animal.turning], 0.1 * (high - low).max()
    assert ((own > low - margin) & (own < high + margin)).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_left_and_right_are_alike(seed):
    animal = made(seed)
    for chain in legs_of(animal).values():
        for part in chain:
            left, right = (BODY.joint(side + part) for side in SIDES)
            np.testing.assert_allclose(animal.joints[left] * [-1, 1, 1], animal.joints[right], atol=0.01)
            boxes = []
            for joint, sign in ((left, 1), (right, -1)):
                points = animal.points[animal.weights[:, joint] == 1] * [sign, 1, 1]
                boxes.append([points.min(axis=0), points.max(axis=0)])
            # Points are drawn on each side, so boxes differ by the gaps between points, and small parts have few.
            assert np.abs(np.subtract(*boxes)).max() < 0.3 * np.ptp(boxes[0], axis=0).max(), part
    has = dict(zip(BODY.joint_names, animal.turning, strict=True))
    for name in has:
        if name.startswith("Left"):
            assert has[name] == has["Right" + name[4:]]


def test_animals_have_one_to_four_bones_a_leg_and_differ():
    animals = [made(seed) for seed in range(30)]
    counts = [len(legs_of(animal)["hind"]) for animal in animals]
    assert {1, 2, 3, 4} >= set(counts) >= {1, 2, 3}
    necks = np.array([animal.turning[BODY.joint("Neck1")] for animal in animals])
    tails = np.array([animal.turning[BODY.joint("Tail1")] for animal in animals])
    assert 0.2 < necks.mean() < 0.9
    assert 0.4 < tails.mean() < 1.0
    heights = np.array([np.ptp(animal.points[:, 1]) / np.ptp(animal.points[:, 2]) for animal in animals])
    assert heights.max() > 2 * heights.min()


@pytest.mark.parametrize("seed", SEEDS)
def test_a_leg_ends_on_the_ground_below_its_joints(seed):
    animal = made(seed)
    height = np.ptp(animal.points[:, 1])
    for side in SIDES:
        for chain in legs_of(animal).values():
            last = animal.points[animal.weights[:, BODY.joint(side + chain[-1])] == 1]
            assert last[:, 1].min() < animal.points[:, 1].min() + 0.35 * height


def test_animals_are_about_as_large_as_the_body_and_the_same_every_time():
    for seed in range(5):
        one, again = made(seed), primitive_animal(BODY, np.random.default_rng(seed))
        np.testing.assert_array_equal(one.points, again.points)
        np.testing.assert_array_equal(one.joints, again.joints)
        size = np.sqrt(np.square(one.points - one.points.mean(axis=0)).sum(axis=1).mean())
        assert 0.5 * body_spread(BODY) < size < 2 * body_spread(BODY)
