"""Whole people are recognised without a note; for halves, missing limbs and chairs the note says why."""

import numpy as np
import pytest

from mimesh.bodies import load_body
from mimesh.core.mesh import Mesh
from mimesh.core.rig import descendants
from mimesh.evaluate.protocols import PROTOCOLS
from mimesh.methods.confidence import (
    MAX_ENTROPY,
    MAX_SPREAD,
    MAX_UNMATCHED_LIMB,
    MAX_UNMATCHED_SURFACE,
    MIN_SHARE,
    Confidence,
)
from mimesh.pipeline import transfer

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
    boxes = [((0, 0.5, 0), (0.5, 0.06, 0.5)), ((0, 0.85, -0.22), (0.5, 0.7, 0.06))]
    boxes += [((x, 0.25, z), (0.06, 0.5, 0.06)) for x in (-0.2, 0.2) for z in (-0.2, 0.2)]
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    box = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    box += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    vertices = np.concatenate([corners * size + middle for middle, size in boxes])
    return Mesh(vertices, np.concatenate([np.array(box) + 8 * k for k in range(len(boxes))]), name="chair")


def notes(mesh):
    return " ".join(transfer(mesh, BODY.mesh(), **AXES).notes)


def test_whole_person_has_no_note():
    assert notes(BODY.mesh()) == ""


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        (chair(), "belongs to no limb in particular"),
        (part_of_body(BODY.vertices[:, 1] > np.median(BODY.vertices[:, 1])), "belongs to no limb in particular"),
        (part_of_body(~limb("Neck1")), "no whole head"),
        (part_of_body(~limb("LeftShoulder")), "no whole left arm"),
    ],
    ids=["chair", "upper half", "headless", "one arm"],
)
def test_note_names_the_reason(mesh, reason):
    note = notes(mesh)
    assert "hardly looks like a whole person" in note
    assert reason in note


def test_note_lists_every_reason():
    limbs = {"head": 0.0, "left arm": 0.1, "right arm": 0.0, "left leg": 0.2, "right leg": 0.2}
    (note,) = Confidence(40.0, 2.0, limbs).notes("thing")
    assert "40 degrees" in note
    assert "no limb in particular" in note
    assert "no whole head and no whole right arm" in note
    assert Confidence(2.0, 0.5, {"head": 0.1}).notes("person") == ()


def test_unmatched_limb_is_noted_where_surface_is_left_over():
    limbs = {"head": 0.1, "left arm": 0.1, "right arm": 0.1, "left leg": 0.2, "right leg": 0.2}
    (note,) = Confidence(2.0, 0.5, limbs, {"left arm": 0.1}, 0.05).notes("person")
    assert "no surface where the left arm should be" in note
    assert Confidence(2.0, 0.5, limbs, {"left arm": 0.1}, 0.0).notes("holed") == ()
    assert Confidence(2.0, 0.5, limbs, {"left arm": 0.0}, 0.05).notes("dressed") == ()
    (note,) = Confidence(2.0, 0.5, limbs, {"left arm": 0.5}, 0.0).notes("one arm")
    assert "no whole left arm" in note


def test_missing_forearms_are_noted_and_holes_are_not():
    noise = PROTOCOLS["noise"]
    for kind, expected in (("holes", ()), ("half", ()), ("cropped", ("no whole",))):
        trial = noise.pair("val", kind, 0)
        notes = " ".join(transfer(trial.identity, trial.driving, **AXES).notes)
        assert all(words in notes for words in expected)
        assert bool(expected) == ("whole person" in notes)


def test_sparse_point_cloud_of_a_person_has_no_note():
    points = np.random.default_rng(0).permutation(BODY.vertices)[:300]
    notes = " ".join(transfer(BODY.mesh(), Mesh(points, np.zeros((0, 3), int), name="cloud"), **AXES).notes)
    assert "whole" not in notes


def random_confidence(rng):
    """A confidence whose figures lie about their thresholds."""
    near = lambda threshold: float(threshold * rng.uniform(0.3, 1.15))  # noqa: E731
    limbs = {name: near(least) / 0.5 for name, least in MIN_SHARE.items()}
    unmatched = {name: near(MAX_UNMATCHED_LIMB) for name in MIN_SHARE} if rng.random() < 0.7 else {}
    return Confidence(near(MAX_SPREAD), near(MAX_ENTROPY), limbs, unmatched, near(MAX_UNMATCHED_SURFACE))


def test_uncertainty_is_above_one_exactly_where_there_is_a_note():
    noted = []
    for seed in range(500):
        confidence = random_confidence(np.random.default_rng(seed))
        noted.append(bool(confidence.notes("mesh")))
        assert (confidence.uncertainty > 1) == noted[-1]
    assert 50 < sum(noted) < 450, "both happen"
    lost = Confidence(1.0, 0.1, dict.fromkeys(MIN_SHARE, 0.0))
    assert 1 < lost.uncertainty < np.inf
