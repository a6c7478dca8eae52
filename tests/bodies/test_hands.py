"""Finger joints of the shipped body, their poses, and the names of other skeletons' finger joints."""

import numpy as np
import pytest
from hand_gestures import GESTURES, finger_rotations, fingertips, gestures, within_limits

from mimesh.bodies import load_body
from mimesh.bodies.hands import HAND_PARENTS, body_with_fingers, hand_frames, load_hands, straight_hand
from mimesh.bodies.joint_names import FINGERS, finger_joints, named_fingers, with_finger_joints
from mimesh.core.geometry import MIRROR
from mimesh.motions.humanoid_rig import rest_frames

CHAINS = {
    "Mixamo": [[f"mixamorig:LeftHand{finger}{k}" for k in (1, 2, 3, 4)] for finger in FINGERS],
    "Unreal": [
        [f"thumb_0{k}_l" for k in (1, 2, 3)],
        *([f"{f}_metacarpal_l", *(f"{f}_0{k}_l" for k in (1, 2, 3))] for f in ("index", "middle", "ring", "pinky")),
    ],
    "Biped": [[f"Bip01 L Finger{f}{k}" for k in ("", "1", "2", "Nub")] for f in range(5)],
    "VRM 0": [[f"J_Bip_L_{f}{k}" for k in (1, 2, 3)] for f in ("Thumb", "Index", "Middle", "Ring", "Little")],
    "VRM 1": [
        ["leftThumbMetacarpal", "leftThumbProximal", "leftThumbDistal"],
        *(
            [f"left{f}{k}" for k in ("Proximal", "Intermediate", "Distal")]
            for f in ("Index", "Middle", "Ring", "Little")
        ),
    ],
    "MakeHuman": [
        [f"finger1-{k}.L" for k in (1, 2, 3)],
        *([f"metacarpal{f - 1}.L", *(f"finger{f}-{k}.L" for k in (1, 2, 3))] for f in (2, 3, 4, 5)),
    ],
    "Xsens": [
        [f"LeftFirst{k}" for k in ("MC", "PP", "DP")],
        *([f"Left{f}{k}" for k in ("MC", "PP", "MP", "DP")] for f in ("Second", "Third", "Fourth", "Fifth")),
    ],
    "MikuMikuDance": [
        [f"左親指{k}" for k in "０１２"],
        *([f"左{f}{k}" for k in ("１", "２", "３", "先")] for f in ("人指", "中指", "薬指", "小指")),
    ],
    "Rigify": [
        [f"DEF-thumb.0{k}.L" for k in (1, 2, 3)],
        *(
            [f"DEF-palm.0{i}.L", *(f"DEF-f_{f}.0{k}.L" for k in (1, 2, 3))]
            for i, f in enumerate(("index", "middle", "ring", "pinky"), 1)
        ),
    ],
}
"""Joints of each finger of a left hand, from the hand outwards, as makers call them."""


def left_hand(chains: list[list[str]]) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Build a skeleton of one arm with the given fingers."""
    names, parents = ["Hips", "LeftArm", "LeftForeArm", "LeftHand"], [-1, 0, 1, 2]
    for chain in chains:
        for k, name in enumerate(chain):
            parents.append(len(names) - 1 if k else 3)
            names.append(name)
    return tuple(names), tuple(parents)


@pytest.mark.parametrize("maker", CHAINS)
def test_fifteen_joints_are_found_by_the_names_of_each_maker(maker):
    names, parents = left_hand(CHAINS[maker])
    found = named_fingers(names, parents, {"LeftHand": 3})
    assert tuple(found) == finger_joints("Left")
    assert found["LeftHandThumb1"] == names.index(CHAINS[maker][0][0])
    phalanges = [
        name for name in CHAINS[maker][4] if not any(word in name.lower() for word in ("carpal", "palm", "mc"))
    ]
    assert found["LeftHandPinky3"] == names.index(phalanges[2])


def test_a_word_of_the_hands_own_name_is_no_word_of_a_finger():
    names, parents = left_hand(
        [[f"CC_Base_L_{f}{k}" for k in (1, 2, 3)] for f in ("Thumb", "Index", "Mid", "Ring", "Pinky")]
    )
    names = ("CC_Base_Hip", "CC_Base_L_Upperarm", "CC_Base_L_Forearm", "CC_Base_L_Hand", *names[4:])
    assert named_fingers(names, parents, {"LeftHand": 3}) == {n: 4 + k for k, n in enumerate(finger_joints("Left"))}


def named(chains: list[list[str]]) -> dict[str, str]:
    """Find the finger joints of a hand: the name of each that is found."""
    names, parents = left_hand(chains)
    return {joint: names[j] for joint, j in named_fingers(names, parents, {"LeftHand": 3}).items()}


def test_single_joints_of_cmu_are_the_first_of_their_finger_and_words_are_no_parts_of_others():
    found = named([["LThumb"], ["LeftFingerBase", "LeftHandIndex1"]])
    assert found == {"LeftHandThumb1": "LThumb", "LeftHandIndex1": "LeftHandIndex1"}
    chains = [["spring01_l"], ["midway_l"], ["lring1", "lring2"], ["leftindexproximal"], ["LTHUMB1"]]
    assert named([*chains, ["mixamoriglefthandmiddle1"]]) == {
        "LeftHandThumb1": "LTHUMB1",
        "LeftHandIndex1": "leftindexproximal",
        "LeftHandMiddle1": "mixamoriglefthandmiddle1",
        "LeftHandRing1": "lring1",
        "LeftHandRing2": "lring2",
    }


def test_one_chain_for_all_other_fingers_is_the_middle_finger():
    """Synty: the right hand has the names of the left one, with a number."""
    chains = [[f"{f}_0{k}.001" for k in (1, 2, 3, 4)] for f in ("Thumb", "IndexFinger", "Finger")]
    assert named(chains) == {
        f"LeftHand{finger}{k}": chain[k - 1]
        for finger, chain in zip(FINGERS[:3], chains, strict=True)
        for k in (1, 2, 3)
    }


def test_stubs_of_the_shipped_body_are_no_fingers_where_there_are_others():
    """mime writes rigs with both: all joints of the shipped body, two of them without weight, and its fingers."""
    stubs, joints = [["LeftFingerBase", "LeftHandFinger1"], ["LThumb"]], np.array(finger_joints("Left")).reshape(5, 3)
    assert named([*stubs, *joints.tolist()]) == {name: name for name in finger_joints("Left")}
    assert tuple(named([["LThumb", "LThumb1", "LThumb2"]]).values()) == ("LThumb", "LThumb1", "LThumb2")


def test_fingers_need_a_hand_and_names_above_it_do_not_count():
    names, parents = left_hand([["LThumb"]])
    assert named_fingers(names, parents, {}) == {}
    assert named_fingers(("LeftHand", "LThumb"), (1, -1), {"LeftHand": 0}) == {}


def test_body_with_fingers_is_the_body_with_other_joints():
    body, fingered = load_body(), body_with_fingers()
    assert fingered.joint_names == with_finger_joints(body.joint_names)
    assert len(fingered.joint_names) == 55
    assert not any("FingerBase" in name or "HandFinger1" in name for name in fingered.joint_names)
    assert np.allclose(fingered.weights.sum(axis=1), 1.0)
    assert (fingered.weights >= 0).all()
    assert np.array_equal(fingered.vertices, body.vertices)
    # In poses that leave the fingers alone the surface is the body's to rounding.
    rotmat = np.tile(np.eye(3), (31, 1, 1))
    turn = finger_rotations(np.full((15, 2), 20.0), left=True)[4]
    rotmat[body.joint("LeftHand")] = rotmat[body.joint("LeftForeArm")] = turn
    with_fingers = np.tile(np.eye(3), (55, 1, 1))
    for j, name in enumerate(fingered.joint_names[:25]):
        with_fingers[j] = rotmat[body.joint(name)]
    shape = np.array([1.0, -0.5])
    assert np.allclose(fingered.posed(shape, with_fingers), body.posed(shape, rotmat), atol=1e-9)


def test_hands_are_mirror_images_and_fingers_lie_beyond_their_joints():
    hands, body = load_hands(), body_with_fingers()
    assert np.allclose(hands.joints[:15] * MIRROR, hands.joints[15:], atol=1e-3)
    tips = body.vertices[fingertips(body.vertices, body.weights[:, 25:40], hands.joints[:15])]
    lengths = np.linalg.norm(np.diff(np.concatenate([hands.joints[:15].reshape(5, 3, 3), tips[:, None]], 1), axis=1),
                             axis=-1)  # fmt: skip
    assert (lengths > 0.01).all()
    assert (lengths < 0.05).all()
    assert HAND_PARENTS == (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)


def test_fist_brings_the_fingertips_to_the_palm_of_either_hand():
    body, hands = body_with_fingers(), load_hands()
    angles = within_limits(gestures(np.array([GESTURES.index("fist")]), np.random.default_rng(0)))[0]
    for side, first, left in (("Left", 25, True), ("Right", 40, False)):
        rotmat = np.tile(np.eye(3), (55, 1, 1))
        rotmat[first : first + 15] = finger_rotations(angles, left)
        tips = fingertips(body.vertices, body.weights[:, first : first + 15], hands.joints[first - 25 :][:15])
        wrist = body.joints[body.joint(f"{side}Hand")]
        before, after = (
            np.linalg.norm(v[tips[1:]] - wrist, axis=1) for v in (body.vertices, body.posed(np.zeros(1), rotmat))
        )
        assert (after < 0.72 * before).all()


def test_a_hand_below_an_arm_without_an_elbow_has_a_frame():
    joints = {"Hips": [0, 1, 0]}
    for side, x in (("Left", 1.0), ("Right", -1.0)):
        joints |= {f"{side}UpLeg": [0.1 * x, 0.9, 0], f"{side}Arm": [0.2 * x, 1.4, 0], f"{side}Hand": [0.7 * x, 1.4, 0]}
    frames = rest_frames(np.array([*joints.values()], float), {name: j for j, name in enumerate(joints)}, {})
    np.testing.assert_allclose(frames["LeftHand"], straight_hand("Left"), atol=1e-9)


@pytest.mark.parametrize("finger", ["Index", "Middle"])
def test_the_only_knuckle_of_a_mitten_does_not_turn_its_hand(finger):
    rest = {"LeftForeArm": [0.5, 1.4, 0.0], "LeftHand": [0.7, 1.4, 0.0], f"LeftHand{finger}1": [0.75, 1.34, 0.0]}
    frames = hand_frames({name: np.array(at) for name, at in rest.items()}, np.eye(3), "Left")
    np.testing.assert_allclose(frames["LeftHand"], straight_hand("Left"), atol=1e-9)
