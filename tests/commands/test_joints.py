"""Corrected joints on the command line: given files, files found beside the inputs, and files of the joints found."""

import json
from pathlib import Path

import numpy as np
import pytest
from people import person

from mimesh.__main__ import run
from mimesh.bodies import load_body
from mimesh.commands.joint_files import with_joint_files
from mimesh.commands.options import JointOptions
from mimesh.core.options import Hints
from mimesh.io import load_mesh, save_mesh

LINE = "transfer {0}/hero.obj {0}/pose.obj -o {0}/{1}.obj --no-preview --front +z --driving-front +z {2}"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with hero.obj and pose.obj (a person in a T-pose), and the result without corrections."""
    folder = tmp_path_factory.mktemp("files")
    for name in ("hero", "pose"):
        save_mesh(person(), folder / f"{name}.obj")
    assert run(LINE.format(folder, "plain", f"--save-joints {folder}/all.json").split()) == 0
    return folder


@pytest.fixture
def side_file(files):
    """A side file with a knee 6 cm beside the one found, deleted afterwards."""
    values = json.loads((files / "all.json").read_text())
    x, y, z = values["joints"]["LeftLeg"]
    values["joints"] = {"LeftLeg": [x + 0.06, y, z]}
    path = files / "hero.joints.json"
    path.write_text(json.dumps(values))
    yield path
    path.unlink()


def test_saved_joints_are_all_of_the_model(files):
    values = json.loads((files / "all.json").read_text())
    assert tuple(values["joints"]) == load_body().joint_names
    assert (values["mesh"], values["vertices"], values["version"]) == ("hero.obj", len(person().vertices), 1)


@pytest.mark.slow
def test_a_side_file_is_used_and_said(files, side_file, call):
    out = call(LINE.format(files, "corrected", "")).out
    assert f"joints: LeftLeg as in {side_file} (--no-joints ignores it)\n" in out
    plain, corrected = (load_mesh(files / f"{name}.obj").vertices for name in ("plain", "corrected"))
    assert np.abs(corrected - plain).max() > 1e-3


def test_a_given_file_is_that_beside_the_mesh_which_can_be_ignored(files, side_file):
    meshes = files / "hero.obj", files / "pose.obj"
    beside, _ = with_joint_files(Hints(), *meshes, JointOptions(), "mime")
    given, lines = with_joint_files(Hints(joints=side_file), *meshes, JointOptions(no_joints=True), "mime")
    np.testing.assert_array_equal(beside.joints.positions["LeftLeg"], given.joints.positions["LeftLeg"])
    assert beside.driving_joints is given.driving_joints is None
    assert lines == (f"LeftLeg as in {side_file}",)
    ignored, lines = with_joint_files(Hints(), *meshes, JointOptions(no_joints=True), "mime")
    assert (ignored.joints, lines) == (None, ())


def test_models_without_joints_ignore_a_side_file_and_refuse_a_given_one(files, side_file, call, refuses):
    assert "joints:" not in call(LINE.format(files, "copy", "-m copy")).out
    line = LINE.format(files, "copy", "-m copy")
    refuses(f"{line} --joints {side_file}", "--joints: expected a model with joints (mime), found copy")
    refuses(f"{line} --save-joints {files}/x.json", "--save-joints: expected a model with joints")


def test_a_side_file_of_another_mesh_is_refused(files, side_file, refuses):
    side_file.write_text(side_file.read_text().replace(str(len(person().vertices)), "5310"))
    refuses(LINE.format(files, "x", ""), "vertices, found those of a mesh with 5310")


@pytest.mark.slow
def test_animate_takes_and_saves_joints_of_the_driving(files, call):
    line = "animate {0}/hero.obj {0}/pose.obj -o {0}/clip.glb --no-preview {1} {0}/driving.json"
    assert call(line.format(files, "--save-driving-joints")).code == 0
    assert json.loads(Path(files, "driving.json").read_text())["mesh"] == "pose.obj"
    assert f"joints: 31 joints as in {files}/driving.json\n" in call(line.format(files, "--driving-joints")).out
