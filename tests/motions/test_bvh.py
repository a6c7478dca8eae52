"""BVH files: channels against rotation matrices, bone directions after retargeting, and errors of damaged files."""

import numpy as np
import pytest
from motion_files import Z_UP, write_bvh
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.sampling import rotvec_to_rotmat
from mimesh.core.errors import InputError
from mimesh.motions import Motion
from mimesh.motions.bvh import load_bvh
from mimesh.motions.retarget import retarget

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
    found = retarget(load_bvh(path), body)
    for j, name in enumerate(body.joint_names):
        finger = any(word in name for word in ("Thumb", "Finger"))
        expected = np.tile(np.eye(3), (4, 1, 1)) if finger else motion.rotmat[:, j]
        np.testing.assert_allclose(found.rotmat[:, j], expected, atol=1e-9)


def test_a_skeleton_without_limbs_is_refused(tmp_path):
    with pytest.raises(InputError, match="LeftUpLeg"):
        retarget(load_bvh(write(tmp_path, SMALL)), load_body())
