"""BVH files: channels against rotation matrices, bone directions after retargeting, and errors of damaged files."""

import numpy as np
import pytest
from motion_files import Z_UP, bone_directions, write_bvh
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.errors import InputError
from mimesh.motions import Motion, load_motion
from mimesh.motions.bvh import load_bvh
from mimesh.motions.on_body import motion_of_file, on_body
from mimesh.motions.retarget import retarget_skeleton

SMALL = """HIERARCHY
ROOT Hips
{
  OFFSET 1 2 3
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Knee
  {
    OFFSET 0 -5 0
    CHANNELS 3 Xrotation Zrotation Yrotation
    End Site
    {
      OFFSET 0 -4 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 0 0 0 0 0 0 0 0
7 8 9 10 20 30 40 50 60
"""


MOVING_HIPS = """HIERARCHY
ROOT Reference
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Hips
  {
    OFFSET 0 9 1
    CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
    JOINT Knee
    {
      OFFSET 0 -5 0
      CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 0 0 0 90 0 4 8 1 0 0 0 0 0 0 0 0 0
0 0 0 0 90 0 6 8 1 0 0 90 0 0 0 0 0 0
"""


def write(tmp_path, text, name="a.bvh"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_channels_are_applied_in_their_order(tmp_path):
    bvh = load_bvh(write(tmp_path, SMALL))
    assert (bvh.joint_names, bvh.parents) == (("Hips", "Knee"), (-1, 0))
    assert bvh.fps == pytest.approx(30, rel=1e-4)
    np.testing.assert_array_equal(bvh.root, [[0, 0, 0], [7, 8, 9]])
    for j, (order, angles) in enumerate((("ZYX", [10, 20, 30]), ("XZY", [40, 50, 60]))):
        expected = Rotation.from_euler(order, angles, degrees=True).as_matrix()
        np.testing.assert_allclose(bvh.rotmat[1, j], expected, atol=1e-12)
    np.testing.assert_array_equal(bvh.ends["Knee"], [0, -4, 0])
    rotation, position = bvh.world()
    np.testing.assert_allclose(position[1, 1], [7, 8, 9] + bvh.rotmat[1, 0] @ [0, -5, 0])
    np.testing.assert_allclose(rotation[1, 1], bvh.rotmat[1, 0] @ bvh.rotmat[1, 1])


def test_hips_may_move_below_a_resting_root(tmp_path):
    """A quarter turn of the root about y takes x to -z; channels that are 0 in all frames leave the offset."""
    bvh = load_bvh(write(tmp_path, MOVING_HIPS))
    _, position = bvh.world()
    np.testing.assert_allclose(position[:, 0], 0)
    np.testing.assert_allclose(position[:, 1], [[1, 8, -4], [1, 8, -6]], atol=1e-12)
    np.testing.assert_allclose(position[:, 2], [[1, 3, -4], [-4, 8, -6]], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("HIERARCHY", "SOMETHING", "expected a BVH file"),
        ("MOTION", "", "found no MOTION; the file is cut off"),
        ("OFFSET 0 -5 0", "OFFSET 0 five 0", "expected a whole HIERARCHY"),
        ("Zrotation Yrotation Xrotation\n  JOINT", "Zrotation Yrotation Wrotation\n  JOINT", "found 'Wrotation'"),
        ("MOTION", "}\nMOTION", "expected a whole HIERARCHY"),
        ("}\nMOTION", "MOTION", "1 braces open"),
        ("Frames: 2", "Frames: 3", "cut short"),
        ("Frame Time: 0.0333333", "Frame Time: 0", "a frame time of"),
        ("7 8 9", "7 nan 9", r"NaN or infinity in frame 1 \(line 20, frame 1\)"),
        ("7 8 9", "7 x 9", r"found damage \(line 20, frame 1\)"),
        ("0 0 0 0 0 0 0 0 0\n", "0 0 0 0 0 0 0 0\n", r"found 17 values \(line 19, frame 0\)"),
        ("\n7 8 9 10 20 30 40 50 60", "", r"found 9 values \(the last frame is 0\)"),
        ("JOINT Knee", "BONE Knee", "found 'BONE' in line 6"),
        ("OFFSET 0 -5 0", "OFFSET 0 -5", "found damage in line 8"),
        ("OFFSET 0 -5 0", "OFFSET 0,0 -5,0 0,0", "found damage in line 8"),
    ],
)
def test_errors_of_damaged_files_are_one_line(tmp_path, old, new, message):
    with pytest.raises(InputError, match=message) as error:
        load_bvh(write(tmp_path, SMALL.replace(old, new, 1)))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["MOTION", "MOTIONROOT", "full MOTION rig", "x-MOTION", "MOTION-1-2"])
def test_joints_may_be_called_motion(name, tmp_path):
    bvh = load_bvh(write(tmp_path, SMALL.replace("Hips", name)))
    assert bvh.joint_names == (name, "Knee")
    np.testing.assert_array_equal(bvh.root, [[0, 0, 0], [7, 8, 9]])


def test_numbers_without_a_blank_before_a_minus_are_two(tmp_path):
    text = SMALL.replace("7 8 9 10", "7.0-8e-1-9.5 10")
    bvh = load_bvh(write(tmp_path, text.replace("OFFSET 0 -5 0", "OFFSET 0-5 0")))
    np.testing.assert_array_equal(bvh.root[1], [7.0, -0.8, -9.5])
    np.testing.assert_array_equal(bvh.offsets[1], [0, -5, 0])
    assert "without a blank before a minus" in bvh.notes[0]
    assert load_bvh(write(tmp_path, SMALL)).notes == ()


def test_numbers_may_have_exponents_and_angles_full_turns(tmp_path):
    """Python writes 1e-05, motion builders count turns: neither changes a rotation, nor those between two frames."""
    plain = load_bvh(write(tmp_path, SMALL))
    same = load_bvh(write(tmp_path, SMALL.replace("10 20 30 40 50 60", "1e+01 380 -3.3E2 4.0e01 -310 7.8e2")))
    np.testing.assert_allclose(same.rotmat, plain.rotmat, atol=1e-12)


def test_scales_of_joints_are_left_with_a_note(tmp_path):
    text = SMALL.replace("CHANNELS 3 Xrotation", "CHANNELS 6 Xscale Yscale Zscale Xrotation")
    plain = load_bvh(write(tmp_path, SMALL))
    same = load_bvh(
        write(tmp_path, text.replace("0 0 0 0 0 0 0 0 0", "0 0 0 0 0 0 1 1 1 0 0 0").replace("30 40", "30 1 1 1 40"))
    )
    grows = load_bvh(
        write(tmp_path, text.replace("0 0 0 0 0 0 0 0 0", "0 0 0 0 0 0 1 1 1 0 0 0").replace("30 40", "30 1 2 1 40"))
    )
    for found in (same, grows):
        np.testing.assert_array_equal(found.rotmat, plain.rotmat)
    assert (same.notes, grows.notes) == (
        (),
        ("a scales Knee: joints are turned and moved, their sizes are not carried over",),
    )


def test_whole_rows_beyond_the_frame_count_are_not_read(tmp_path):
    """Boxing_Toes.bvh of assimp counts one frame too few."""
    whole = load_bvh(write(tmp_path, SMALL))
    short = load_bvh(write(tmp_path, SMALL.replace("Frames: 2", "Frames: 1")))
    assert (len(whole.rotmat), len(short.rotmat)) == (2, 1)
    np.testing.assert_array_equal(short.rotmat, whole.rotmat[:1])
    with pytest.raises(InputError, match="cut short"):
        load_bvh(write(tmp_path, SMALL + " 1"))


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="found none"):
        load_bvh(tmp_path / "no.bvh")


def test_a_file_of_the_body_gives_its_rotations(tmp_path):
    """Same rest pose, other axes and unit; fingers stay at rest."""
    body = load_body()
    turns = np.random.default_rng(0).uniform(-0.5, 0.5, (4, len(body.parents), 3))
    motion = Motion("random", body.joint_names, rotvec_to_rotmat(turns), np.zeros((4, 3)))
    path = write_bvh(tmp_path / "a.bvh", body, motion, axes=Z_UP, scale=17.0)
    found = retarget_skeleton(load_bvh(path), body)
    for j, name in enumerate(body.joint_names):
        finger = any(word in name for word in ("Thumb", "Finger"))
        expected = np.tile(np.eye(3), (4, 1, 1)) if finger else motion.rotmat[:, j]
        np.testing.assert_allclose(found.rotmat[:, j], expected, atol=1e-9)


def test_a_skeleton_without_limbs_is_refused(tmp_path):
    with pytest.raises(InputError, match="LeftUpLeg"):
        retarget_skeleton(load_bvh(write(tmp_path, SMALL)), load_body())


def with_positions(text: str, bones: dict[str, str], offsets: bool) -> str:
    """Give each joint but the root position channels that hold its bone in every frame, and keep its OFFSET or not."""
    hierarchy, rows = text.split("MOTION")
    for bone in bones.values():
        hierarchy = hierarchy.replace(f"OFFSET {bone}", f"OFFSET {bone if offsets else '0 0 0'}", 1)
    hierarchy = hierarchy.replace("CHANNELS 3 ", "CHANNELS 6 Xposition Yposition Zposition ")
    *head, first, second, _ = rows.split("\n")
    moved = [" ".join([*row.split()[:6], *bones.values(), *row.split()[6:]]) for row in (first, second)]
    return "MOTION".join((hierarchy, "\n".join([*head, *moved])))


@pytest.mark.parametrize("offsets", [False, True])
def test_positions_replace_the_offset_even_where_they_never_change(offsets, tmp_path):
    """Some exporters write bones as positions of frames alone, others an actor's bones beside a standard skeleton."""
    bones = {"Knee": "0 -5 0"}
    bvh = load_bvh(write(tmp_path, with_positions(SMALL, bones, offsets).replace(" 0 -5 0 ", " 0 -6 0 ")))
    np.testing.assert_array_equal(bvh.rest(), [[0, 0, 0], [0, -6, 0]])
    np.testing.assert_allclose(bvh.world()[1][1, 1], [7, 8, 9] + bvh.rotmat[1, 0] @ [0, -6, 0])


def test_positions_of_rounding_alone_leave_the_offset(tmp_path):
    rows = MOVING_HIPS.replace("8 1 0 0 0 0 0 0", "8 1 0 0 0 0.001 -0.001 0")
    assert rows != MOVING_HIPS
    bvh = load_bvh(write(tmp_path, rows))
    np.testing.assert_array_equal(bvh.offsets[2], [0, -5, 0])
    assert set(bvh.moved) == {1}


def test_a_bone_without_an_offset_that_changes_its_length_has_its_mean_at_rest(tmp_path):
    """One with an OFFSET keeps it."""
    bvh = load_bvh(write(tmp_path, MOVING_HIPS.replace("OFFSET 0 9 1", "OFFSET 0 0 0")))
    np.testing.assert_array_equal(bvh.offsets[1], [5, 8, 1])
    np.testing.assert_array_equal(bvh.moved[1], [[4, 8, 1], [6, 8, 1]])
    np.testing.assert_array_equal(load_bvh(write(tmp_path, MOVING_HIPS)).offsets[1], [0, 9, 1])


@pytest.mark.parametrize("axes", [np.eye(3), Z_UP], ids=["y-up", "z-up"])
@pytest.mark.parametrize("degrees", [40, -130])
def test_a_rest_pose_between_the_axes_has_its_own_front(degrees, axes, tmp_path):
    body, walk = load_body(), load_motion("walk")
    heading = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
    found = retarget_skeleton(load_bvh(write_bvh(tmp_path / "a.bvh", body, walk, axes=axes @ heading)), body)
    expected = retarget_skeleton(load_bvh(write_bvh(tmp_path / "b.bvh", body, walk)), body)
    np.testing.assert_allclose(found.rotmat, expected.rotmat, atol=1e-6)
    np.testing.assert_allclose(found.root, expected.root, atol=1e-5)


CAMERA = np.diag([1.0, -1.0, -1.0])
"""Rotation to the axes of a camera: x right, y down, z ahead."""


def upside_down(motion: Motion, **raised: float) -> Motion:
    rotmat = motion.rotmat.copy()
    rotmat[:, 0] = CAMERA @ rotmat[:, 0]
    for joint, angle in raised.items():
        turn = Rotation.from_euler("z", angle, degrees=True).as_matrix()
        rotmat[:, motion.joint_names.index(joint)] = turn
    return Motion("down", motion.joint_names, rotmat, motion.root @ CAMERA, motion.fps)


def test_a_motion_in_the_axes_of_a_camera_stands_upright_and_a_handstand_stays(tmp_path):
    body, walk = load_body(), load_motion("walk")
    plain = motion_of_file(write_bvh(tmp_path / "a.bvh", body, walk))
    path = write_bvh(tmp_path / "b.bvh", body, upside_down(walk))
    found = motion_of_file(path)
    np.testing.assert_allclose(found.rotmat, plain.rotmat, atol=1e-6)
    np.testing.assert_allclose(found.root, plain.root, atol=1e-5)
    assert "upside down" in on_body(load_bvh(path), path).notes[-1]
    stand = upside_down(walk, LeftArm=90, RightArm=-90, LeftForeArm=0, RightForeArm=0)
    kept = motion_of_file(write_bvh(tmp_path / "c.bvh", body, stand))
    for joint, direction in bone_directions(body, kept).items():
        np.testing.assert_allclose(direction, bone_directions(body, stand)[joint], atol=1e-6)


@pytest.mark.parametrize("axes", [np.eye(3), Z_UP], ids=["y-up", "z-up"])
def test_who_lies_in_all_frames_of_a_take_without_a_standing_rest_pose_stays_lying(axes, tmp_path):
    """Parts of LAFAN1's takes: all bones point along x at rest. A take with z up that stands is still recognised."""
    body, walk = load_body(), load_motion("walk")
    if axes is not Z_UP:
        lying = Rotation.from_euler("x", -90, degrees=True).as_matrix()
        low = walk.root + [0.0, -body.joints[0, 1] - walk.root[:, 1].mean() + 0.35, 0.0]
        walk = Motion("lies", walk.joint_names, walk.rotmat.copy(), low)
        walk.rotmat[:, 0] = lying @ walk.rotmat[:, 0]
    found = motion_of_file(write_bvh(tmp_path / "a.bvh", body, walk, rest="along-x", axes=axes))
    expected, directions = bone_directions(body, walk), bone_directions(body, found)
    for joint in ("LeftUpLeg", "RightArm"):
        np.testing.assert_allclose(directions[joint], expected[joint], atol=1e-6)
