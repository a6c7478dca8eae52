"""Predicted joints are moved to corrected positions, others with them, and the rotations follow."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_pose
from mimesh.methods.mime.joint_targets import JointTargets, two_bone_middle

BODY = load_body()
AT = {name: j for j, name in enumerate(BODY.joint_names)}
LIMBS = [(f"{side}{a}", f"{side}{b}") for side in ("Left", "Right") for a, b in (("UpLeg", "Leg"), ("Leg", "Foot"),
         ("Arm", "ForeArm"), ("ForeArm", "Hand"))]  # fmt: skip
FRONT = np.array([0.0, 0, 1])


def pose(seed=0):
    """World rotations and positions of the joints in a pose of Table 6."""
    local = Rotation.from_rotvec(sample_pose(BODY, seed, 0)).as_matrix()
    rotation, offset = BODY.skinning_transforms(BODY.joints, local)
    return rotation, offset + (rotation @ BODY.joints[..., None])[..., 0]


def moved(positions, rotation, joints):
    index = [AT[name] for name in positions]
    return JointTargets(index, np.array(list(positions.values()))).move(rotation, joints)


def assert_bones_follow(rotation, joints, limbs=LIMBS):
    for first, second in limbs:
        predicted = rotation[AT[first]] @ (BODY.joints[AT[second]] - BODY.joints[AT[first]])
        bone = joints[AT[second]] - joints[AT[first]]
        cosine = predicted @ bone / np.linalg.norm(predicted) / np.linalg.norm(bone)
        assert cosine > 1 - 1e-6, (first, second)


@pytest.mark.parametrize("seed", range(3))
def test_targets_where_joints_are_change_nothing(seed):
    rotation, joints = pose(seed)
    result = moved({name: joints[AT[name]] for name in ("Head", "LeftLeg", "RightHand", "Hips")}, rotation, joints)
    for array, expected in zip(result, (rotation, joints), strict=True):
        np.testing.assert_allclose(array, expected, atol=1e-9)


@pytest.mark.parametrize("name", ["LeftLeg", "RightForeArm"])
def test_a_dragged_knee_or_elbow_turns_both_bones_and_leaves_the_end(name):
    rotation, joints = pose()
    result, positions = moved({name: joints[AT[name]] + [0.05, 0.02, 0.04]}, rotation, joints)
    np.testing.assert_array_equal(positions[AT[name]], joints[AT[name]] + [0.05, 0.02, 0.04])
    others = [j for j in range(31) if j != AT[name]]
    np.testing.assert_allclose(positions[others], joints[others], atol=1e-9)
    assert_bones_follow(result, positions)
    np.testing.assert_allclose(np.linalg.det(result), 1)
    np.testing.assert_allclose(result @ result.swapaxes(1, 2), np.tile(np.eye(3), (31, 1, 1)), atol=1e-9)


def test_a_dragged_foot_bends_the_knee_and_takes_the_toes_along():
    rotation, joints = pose()
    foot = joints[AT["LeftUpLeg"]] + [0.1, -0.15, 0.2]  # the shin alone would be too short
    result, positions = moved({"LeftFoot": foot}, rotation, joints)
    for first, second in (("LeftUpLeg", "LeftLeg"), ("LeftLeg", "LeftFoot"), ("LeftFoot", "LeftToeBase")):
        before, after = (np.linalg.norm(p[AT[second]] - p[AT[first]]) for p in (joints, positions))
        assert after == pytest.approx(before)
    assert_bones_follow(result, positions)
    untouched = [AT[name] for name in ("Head", "RightFoot", "LeftHand", "Hips")]
    np.testing.assert_array_equal(positions[untouched], joints[untouched])


def test_one_drag_uncrosses_legs():
    rotation, joints = pose()
    legs = [AT[f"{side}{part}"] for part in ("UpLeg", "Leg", "Foot") for side in ("Left", "Right")]
    crossed = joints.copy()
    crossed[legs] = joints[np.reshape(legs, (3, 2))[:, ::-1].reshape(-1)]
    _, positions = moved({"LeftFoot": joints[AT["LeftFoot"]]}, rotation, crossed)
    np.testing.assert_allclose(positions[legs], joints[legs], atol=1e-9)


def test_a_person_read_from_behind_is_turned_round():
    """Corrected hips, shoulders, knees, elbows, hands and feet: the twist of every limb is turned with them."""
    rotation, joints = pose()
    round_about = Rotation.from_euler("y", 180, degrees=True).as_matrix()
    wrong = round_about @ rotation
    mirrored = joints.copy()
    for part in ("UpLeg", "Leg", "Foot", "ToeBase", "Arm", "ForeArm", "Hand", "Shoulder"):
        pair = [AT[f"Left{part}"], AT[f"Right{part}"]]
        mirrored[pair] = joints[pair[::-1]]
    names = [f"{side}{part}" for side in ("Left", "Right") for part in
             ("UpLeg", "Leg", "Foot", "Arm", "ForeArm", "Hand")]  # fmt: skip
    result, _ = moved({name: joints[AT[name]] for name in names}, wrong, mirrored)
    checked = [AT[name] for name in (*names[:2], *names[3:5], *names[6:8], *names[9:11], "Hips", "Spine1")]
    cosine = (np.einsum("jab,jab->j", result[checked], rotation[checked]) - 1) / 2
    assert np.degrees(np.arccos(cosine.clip(-1, 1))).max() < 75  # 180 before


@pytest.mark.parametrize("end", [(0.0, -3, 0), (0, -2, 0), (0, 0, 0)])
def test_limbs_that_cannot_reach_are_stretched(end):
    middle = two_bone_middle(np.array([[0.0, 0, 0], [0, -1, 0], [0, -2, 0]]), np.zeros(3), np.array(end, float), FRONT)
    np.testing.assert_allclose(middle, np.array(end) / 2)


def test_straight_limbs_bend_to_the_front():
    limb = np.array([[0.0, 0, 0], [0, -1, 0], [0, -2, 0]])
    middle = two_bone_middle(limb, np.zeros(3), np.array([0.0, -np.sqrt(2), 0]), FRONT)
    np.testing.assert_allclose(middle, [0, -np.sqrt(0.5), np.sqrt(0.5)], atol=1e-9)
