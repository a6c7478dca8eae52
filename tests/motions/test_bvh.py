"""BVH files: channels against rotation matrices, bone directions after retargeting, and errors of damaged files."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.motions import load_bvh, retarget
from mimesh.motions.motion import joint_tracks
from mimesh.motions.retarget import BONES

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
    np.testing.assert_allclose(
        bvh.rotmat[1, 0], Rotation.from_euler("ZYX", [10, 20, 30], degrees=True).as_matrix(), atol=1e-12
    )
    np.testing.assert_allclose(
        bvh.rotmat[1, 1], Rotation.from_euler("XZY", [40, 50, 60], degrees=True).as_matrix(), atol=1e-12
    )
    np.testing.assert_array_equal(bvh.ends["Knee"], [0, -4, 0])
    rotation, position = bvh.world()
    np.testing.assert_allclose(position[1, 1], [7, 8, 9] + bvh.rotmat[1, 0] @ [0, -5, 0])
    np.testing.assert_allclose(rotation[1, 1], bvh.rotmat[1, 0] @ bvh.rotmat[1, 1])


def test_hips_may_move_below_a_resting_root(tmp_path):
    """A quarter turn of the root about y takes x to -z; positions that never change are those of the offsets."""
    bvh = load_bvh(write(tmp_path, MOVING_HIPS))
    _, position = bvh.world()
    np.testing.assert_allclose(position[:, 0], 0)
    np.testing.assert_allclose(position[:, 1], [[1, 9, -4], [1, 9, -6]], atol=1e-12)
    np.testing.assert_allclose(position[:, 2], [[1, 4, -4], [-4, 9, -6]], atol=1e-12)


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
        ("7 8 9", "7 nan 9", "NaN or infinity in frame 1"),
        ("JOINT Knee", "BONE Knee", "found 'BONE'"),
    ],
)
def test_errors_of_damaged_files_are_one_line(tmp_path, old, new, message):
    with pytest.raises(InputError, match=message) as error:
        load_bvh(write(tmp_path, SMALL.replace(old, new, 1)))
    assert "\n" not in str(error.value)


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


def as_bvh(body, rng, frames=4, scale=17.0):
    """Text of a BVH file of the shipped body in random poses, z up and facing -y, in another unit."""
    children = {j: [k for k, p in enumerate(body.parents) if p == j] for j in range(len(body.parents))}
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    lines: list[str] = ["HIERARCHY"]
    order: list[int] = []

    def visit(j):
        parent = body.parents[j]
        offset = scale * turn @ (body.joints[j] - (body.joints[parent] if parent >= 0 else 0))
        order.append(j)
        kind, numbers = "ROOT" if parent < 0 else "JOINT", " ".join(repr(float(x)) for x in offset)
        lines.append(f"{kind} {body.joint_names[j]}\n{{\nOFFSET {numbers}")
        position = "6 Xposition Yposition Zposition" if parent < 0 else "3"
        lines.append(f"CHANNELS {position} Zrotation Yrotation Xrotation")
        for child in children[j]:
            visit(child)
        if not children[j]:
            lines.append("End Site\n{\nOFFSET 0 0 1\n}")
        lines.append("}")

    visit(0)
    angles = rng.uniform(-40, 40, (frames, len(order), 3))
    rows = [" ".join(map(str, [0, 0, 16, *row.ravel()])) for row in angles]
    return "\n".join([*lines, "MOTION", f"Frames: {frames}", "Frame Time: 0.01", *rows]) + "\n"


def check_limbs(body, source):
    """Check that limb bones of the retargeted motion have the directions of the source's."""
    _, positions = joint_tracks(body, retarget(source, body))
    source_positions = source.world()[1] @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]).T
    for joint, tail in BONES.items():
        bone = positions[:, body.joint(tail)] - positions[:, body.joint(joint)]
        tail_index, joint_index = source.joint_names.index(tail), source.joint_names.index(joint)
        source_bone = source_positions[:, tail_index] - source_positions[:, joint_index]
        unit = [v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (bone, source_bone)]
        np.testing.assert_allclose(*unit, atol=1e-9)


def test_limbs_have_the_directions_of_the_source(tmp_path):
    body = load_body()
    check_limbs(body, load_bvh(write(tmp_path, as_bvh(body, np.random.default_rng(0)))))


def test_a_file_of_the_body_gives_its_rotations(tmp_path):
    """Same rest pose, other axes, unit and joint order; fingers stay at rest."""
    body = load_body()
    source = load_bvh(write(tmp_path, as_bvh(body, np.random.default_rng(0))))
    axes = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    motion = retarget(source, body)
    for j, name in enumerate(body.joint_names):
        expected = axes @ source.rotmat[:, source.joint_names.index(name)] @ axes.T
        finger = any(word in name for word in ("Thumb", "Finger"))
        np.testing.assert_allclose(
            motion.rotmat[:, j], np.broadcast_to(np.eye(3), expected.shape) if finger else expected, atol=1e-9
        )


def test_limb_directions_do_not_depend_on_the_rest_pose(tmp_path):
    """The source rests in an A-pose: legs apart and arms lowered."""
    body = load_body()
    text = as_bvh(body, np.random.default_rng(1), frames=2)
    source = load_bvh(write(tmp_path, text))
    bent = source.offsets.copy()
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        for joint, degrees in ((f"{side}Leg", 20.0), (f"{side}ForeArm", -40.0), (f"{side}Hand", -40.0)):
            j = source.joint_names.index(joint)
            bent[j] = Rotation.from_euler("y", -sign * degrees, degrees=True).apply(bent[j])
    source = dataclasses.replace(source, offsets=bent)
    check_limbs(body, source)


def test_a_skeleton_without_limbs_is_refused(tmp_path):
    with pytest.raises(InputError, match="LeftUpLeg"):
        retarget(load_bvh(write(tmp_path, SMALL)), load_body())
