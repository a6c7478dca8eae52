"""Corrected joints on the command line: given files, files found beside the inputs, and files of the joints found."""

import json
from pathlib import Path

import numpy as np
import pytest
from people import person

from mimesh.bodies import load_body
from mimesh.cli import run
from mimesh.commands.move import JointFiles
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


def test_a_side_file_is_used_and_said(files, side_file, call):
    out = call(LINE.format(files, "corrected", "")).out
    assert f"joints: LeftLeg as in {side_file} (--no-joints ignores it)\n" in out
    plain, corrected = (load_mesh(files / f"{name}.obj").vertices for name in ("plain", "corrected"))
    assert np.abs(corrected - plain).max() > 1e-3


def test_a_given_file_is_that_beside_the_mesh_which_can_be_ignored(files, side_file):
    meshes = files / "hero.obj", files / "pose.obj"
    beside = JointFiles.found(*meshes, None, None, False, "mime")
    given = JointFiles.found(*meshes, side_file, None, True, "mime")
    assert beside.identity is not None
    assert given.identity is not None
    np.testing.assert_array_equal(beside.identity.positions["LeftLeg"], given.identity.positions["LeftLeg"])
    assert beside.driving is given.driving is None
    assert given.described() == (f"LeftLeg as in {side_file}",)
    assert JointFiles.found(*meshes, None, None, True, "mime") == JointFiles(None, None)


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
