"""DeepMimic files: known poses and motions give the expected limb directions; errors of damaged files are one line."""

import numpy as np
import pytest
from deepmimic_files import still_rows, swaying_rows, write_folder, write_rows
from motion_files import bone_directions

from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.core.geometry import unit_vectors
from mimesh.motions.deepmimic import CLIPS, deepmimic_folder, load_deepmimic, read_deepmimic
from mimesh.motions.motion import joint_tracks, leg_length, lowest
from mimesh.motions.retarget import BONES

AXES = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
"""Rotation from x front, y up, z right (the files) to x left, y up, z front."""
ROOT, LEFT_SHOULDER, LEFT_KNEE, LEFT_ELBOW = 4, 39, 34, 43


@pytest.fixture(scope="module")
def body():
    return load_body()


def turn(axis: int, degrees: float) -> np.ndarray:
    """Quaternion w x y z about a coordinate axis of the file."""
    half = np.radians(degrees) / 2
    return np.array([np.cos(half), *(np.sin(half) * np.eye(3)[axis])])


def test_limbs_at_rest_point_down_and_soles_are_on_the_floor(body, tmp_path):
    motion = load_deepmimic(write_rows(tmp_path / "a.txt", still_rows()), body)
    for direction in bone_directions(body, motion).values():
        np.testing.assert_allclose(direction, [[0, -1, 0]] * 3, atol=1e-9)
    np.testing.assert_allclose(motion.rotmat[:, body.joint("Hips")], [np.eye(3)] * 3, atol=1e-12)
    np.testing.assert_allclose(lowest(body, motion.rotmat, motion.root), 0, atol=0.01)
    assert (motion.name, motion.fps) == ("a", pytest.approx(30))


def test_known_rotations_move_the_right_limb_in_the_right_direction(body, tmp_path):
    rows = still_rows()
    rows[:, LEFT_SHOULDER : LEFT_SHOULDER + 4] = turn(0, 90)  # out to the left
    rows[:, LEFT_ELBOW] = np.pi / 2  # then forward
    rows[:, LEFT_KNEE] = -np.pi / 2  # heel to the back
    motion = load_deepmimic(write_rows(tmp_path / "a.txt", rows), body)
    expected = {"LeftArm": [1, 0, 0], "LeftForeArm": [0, 0, 1], "LeftLeg": [0, 0, -1], "RightArm": [0, -1, 0]}
    found = bone_directions(body, motion)
    for joint, direction in expected.items():
        np.testing.assert_allclose(found[joint][0], direction, atol=1e-9)
    # An arm with the direction of the T-pose has the rotation of the T-pose.
    np.testing.assert_allclose(motion.rotmat[0, body.joint("LeftArm")], np.eye(3), atol=1e-9)


def test_path_and_heading_are_those_of_the_file(body, tmp_path):
    rows = still_rows(4)
    rows[:, 1] = np.arange(4) * 0.1
    rows[:, 2] += [0, 0.3, 0, 0]
    rows[-1, ROOT : ROOT + 4] = turn(1, 90)
    rows[-1, 0] = 0.0  # the last frame may have no duration
    motion = load_deepmimic(write_rows(tmp_path / "a.txt", rows), body)
    scale = leg_length(body.joints, body.joint_names) / (0.421546 + 0.40987)
    np.testing.assert_allclose(motion.root - motion.root[0], scale * rows[:, [3, 2, 1]] - scale * rows[0, [3, 2, 1]])
    np.testing.assert_allclose(motion.rotmat[-1, 0][:, 2], [1, 0, 0], atol=1e-9)  # to the left


def test_limb_directions_and_trunk_rotations_are_kept(body, tmp_path):
    path = write_rows(tmp_path / "a.txt", swaying_rows(0))
    source, motion = read_deepmimic(path), load_deepmimic(path, body)
    rotation, position = source.world()
    for joint, direction in bone_directions(body, motion).items():
        ends = (position[:, source.joint_names.index(name)] @ AXES.T for name in (BONES[joint], joint))
        np.testing.assert_allclose(direction, unit_vectors(np.subtract(*ends)), atol=1e-9)
    world = joint_tracks(body, motion)[0]
    for joint in ("Hips", "Spine1", "Head"):
        expected = AXES @ rotation[:, source.joint_names.index(joint)] @ AXES.T
        np.testing.assert_allclose(world[:, body.joint(joint)], expected, atol=1e-9)


def test_frames_of_unequal_duration_are_resampled_at_one_rate(tmp_path):
    rows = swaying_rows(1, frames=20)
    gap = np.delete(rows, 7, axis=0)
    gap[6, 0] *= 2
    whole, filled = (read_deepmimic(write_rows(tmp_path / "a.txt", r)) for r in (rows, gap))
    assert filled.fps == whole.fps
    assert len(filled.rotmat) == len(whole.rotmat)
    np.testing.assert_allclose(np.delete(filled.rotmat, 7, 0), np.delete(whole.rotmat, 7, 0), atol=1e-9)
    np.testing.assert_allclose(filled.root, whole.root, atol=1e-12)
    np.testing.assert_allclose(filled.rotmat[7], whole.rotmat[7], atol=0.02)


def damaged_rows(column: int | slice, value: float):
    rows = still_rows()
    rows[1, column] = value
    return rows


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (still_rows()[:, :20], "44 numbers, a person's, found 3 frames of 20"),
        (still_rows(1), "two frames or more"),
        ([], "found 0 frames of no"),
        ([still_rows()[0].tolist(), [1.0]], "frames of 1 or 44"),
        (damaged_rows(2, np.nan), "NaN or infinity in frame 1"),
        (damaged_rows(0, 0.0), "found 0 s for frame 1"),
        (damaged_rows(slice(8, 12), 0.0), r"found 0 in frame 1 \(LowerBack\)"),
        ("text", "something else"),
        ([["a"] * 44] * 2, "something else"),
    ],
)
def test_errors_of_damaged_files_are_one_line(rows, message, tmp_path):
    with pytest.raises(InputError, match=message) as error:
        read_deepmimic(write_rows(tmp_path / "a.txt", rows))
    assert "\n" not in str(error.value)


def test_missing_and_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="expected a DeepMimic motion file, found none"):
        read_deepmimic(tmp_path / "gone.txt")
    for text in ("not JSON", "[1, 2]", '{"Loop": "wrap"}'):
        (tmp_path / "a.txt").write_text(text)
        with pytest.raises(InputError, match="something else"):
            read_deepmimic(tmp_path / "a.txt")


def test_the_folder_is_the_given_one_or_that_of_pybullet(tmp_path, monkeypatch):
    assert len(CLIPS) == 20
    given = write_folder(tmp_path / "given")
    assert deepmimic_folder(given) == given
    (given / CLIPS["walk"]).unlink()
    with pytest.raises(InputError, match=r"found no humanoid3d_walk\.txt; pip install"):
        deepmimic_folder(given)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match="neither; pip install"):
        deepmimic_folder()
    monkeypatch.undo()
    package = tmp_path / "site" / "pybullet_data"
    write_folder(package / "data" / "motions")
    (package / "__init__.py").write_text("raise RuntimeError('nobody imports it')")
    monkeypatch.syspath_prepend(tmp_path / "site")
    assert deepmimic_folder() == package / "data" / "motions"
