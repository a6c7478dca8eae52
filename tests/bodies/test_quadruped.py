"""The shipped quadruped: symmetric, skinned, with shapes of other proportions, and its joints by what they are."""

import itertools

import numpy as np
import pytest
from animals import BODY
from scipy.spatial import cKDTree

from mimesh.bodies import load_body
from mimesh.bodies.anatomy import HUMAN, QUADRUPED, anatomy_of, anatomy_of_joints
from mimesh.bodies.body_model import LANDMARKS, landmarks
from mimesh.bodies.quadruped import LIMITS, USUAL
from mimesh.bodies.sampling import sample_shape
from mimesh.core import surface_points
from mimesh.core.geometry import edges

OPPOSITE = {"Left": "Right", "Righ": "Left"}
MIRRORED = [BODY.joint(OPPOSITE.get(name[:4], "") + name.removeprefix("Left").removeprefix("Right"))
            for name in BODY.joint_names]  # fmt: skip
FLIP = np.array([-1, 1, 1])


def test_it_is_a_closed_manifold_that_stands_on_the_floor_and_faces_z():
    assert len(BODY.vertices) - len(edges(BODY.faces)) + len(BODY.faces) == 2  # Euler: one closed surface, no handles
    directed = BODY.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)
    assert abs(BODY.vertices[:, 1].min()) < 0.01
    assert BODY.joints[BODY.joint("Head"), 2] > BODY.joints[BODY.joint("Chest"), 2] > BODY.joints[BODY.joint("Hips"), 2]
    assert BODY.joints[BODY.joint("LeftThigh"), 0] > 0


def test_weights_are_a_partition_of_unity():
    np.testing.assert_allclose(BODY.weights.sum(axis=1), 1, atol=1e-12)
    assert BODY.weights.min() >= 0
    assert BODY.weights.any(axis=0).all()


def test_left_and_right_are_mirror_images():
    np.testing.assert_allclose(BODY.joints[MIRRORED] * FLIP, BODY.joints, atol=1e-3)
    # Vertices are not paired, so they are compared with points spread over the whole surface.
    face, share = surface_points.sample_surface(BODY.vertices, BODY.faces, 200_000, np.random.default_rng(0))
    points = surface_points.at_barycentric(BODY.vertices, BODY.faces, face, share)
    assert cKDTree(points).query(BODY.vertices * FLIP)[0].max() < 0.01


@pytest.mark.parametrize("seed", range(3))
def test_joints_of_all_shapes_are_mirror_images_and_inside(seed):
    vertices, joints = BODY.shaped(sample_shape(BODY, seed, 0))
    np.testing.assert_allclose(joints[MIRRORED] * FLIP, joints, atol=0.02)
    assert (joints > vertices.min(axis=0)).all()
    assert (joints < vertices.max(axis=0)).all()


def test_components_change_the_lengths_of_legs_neck_and_trunk():
    above = list(BODY.parents[1:])
    lengths = np.stack(
        [np.linalg.norm(np.diff(joints[np.array([above, range(1, len(joints))])], axis=0)[0], axis=1)
         for joints in (BODY.shaped(sample_shape(BODY, 0, i))[1] for i in range(30))]
    )  # fmt: skip
    change = lengths.std(axis=0) / lengths.mean(axis=0)
    for name in ("LeftForearm", "RightShin", "Neck2", "Spine2", "Tail4"):
        assert change[BODY.joint(name) - 1] > 0.05, name


def test_landmarks_are_distinct_vertices_of_their_parts():
    found = landmarks(BODY)
    assert len(found) == len(LANDMARKS)  # deformation transfer takes the first five of both bodies
    assert len(set(found.values())) == len(found)
    strongest = {name: BODY.joint_names[BODY.weights[vertex].argmax()] for name, vertex in found.items()}
    assert strongest["nose"] in ("Head", "Jaw")
    for side in ("left", "right"):
        assert strongest[f"{side} forefoot"] in (f"{side.title()}Fingers", f"{side.title()}Hand")
        assert strongest[f"{side} hind foot"] in (f"{side.title()}Toes", f"{side.title()}Foot")
        sign = 1 if side == "left" else -1
        for part in ("forefoot", "hind foot", "elbow", "knee"):
            assert sign * BODY.vertices[found[f"{side} {part}"], 0] > 0.02


@pytest.mark.parametrize("name", ["human", "quadruped"])
def test_all_joints_of_an_anatomy_are_those_of_its_body(name):
    body, anatomy = load_body(name), anatomy_of(name)
    named = {
        *(joint for chain in (*anatomy.legs, *anatomy.hinges, *anatomy.ends) for joint in chain),
        *anatomy.long_bones,
        *anatomy.regions.values(),
        *anatomy.props,
    }
    assert named <= set(body.joint_names)
    assert sum(anatomy.props.values()) == pytest.approx(1.0)
    for chain in (*anatomy.legs, *anatomy.hinges):
        for above, below in itertools.pairwise(chain):
            assert body.parents[body.joint(below)] == body.joint(above)


def test_anatomy_is_that_of_the_legs_among_the_joints():
    assert anatomy_of_joints(BODY.joint_names) is QUADRUPED
    assert anatomy_of_joints(("Hips", "RightThigh", "Head")) is QUADRUPED
    assert anatomy_of_joints(load_body().joint_names) is HUMAN
    assert anatomy_of_joints(("Hips", "Head")) is HUMAN


@pytest.mark.parametrize("table", [LIMITS, USUAL], ids=["limits", "usual"])
def test_ranges_are_those_of_joints_alike_on_both_sides_and_with_rest_in_them(table):
    assert set(table) <= set(BODY.joint_names)
    for name, ranges in table.items():
        assert all(low <= 0 <= high for low, high in ranges), name
        if name.startswith("Left"):
            x, y, z = ranges
            assert table["Right" + name[4:]] == (x, (-y[1], -y[0]), (-z[1], -z[0]))
    assert all(low >= LIMITS[name][k][0] - 1 and high <= LIMITS[name][k][1] + 1
               for name, ranges in USUAL.items() for k, (low, high) in enumerate(ranges) if k == 0)  # fmt: skip
