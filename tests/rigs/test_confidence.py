"""Whole people are recognised without a note; for halves, missing limbs and chairs the note says why."""

import dataclasses

import numpy as np
import pytest
from grouped_options import grouped
from people import person as person_mesh
from zoo import boxes

from mimesh import InputError
from mimesh.bodies import load_body
from mimesh.core.mesh import Mesh
from mimesh.core.rig import descendants
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.pipeline import transfer
from mimesh.rigs.confidence import (
    DOUBTFUL_ERROR,
    EXPECTED_ERROR,
    MAX_ENTROPY,
    MAX_ERROR,
    MAX_OTHER_KIND,
    MAX_SPREAD,
    MAX_UNMATCHED_SURFACE,
    MIN_SHARE,
    MISSING_LIMB,
    OTHER_KIND_ERROR,
    Confidence,
    Standards,
    largest_flexion,
    limb_joints,
)

BODY = load_body()
AXES = {"up": "+y", "front": "+z"}
STRONGEST = BODY.weights.argmax(axis=1)


def limb(top):
    """Mask of the vertices whose strongest joint is `top` or below it."""
    return np.isin(STRONGEST, descendants([BODY.joint(top)], BODY.parents))


def part_of_body(chosen):
    """The body's faces whose corners are all chosen."""
    faces = BODY.faces[chosen[BODY.faces].all(axis=1)]
    used, index = np.unique(faces, return_inverse=True)
    return Mesh(BODY.vertices[used], index.reshape(-1, 3), name="part")


def chair():
    """A seat, a back and four legs, each a box."""
    legs = [((x, 0.25, z), (0.06, 0.5, 0.06)) for x in (-0.2, 0.2) for z in (-0.2, 0.2)]
    return boxes("chair", ((0, 0.5, 0), (0.5, 0.06, 0.5)), ((0, 0.85, -0.22), (0.5, 0.7, 0.06)), *legs)


def notes(mesh):
    return " ".join(transfer(mesh, person_mesh(1, pose=1, faces=600), **grouped(**AXES)).notes)


def test_whole_person_has_no_note():
    assert notes(person_mesh(0)) == ""


REASONS = {
    "upper half": (BODY.vertices[:, 1] > np.median(BODY.vertices[:, 1]), "no whole left leg and no whole right leg"),
    "headless": (~limb("Neck1"), "no whole head"),
    "one arm": (~limb("LeftShoulder"), "no whole left arm"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REASONS)
def test_note_names_the_reason(name):
    kept, reason = REASONS[name]
    note = notes(part_of_body(kept))
    # The upper half is as near to no person at all as to an incomplete one (1.15, limit 1.1): rounding decides.
    assert "limbs were not found with certainty" in note or "does not look like a person" in note
    assert reason in note


@pytest.mark.slow
def test_a_chair_does_not_look_like_a_person():
    with pytest.raises(InputError, match=r"chair: expected a person or a four-legged animal, .* looks like neither"):
        notes(chair())


UNSURE = {"prediction_spread": 14.0, "weight_entropy": 0.8, "fit_distance": 3e-3}
"""Figures of a person with an expected error of 0.066 heights: a note, but none that it may be something else."""


def fitted(**figures):
    """A confidence of a person to whom a body was fitted closely, but for some figures."""
    limbs = {"head": 0.1, "left arm": 0.1, "right arm": 0.1, "left leg": 0.2, "right leg": 0.2}
    sound = {
        "prediction_spread": 2.0,
        "weight_entropy": 0.5,
        "limbs": limbs,
        "unmatched_body": dict.fromkeys(MIN_SHARE, 0.0),
        "fit_distance": 2e-4,
        "fit_angle": 3.0,
    }
    return Confidence(**sound | figures)


def test_missing_limb_is_noted_and_a_hole_is_not():
    assert fitted().notes("person") == ()
    assert fitted(unmatched_body={"left arm": 0.1}).notes("holed") == ()
    (note,) = fitted(unmatched_body={"left arm": 0.5}).notes("one arm")
    assert "no whole left arm" in note


def test_contradicting_fit_is_noted_with_the_expected_error():
    lost = fitted(weight_entropy=0.8, prediction_spread=12.0, fit_distance=4e-3)
    (note,) = lost.notes("person")
    assert "do not fit together" in note
    assert f"about {lost.expected_error:.0%} of the height" in note
    (note,) = fitted(**UNSURE, unmatched_body={"left arm": 0.1}, unmatched_surface=0.05).notes("person")
    assert "no surface where the left arm should be" in note


@pytest.mark.parametrize(
    ("figure", "value"),
    {
        "prediction_spread": 4.0,
        "weight_entropy": 1.0,
        "fit_distance": 4e-4,
        "fit_angle": 6.0,
        "unmatched_body": {"left arm": 0.5},
    }.items(),
)
def test_no_figure_that_gets_worse_lowers_the_expected_error(figure, value):
    sound, worse = fitted(), fitted(**{figure: value})
    (name,) = (name for name, of_worse in worse.features().items() if of_worse > sound.features()[name])
    assert (worse.expected_error > sound.expected_error) == (name in EXPECTED_ERROR)
    assert worse.expected_error >= sound.expected_error
    assert worse.uncertainty >= sound.uncertainty


def test_stylised_people_have_no_note_and_people_whose_predictions_lie_apart_have_one():
    """Figures of a person at the joint limits, one of cubes at rest with short legs, and one that is read wrongly."""
    legs = {"head": 0.5, "left arm": 0.08, "right arm": 0.08, "left leg": 0.05, "right leg": 0.045}
    right = fitted(prediction_spread=10.7, weight_entropy=0.75, fit_distance=1.8e-3, fit_angle=8.3)
    cubes = fitted(prediction_spread=7.3, weight_entropy=0.48, fit_distance=2.6e-3, fit_angle=6.9, limbs=legs)
    wrong = fitted(prediction_spread=12.9, weight_entropy=0.75, fit_distance=5.9e-3)
    assert [confidence.notes("it") for confidence in (right, cubes)] == [(), ()]
    # exp(-7.17 + 0.45 ln 13.9 + 1.64 0.75 + 1.38 ln 6.9)
    assert wrong.expected_error == pytest.approx(0.12367, abs=1e-5)
    assert len(wrong.notes("it")) == 1


def test_a_missing_limb_alone_is_noted_without_an_error():
    confidence = fitted(unmatched_body={"left arm": 1.2 * MISSING_LIMB})
    assert confidence.expected_error < MAX_ERROR < confidence.uncertainty * MAX_ERROR
    (note,) = confidence.notes("person")
    assert "of the height" not in note


def test_flexion_is_that_of_the_joint_that_is_bent_most():
    names = ("Hips", "LeftUpLeg", "LeftLeg", "LeftFoot", "RightUpLeg", "RightLeg", "RightFoot")
    angle = np.radians(160.0)
    straight = [[0.1, 1, 0], [0.1, 0.5, 0], [0.1, 0, 0]]
    folded = [[-0.1, 1, 0], [-0.1, 0.5, 0], [-0.1, 0.5 - 0.4 * np.cos(angle), -0.4 * np.sin(angle)]]
    assert largest_flexion(np.array([[0, 1, 0], *straight, *folded]), names) == pytest.approx(160.0)
    assert largest_flexion(np.array([[0, 1, 0], *straight, *straight]), names) == pytest.approx(0.0, abs=1e-5)
    assert largest_flexion(np.zeros((1, 3)), ("Hips",)) == 0.0


def test_a_folded_limb_is_noted():
    assert fitted(flexion=140.0).notes("person") == ()
    (note,) = fitted(flexion=165.0).notes("person")
    assert "folded by 165 degrees" in note


def test_confidence_is_a_half_at_the_threshold_of_the_note():
    confidences = [fitted(**UNSURE | {"prediction_spread": spread}) for spread in np.linspace(1.0, 90.0, 400)]
    noted = [bool(confidence.notes("person")) for confidence in confidences]
    assert noted == [confidence.facts()["confidence"] < 0.5 for confidence in confidences]
    assert set(noted) == {False, True}


@pytest.mark.slow
def test_missing_forearms_are_noted_and_holes_are_not():
    noise = PROTOCOLS["noise"]
    for kind, expected in (("holes", ()), ("cropped", ("certainty",))):
        trial = noise.pair("val", kind, 0)
        notes = " ".join(transfer(trial.identity, trial.driving, **grouped(**AXES)).notes)
        assert all(words in notes for words in expected)
        assert bool(expected) == ("certainty" in notes)


@pytest.mark.slow
def test_sparse_point_cloud_of_a_person_has_no_note():
    points = np.random.default_rng(0).permutation(BODY.vertices)[:300]
    notes = " ".join(
        transfer(person_mesh(0, faces=600), Mesh(points, np.zeros((0, 3), int), name="cloud"), **grouped(**AXES)).notes
    )
    assert "certainty" not in notes


def random_confidence(rng):
    """A confidence whose figures lie about their thresholds."""
    near = lambda threshold: float(threshold * rng.uniform(0.3, 1.15))  # noqa: E731
    limbs = {name: near(least) / 0.5 for name, least in MIN_SHARE.items()}
    if rng.random() < 0.3:
        return Confidence(near(MAX_SPREAD), near(MAX_ENTROPY), limbs)
    unmatched = {name: near(MISSING_LIMB) for name in MIN_SHARE}
    fit = {"fit_distance": near(1e-3), "fit_angle": near(8.0)}
    return Confidence(near(MAX_SPREAD), near(MAX_ENTROPY), limbs, unmatched, near(MAX_UNMATCHED_SURFACE), **fit)


def test_uncertainty_is_above_one_exactly_where_there_is_a_note():
    noted = []
    for seed in range(500):
        confidence = random_confidence(np.random.default_rng(seed))
        noted.append(bool(confidence.notes("mesh")))
        assert (confidence.uncertainty > 1) == noted[-1]
    assert 50 < sum(noted) < 450, "both happen"
    lost = Confidence(1.0, 0.1, dict.fromkeys(MIN_SHARE, 0.0))
    assert 1 < lost.uncertainty < np.inf


def test_animals_have_the_limbs_and_standards_of_animals():
    animal, person = load_body("quadruped"), load_body()
    limbs = limb_joints(animal.joint_names, animal.parents)
    assert set(limbs) == {"head", *(f"{side} {leg}" for side in ("left", "right") for leg in ("foreleg", "hind leg"))}
    assert animal.joint("LeftToes") in limbs["left hind leg"]
    assert animal.joint("Jaw") in limbs["head"]
    for body, kind in ((animal, "a four-legged animal"), (person, "a person")):
        standards = Standards.of(body.joint_names)
        assert standards.kind == kind
        assert set(standards.min_share) == set(limb_joints(body.joint_names, body.parents))
        whole = Confidence.of(2.0, body.weights, body.joint_names, body.parents)
        assert whole.standards is standards
        assert whole.notes("it") == ()


def test_a_missing_hind_leg_is_noted_by_its_name():
    body = load_body("quadruped")
    gone = limb_joints(body.joint_names, body.parents)["left hind leg"]
    weights = body.weights[body.weights[:, gone].sum(axis=1) < 0.01]
    (note,) = Confidence.of(2.0, weights, body.joint_names, body.parents).notes("cow")
    assert "no whole left hind leg was found" in note
    assert "feet are not planted" in note
    lost = fitted(
        standards=Standards.of(body.joint_names), unmatched_body={}, limbs={}, fit_angle=170.0, fit_distance=0.1
    )
    (note,) = lost.notes("chair")
    assert "does not look like a four-legged animal" in note
    assert lost.expected_error >= OTHER_KIND_ERROR


def test_a_body_that_fits_badly_and_belongs_to_no_limb_is_of_another_kind():
    right, block = fitted(weight_entropy=0.5, fit_distance=0.002), fitted(weight_entropy=0.7, fit_distance=0.005)
    wrong = fitted(weight_entropy=1.6, fit_distance=0.01)
    assert right.other_kind < block.other_kind < MAX_OTHER_KIND < wrong.other_kind
    assert [confidence.is_other_kind for confidence in (right, block, wrong)] == [False, False, True]
    assert not Confidence(1.0, 3.0, {}).is_other_kind, "without a fit nothing is said"
    (note,) = wrong.notes("lamp")
    assert "lamp does not look like a person, as far as can be told" in note
    assert 'body="other"' in note
    assert wrong.facts()["expected_error"] >= OTHER_KIND_ERROR


def test_a_surface_away_from_the_fitted_person_is_a_misfit_and_one_of_an_animal_is_not():
    near, far = fitted(surface_distance=0.022), fitted(surface_distance=0.044)
    assert near.misfit == near.other_kind
    assert far.misfit == pytest.approx(far.other_kind + 10 * np.log(2))
    cow = dataclasses.replace(far, standards=Standards.of(load_body("quadruped").joint_names), limbs={})
    assert cow.misfit == cow.other_kind


def test_a_note_on_limbs_says_that_the_mesh_may_be_something_else_where_the_error_is_large():
    small, large = (fitted(**UNSURE | {"prediction_spread": spread}) for spread in (14.0, 40.0))
    assert small.expected_error < DOUBTFUL_ERROR < large.expected_error
    assert not large.is_other_kind
    assert "may not be a person" not in " ".join(small.notes("it"))
    assert "may not be a person" in " ".join(large.notes("it"))


@pytest.mark.parametrize(("lacking", "doubted"), [(1, False), (2, False), (3, True), (5, True)])
def test_a_note_says_that_a_mesh_without_surface_for_several_limbs_may_be_something_else(lacking, doubted):
    unmatched = dict.fromkeys(MIN_SHARE, 0.0) | dict.fromkeys(list(MIN_SHARE)[:lacking], 0.9 * MISSING_LIMB)
    lacks = fitted(**UNSURE, unmatched_body=unmatched, unmatched_surface=0.1)
    assert lacks.expected_error < DOUBTFUL_ERROR
    assert ("may not be a person" in " ".join(lacks.notes("it"))) == doubted


def test_note_lists_every_reason():
    limbs = {"head": 0.0, "left arm": 0.1, "right arm": 0.0, "left leg": 0.2, "right leg": 0.2}
    (note,) = Confidence(40.0, 2.0, limbs).notes("thing")
    assert "40 degrees" in note
    assert "no limb in particular" in note
    assert "no whole head and no whole right arm" in note
    assert Confidence(2.0, 0.5, {"head": 0.1}).notes("person") == ()
