"""Clips of animals in gaits: feet stand still on the ground, or all are in the air; the path goes straight on."""

from functools import cache

import numpy as np
import pytest
from matrix import matrix

from mimesh.bodies.animals import ANIMALS, animal_body, standing
from mimesh.core.errors import InputError
from mimesh.core.rig import descendants
from mimesh.motions.animal_clips import ANIMAL_MOTIONS, RUNS, animal_clip, gait_clip, random_style, run
from mimesh.motions.gaits import LEGS

FPS = 60.0
CASES = [("horse", "gallop", 4), ("horse", "canter", 0), ("cat", "bound", 0), ("dog", "trot", 0), ("dog", "walk", 2)]
ENDS = {"Hind": "Toes", "Front": "Fingers"}


@cache
def feet_of(species: str, gait: str, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute paths of the feet in two cycles over the animal's height, whether each should stand, and the root's path.

    The place of a foot is the mean of its lowest tenth at rest, its height that of its lowest vertex.
    """
    body, style = animal_body(species), random_style(gait, index)
    cycle = style.start + np.arange(0, 2, style.pace / FPS)
    rotmat, root = run(body, RUNS[gait], style, standing(body, species), cycle)
    vertices = body.posed(np.zeros(0), rotmat, root)
    rest = body.posed(np.zeros(0), standing(body, species))
    feet = []
    for leg in LEGS:
        kind = "Hind" if leg.endswith("Hind") else "Front"
        joints = descendants([body.joint(leg.removesuffix(kind) + ENDS[kind])], body.parents)
        foot = np.flatnonzero(body.weights[:, joints].sum(axis=1) > 0.5)
        sole = foot[rest[foot, 1].argsort()[: len(foot) // 10]]
        place = vertices[:, sole].mean(axis=1)
        place[:, 1] = vertices[:, foot, 1].min(axis=1)
        feet.append(place)
    phase = (cycle[:, None] - RUNS[gait].phases) % 1.0
    return np.stack(feet, axis=1) / np.ptp(rest[:, 1]), phase < RUNS[gait].duty, root / np.ptp(rest[:, 1])


@matrix("case", CASES, quick=[CASES[0], CASES[4]])
def test_standing_feet_do_not_slide_and_only_running_animals_leave_the_ground(case):
    feet, stands, root = feet_of(*case)
    on_ground = feet[..., 1][stands]
    assert np.abs(on_ground).mean() < 0.01
    assert feet[..., 1].min() > -0.02
    steps = np.linalg.norm(np.diff(feet[..., [0, 2]], axis=0), axis=-1)[stands[1:] & stands[:-1]]
    speed = (root[-1, 2] - root[0, 2]) / (len(root) - 1)
    assert steps.mean() < 0.05 * speed
    in_air = feet[..., 1].min(axis=1) > 0.005
    if "walk" in case:
        assert not in_air.any()
    else:
        assert in_air[~stands.any(axis=1)].mean() > 0.5
        assert in_air.mean() > 0.05


def test_the_hind_feet_of_a_gallop_land_before_the_forefeet_and_no_foot_stands_before_the_next_hind_foot():
    phases = dict(zip(LEGS, RUNS["gallop"].phases, strict=True))
    assert sorted(phases, key=lambda leg: phases[leg]) == ["LeftHind", "RightHind", "LeftFront", "RightFront"]
    assert max(phases.values()) + RUNS["gallop"].duty < 0.9


def test_clips_are_the_same_again_and_others_with_another_number():
    one, again, other = (np.asarray(gait_clip("dog", "trot", i, seconds=0.2, fps=10.0).vertices) for i in (0, 0, 1))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 0.01 * ANIMALS["dog"].size


def test_animals_in_postures_are_on_the_ground():
    for name, motion, number in ANIMAL_MOTIONS.values():
        if motion not in RUNS:
            clip = gait_clip(name, motion, number, seconds=0.6, fps=10.0)
            assert np.abs(np.asarray(clip.vertices)[..., 1].min(axis=1)).max() < 1e-3, motion


def test_errors_of_unknown_motions_list_the_known_ones():
    with pytest.raises(InputError, match="horse gallop"):
        animal_clip("horse flies")


@matrix("case", CASES, quick=[CASES[0], CASES[4]])
def test_the_root_goes_straight_on_at_one_speed(case):
    _, _, root = feet_of(*case)
    assert np.abs(root[:, 0]).max() == 0.0
    steps = np.diff(root[:, 2])
    assert steps.min() > 0
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-9)
