"""The shipped bodies: closed surfaces with weights, landmarks and joints by what they are, random shapes and poses."""

import itertools

import numpy as np
import pytest
from save_body import save_body
from scipy.spatial import cKDTree

from mimesh.bodies import load_body
from mimesh.bodies.anatomy import HUMAN, QUADRUPED, anatomy_of, anatomy_of_joints
from mimesh.bodies.body_model import LANDMARKS, landmarks
from mimesh.bodies.joint_names import other_side
from mimesh.bodies.quadruped import LIMITS, USUAL
from mimesh.bodies.sampling import JOINT_LIMITS, TABLE_6, mirror_ranges, sample_pose, sample_shape
from mimesh.core.errors import InputError
from mimesh.core.geometry import MIRROR, edges
from mimesh.core.surface_points import at_barycentric, sample_surface

BODIES = {"human": load_body(), "quadruped": load_body("quadruped")}
HUMAN_BODY, ANIMAL = BODIES.values()
EACH = pytest.mark.parametrize("name", BODIES)


def joints_of(body, *names):
    return [body.joints[body.joint(name)] for name in names]


@EACH
def test_a_body_is_a_closed_manifold_with_weights_that_sum_to_1(name):
    body = BODIES[name]
    assert len(body.vertices) - len(edges(body.faces)) + len(body.faces) == 2  # Euler: one closed surface, no handles
    directed = body.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)  # every edge once in each direction
    np.testing.assert_allclose(body.weights.sum(axis=1), 1, atol=1e-12)
    assert body.weights.min() >= 0


def test_the_human_has_the_documented_counts_and_rests_in_a_t_pose_with_y_up_facing_z():
    body = HUMAN_BODY
    assert (body.vertices.shape, body.faces.shape) == ((6890, 3), (13776, 3))
    assert len(body.components) >= 10
    assert 24 <= len(body.joint_names) <= 31
    left, right, shoulder = joints_of(body, "LeftHand", "RightHand", "LeftArm")
    foot, toes = joints_of(body, "LeftFoot", "LeftToeBase")
    assert left[0] > 0.5 > -0.5 > right[0]
    assert abs(left[1] - shoulder[1]) < 0.01
    assert toes[2] > foot[2]  # toes in front: +z
    assert 1.4 < np.ptp(body.vertices[:, 1]) < 2.1


def test_the_quadruped_stands_on_the_floor_and_faces_z():
    head, chest, hips, thigh = joints_of(ANIMAL, "Head", "Chest", "Hips", "LeftThigh")
    assert abs(ANIMAL.vertices[:, 1].min()) < 0.01
    assert head[2] > chest[2] > hips[2]
    assert thigh[0] > 0
    assert ANIMAL.weights.any(axis=0).all()


def test_left_and_right_of_the_quadruped_are_mirror_images_in_every_shape():
    mirrored = [ANIMAL.joint(other_side(name)) for name in ANIMAL.joint_names]
    np.testing.assert_allclose(ANIMAL.joints[mirrored] * MIRROR, ANIMAL.joints, atol=1e-3)
    # Vertices are not paired, so they are compared with points spread over the whole surface.
    chosen = sample_surface(ANIMAL.vertices, ANIMAL.faces, 100_000, np.random.default_rng(0))
    points = at_barycentric(ANIMAL.vertices, ANIMAL.faces, *chosen)
    assert cKDTree(points).query(ANIMAL.vertices * MIRROR)[0].max() < 0.01
    for seed in range(3):
        vertices, joints = ANIMAL.shaped(sample_shape(ANIMAL, seed, 0))
        np.testing.assert_allclose(joints[mirrored] * MIRROR, joints, atol=0.02)
        assert (joints > vertices.min(axis=0)).all()
        assert (joints < vertices.max(axis=0)).all()


def test_components_of_the_quadruped_change_the_lengths_of_legs_neck_and_trunk():
    above = list(ANIMAL.parents[1:])
    joints = np.stack([ANIMAL.shaped(sample_shape(ANIMAL, 0, i))[1] for i in range(30)])
    lengths = np.linalg.norm(joints[:, 1:] - joints[:, above], axis=-1)
    change = lengths.std(axis=0) / lengths.mean(axis=0)
    for name in ("LeftForearm", "RightShin", "Neck2", "Spine2", "Tail4"):
        assert change[ANIMAL.joint(name) - 1] > 0.05, name


@EACH
def test_landmarks_are_distinct_vertices_on_the_sides_that_their_names_say(name):
    body = BODIES[name]
    found = landmarks(body)
    assert len(set(found.values())) == len(found) == len(LANDMARKS)  # of both bodies, the first five are ends
    for landmark, vertex in found.items():
        side, _, part = landmark.partition(" ")
        if side in ("left", "right"):
            position = body.vertices[vertex]
            assert position[0] * (1 if side == "left" else -1) > 0.02, landmark
            other = body.vertices[found[f"{'right' if side == 'left' else 'left'} {part}"]]
            assert np.linalg.norm(position - other * MIRROR) < 0.05, landmark


def test_landmarks_of_ends_are_extreme_vertices_or_those_of_their_parts():
    found, (x, y, z) = landmarks(HUMAN_BODY), HUMAN_BODY.vertices.T
    assert tuple(found) == LANDMARKS
    assert abs(x[found["head"]]) < 0.03
    assert y[found["head"]] > y.max() - 0.02
    assert x[found["left hand"]] > x.max() - 0.02
    assert z[found["left foot"]] > z[y < 0.1].max() - 0.03
    assert y[found["left elbow"]] == pytest.approx(joints_of(HUMAN_BODY, "LeftForeArm")[0][1], abs=0.06)
    strongest = {
        name: ANIMAL.joint_names[ANIMAL.weights[vertex].argmax()] for name, vertex in landmarks(ANIMAL).items()
    }
    assert strongest["nose"] in ("Head", "Jaw")
    for side in ("left", "right"):
        assert strongest[f"{side} forefoot"] in (f"{side.title()}Fingers", f"{side.title()}Hand")
        assert strongest[f"{side} hind foot"] in (f"{side.title()}Toes", f"{side.title()}Foot")


@EACH
def test_all_joints_of_an_anatomy_are_those_of_its_body(name):
    body, anatomy = BODIES[name], anatomy_of(name)
    named = {
        *(joint for chain in (*anatomy.legs, *anatomy.hinges, *anatomy.ends) for joint in chain),
        *(*anatomy.long_bones, *anatomy.regions.values(), *anatomy.props),
    }
    assert named <= set(body.joint_names)
    assert sum(anatomy.props.values()) == pytest.approx(1.0)
    for chain in (*anatomy.legs, *anatomy.hinges):
        for above, below in itertools.pairwise(chain):
            assert body.parents[body.joint(below)] == body.joint(above)
    assert anatomy_of_joints(body.joint_names) is anatomy


def test_anatomy_is_that_of_the_legs_among_the_joints():
    assert anatomy_of_joints(("Hips", "RightThigh", "Head")) is QUADRUPED
    assert anatomy_of_joints(("Hips", "Head")) is HUMAN


def test_samples_depend_on_seed_and_index_only():
    first = [sample_pose(HUMAN_BODY, 7, i) for i in range(5)]
    np.testing.assert_array_equal(sample_pose(HUMAN_BODY, 7, 4), first[4])
    assert not np.array_equal(sample_pose(HUMAN_BODY, 8, 4), first[4])
    assert not np.array_equal(sample_shape(HUMAN_BODY, 7, 0), sample_shape(HUMAN_BODY, 7, 1))


def test_ranges_of_table_6_are_those_of_the_paper():
    assert len(TABLE_6) == 24
    poses = np.degrees(np.stack([sample_pose(HUMAN_BODY, 0, i) for i in range(200)]))
    knee, elbow = poses[:, HUMAN_BODY.joint("LeftLeg")], poses[:, HUMAN_BODY.joint("RightForeArm")]
    assert 0 <= knee[:, 0].min() < 10 < 90 < knee[:, 0].max() <= 100
    assert (knee[:, 1:] == 0).all()
    assert 0 <= elbow[:, 1].min() < 10 < 50 < elbow[:, 1].max() <= 60
    assert (poses[:, HUMAN_BODY.joint("LHipJoint")] == 0).all()


@pytest.mark.parametrize(("name", "table"), [("human", JOINT_LIMITS), ("quadruped", LIMITS), ("quadruped", USUAL)])
def test_ranges_are_alike_on_both_sides_and_have_rest_in_them(name, table):
    assert set(table) <= set(BODIES[name].joint_names)
    for joint, ranges in table.items():
        assert all(low <= 0 <= high for low, high in ranges), joint
        if joint.startswith("Left"):
            assert table["Right" + joint[4:]] == mirror_ranges(ranges)
    assert mirror_ranges(((1, 2), (3, 4), (-5, 6))) == ((1, 2), (-4, -3), (-6, 5))


def test_usual_poses_of_the_quadruped_are_within_its_limits():
    for joint, ((low, high), *_) in USUAL.items():
        assert LIMITS[joint][0][0] - 1 <= low <= high <= LIMITS[joint][0][1] + 1


def test_a_saved_body_loads_unchanged(tmp_path):
    save_body(HUMAN_BODY, tmp_path / "again.npz")
    again = load_body(tmp_path / "again.npz")
    np.testing.assert_array_equal(again.vertices, HUMAN_BODY.vertices)
    np.testing.assert_array_equal(again.components, HUMAN_BODY.components)
    assert again.joint_names == HUMAN_BODY.joint_names


def test_errors_of_unknown_names_list_the_known_ones():
    with pytest.raises(InputError, match="expected a shipped body"):
        load_body("octopus")
    with pytest.raises(KeyError, match="LeftArm"):
        HUMAN_BODY.joint("Tail")
