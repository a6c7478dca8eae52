"""Motion files as clips: the motion does not depend on the names, rest pose, axes and unit of the file."""

import dataclasses

import numpy as np
import pytest
from foreign_names import SCHEMES, renamed
from matrix import matrix
from motion_files import X_FRONT, Z_UP, rest_pose, write_bvh
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.character_limbs import SIDES
from mimesh.bodies.hands import hand_weight
from mimesh.core.errors import InputError
from mimesh.core.geometry import angles_between
from mimesh.core.mesh import cut_clip
from mimesh.core.rig import local_rotations
from mimesh.core.skinning import SkinnedMesh
from mimesh.io import load_clip, load_mesh
from mimesh.motions import Motion, load_motion, motion_clip, resample, window
from mimesh.motions.bvh import load_bvh
from mimesh.motions.motion import BONES, joint_tracks
from mimesh.motions.on_body import is_motion_file, motion_of_file, on_body
from mimesh.motions.retarget import rests_standing
from mimesh.pipeline.known import driving_axes
from mimesh.tools.inspect import inspect_file

STANDING = ("t", "a", "lowered")
"""Kinds of `rest_pose` that stand."""

KNOWN = "25 of a person and 2 of fingers known"
"""Joints of the shipped body that are found by name."""


@pytest.fixture(scope="module")
def body():
    return load_body()


@pytest.fixture(scope="module")
def motion():
    return window(load_motion("jump"), 0.0, 1.0)


def relative_positions(body, motion):
    """Joint positions relative to the hips of the first frame, (T, J, 3)."""
    _, position = joint_tracks(body, motion)
    return position - position[0, 0]


def besides_hands(body):
    """Select the vertices without weights of hands: of a file without fingers they are straight, the body's relaxed."""
    return sum(hand_weight(body, side) for side in SIDES) == 0


def rotation_error(body, found, expected, joint):
    """Angle (degrees) between the world rotations of a joint in two motions, in every frame."""
    return angles_between(*(joint_tracks(body, motion)[0][:, body.joint(joint)] for motion in (found, expected)))


@matrix("rest", STANDING, quick=["a"])
@pytest.mark.parametrize("axes", [None, Z_UP, X_FRONT], ids=["ours", "z-up", "x-front"])
@pytest.mark.parametrize("scheme", ["cmu", "lafan1"])
def test_joint_positions_do_not_depend_on_a_standing_rest_pose(rest, axes, scheme, body, motion, tmp_path):
    path = write_bvh(tmp_path / "a.bvh", body, motion, rest=rest, axes=axes, scale=39.37, name=renamed(scheme))
    loaded = motion_of_file(path)
    fingers = [body.joint(n) for n in body.joint_names if "Finger" in n or "Thumb" in n]
    unknown = fingers if scheme == "cmu" else [*fingers, body.joint("Neck1")]
    found, expected = (np.delete(relative_positions(body, moved), unknown, axis=1) for moved in (loaded, motion))
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert rotation_error(body, loaded, motion, "LeftForeArm").max() < 1e-3
    # The body's thigh is 5 degrees off the frontal plane.
    assert rotation_error(body, loaded, motion, "LeftUpLeg").max() < 1.5


@matrix("scheme", SCHEMES, quick=["mixamo", "lafan1"])
def test_joint_positions_do_not_depend_on_the_names(scheme, body, motion, tmp_path):
    loaded = motion_of_file(write_bvh(tmp_path / "a.bvh", body, motion, rest="a", name=renamed(scheme), order="YXZ"))
    ends = [body.joint(joint) for joint in (*BONES, *BONES.values())]
    if scheme != "kaykit":  # without shoulders the arms are children of another joint
        found, expected = (relative_positions(body, moved)[:, ends] for moved in (loaded, motion))
        np.testing.assert_allclose(found, expected, atol=1e-6)
    assert rotation_error(body, loaded, motion, "Head").max() < 1e-3


@matrix("rest", ["up", "along-x"], quick=["up"])
@pytest.mark.parametrize("axes", [None, Z_UP], ids=["ours", "z-up"])
def test_joints_of_other_rest_poses_are_calibrated(rest, axes, body, tmp_path):
    """Limb directions are exact, rolls of limbs and the tilt of hips and feet correct to some degrees."""
    motion = load_motion("jump")
    path = write_bvh(tmp_path / "a.bvh", body, motion, rest=rest, axes=axes, scale=100.0, name=renamed("lafan1"))
    loaded = motion_of_file(path)
    found, expected = relative_positions(body, loaded), relative_positions(body, motion)
    for joint, tail in BONES.items():
        bones = [position[:, body.joint(tail)] - position[:, body.joint(joint)] for position in (found, expected)]
        np.testing.assert_allclose(*bones, atol=1e-5)
    np.testing.assert_allclose(found[:, 0], expected[:, 0], atol=1e-5)
    for joint, degrees in (("Arm", 3), ("ForeArm", 3), ("UpLeg", 3), ("Leg", 3), ("Foot", 8)):
        for side in ("Left", "Right"):
            assert rotation_error(body, loaded, motion, side + joint).max() < degrees
    assert rotation_error(body, loaded, motion, "Hips").max() < 5
    assert rotation_error(body, loaded, motion, "Spine1").max() < 4


def test_frames_along_the_axes_of_a_t_pose_tell_how_sticks_lean_and_bend(body, tmp_path):
    """Who runs never stands upright, and elbows of game rigs bend to the front, 30 degrees from those of the body."""
    motion, turns = window(load_motion("walk"), 0.0, 2.0), []
    rotation = joint_tracks(body, motion)[0]
    lean = Rotation.from_euler("x", 15, degrees=True).as_matrix()
    ahead = rotation[:, body.joint("Spine1"), :, 2].mean(axis=0) * [1.0, 0.0, 1.0]
    heading = Rotation.align_vectors(ahead[None], [[0.0, 0.0, 1.0]])[0].as_matrix()
    for j, joint in enumerate(body.joint_names):
        rolled = Rotation.from_euler("x", 30 * joint.endswith(("Arm", "Hand")), degrees=True).as_matrix()
        turns.append(heading @ lean @ heading.T @ rotation[:, j] @ rolled)
    leaning = dataclasses.replace(motion, rotmat=local_rotations(np.stack(turns, axis=1), body.parents))
    loaded = motion_of_file(write_bvh(tmp_path / "a.bvh", body, leaning, rest="axes", name=renamed("lafan1")))
    for joint in ("Hips", "Spine", "Spine1", "Neck", "Head", "LeftArm", "RightForeArm", "LeftHand"):
        assert rotation_error(body, loaded, leaning, joint).max() < 1e-3, joint
    for joint in ("LeftUpLeg", "RightLeg"):  # the body's thighs are 5 degrees off the frontal plane
        assert rotation_error(body, loaded, leaning, joint).max() < 1.5, joint


def test_toes_of_sticks_along_the_axes_of_a_t_pose_point_ahead_in_it(body, tmp_path):
    """Those of the shipped body point outwards by 6 degrees."""
    feet, joints = {f"{side}Foot": f"{side}ToeBase" for side in SIDES}, body.joints.copy()
    for foot, toes in feet.items():
        joints[body.joint(toes), 0] = joints[body.joint(foot), 0]
    ahead, motion = dataclasses.replace(body, joints=joints), window(load_motion("walk"), 0.0, 2.0)
    loaded = motion_of_file(write_bvh(tmp_path / "a.bvh", ahead, motion, rest="axes", name=renamed("lafan1")))
    for foot in feet:
        expected, found = (joint_tracks(body, of)[0][:, body.joint(foot)] for of in (motion, loaded))
        turn = Rotation.from_matrix(expected).inv() * Rotation.from_matrix(found)
        assert abs(turn.mean().as_rotvec(degrees=True)[1]) < 1, foot


def test_hips_and_feet_of_sticks_are_level_while_a_person_stands(body, tmp_path):
    """Not as steep as the trunk and the feet of the shipped body are: here toes are 5 cm lower."""
    joints = body.joints.copy()
    joints[[body.joint("LeftToeBase"), body.joint("RightToeBase")], 1] -= 0.05
    steep = dataclasses.replace(body, joints=joints)
    turns = np.tile(np.eye(3), (4, len(body.parents), 1, 1))
    still = Motion("sticks", body.joint_names, turns, np.tile([0.0, 1.0, 0.0], (4, 1)), 30.0)
    loaded = on_body(load_bvh(write_bvh(tmp_path / "sticks.bvh", steep, still, rest="up")), "sticks")
    for joint in ("Hips", "Head", "LeftFoot", "RightFoot", "LeftToeBase"):
        assert rotation_error(body, loaded.motion, still, joint).max() < 0.5, joint
    assert loaded.front is None
    assert "does not stand in its rest pose" in loaded.notes[0]


@pytest.mark.parametrize("rest", [*STANDING, "up", "along-x"])
def test_standing_rest_poses_are_recognised(rest, body):
    turns = rest_pose(body, rest)
    joints = np.zeros_like(body.joints)
    for j, parent in enumerate(body.parents):
        if parent >= 0:
            joints[j] = joints[parent] + turns[parent] @ (body.joints[j] - body.joints[parent])
    index = {joint: j for j, joint in enumerate(body.joint_names)}
    for axes in (np.eye(3), Z_UP, X_FRONT):
        assert rests_standing(17.0 * joints @ axes.T, index) == (rest in STANDING)


def test_a_file_loads_as_the_clip_of_its_motion(body, motion, tmp_path):
    path = write_bvh(tmp_path / "leap.bvh", body, motion, axes=Z_UP)
    calls: list[tuple[int, int]] = []
    clip = load_clip(path, progress=lambda done, count: calls.append((done, count)))
    assert (clip.mesh.name, clip.fps, len(clip)) == ("leap", 30.0, len(motion))
    assert calls == [(k + 1, len(motion)) for k in range(len(motion))]
    rest = besides_hands(body)
    expected = motion_clip(body, None, motion).vertices[:, rest]
    shift = clip.vertices[0, rest].mean(axis=0) - expected[0].mean(axis=0)
    np.testing.assert_allclose(clip.vertices[:, rest] - shift, expected, atol=2e-6)
    np.testing.assert_array_equal(load_mesh(path).vertices.astype(np.float32), clip.vertices[0])
    np.testing.assert_array_equal(clip.mesh.vertices.astype(np.float32), clip.vertices[0])
    heights = clip.vertices[..., 1].min(axis=1)
    assert abs(np.quantile(heights, 0.2)) < 1e-6


def test_another_frame_rate_resamples_the_motion(body, motion, tmp_path):
    path = write_bvh(tmp_path / "a.bvh", body, window(motion, 0.0, 0.3))
    for fps in (15.0, 60.0):
        clip, resampled = load_clip(path, fps=fps), resample(motion_of_file(path), fps)
        assert (clip.fps, len(clip)) == (fps, len(resampled))
        rest = besides_hands(body)
        expected = motion_clip(body, None, resampled).vertices[:, rest]
        np.testing.assert_allclose(clip.vertices[:, rest], expected, atol=1e-6)


@pytest.mark.parametrize(
    ("written", "rate"),
    [("0.0333333", 30), (".0083333", 120), ("0.00833", 120), ("0.0417", 24), ("0.01", 100), ("8.3333e-3", 120),
     ("0.0333667", 1 / 0.0333667), ("0.0416", 1 / 0.0416), ("2", 0.5)],
)  # fmt: skip
def test_rounded_frame_times_give_whole_rates(written, rate, body, motion, tmp_path):
    path = write_bvh(tmp_path / "a.bvh", body, window(motion, 0.0, 0.1))
    path.write_text(path.read_text().replace("0.0333333", written))
    assert load_bvh(path).fps == rate


def test_frames_of_a_cut_capture_are_those_of_the_whole(body, motion, tmp_path):
    path = write_bvh(tmp_path / "a.bvh", body, motion)
    expected = cut_clip(load_clip(path), 2, 20, 3)
    clip = load_clip(path, frames=slice(2, 20, 3))
    np.testing.assert_array_equal(clip.vertices, expected.vertices)
    np.testing.assert_array_equal(clip.headings, expected.headings)
    np.testing.assert_array_equal(clip.skeleton.person().positions, expected.skeleton.person().positions)
    assert (clip.fps, len(clip)) == (expected.fps, 6)
    for frames, message in ((slice(999, None), "leaves none"), (slice(0, None, 0), "^step: expected 1 or more")):
        with pytest.raises(InputError, match=message):
            load_clip(path, frames=frames)


def test_only_chosen_frames_of_a_capture_are_posed(body, motion, tmp_path, monkeypatch):
    posed = []
    pose = SkinnedMesh.posed
    monkeypatch.setattr(SkinnedMesh, "posed", lambda *args: posed.append(0) or pose(*args))
    path = write_bvh(tmp_path / "a.bvh", body, motion)
    load_clip(path, frames=slice(0, 2))
    assert len(posed) <= 4  # the two, and the first one again for the mesh and for its check
    write_bvh(path, body, window(motion, 0.0, 0.5))
    assert len(load_clip(path)) == len(window(motion, 0.0, 0.5))  # a changed file is read again


def test_inspection_reports_a_motion(body, motion, tmp_path):
    facts = inspect_file(write_bvh(tmp_path / "a.bvh", body, window(motion, 0.0, 0.1)))
    assert facts.details == (("motion", f"31 joints, {KNOWN}, played on the shipped body, which these facts describe"),)
    assert facts.details[0][1] in facts.text()
    assert (facts.frames, facts.format, facts.unit_guess) == (3, "bvh", "m")
    assert is_motion_file(tmp_path / "b.BVH")
    assert not is_motion_file(tmp_path / "b.npz")


def test_a_folder_of_motion_files_is_refused(body, motion, tmp_path):
    write_bvh(tmp_path / "a1.bvh", body, motion)
    with pytest.raises(InputError, match="numbered meshes"):
        load_clip(tmp_path)


def test_the_error_of_a_skeleton_without_limbs_names_file_and_joints(body, motion, tmp_path):
    path = write_bvh(tmp_path / "fox.bvh", body, motion, name=lambda joint: joint.replace("Left", "Port"))
    with pytest.raises(InputError, match=r"fox\.bvh: expected hips .* found none for LeftUpLeg, .* among Hips, "):
        load_clip(path)


def test_a_clip_has_the_headings_of_its_motion(body, motion, tmp_path):
    turned = Rotation.from_euler("y", 100, degrees=True).as_matrix()
    rotmat = motion.rotmat.copy()
    rotmat[:, 0] = turned @ rotmat[:, 0]
    write_bvh(tmp_path / "a.bvh", body, dataclasses.replace(motion, rotmat=rotmat))
    clip = load_clip(tmp_path / "a.bvh")
    np.testing.assert_allclose(clip.headings, rotmat[:, 0, :, 2], atol=1e-4)
    assert driving_axes(cut_clip(clip, 3, None, 2), None, None) == ("+y", "+x")
    assert driving_axes(clip, None, "-z") == (None, "-z")
    lying = dataclasses.replace(clip, headings=np.tile([0.1, -0.9, 0.2], (len(clip), 1)))
    assert driving_axes(lying, None, None) == ("+y", None)
