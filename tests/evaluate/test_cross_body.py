"""Characters by other authors take the shipped body's poses by joint names; splits share no character."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import rigs
from foreign_names import renamed
from matrix import matrix

from mimesh.bodies import load_body
from mimesh.bodies.body_model import landmarks
from mimesh.bodies.joint_names import named_joints
from mimesh.bodies.sampling import JOINT_LIMITS, lowered_arms, rotvec_to_rotmat, sample_pose
from mimesh.core.errors import InputError
from mimesh.core.rig import local_rotations
from mimesh.evaluate.cross_body import check_character, cross_body, find_landmarks, pose_at_rest, pose_on_rig
from mimesh.evaluate.metrics import pmd_aligned, resized
from mimesh.io.gltf.skin_file import read_skin
from mimesh.motions.retarget import BONES

SCHEMES = ("cmu", "mixamo", "quaternius", "kaykit", "unreal", "vroid")
"""Naming schemes of joints that the tests use."""


@pytest.fixture(scope="module")
def body():
    return load_body()


@pytest.fixture(scope="module")
def characters(tmp_path_factory) -> Path:
    """A folder with three characters with CMU names, three in an A-pose with mixamo names, and one other skeleton."""
    folder = tmp_path_factory.mktemp("characters")
    lowered = rotvec_to_rotmat(0.6 * lowered_arms(load_body()))
    for i in range(3):
        rigs.character(folder / f"man{i}.glb", shape=i, faces=400 if i == 1 else 300, frames=i)
        rigs.character(folder / f"woman{i}.glb", shape=4 + i, name=renamed("mixamo"), rest=lowered)
    rigs.character(folder / "zed.glb", name=renamed("vroid"))
    (folder / "LICENSE.txt").write_text("CC0")
    return folder


def pose(body, i: int = 0) -> np.ndarray:
    return rotvec_to_rotmat(sample_pose(body, 5, i, JOINT_LIMITS))


def posed_with(known: set[str], body, rotmat: np.ndarray) -> np.ndarray:
    """Vertices of a character made of the shipped body; joints whose names are not `known` follow their parents."""
    world, _ = body.skinning_transforms(body.joints, rotmat)
    for j, (joint, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
        world[j] = world[j] if joint in known else world[parent]
    return body.posed(np.zeros(1), local_rotations(world[None], body.parents)[0])[rigs.kept()]


def joints_in(rig, rotmat, body) -> dict[str, np.ndarray]:
    """Positions of the rig's joints in a pose of the shipped body, by the body's joint names."""
    transforms = rig.skinning_transforms(pose_on_rig(rig, body, rotmat))
    return {n: (transforms[j] @ [*rig.joints[j], 1])[:3] for n, j in named_joints(rig.joint_names, rig.parents).items()}


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


@matrix("scheme", SCHEMES, quick=("mixamo", "kaykit"))
def test_shipped_body_with_other_joint_names_takes_its_own_poses(scheme, body, tmp_path):
    """The vertices are equal; joints that a naming scheme lacks follow their parent."""
    rig = check_character(read_skin(rigs.character(tmp_path / "a.glb", shape=None, name=renamed(scheme))), "a")
    expected = posed_with(set(named_joints(rig.joint_names, rig.parents)), body, pose(body))
    np.testing.assert_allclose(rig.posed(pose_on_rig(rig, body, pose(body))), expected, atol=3e-6)


def test_limb_directions_are_those_of_the_body_for_any_rest_pose(body, tmp_path):
    lowered = rotvec_to_rotmat(0.6 * lowered_arms(body))
    rotation, offset = body.skinning_transforms(body.joints, pose(body))
    body_joints = (rotation @ body.joints[..., None])[..., 0] + offset
    for rest in (None, lowered, rotvec_to_rotmat(sample_pose(body, 1, 0))):
        rig = read_skin(rigs.character(tmp_path / "a.glb", shape=3, rest=rest, frames=2))
        rig_joints = joints_in(rig, pose(body), body)
        for joint, tail in BONES.items():
            expected = unit(body_joints[body.joint(tail)] - body_joints[body.joint(joint)])
            np.testing.assert_allclose(unit(rig_joints[tail] - rig_joints[joint]), expected, atol=1e-6)


def test_pose_at_rest_gives_the_rest_pose(body, tmp_path):
    rig = read_skin(rigs.character(tmp_path / "a.glb", shape=3, rest=rotvec_to_rotmat(lowered_arms(body))))
    local = pose_on_rig(rig, body, pose_at_rest(rig, body))
    np.testing.assert_allclose(local, np.tile(np.eye(3), (len(local), 1, 1)), atol=1e-12)
    arm = pose_at_rest(rig, body)[body.joint("LeftArm")]
    np.testing.assert_allclose(arm, rotvec_to_rotmat(lowered_arms(body))[body.joint("LeftArm")], atol=0.1)


def test_legs_that_are_children_of_the_root_follow_the_hips(body, tmp_path):
    """Some rigs are built so: the root, and with it the legs, rotates like the hips."""
    hold, names = {"LowerBack": "LHipJoint", "LeftUpLeg": "Hips"}, {"Hips": "Root", "LHipJoint": "Hips"}
    path = rigs.character(tmp_path / "a.glb", shape=None, hold=hold, name=lambda name: names.get(name, name))
    rig = read_skin(path)
    assert rig.parents[rig.joint_names.index("LeftUpLeg")] == rig.joint_names.index("Root")
    tilted = pose(body)
    expected = posed_with({name for name in body.joint_names if "Finger" not in name}, body, tilted)
    np.testing.assert_allclose(rig.posed(pose_on_rig(rig, body, tilted)), expected, atol=3e-6)


@matrix("scheme", ["cmu", "quaternius"], quick=["quaternius"])
def test_landmarks_are_those_of_the_shipped_body(scheme, body, tmp_path):
    """In an A-pose, with and without toes; on a decimated body within 5 cm."""
    lowered = rotvec_to_rotmat(0.6 * lowered_arms(body))
    rig = read_skin(rigs.character(tmp_path / "a.glb", shape=None, name=renamed(scheme), rest=lowered, faces=3000))
    expected = body.posed(np.zeros(1), lowered)[list(landmarks(body).values())]
    np.testing.assert_allclose(rig.mesh.vertices[find_landmarks(rig)], expected, atol=0.05)


def test_splits_share_no_character(characters, tmp_path):
    protocol = cross_body(characters)
    test, val = protocol.character_pairs("test"), protocol.character_pairs("val")
    names = [(identity_rig.mesh.name, driving_rig.mesh.name) for identity_rig, driving_rig in test]
    assert names == [("man1", "man2"), ("man2", "man1"), ("woman1", "woman2"), ("woman2", "woman1")]
    assert [(identity_rig.mesh.name, driving_rig.mesh.name) for identity_rig, driving_rig in val] == [
        ("man0", "woman0"),
        ("woman0", "man0"),
    ]
    assert all(identity_rig.skeleton == driving_rig.skeleton for identity_rig, driving_rig in test)
    # Two characters of a skeleton belong to `test` alone.
    for name in ("man0.glb", "man2.glb"):
        shutil.copy(characters / name, tmp_path / name)
    protocol = cross_body(tmp_path)
    assert len(protocol.character_pairs("test")) == 2
    with pytest.raises(InputError, match=r"expected two skeletons of three characters each .* found skeletons of 2 "):
        protocol.character_pairs("val")


def test_figures_of_one_maker_share_a_skeleton_in_any_namespace(tmp_path):
    """Mixamo numbers the namespaces of further characters; other joints beside a person's do not count."""
    mixamo = renamed("mixamo")
    rigs.character(tmp_path / "one.glb", 3, name=mixamo)
    person = rigs.changed(rigs.figure(3), "twists")
    rigs.character(tmp_path / "two.glb", person=person, name=lambda joint: mixamo(joint).replace("rig:", "rig7:"))
    rigs.character(tmp_path / "vroid.glb", name=renamed("vroid"))
    rigs.character(tmp_path / "unreal.glb", name=renamed("unreal"))
    pairs = cross_body(tmp_path).character_pairs("test")
    assert [(a.mesh.name, b.mesh.name) for a, b in pairs] == [("one", "two"), ("two", "one")]


@matrix("split", ["val", "test"], quick=["val"])
def test_truth_is_the_identity_in_the_driving_pose(body, characters, split):
    protocol = cross_body(characters)
    in_rest_pose = set()
    for kind in protocol.kinds:
        for i in range(4):
            pair = protocol.unshuffled_pair(split, kind, i, protocol.rng(split, kind, i))
            identity_rig, driving_rig = next(
                (first, second)
                for first, second in protocol.character_pairs(split)
                if pair.identity.name.startswith(first.mesh.name) and pair.driving.name.startswith(second.mesh.name)
            )
            edge = pair.identity.faces[:, :2]
            lengths = [
                np.linalg.norm(np.diff(v[edge], axis=1)[:, 0], axis=1) for v in (identity_rig.mesh.vertices, pair.truth)
            ]
            assert np.median(np.abs(lengths[1] / lengths[0] - 1)) < 0.05
            assert pair.reference is not None
            assert pair.reference.shape == pair.driving.vertices.shape == driving_rig.mesh.vertices.shape
            at_rest = np.abs(pair.identity.vertices - identity_rig.mesh.vertices).max() < 1e-9
            assert at_rest == pair.identity.name.endswith("_rest")
            in_rest_pose.add(at_rest)
            assert abs(pair.height / np.ptp(identity_rig.mesh.vertices[:, 1]) - 1) < 1e-12
            directions = []
            for rig, vertices in ((identity_rig, pair.truth), (driving_rig, pair.driving.vertices)):
                head = rig.weights * (rig.joint_of == named_joints(rig.joint_names, rig.parents)["Head"])
                hips = rig.weights * (rig.joint_of == named_joints(rig.joint_names, rig.parents)["Hips"])
                directions.append(unit(np.average(vertices, axis=0, weights=head.sum(1)) -
                                  np.average(vertices, axis=0, weights=hips.sum(1))))  # fmt: skip
            assert directions[0] @ directions[1] > 0.98
    assert in_rest_pose == {True, False}


@pytest.mark.slow
def test_copy_exists_for_characters_with_the_same_triangles(characters):
    """man2 and the women have the same decimated body; man1 has another one."""
    protocol = cross_body(characters)
    pairs = [protocol.unshuffled_pair("test", "table6", i, np.random.default_rng(i)) for i in range(4)]
    assert [pair.aligned is not None for pair in pairs] == [False, False, True, True]
    for pair in pairs[2:]:
        copied = resized(pair.aligned, pair.truth)
        assert pmd_aligned(copied, pair.truth) < 60e-4 < 100e-4 < pmd_aligned(pair.identity.vertices, pair.truth)


def test_folders_without_characters_are_refused(characters, tmp_path):
    with pytest.raises(InputError, match="nowhere: expected a folder of rigged characters, found none; "):
        cross_body(tmp_path / "nowhere")
    with pytest.raises(
        InputError, match=r"expected two characters of one skeleton .* found skeletons of no characters"
    ):
        cross_body(tmp_path)
    with pytest.raises(InputError, match="train: expected val or test of cross-body, found no such split; "):
        cross_body(characters).character_pairs("train")


MISSING = r"found none for LeftUpLeg, LeftLeg, LeftArm, LeftForeArm, LeftFoot, LeftHand among Hips, .*; rename"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": lambda name: name.replace("Left", "Port")}, MISSING),
        ({"hold": {"LeftFoot": "Hips"}}, "LeftFoot below LeftLeg, found it elsewhere"),
        ({"turn": np.diag([-1.0, 1.0, -1.0])}, r"stands y up and faces \+z, found the left hip at \[-0\."),
        ({"turn": np.diag([1.0, -1.0, -1.0])}, r"stands y up and faces \+z"),
    ],
    ids=["names", "feet", "back", "lying"],
)
def test_characters_that_cannot_take_the_poses_are_refused(options, message, tmp_path):
    path = rigs.character(tmp_path / "a.glb", **options)
    with pytest.raises(InputError, match=message) as caught:
        check_character(read_skin(path), path)
    assert str(caught.value).startswith(f"{path}: expected ")
    assert "\n" not in str(caught.value)
