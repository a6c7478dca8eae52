"""Predicted joints are moved to corrected positions, others with them, and the rotations follow."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampling import sample_pose
from mimesh.mime.joint_targets import JointTargets, two_bone_middle
from mimesh.motions.gaits import gait_rotations


@dataclass(frozen=True)
class Skeleton:
    """The joints of a shipped body in a pose, and targets for them."""

    kind: str

    @cached_property
    def body(self):
        return load_body(self.kind)

    @cached_property
    def at(self):
        return {name: j for j, name in enumerate(self.body.joint_names)}

    def posed(self, local):
        """World rotations and positions of the joints."""
        rotation, offset = self.body.skinning_transforms(self.body.joints, local)
        return rotation, offset + (rotation @ self.body.joints[..., None])[..., 0]

    def moved(self, positions, rotation, joints):
        index = [self.at[name] for name in positions]
        return JointTargets(index, np.array(list(positions.values())), self.kind).move(rotation, joints)

    def bone(self, joints, first, second):
        return joints[self.at[second]] - joints[self.at[first]]

    def assert_bones_follow(self, rotation, joints, bones):
        for first, second in bones:
            predicted = rotation[self.at[first]] @ self.bone(self.body.joints, first, second)
            found = self.bone(joints, first, second)
            cosine = predicted @ found / np.linalg.norm(predicted) / np.linalg.norm(found)
            assert cosine > 1 - 1e-6, (first, second)


PERSON, ANIMAL = Skeleton("human"), Skeleton("quadruped")
AT, ANIMAL_AT, moved, animal_moved, bone = PERSON.at, ANIMAL.at, PERSON.moved, ANIMAL.moved, ANIMAL.bone
LIMBS = [(f"{side}{a}", f"{side}{b}") for side in ("Left", "Right") for a, b in (("UpLeg", "Leg"), ("Leg", "Foot"),
         ("Arm", "ForeArm"), ("ForeArm", "Hand"))]  # fmt: skip
FRONT = np.array([0.0, 0, 1])


def pose(seed=0):
    """World rotations and positions of the joints in a pose of Table 6."""
    return PERSON.posed(Rotation.from_rotvec(sample_pose(PERSON.body, seed, 0)).as_matrix())


def animal_pose():
    return ANIMAL.posed(gait_rotations(ANIMAL.body, "walk", 0, 0, 1.0, 10.0)[3])


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
    PERSON.assert_bones_follow(result, positions, LIMBS)
    np.testing.assert_allclose(np.linalg.det(result), 1)
    np.testing.assert_allclose(result @ result.swapaxes(1, 2), np.tile(np.eye(3), (31, 1, 1)), atol=1e-9)


def test_a_dragged_foot_bends_the_knee_and_takes_the_toes_along():
    rotation, joints = pose()
    foot = joints[AT["LeftUpLeg"]] + [0.1, -0.15, 0.2]  # the shin alone would be too short
    result, positions = moved({"LeftFoot": foot}, rotation, joints)
    for first, second in (("LeftUpLeg", "LeftLeg"), ("LeftLeg", "LeftFoot"), ("LeftFoot", "LeftToeBase")):
        before, after = (np.linalg.norm(p[AT[second]] - p[AT[first]]) for p in (joints, positions))
        assert after == pytest.approx(before)
    PERSON.assert_bones_follow(result, positions, LIMBS)
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


@pytest.mark.parametrize("leg", [("Thigh", "Shin", "Foot"), ("UpperArm", "Forearm", "Hand")])
def test_a_dragged_knee_or_elbow_of_an_animal_leaves_the_other_joints(leg):
    rotation, joints = animal_pose()
    names = [f"Right{part}" for part in leg]
    target = joints[ANIMAL_AT[names[1]]] + [0.01, 0.02, 0.03]
    result, positions = animal_moved({names[1]: target}, rotation, joints)
    np.testing.assert_array_equal(positions[ANIMAL_AT[names[1]]], target)
    others = np.arange(37) != ANIMAL_AT[names[1]]
    np.testing.assert_allclose(positions[others], joints[others], atol=1e-9)
    ANIMAL.assert_bones_follow(result, positions, pairwise(names))
    np.testing.assert_allclose(np.linalg.det(result), 1)


@pytest.mark.parametrize("leg", [("Thigh", "Shin", "Foot", "Toes"), ("UpperArm", "Forearm", "Hand", "Fingers")])
def test_dragged_toes_of_an_animal_take_the_hock_along_and_bend_the_knee(leg):
    rotation, joints = animal_pose()
    upper, middle, end, toes = (f"Left{part}" for part in leg)
    step = np.array([0.02, 0.06, 0.03])
    result, positions = animal_moved({toes: joints[ANIMAL_AT[toes]] + step}, rotation, joints)
    np.testing.assert_allclose(positions[ANIMAL_AT[end]], joints[ANIMAL_AT[end]] + step)
    ANIMAL.assert_bones_follow(result, positions, pairwise((upper, middle, end, toes)))
    before, after = (bone(of, upper, end) for of in (joints, positions))
    assert np.linalg.norm(after) < np.linalg.norm(before)
    sides = [np.cross(bone(of, upper, middle), bone(of, middle, end)) for of in (joints, positions)]
    assert sides[0] @ sides[1] > 0, "the leg bends to the side that it bent to"


def test_a_hock_far_from_its_place_takes_the_toes_along():
    rotation, joints = animal_pose()
    hock = joints[ANIMAL_AT["LeftFoot"]] + [0.0, 0.0, 0.25]
    _, positions = animal_moved({"LeftFoot": hock}, rotation, joints)
    np.testing.assert_allclose(bone(positions, "LeftFoot", "LeftToes"), bone(joints, "LeftFoot", "LeftToes"))
    _, near = animal_moved({"LeftFoot": joints[ANIMAL_AT["LeftFoot"]] + [0, 0, 0.01]}, rotation, joints)
    np.testing.assert_array_equal(near[ANIMAL_AT["LeftToes"]], joints[ANIMAL_AT["LeftToes"]])


def test_a_dragged_end_of_the_tail_bends_the_whole_tail():
    rotation, joints = animal_pose()
    end = joints[ANIMAL_AT["Tail6"]] + [0.1, 0.2, 0.0]
    result, positions = animal_moved({"Tail6": end}, rotation, joints)
    np.testing.assert_array_equal(positions[ANIMAL_AT["Tail6"]], end)
    np.testing.assert_array_equal(positions[ANIMAL_AT["Tail1"]], joints[ANIMAL_AT["Tail1"]])
    heights = [positions[ANIMAL_AT[f"Tail{k}"]][1] - joints[ANIMAL_AT[f"Tail{k}"]][1] for k in range(1, 7)]
    assert all(a < b for a, b in pairwise(heights))
    ANIMAL.assert_bones_follow(result, positions, pairwise(f"Tail{k}" for k in range(1, 7)))
    kept = np.array(["Tail" not in name for name in ANIMAL.body.joint_names])
    np.testing.assert_allclose(positions[kept], joints[kept], atol=1e-9)


def test_a_paw_on_the_other_side_of_an_animal_swaps_its_legs():
    rotation, joints = animal_pose()
    _, positions = animal_moved({"LeftToes": joints[ANIMAL_AT["RightToes"]]}, rotation, joints)
    for part in ("Thigh", "Shin", "Foot"):
        np.testing.assert_allclose(positions[ANIMAL_AT[f"Left{part}"]], joints[ANIMAL_AT[f"Right{part}"]], atol=1e-9)
    np.testing.assert_array_equal(positions[ANIMAL_AT["LeftHand"]], joints[ANIMAL_AT["LeftHand"]])
