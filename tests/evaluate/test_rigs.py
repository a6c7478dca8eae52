"""Rigs beside those of their makers: RigNet's figures on hand-made skeletons, and a folder of characters."""

import dataclasses

import numpy as np
import pytest
import rigs as rigged_files
from pools import write_character

from mimesh.core.errors import InputError
from mimesh.evaluate import rigs
from mimesh.evaluate.markdown import markdown
from mimesh.evaluate.rigs import (
    ListedRig,
    bones_to_bones,
    compare,
    deformation_error,
    joints_to_bones,
    joints_to_joints,
    limb_radius,
    matched_share,
    weights_apart,
)
from mimesh.evaluate.run import evaluate_command

LINE = np.array([[0.0, 0, 0], [0, 1, 0], [0, 2, 0]])
BONES = LINE[[[0, 1], [1, 2]]]
BESIDE = LINE + [0.25, 0, 0]


def test_joints_and_bones_that_lie_beside_each_other_are_that_far_apart():
    assert joints_to_joints(LINE, BESIDE) == pytest.approx(0.25)
    assert joints_to_bones((LINE, BONES), (BESIDE, BONES + [0.25, 0, 0])) == pytest.approx(0.25)
    assert bones_to_bones(BONES, BONES + [0.25, 0, 0]) == pytest.approx(0.25)


def test_a_joint_that_one_skeleton_lacks_counts_for_joints_and_not_for_bones():
    """Without the middle joint the bone is the same line: J2J is the mean of 0 and a third of 1, over both ways."""
    ends, bone = LINE[[0, 2]], LINE[None, [0, 2]]
    assert joints_to_joints(LINE, ends) == pytest.approx(1 / 6)
    assert joints_to_bones((LINE, BONES), (ends, bone)) == pytest.approx(0, abs=1e-12)
    assert bones_to_bones(BONES, bone) == pytest.approx(0, abs=1e-12)


def test_a_bone_counts_as_much_as_it_is_long():
    """Of a bone of length 3 beside one of length 1, two thirds lie beyond the end, 1 away in the mean."""
    short, long = np.array([[[0.0, 0, 0], [1, 0, 0]]]), np.array([[[0.0, 0, 0], [3, 0, 0]]])
    assert bones_to_bones(short, long) == pytest.approx((0 + 2 / 3 * 1) / 2, rel=1e-3)


def test_joints_within_the_tolerance_have_partners():
    found = np.array([[0.0, 0.1, 0], [0, 1.4, 0]])
    assert matched_share(found, LINE, np.full(3, 0.3)) == pytest.approx(2 / 5)
    assert matched_share(found, LINE, np.array([0.3, 0.5, 0.3])) == pytest.approx(4 / 5)
    assert matched_share(found, LINE, np.zeros(3)) == 0


def test_the_radius_of_a_square_bar_is_that_of_its_walls():
    """A bar of 2 x 2 x 10: rays in its cross-section go 1 to sqrt(2) far; outside nothing is hit on one side."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (0, 10) for z in (-1, 1)], float)
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    joints, up = np.array([[0.0, 5, 0], [0, 20, 0]]), np.array([[0.0, 3, 0], [0, 0, 0]])
    radius = limb_radius(joints, up, corners, faces)
    assert radius[0] == pytest.approx(2 / np.sqrt(3), rel=1e-6)  # at 0, 30 and 60 degrees: 1, 1.155, 1.155
    assert radius[1] == 0


def test_weights_of_other_joints_are_two_apart():
    own = np.eye(2)[[0, 0, 1, 1]]
    assert weights_apart(own, own) == 0
    assert weights_apart(own, own[[2, 0, 2, 2]]) == pytest.approx(0.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two people of a pool, one of them of another split, and a rigged file of another maker."""
    folder = tmp_path_factory.mktemp("rigs")
    write_character(folder, "hero", split="val", pack="ours")
    write_character(folder, "judge", 1, split="test", pack="ours")
    (folder / "kit").mkdir()
    rigged_files.character(folder / "kit" / "file.glb", shape=2)
    return folder


def test_the_maker_s_own_rig_has_no_error(folder):
    """Joints, weights and deformation in the clips are those of the maker; weights are added up by listed joints."""
    trial = rigs.rigs(folder).pair("val", "people", 0)
    own = ListedRig.of_maker(trial.character)
    figures = compare(trial, own)
    assert "LeftHandFinger1" not in own.names
    np.testing.assert_allclose(own.weights.sum(axis=1), 1)
    expected = {"joints_pct": 0, "j2j": 0, "j2b": 0, "b2b": 0, "iou": 100, "weights_l1": 0}
    assert {name: figures[name] for name in expected} == pytest.approx(expected, abs=1e-9)
    assert figures["deform_mm"] < 3  # fingers and a second joint of the neck turn, and count as those above


def test_a_rig_that_is_off_has_the_error_that_it_is_off_by(folder):
    """All joints 1 % of the height to the side; in clips, turned limbs are off by as much as the turn moves that."""
    trial = rigs.rigs(folder).pair("val", "people", 0)
    own = ListedRig.of_maker(trial.character)
    off = dataclasses.replace(own, joints=own.joints + [trial.height / 100, 0, 0])
    figures = compare(trial, off)
    assert figures["joints_pct"] == pytest.approx(1)
    assert set(figures["joints"].values()) == {1.0}
    side = np.ptp(trial.identity.vertices, axis=0).max()
    assert figures["b2b"] <= figures["j2b"] <= figures["j2j"] <= 100 * trial.height / 100 / side + 1e-9
    error = deformation_error(trial, off)
    assert error is not None
    assert compare(trial, own)["deform_mm"] < error < 2 * 17  # twice the offset, for a joint that turns over


def test_without_clips_no_deformation_is_measured(folder):
    trial = rigs.rigs(folder).pair("val", "people", 1)
    character = dataclasses.replace(trial.character, clips={})
    assert deformation_error(dataclasses.replace(trial, character=character), ListedRig.of_maker(character)) is None


@pytest.mark.slow
def test_characters_of_a_folder_are_measured_without_their_rigs(folder, tmp_path):
    report = evaluate_command("rigs", ["mime"], tmp_path / "rigs.json", "val", data=folder, dump=tmp_path / "worst")
    (row,) = report["results"]
    assert (row["pairs"], row.get("failures", 0)) == (2, 0)
    assert row["joints_pct"] < 2.5
    assert row["iou"] > 70
    assert row["each"]["identity"] == ["we: ours: hero", "not stated: kit: file"]
    text = markdown(report)
    assert "| we: ours | 1 |" in text
    rows = [line.strip("| ").split(" | ") for line in text.split("joints, % of height: mean")[1].splitlines()]
    of_hero = dict(zip(rows[0], next(cells for name, *cells in rows if name == "we: ours"), strict=True))
    errors = row["each"]["joints"][0]
    assert of_hero["Neck"] == f"{errors['Neck']:.1f}"
    assert of_hero["Foot"] == f"{(errors['LeftFoot'] + errors['RightFoot']) / 2:.1f}"
    assert len(list((tmp_path / "worst").glob("mime-people-*.png"))) == 2


def test_folders_without_people_and_other_methods_are_refused(folder, tmp_path):
    with pytest.raises(InputError, match="rigs: expected a folder of rigged people, found none; give it with --data"):
        evaluate_command("rigs", ["mime"])
    with pytest.raises(InputError, match="expected a folder of rigged characters"):
        evaluate_command("rigs", ["mime"], data=tmp_path)


def test_methods_without_joints_are_not_applicable(folder):
    rows = evaluate_command("rigs", ["copy", "npt", "identity"], split="val", pairs=1, data=folder)["results"]
    assert [(row["pairs"], row.get("failures"), row["not_applicable"]) for row in rows] == [(0, None, 1)] * 3
    assert "expected a model with joints (mime), found npt" in rows[1]["why"]


def test_packs_take_turns_where_files_of_two_have_one_name(tmp_path):
    for pack, names in (("a", ["first", "hero"]), ("b", ["hero"])):
        (tmp_path / pack).mkdir()
        for name in names:
            rigged_files.character(tmp_path / pack / f"{name}.glb")
    found = [(one.meta.pack, one.meta.file) for one in rigs.rigs(tmp_path).pool("val").characters]
    assert found == [("a", "first"), ("b", "hero"), ("a", "hero")]
