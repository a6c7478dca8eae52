"""A hand that is weighted to a knee gets the weights of its arm, a piece those of its limb; correct weights stay."""

import numpy as np
import pytest
import trimesh

from mimesh.bodies import load_body
from mimesh.bodies.anatomy import anatomy_of
from mimesh.core.geometry import edges
from mimesh.core.rig import descendants
from mimesh.mime.body_fit import NearestBody
from mimesh.mime.weights import MAX_BONES, bone_distances, clean_weights, without_steps

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
    trunk = {body.joint(name): 0 for name in anatomy_of("quadruped").optional_trunk}
    leg, hips = body.joint("LeftForearm"), body.joint("Hips")
    assert bone_distances(body.parents)[leg, hips] >= MAX_BONES
    assert bone_distances(body.parents, trunk)[leg, hips] < MAX_BONES


def test_a_hem_that_a_hand_touches_does_not_go_with_the_arm():
    """Cloth beside a hand is predicted to be of its arm, in part of the upper one, which is near the trunk's joints."""
    lower, arm = BODY.joint("LowerBack"), BODY.joint("LeftArm")
    strongest, pairs = BODY.weights.argmax(axis=1), edges(BODY.faces)
    border = pairs[strongest[pairs[:, 0]] != strongest[pairs[:, 1]]]
    hem = np.setdiff1d(np.flatnonzero((strongest == lower) & (BODY.vertices[:, 0] > 0)), border)
    weights = BODY.weights.copy()
    weights[hem] = 0
    weights[hem, arm] = 1
    found = clean_weights(weights, BODY.vertices, BODY.faces, BODY.parents, counts={arm: 2})
    assert len(hem) > 20
    assert found[hem, arm].max() < 0.05
    assert np.abs(found[hem] - BODY.weights[hem]).mean() < 0.02


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


def moved_by(**share):
    """Weights of a vertex by the names of its joints."""
    weights = np.zeros(len(BODY.parents))
    for name, value in share.items():
        weights[BODY.joint(name)] = value
    return weights


def cleaned_with(piece, weights, of_body=BODY.weights):
    """Clean the weights of the body with another piece, and return those of the piece."""
    count = len(BODY.vertices)
    vertices = np.concatenate([BODY.vertices, piece.vertices])
    faces = np.concatenate([BODY.faces, np.asarray(piece.faces) + count])
    weights = np.concatenate([of_body, weights])
    return clean_weights(weights, vertices, faces, BODY.parents, nearest_body(vertices))[count:]


FAR_END, NEAR_END = moved_by(LeftHand=1), moved_by(LeftArm=1)
LIKE_A_HEAD = moved_by(Head=0.6, LeftArm=0.4), moved_by(Head=0.4, LeftHand=0.6)


@pytest.mark.parametrize(("ends", "at_far_end"), [((NEAR_END, FAR_END), 4), (LIKE_A_HEAD, 2)])
def test_a_box_that_stands_for_an_arm_moves_with_its_first_joint(ends, at_far_end):
    """Its eight vertices are at both ends of the arm: weighted to two joints, it would shear.

    Where head and arm share a vertex, the weaker one is too far away to stay; it counts for the whole box all the same.
    """
    box = trimesh.primitives.Box(extents=(0.62, 0.12, 0.12)).to_mesh()
    box.vertices += (BODY.joints[BODY.joint("LeftArm")] + BODY.joints[BODY.joint("LeftHand")]) / 2
    rank = np.argsort(np.argsort(-box.vertices[:, 0], kind="stable"))
    found = cleaned_with(box, np.stack(ends)[(rank < at_far_end).astype(int)])
    assert np.array_equal(found, np.eye(len(BODY.parents))[[ARM] * len(found)])


def test_a_solid_piece_goes_with_one_limb_alone():
    """A block of the trunk keeps nothing of the head; an open shell, which may be cloth, keeps its weights."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.15)
    ball.vertices += BODY.joints[BODY.joint("Spine")]
    weights = np.tile(moved_by(Spine=0.32, Spine1=0.28, Neck=0.2, Hips=0.1, LowerBack=0.1), (len(ball.vertices), 1))
    found = cleaned_with(ball, weights)
    assert np.abs(found[:, BODY.joint("Neck")]).max() < 1e-12
    assert np.allclose(found.sum(axis=1), 1)
    assert (found[:, BODY.joint("Spine")] > 0.32).all()
    ball.update_faces(ball.triangles_center[:, 1] < ball.center_mass[1] + 0.13)
    assert np.allclose(cleaned_with(ball, weights), weights, atol=1e-12)


def test_a_block_that_narrowly_misses_a_limb_is_that_limb_if_the_figure_lacks_it():
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    ball.vertices += (BODY.joints[ARM] + BODY.joints[ELBOW]) / 2
    weights = np.tile(moved_by(LeftArm=0.25, Spine1=0.75), (len(ball.vertices), 1))
    assert np.allclose(cleaned_with(ball, weights), moved_by(Spine1=1), atol=1e-12)
    arm = descendants([ARM], BODY.parents)
    without = BODY.weights.copy()
    without[:, BODY.joint("Spine1")] += without[:, arm].sum(axis=1)
    without[:, arm] = 0
    assert cleaned_with(ball, weights, without)[:, arm].sum(axis=1) == pytest.approx(1)


def test_a_step_of_weights_is_spread_over_neighbours():
    """The triangle changes by 2 over a length of 1, where the area is 400: by STEEP, so a quarter is averaged."""
    leg = np.sqrt(2 * (400 - np.sqrt(3) / 4))
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0], [9, 0, 0], [9 + leg, 0, 0], [9, leg, 0]])
    faces, weights = np.arange(6).reshape(2, 3), np.eye(2)[[0, 1, 1, 0, 1, 1]]
    first = [0.49609375, 0.251953125, 0.251953125]
    expected = np.array([*first, 1, 0, 0])  # the large triangle changes slowly
    assert np.allclose(without_steps(weights, vertices, faces), np.stack([expected, 1 - expected], 1), atol=1e-6)
    assert np.array_equal(without_steps(weights, vertices, faces, known=1.0), weights)
    assert without_steps(weights, vertices, faces[:0]) is weights
