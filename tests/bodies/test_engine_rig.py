"""Layouts of game engines: the motion stays, names and hierarchy are the documented ones, the rest pose is as asked."""

from dataclasses import replace
from functools import cache

import engine_rigs
import numpy as np
import pytest
from engine_rigs import ROOTS, expected_parents, posed
from matrix import matrix

from mimesh.bodies.engine_names import REQUIRED, SCHEMES
from mimesh.bodies.engine_rig import A_ANGLE, engine_rig
from mimesh.bodies.joint_names import named_fingers, named_joints
from mimesh.core.errors import InputError
from mimesh.core.geometry import unit_vectors
from mimesh.core.normalization import ORIENTATIONS, ROTATIONS
from mimesh.core.options import Layout
from mimesh.core.rig import Rig

moving_rig = cache(engine_rigs.moving_rig)
ENGINES = tuple(name for name in SCHEMES if name != "own")
FACINGS = (("+y", "+z"), ("+z", "-y"), ("+y", "-x"))
VRM_REQUIRED = (
    "hips spine head leftUpperLeg leftLowerLeg leftFoot rightUpperLeg rightLowerLeg rightFoot "
    "leftUpperArm leftLowerArm leftHand rightUpperArm rightLowerArm rightHand"
)
"""`Required` in the tables of VRM 1.0's humanoid.md."""
GODOT_REQUIRED = (
    "Hips Spine Head LeftShoulder LeftUpperArm LeftLowerArm LeftHand RightShoulder RightUpperArm RightLowerArm "
    "RightHand LeftUpperLeg LeftLowerLeg LeftFoot RightUpperLeg RightLowerLeg RightFoot"
)
"""Bones with `required` in Godot's skeleton_profile.cpp."""


def size(rig):
    return np.ptp(rig.mesh.vertices, axis=0).max()


def parent_names(rig):
    return {name: rig.names[parent] for name, parent in zip(rig.names, rig.parents, strict=True) if parent >= 0}


@matrix("names", SCHEMES, quick=["own", "unreal", "vrm"])
@pytest.mark.parametrize("root_bone", [False, True])
@matrix("fingers", [False, True], quick=[True])
def test_every_frame_stays_in_every_layout(names, root_bone, fingers):
    for seed, (up, front) in enumerate(FACINGS):
        rig = moving_rig(seed, fingers, up, front)
        laid = engine_rig(rig, names, root_bone, up=up, front=front)
        assert np.allclose(laid.rig.weights.sum(axis=1), 1.0)
        assert np.array_equal(laid.mesh.vertices, rig.mesh.vertices)
        for t in range(len(rig.root)):
            assert np.abs(posed(laid, t) - posed(rig, t)).max() < 1e-9 * size(rig)


@matrix("names", SCHEMES, quick=["unreal", "vrm"])
@pytest.mark.parametrize("rest", ["T", "A"])
@matrix("root_bone", [False, True], quick=[True])
def test_a_rig_in_another_rest_pose_takes_the_mesh_back_to_its_file(names, rest, root_bone):
    """Frame 0 is the pose of the file: there the vertices are exact; other frames deviate a little at the shoulders."""
    rig = moving_rig(1, fingers=True, arms=20.0)
    rotation = np.concatenate([rig.rig.rotation[None], rig.rotation])
    still = replace(rig, rotation=rotation, root=np.concatenate([rig.rig.joints[:1], rig.root]))
    laid = engine_rig(still, names, root_bone, rest)
    assert np.abs(posed(laid, 0) - rig.mesh.vertices).max() < 1e-5 * size(rig)
    for t in range(1, len(still.root)):
        difference = np.linalg.norm(posed(laid, t) - posed(still, t), axis=1) / size(rig)
        assert difference.max() < 0.02
        assert difference.mean() < 1e-3


@pytest.mark.parametrize("names", ENGINES)
@pytest.mark.parametrize("root_bone", [False, True])
@pytest.mark.parametrize("fingers", [False, True])
def test_names_and_hierarchy_are_the_documented_ones(names, root_bone, fingers):
    laid = engine_rig(moving_rig(0, fingers), names, root_bone)
    found, wanted = parent_names(laid), expected_parents(names, fingers)
    assert len(set(laid.names)) == len(laid.names)
    assert all(parent < j for j, parent in enumerate(laid.parents))
    assert laid.parents.count(-1) == 1
    assert {name: found.get(name) for name in wanted} == wanted
    hips = SCHEMES[names].bones["Hips"]
    assert found.get(hips) == (ROOTS[names] if root_bone or names == "unreal" else None)
    # What is not in the documented hierarchy is ours, and no documented bone is below it.
    extra = {name for name in laid.names if name not in {*wanted, *wanted.values(), hips, ROOTS[names]}}
    assert extra <= set(moving_rig(0, fingers).names)
    assert not extra & set(wanted.values())


@pytest.mark.parametrize(("names", "required"), [("vrm", VRM_REQUIRED), ("godot", GODOT_REQUIRED)])
def test_required_bones_are_there(names, required):
    assert set(required.split()) <= set(engine_rig(moving_rig(0), names).names)
    assert {SCHEMES["vrm"].bones[joint] for joint in REQUIRED} == set(VRM_REQUIRED.split())


@pytest.mark.parametrize("names", ENGINES)
def test_names_are_read_again_as_the_joints_they_are(names):
    laid = engine_rig(moving_rig(0, fingers=True), names)
    found = named_joints(laid.names, laid.parents)
    hands = {side: found[side] for side in ("LeftHand", "RightHand")}
    found |= named_fingers(laid.names, laid.parents, hands)
    read = {joint: laid.names[j] for joint, j in found.items()}
    for joint, bone in SCHEMES[names].bones.items():
        assert read[joint] == bone


@pytest.mark.parametrize(("up", "front"), FACINGS)
def test_root_bone_has_the_way_over_the_ground_and_nothing_else(up, front):
    rig = moving_rig(3, up=up, front=front)
    laid = engine_rig(rig, "godot", True, up=up, front=front)
    axes = ROTATIONS[ORIENTATIONS.index((up, front))]
    root, hips = (laid.joint_positions()[:, laid.names.index(name)] @ axes.T for name in ("Root", "Hips"))
    assert np.allclose(np.ptp(root[:, 1]), 0)
    assert np.allclose(root[0, 1], (rig.mesh.vertices @ axes.T)[:, 1].min())
    assert np.allclose(np.diff(root, axis=0)[:, [0, 2]], np.diff(rig.root @ axes.T, axis=0)[:, [0, 2]])
    assert np.allclose(hips - root, (hips - root)[0] * [1, 0, 1] + (hips - root) * [0, 1, 0])
    assert np.allclose(laid.rotation[:, 0], axes.T)
    assert np.allclose(hips, rig.root @ axes.T)


@pytest.mark.parametrize(("up", "front"), FACINGS)
@pytest.mark.parametrize("rest", ["T", "A"])
def test_limbs_of_the_rest_pose_point_where_they_should(rest, up, front):
    rig = moving_rig(2, True, up, front, arms=35.0)
    laid = engine_rig(rig, "vrm", rest=rest, up=up, front=front)
    axes = ROTATIONS[ORIENTATIONS.index((up, front))]
    joints = dict(zip(laid.names, laid.rig.joints @ axes.T, strict=True))
    below = np.radians(A_ANGLE if rest == "A" else 0.0)
    for side, left in (("left", 1), ("right", -1)):
        along = [left * np.cos(below), -np.sin(below), 0.0]
        for start, end in (("UpperArm", "LowerArm"), ("LowerArm", "Hand"), ("Hand", "MiddleProximal")):
            assert np.allclose(unit_vectors(joints[side + end] - joints[side + start]), along, atol=1e-6)
        if rest == "T":
            finger = unit_vectors(joints[side + "RingIntermediate"] - joints[side + "RingProximal"])
            thumb = unit_vectors(joints[side + "ThumbProximal"] - joints[side + "ThumbMetacarpal"])
            assert np.allclose(finger, [left, 0, 0], atol=1e-6)
            assert np.allclose(thumb, [left * 0.5**0.5, 0, 0.5**0.5], atol=1e-6)
    ours = engine_rig(rig, "own", rest=rest, up=up, front=front)
    joints = dict(zip(ours.names, ours.rig.joints @ axes.T, strict=True))
    for side in ("Left", "Right"):
        foot = joints[f"{side}ToeBase"] - joints[f"{side}Foot"]
        assert abs(foot[0]) < 1e-9
        assert foot[2] > 0
    assert np.isclose((laid.mesh.vertices @ axes.T)[:, 1].min(), (rig.mesh.vertices @ axes.T)[:, 1].min())
    assert np.allclose(laid.rig.rotation, axes.T)  # no bone is turned at rest


STEPS = {
    "own": {},
    "mixamo": {"Hips": (0, 2.2855, 1.2754), "Head": (0, -5.4288, 1.4165)},
    "unreal": {},
    "vrm": {"Head": (0, -5.4288, 1.4165)},
    "godot": {"Head": (0, -5.4288, 1.4165)},
    "rigify": {},
}
"""How far joints of schemes are from those of the shipped body (left, up, front), in cm; toes are alike in all."""


@pytest.mark.parametrize("names", SCHEMES)
def test_joints_lie_where_programs_have_them(names):
    """Heads at the base of the skull, toes at the ball of the foot."""
    rig = moving_rig(4)
    laid = engine_rig(rig, names)
    joints = dict(zip(laid.names, laid.rig.joints, strict=True))
    steps = STEPS[names]
    if names != "own":
        steps = steps | {f"{side}ToeBase": (x, -1.0742, -1.5688) for side, x in (("Left", -1.1942), ("Right", 1.1942))}
    for name, old, frame in zip(rig.names, rig.rig.joints, rig.rig.rotation, strict=True):
        bone = SCHEMES[names].bones.get(name, name)
        if bone in joints:
            step = frame.T @ (joints[bone] - old)
            np.testing.assert_allclose(100 * step, steps.get(name, (0, 0, 0)), atol=1e-3, err_msg=name)


def test_the_default_changes_nothing():
    rig = moving_rig(0)
    assert engine_rig(rig) is rig


def test_other_joints_keep_their_names():
    rig = moving_rig(0)
    tail = np.zeros((len(rig.mesh.vertices), 1))
    tail[:3] = 1.0
    weights = np.concatenate([rig.rig.weights * (1 - tail), tail], axis=1)
    joints = np.append(rig.rig.joints, [[0, 0.9, -0.2]], 0)
    rest = Rig(np.concatenate([rig.rig.rotation, np.eye(3)[None]]), joints, weights)
    rotation = np.concatenate([rig.rotation, rig.rotation[:, :1]], axis=1)
    longer = replace(rig, names=(*rig.names, "Tail"), parents=(*rig.parents, 0), rig=rest, rotation=rotation)
    assert parent_names(engine_rig(longer, "unreal"))["Tail"] == "pelvis"


def test_unknown_layouts_are_refused():
    with pytest.raises(InputError, match=r"names: expected one of own, .*rigify, found 'maya'"):
        engine_rig(moving_rig(0), "maya")
    with pytest.raises(InputError, match="rest: expected one of file, T, A, found 'sitting'"):
        Layout("vrm", rest="sitting")
    with pytest.raises(InputError, match="output_fps: expected a frame rate from"):
        Layout("vrm", fps=-1.0)


def test_a_rig_that_is_no_person_is_refused():
    rig = moving_rig(0)
    renamed = replace(rig, names=tuple(f"bone{j}" for j in range(31)))
    with pytest.raises(InputError, match=r"names=\"godot\": expected joints for a whole person, found none for Hips"):
        engine_rig(renamed, "godot")
    with pytest.raises(InputError, match=r"rest=\"T\": expected joints"):
        engine_rig(renamed, rest="T")


def test_a_character_that_sits_stands_in_the_rest_pose():
    rig = moving_rig(0)
    names = list(rig.names)
    turn = np.tile(np.eye(3), (len(names), 1, 1))
    for side in ("Left", "Right"):
        turn[names.index(f"{side}UpLeg")] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # thighs forward, -90 degrees about x
    world, joints = turn.copy(), rig.rig.joints.copy()
    for j, parent in enumerate(rig.parents):
        if parent >= 0:
            world[j] = world[parent] @ turn[j]
            joints[j] = joints[parent] + world[parent] @ (rig.rig.joints[j] - rig.rig.joints[parent])
    sitting = replace(rig, rig=Rig(world @ rig.rig.rotation, joints, rig.rig.weights))
    laid = engine_rig(sitting, "vrm", rest="T")
    at = dict(zip(laid.names, laid.rig.joints, strict=True))
    assert np.allclose(unit_vectors(at["leftLowerLeg"] - at["leftUpperLeg"]), [0, -1, 0], atol=1e-6)
