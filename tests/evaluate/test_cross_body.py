"""Characters of others take our poses by joint names; splits share nobody; truth is the identity in that pose."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import rigs
from foreign_names import renamed

from mimesh.bodies import load_body
from mimesh.bodies.body_model import landmarks
from mimesh.bodies.joint_names import named_joints
from mimesh.bodies.sampling import JOINT_LIMITS, lowered_arms, rotvec_to_rotmat, sample_pose
from mimesh.core.errors import InputError
from mimesh.evaluate.cross_body import check_character, cross_body, find_landmarks, pose_at_rest, pose_on_rig
from mimesh.evaluate.metrics import pmd_of_pair, resized
from mimesh.io.gltf.skin import read_skin
from mimesh.motions.retarget import BONES, to_local

MADE = ("cmu", "mixamo", "quaternius", "kaykit", "unreal", "vroid")
"""Whose names characters in the tests bear."""


@pytest.fixture(scope="module")
def body():
    return load_body()


@pytest.fixture(scope="module")
def crowd(tmp_path_factory) -> Path:
    """Three men with CMU's names, three women with mixamo's who stand in an A-pose, one of nobody else's skeleton."""
    folder = tmp_path_factory.mktemp("crowd")
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
    """A character's vertices on our body, whose joints of other names follow their parents."""
    world, _ = body.skinning_transforms(body.joints, rotmat)
    for j, (joint, parent) in enumerate(zip(body.joint_names, body.parents, strict=True)):
        world[j] = world[j] if joint in known else world[parent]
    return body.posed(np.zeros(1), to_local(world[None], body.parents)[0])[rigs.kept()]


def joints_in(rig, rotmat, body) -> dict[str, np.ndarray]:
    """Where the rig's joints are, by our names, in a pose of ours."""
    transforms = rig.skinning_transforms(pose_on_rig(rig, body, rotmat))
    return {n: (transforms[j] @ [*rig.joints[j], 1])[:3] for n, j in named_joints(rig.joint_names, rig.parents).items()}


def unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


@pytest.mark.parametrize("scheme", MADE)
def test_our_body_under_other_names_takes_our_poses(scheme, body, tmp_path):
    """Exactly; joints that a scheme does not have follow their parent."""
    rig = check_character(read_skin(rigs.character(tmp_path / "a.glb", shape=None, name=renamed(scheme))), "a")
    expected = posed_with(set(named_joints(rig.joint_names, rig.parents)), body, pose(body))
    np.testing.assert_allclose(rig.posed(pose_on_rig(rig, body, pose(body))), expected, atol=3e-6)


def test_limbs_point_where_ours_point_whatever_the_rest_pose(body, tmp_path):
    lowered = rotvec_to_rotmat(0.6 * lowered_arms(body))
    ours, place = body.skinning_transforms(body.joints, pose(body))
    ours = (ours @ body.joints[..., None])[..., 0] + place
    for rest in (None, lowered, rotvec_to_rotmat(sample_pose(body, 1, 0))):
        rig = read_skin(rigs.character(tmp_path / "a.glb", shape=3, rest=rest, frames=2))
        theirs = joints_in(rig, pose(body), body)
        for joint, tail in BONES.items():
            expected = unit(ours[body.joint(tail)] - ours[body.joint(joint)])
            np.testing.assert_allclose(unit(theirs[tail] - theirs[joint]), expected, atol=1e-6)


def test_the_pose_at_rest_is_the_rest(body, tmp_path):
    rig = read_skin(rigs.character(tmp_path / "a.glb", shape=3, rest=rotvec_to_rotmat(lowered_arms(body))))
    local = pose_on_rig(rig, body, pose_at_rest(rig, body))
    np.testing.assert_allclose(local, np.tile(np.eye(3), (len(local), 1, 1)), atol=1e-12)
    arm = pose_at_rest(rig, body)[body.joint("LeftArm")]
    np.testing.assert_allclose(arm, rotvec_to_rotmat(lowered_arms(body))[body.joint("LeftArm")], atol=0.1)


def test_legs_that_hang_on_a_root_beside_the_hips_stay_on_them(body, tmp_path):
    """Some rigs do so: a tilt of the hips takes the root, and so the legs, along."""
    hold, names = {"LowerBack": "LHipJoint", "LeftUpLeg": "Hips"}, {"Hips": "Root", "LHipJoint": "Hips"}
    path = rigs.character(tmp_path / "a.glb", shape=None, hold=hold, name=lambda name: names.get(name, name))
    rig = read_skin(path)
    assert rig.parents[rig.joint_names.index("LeftUpLeg")] == rig.joint_names.index("Root")
    tilted = pose(body)
    expected = posed_with({name for name in body.joint_names if "Finger" not in name}, body, tilted)
    np.testing.assert_allclose(rig.posed(pose_on_rig(rig, body, tilted)), expected, atol=3e-6)


def test_characters_of_one_skeleton_get_the_same_rotations(body, crowd):
    one, other = cross_body(crowd).character_pairs("test")[0]
    rest = [np.stack(list(joints_in(rig, pose_at_rest(rig, body), body).values())) for rig in (one, other)]
    assert np.abs(rest[0] - rest[1]).max() > 0.005  # two people
    for i in range(3):
        a, b = (pose_on_rig(rig, body, pose(body, i)) for rig in (one, other))
        fixed = [one.joint_names.index(name) for name in ("Hips", "Spine", "Spine1", "Head", "LeftShoulder")]
        np.testing.assert_allclose(a[fixed], b[fixed], atol=1e-12)


@pytest.mark.parametrize("scheme", ["cmu", "quaternius"])
def test_landmarks_are_where_our_body_has_them(scheme, body, tmp_path):
    """In an A-pose, in another unit, with toes or without; a thinned body has them near by."""
    lowered = rotvec_to_rotmat(0.6 * lowered_arms(body))
    rig = read_skin(rigs.character(tmp_path / "a.glb", shape=None, name=renamed(scheme), rest=lowered, faces=3000))
    found = body.posed(np.zeros(1), lowered)[list(landmarks(body).values())]
    np.testing.assert_allclose(rig.mesh.vertices[find_landmarks(rig)], found, atol=0.05)


def test_splits_share_no_character(crowd):
    protocol = cross_body(crowd)
    test, val = protocol.character_pairs("test"), protocol.character_pairs("val")
    names = [(mover.mesh.name, actor.mesh.name) for mover, actor in test]
    assert names == [("man1", "man2"), ("man2", "man1"), ("woman1", "woman2"), ("woman2", "woman1")]
    assert [(mover.mesh.name, actor.mesh.name) for mover, actor in val] == [("man0", "woman0"), ("woman0", "man0")]
    assert all(mover.bones() == actor.bones() for mover, actor in test)


def test_two_of_a_skeleton_are_test_alone(crowd, tmp_path):
    for name in ("man0.glb", "man2.glb"):
        shutil.copy(crowd / name, tmp_path / name)
    protocol = cross_body(tmp_path)
    assert len(protocol.character_pairs("test")) == 2
    with pytest.raises(InputError, match=r"expected two skeletons of three characters each .* found skeletons of 2 "):
        protocol.character_pairs("val")


@pytest.mark.parametrize("split", ["val", "test"])
def test_truth_is_the_identity_in_the_driving_pose(body, crowd, split):
    protocol = cross_body(crowd)
    stands = set()
    for kind in protocol.kinds:
        for i in range(4):
            pair = protocol.unshuffled_pair(split, kind, i, protocol.rng(split, kind, i))
            mover, actor = next(
                cast for cast in protocol.character_pairs(split)
                if pair.identity.name.startswith(cast[0].mesh.name) and pair.driving.name.startswith(cast[1].mesh.name)
            )  # fmt: skip
            edge = pair.identity.faces[:, :2]
            lengths = [
                np.linalg.norm(np.diff(v[edge], axis=1)[:, 0], axis=1) for v in (mover.mesh.vertices, pair.truth)
            ]
            assert np.median(np.abs(lengths[1] / lengths[0] - 1)) < 0.05
            assert pair.reference is not None
            assert pair.reference.shape == pair.driving.vertices.shape == actor.mesh.vertices.shape
            at_rest = np.abs(pair.identity.vertices - mover.mesh.vertices).max() < 1e-9
            assert at_rest == pair.identity.name.endswith("_rest")
            stands.add(at_rest)
            assert abs(pair.height / np.ptp(mover.mesh.vertices[:, 1]) - 1) < 1e-12
            heads = []
            for rig, vertices in ((mover, pair.truth), (actor, pair.driving.vertices)):
                head = rig.weights * (rig.joint_of == named_joints(rig.joint_names, rig.parents)["Head"])
                hips = rig.weights * (rig.joint_of == named_joints(rig.joint_names, rig.parents)["Hips"])
                heads.append(unit(np.average(vertices, axis=0, weights=head.sum(1)) -
                                  np.average(vertices, axis=0, weights=hips.sum(1))))  # fmt: skip
            assert heads[0] @ heads[1] > 0.98
    assert stands == {True, False}


def test_copy_is_there_where_two_share_their_triangles(crowd):
    """man2 and the women have the same thinned body; man1 has another."""
    protocol = cross_body(crowd)
    pairs = [protocol.unshuffled_pair("test", "table6", i, np.random.default_rng(i)) for i in range(4)]
    assert [pair.aligned is not None for pair in pairs] == [False, False, True, True]
    for pair in pairs[2:]:
        copied = resized(pair.aligned, pair.truth)
        assert pmd_of_pair(copied, pair.truth) < 60e-4 < 100e-4 < pmd_of_pair(pair.identity.vertices, pair.truth)


def test_pairs_are_a_pure_function_of_split_kind_and_number(crowd):
    protocol = cross_body(crowd)
    for kind in protocol.kinds:
        (first, second), (again, _) = (list(protocol.trials("test", kind, 2)) for _ in range(2))
        np.testing.assert_array_equal(first.truth, again.truth)
        np.testing.assert_array_equal(first.driving.faces, again.driving.faces)
        assert first.identity.name != second.identity.name
    tests, vals = (list(protocol.trials(split, "limits", 2)) for split in ("test", "val"))
    assert protocol.seed("test/limits") != protocol.seed("val/limits")
    assert not {p.truth_name for p in tests} & {p.truth_name for p in vals}
    assert len(list(protocol.trials("test", "clips"))) == 12


def test_what_is_no_folder_of_characters_is_refused(crowd, tmp_path):
    with pytest.raises(InputError, match="nowhere: expected a folder of rigged characters, found none; "):
        cross_body(tmp_path / "nowhere")
    with pytest.raises(
        InputError, match=r"expected two characters of one skeleton .* found skeletons of no characters"
    ):
        cross_body(tmp_path)
    with pytest.raises(InputError, match="train: expected val or test of cross-body, found no such split; "):
        cross_body(crowd).character_pairs("train")


def refused(path: Path, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        check_character(read_skin(path), path)
    assert str(caught.value).startswith(f"{path}: expected ")
    assert "\n" not in str(caught.value)


def test_who_cannot_take_our_poses_is_refused(body, tmp_path):
    odd = rigs.character(tmp_path / "a.glb", name=lambda name: name.replace("Left", "Port"))
    refused(odd, r"found none for LeftUpLeg, LeftLeg, LeftArm, LeftForeArm, LeftFoot, LeftHand among Hips, .*; rename")
    feet = rigs.character(tmp_path / "b.glb", hold={"LeftFoot": "Hips"})
    refused(feet, "LeftFoot below LeftLeg, found it elsewhere")
    back = rigs.character(tmp_path / "c.glb", turn=rotvec_to_rotmat(np.array([0.0, np.pi, 0.0])))
    refused(back, r"stands y up and faces \+z, found the left hip at \[-0\.")
    lying = rigs.character(tmp_path / "d.glb", turn=rotvec_to_rotmat(np.array([np.pi, 0.0, 0.0])))
    refused(lying, r"stands y up and faces \+z")


def test_one_bad_character_of_a_shared_skeleton_stops_the_protocol(tmp_path):
    for name in "ab":
        rigs.character(tmp_path / f"{name}.glb", hold={"LeftFoot": "Hips"})
    with pytest.raises(InputError, match=r"a\.glb: expected LeftFoot below LeftLeg"):
        cross_body(tmp_path)
