"""AMASS-style archives: directions of limbs, both layouts, both up axes, and errors of damaged files."""

import numpy as np
import pytest
from matrix import matrix
from motion_files import OURS, PARENTS, Z_UP, bone_directions, write_amass
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.io import load_clip, load_mesh
from mimesh.motions import load_motion, window
from mimesh.motions.amass import JOINTS, is_amass, load_amass
from mimesh.motions.motion import joint_tracks
from mimesh.motions.on_body import motion_of_file

STRAIGHT = {"UpLeg": (0, -1, 0), "Leg": (0, -1, 0), "Arm": (1, 0, 0), "ForeArm": (1, 0, 0)}
"""Directions of left bones in the assumed T-pose."""


@pytest.fixture(scope="module")
def body():
    return load_body()


@pytest.fixture(scope="module")
def motion():
    return window(load_motion("walk"), 0.0, 1.0)


def test_joints_and_parents_are_those_of_the_format():
    assert [(joint, parent) for joint, (parent, _) in JOINTS.items()] == list(PARENTS.items())


@pytest.mark.parametrize("axes", [Z_UP, np.eye(3)], ids=["z-up", "y-up"])
@matrix("joints", [22, 24, 52, 55], quick=[22, 55])
def test_limbs_have_the_directions_of_the_rotated_bones_of_a_t_pose(axes, joints, body, motion, tmp_path):
    path = write_amass(tmp_path / "a.npz", body, motion, axes, joints, mocap_framerate=120.0, betas=np.ones(16))
    loaded, world = motion_of_file(path), joint_tracks(body, motion)[0]
    assert (loaded.name, loaded.fps, len(loaded)) == ("a", 120.0, len(motion))
    before = bone_directions(body, motion)
    for joint, direction in bone_directions(body, loaded).items():
        side = 1.0 if joint.startswith("Left") else -1.0
        bone = np.array(STRAIGHT[joint.removeprefix("Left").removeprefix("Right")]) * [side, 1.0, 1.0]
        np.testing.assert_allclose(direction, world[:, body.joint(joint)] @ bone, atol=1e-9)
        assert np.degrees(np.arccos((direction * before[joint]).sum(-1).min())) < 7  # the body's legs are not straight


def test_rotations_of_the_trunk_and_the_scaled_path_are_kept(body, motion, tmp_path):
    loaded = motion_of_file(write_amass(tmp_path / "a.npz", body, motion, Z_UP))
    (rotation, position), (true_rotation, true_position) = joint_tracks(body, loaded), joint_tracks(body, motion)
    for joint in OURS.values():
        if not any(part in joint for part in ("Arm", "Hand", "Leg", "Foot", "Toe")):
            j = body.joint(joint)
            np.testing.assert_allclose(rotation[:, j], true_rotation[:, j], atol=1e-9)
    step, stride = (p[-1, 0, [0, 2]] - p[0, 0, [0, 2]] for p in (position, true_position))
    assert np.linalg.norm(stride) > 0.4
    np.testing.assert_allclose(step / stride, (step / stride)[0], rtol=1e-9)  # one scale: that of the legs
    assert 0.9 < (step / stride)[0] < 1.1


def test_separate_arrays_of_root_and_body_give_the_same_motion(body, motion, tmp_path):
    path = write_amass(tmp_path / "a.npz", body, motion, Z_UP, mocap_frame_rate=60)
    with np.load(path) as data:
        poses, trans = data["poses"], data["trans"]
    split = {"root_orient": poses[:, :3], "pose_body": poses[:, 3:66], "pose_hand": poses[:, 66:]}
    np.savez(tmp_path / "b.npz", trans=trans, mocap_frame_rate=60, gender="neutral", **split)
    first, second = (motion_of_file(tmp_path / name) for name in ("a.npz", "b.npz"))
    np.testing.assert_array_equal(first.rotmat, second.rotmat)
    np.testing.assert_array_equal(first.root, second.root)
    assert first.fps == second.fps == 60


def test_an_archive_loads_as_a_clip_and_its_first_frame_as_a_mesh(body, motion, tmp_path):
    path = write_amass(tmp_path / "dance.npz", body, motion, Z_UP)
    clip, mesh = load_clip(path), load_mesh(path)
    assert (clip.mesh.name, clip.fps, clip.vertices.shape) == ("dance", 30.0, (len(motion), 6890, 3))
    np.testing.assert_allclose(clip.vertices[0], mesh.vertices, atol=1e-6)
    assert len(load_clip(path, fps=15.0)) == (len(motion) + 1) // 2


def test_archives_with_poses_and_without_points_are_motions():
    assert is_amass({"poses", "trans"})
    assert is_amass(("root_orient", "pose_body", "trans"))
    assert not is_amass(("vertices", "faces", "poses"))
    assert not is_amass(("trans", "betas"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"poses": np.zeros((2, 69))}, "found 69 numbers, SMPL's body without its root; save the root's rotation"),
        ({"poses": np.zeros((2, 23, 3))}, "found 69 numbers, SMPL's body without its root"),
        ({"mocap_framerate": "fast"}, "expected a positive frame rate, found 'fast';"),
        ({"trans": np.zeros((3, 3))}, "as many rows in 'trans' as in 'poses', found 3 and 2"),
        ({"trans": np.zeros((2, 2))}, r"'trans' to be numbers of shape \(T, 3\) or wider"),
        ({"poses": np.zeros((2, 63))}, r"'poses' to be numbers of shape \(T, 66\) or wider, found float64 \(2, 63\)"),
        ({"poses": np.full((2, 66), np.nan)}, "NaN or infinity in frame 0 of 'poses'"),
        ({"poses": np.zeros((0, 66))}, r"found float64 \(0, 66\)"),
        ({"poses": np.array([{}, {}])}, "expected a NumPy archive of plain arrays"),
        ({"poses": None, "pose_body": np.zeros((2, 63))}, "save 'root_orient' as well"),
        ({"mocap_framerate": 0.0}, "expected a positive frame rate, found 0.0;"),
        ({"mocap_framerate": np.zeros((4, 3))}, r"expected a positive frame rate, found float64 \(4, 3\);"),
    ],
)
def test_errors_of_damaged_archives_are_one_line(changes, message, tmp_path):
    arrays = {"poses": np.zeros((2, 66)), "trans": np.zeros((2, 3))} | changes
    np.savez(tmp_path / "a.npz", **{name: value for name, value in arrays.items() if value is not None})
    with pytest.raises(InputError, match=message) as error:
        load_amass(tmp_path / "a.npz")
    assert "\n" not in str(error.value)


def test_numbers_that_no_motion_has_are_refused(tmp_path):
    """They would overflow in the forward kinematics, and a matrix of NaN has no rotation."""
    poses = np.zeros((2, 66))
    np.savez(tmp_path / "a.npz", poses=poses, trans=np.full((2, 3), 1e300))
    np.savez(tmp_path / "b.npz", poses=poses + 1e200, trans=np.zeros((2, 3)))
    for name in ("a.npz", "b.npz"):
        with pytest.raises(InputError, match=r"expected positions and rotations of joints that are finite") as error:
            load_clip(tmp_path / name, fps=20.0)
        assert str(tmp_path / name) in str(error.value)


def test_refusal_of_too_many_frames_names_the_file(tmp_path):
    np.savez(tmp_path / "a.npz", poses=np.zeros((2, 66)), trans=np.zeros((2, 3)), mocap_framerate=1e-30)
    with pytest.raises(InputError, match="at most 1,000,000 frames, found far more") as error:
        load_clip(tmp_path / "a.npz", fps=20.0)
    assert str(error.value).startswith(str(tmp_path / "a.npz"))


def test_a_body_of_69_numbers_with_its_root_beside_it_is_read(body, motion, tmp_path):
    path = write_amass(tmp_path / "a.npz", body, motion, Z_UP, 24)
    with np.load(path) as data:
        poses, trans = data["poses"], data["trans"]
    np.savez(tmp_path / "b.npz", poses=poses[:, 3:], root_orient=poses[:, :3], trans=trans)
    first, second = (load_amass(tmp_path / name) for name in ("a.npz", "b.npz"))
    np.testing.assert_array_equal(first.rotmat, second.rotmat)


@pytest.mark.parametrize("rate", ["119.88", np.array(b"119.88"), np.array(["119.88"])])
def test_a_rate_may_be_text(rate, body, motion, tmp_path):
    loaded = load_amass(write_amass(tmp_path / "a.npz", body, motion, Z_UP, mocap_framerate=rate))
    assert (loaded.fps, loaded.notes) == (119.88, ())


def test_without_a_rate_30_frames_a_second_are_taken_with_a_note(body, motion, tmp_path):
    clip = load_clip(write_amass(tmp_path / "a.npz", body, motion, Z_UP))
    assert clip.fps == 30.0
    assert [note for note in clip.notes if "no frame rate: 30 per second are taken" in note]


@pytest.mark.parametrize("axes", [Z_UP, np.eye(3)], ids=["z-up", "y-up"])
def test_without_a_path_the_lower_foot_stays_on_the_ground(axes, body, tmp_path):
    """Legs spread by 40 degrees, and a bent knee: the hips come down."""
    poses = np.zeros((3, 22, 3))
    up = Rotation.from_matrix(axes)
    poses[:, 0] = up.as_rotvec()
    poses[1, 1:3] = np.radians([[0, 0, 40.0], [0, 0, -40.0]])
    poses[2, [1, 2, 4, 5]] = np.radians([[-60.0, 0, 0], [-60.0, 0, 0], [60.0, 0, 0], [60.0, 0, 0]])
    np.savez(tmp_path / "a.npz", poses=poses.reshape(3, 66), mocap_framerate=30.0)
    loaded = load_amass(tmp_path / "a.npz")
    feet = [loaded.joint_names.index(f"{side}_{part}") for side in ("left", "right") for part in ("ankle", "foot")]
    raised = loaded.world()[1][:, feet, 1] - loaded.rest()[feet, 1]
    np.testing.assert_allclose(raised.min(axis=1), 0.0, atol=1e-9)
    np.testing.assert_array_equal(loaded.root[:, [0, 2]], 0.0)
    assert loaded.root[2, 1] == pytest.approx(-1.7 * 0.245 * (1 - np.cos(np.radians(60))), abs=1e-6)
    assert "no 'trans': the person stays in place" in loaded.notes[0]


def test_an_archive_in_the_axes_of_a_camera_stands_upright(body, motion, tmp_path):
    plain, camera = (
        write_amass(tmp_path / f"{k}.npz", body, motion, axes, mocap_framerate=30.0)
        for k, axes in enumerate((np.eye(3), np.diag([1.0, -1.0, -1.0])))
    )
    np.testing.assert_allclose(motion_of_file(camera).rotmat, motion_of_file(plain).rotmat, atol=1e-6)
    assert "y points down" in load_amass(camera).notes[-1]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_person_who_lies_along_y_stays_lying(side, tmp_path):
    """z is up, and the head points to y or to -y: the pelvis is 0.12 m over the floor."""
    poses = np.zeros((2, 66))
    poses[:, :3] = Rotation.from_matrix(np.diag([1.0, side, side])).as_rotvec()
    np.savez(tmp_path / "a.npz", poses=poses, trans=np.full((2, 3), 0.12), mocap_framerate=30.0)
    np.testing.assert_allclose(load_amass(tmp_path / "a.npz").rotmat[0, 0, :, 1], [0, 0, -side], atol=1e-9)
