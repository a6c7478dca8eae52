"""A hand that is weighted to a knee gets the weights of its arm, and correct weights stay as they are."""

import numpy as np
import pytest
import trimesh

from mimesh.bodies import load_body
from mimesh.bodies.anatomy import anatomy_of
from mimesh.mime.body_fit import NearestBody
from mimesh.mime.weights import MAX_BONES, bone_distances, clean_weights

BODY = load_body()
HAND = np.isin(BODY.weights.argmax(axis=1), [BODY.joint(f"Left{name}") for name in ("HandFinger1", "FingerBase")])
KNEE, ARM, ELBOW = (BODY.joint(f"Left{name}") for name in ("Leg", "Arm", "ForeArm"))


def cleaned(weights, faces=BODY.faces):
    return clean_weights(weights, BODY.vertices, faces, BODY.parents)


def corrupted(share=1.0):
    """Weights that give the left hand, wholly or mostly, to the left knee."""
    weights = BODY.weights.copy()
    weights[HAND] = (1 - share) * weights[HAND]
    weights[HAND, KNEE] += share
    return weights


def test_bones_of_an_animals_trunk_are_not_counted():
    """Forelegs border on hips where one joint moves the trunk; counted, their bones would be cut apart."""
    body = load_body("quadruped")
    trunk = [body.joint(name) for name in anatomy_of("quadruped").optional_trunk]
    leg, hips = body.joint("LeftForearm"), body.joint("Hips")
    assert bone_distances(body.parents)[leg, hips] >= MAX_BONES
    assert bone_distances(body.parents, trunk)[leg, hips] < MAX_BONES


def test_correct_weights_stay():
    assert np.abs(cleaned(BODY.weights) - BODY.weights).max() < 0.05


@pytest.mark.parametrize("share", [1.0, 0.7])
def test_weights_of_a_hand_on_a_knee_are_cleaned(share):
    found = cleaned(corrupted(share))
    assert found[HAND, KNEE].max() < 1e-9
    assert np.allclose(found.sum(axis=1), 1)
    arm = [BODY.joint(name) for name in ("LeftForeArm", "LeftHand", "LThumb", "LeftFingerBase", "LeftHandFinger1")]
    assert found[HAND][:, arm].sum(axis=1).min() > 0.9
    assert np.abs(found - BODY.weights)[~HAND].max() < 0.05


def test_weights_of_a_separate_surface_stay():
    """A surface that is not connected to the body keeps its weights, even if all are the knee's."""
    count = len(BODY.vertices)
    vertices = np.concatenate([BODY.vertices, [[3, 0, 0], [3, 1, 0], [4, 0, 0]]])
    weights = np.concatenate([corrupted(), np.eye(len(BODY.parents))[[KNEE] * 3]])
    faces = np.concatenate([BODY.faces, [[count, count + 1, count + 2]]])
    found = clean_weights(weights, vertices, faces, BODY.parents)
    assert np.array_equal(found[count:], weights[count:])
    assert np.allclose(found[:count], cleaned(corrupted()), atol=1e-12)


def test_weights_of_a_point_cloud_stay():
    weights = corrupted()
    assert cleaned(weights, np.zeros((0, 3), int)) is weights


def with_stick(height, count=12):
    """Add a thin stick, upright in front of the left hand and up to `height` above it, as a piece of its own."""
    hand = BODY.joints[BODY.joint("LeftHand")]
    steps = np.linspace(0, height, count)
    stick = hand + np.concatenate([[[0.02 * side, y, 0.03] for y in steps] for side in (-1, 1)])
    a = np.arange(count - 1)
    faces = np.concatenate([np.stack([a, a + 1, a + count], 1), np.stack([a + 1, a + count + 1, a + count], 1)])
    start = len(BODY.vertices)
    return np.concatenate([BODY.vertices, stick]), np.concatenate([BODY.faces, faces + start]), start


def nearest_body(vertices):
    from scipy.spatial import KDTree

    distance, index = KDTree(BODY.vertices).query(vertices)
    return NearestBody(distance, BODY.weights[index])


def test_a_stick_that_reaches_far_from_the_body_moves_with_the_hand_that_holds_it():
    vertices, faces, start = with_stick(0.9)
    weights = np.concatenate([BODY.weights, np.full((len(vertices) - start, len(BODY.parents)), 1 / len(BODY.parents))])
    found = clean_weights(weights, vertices, faces, BODY.parents, nearest_body(vertices))[start:]
    assert (found.max(axis=1) == 1).all()
    assert len(np.unique(found.argmax(axis=1))) == 1
    assert BODY.joint_names[found[0].argmax()] in ("LeftHand", "LeftFingerBase", "LThumb", "LeftForeArm")
    # Without a fitted body nothing says that it is far from one.
    assert clean_weights(weights, vertices, faces, BODY.parents)[start:].max() < 1


def test_the_figure_itself_never_becomes_rigid():
    """Where the fit failed, the whole surface is far from the fitted body."""
    far = NearestBody(np.full(len(BODY.vertices), 0.1), BODY.weights)
    assert np.array_equal(
        clean_weights(BODY.weights, BODY.vertices, BODY.faces, BODY.parents, far), cleaned(BODY.weights)
    )


def test_a_piece_that_follows_the_body_keeps_bending():
    """A sleeve over a whole arm is near the body and weighted to several joints."""
    arm = BODY.weights[:, [BODY.joint("LeftArm"), ELBOW]].sum(axis=1) > 0.9
    sleeve = BODY.faces[arm[BODY.faces].all(axis=1)]
    vertices = np.concatenate([BODY.vertices, BODY.vertices + 0.01 * BODY.vertices / 2])
    faces = np.concatenate([BODY.faces, sleeve + len(BODY.vertices)])
    weights = np.concatenate([BODY.weights, BODY.weights])
    found = clean_weights(weights, vertices, faces, BODY.parents, nearest_body(vertices))
    worn = np.unique(sleeve) + len(BODY.vertices)
    assert np.abs(found - weights)[worn].max() < 0.05


def test_a_box_that_stands_for_an_arm_moves_with_its_first_joint():
    """Its eight vertices are at both ends of the arm: weighted to two joints, it would shear."""
    box = trimesh.primitives.Box(extents=(0.62, 0.12, 0.12))
    shoulder, hand = BODY.joints[BODY.joint("LeftArm")], BODY.joints[BODY.joint("LeftHand")]
    corners = np.asarray(box.vertices) + (shoulder + hand) / 2
    vertices = np.concatenate([BODY.vertices, corners])
    faces = np.concatenate([BODY.faces, np.asarray(box.faces) + len(BODY.vertices)])
    ends = np.where(corners[:, :1] > corners[:, 0].mean(), *np.eye(len(BODY.parents))[[BODY.joint("LeftHand"), ARM]])
    weights = np.concatenate([BODY.weights, ends])
    found = clean_weights(weights, vertices, faces, BODY.parents, nearest_body(vertices))[len(BODY.vertices) :]
    assert np.array_equal(found, np.eye(len(BODY.parents))[[ARM] * len(corners)])
