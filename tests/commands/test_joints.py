"""Corrected joints on the command line: given files, files found beside the inputs, and files of the joints found."""

import json

import numpy as np
import pytest
from people import person

from mimesh.bodies import load_body
from mimesh.cli import run
from mimesh.io import load_mesh, save_mesh


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with hero.obj and pose.obj (a person in a T-pose), and the result without corrections."""
    folder = tmp_path_factory.mktemp("files")
    for name in ("hero", "pose"):
        save_mesh(person(), folder / f"{name}.obj")
    assert transfer(folder, "plain.obj", "--save-joints", folder / "all.json") == 0
    return folder


def transfer(folder, output, *more):
    """Run `mimesh transfer`; returns the exit code."""
    words = ["transfer", folder / "hero.obj", folder / "pose.obj", "-o", folder / output, "--no-preview"]
    return run([*map(str, words), "--front", "+z", "--driving-front", "+z", *map(str, more)])


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


def test_a_side_file_is_used_and_said_and_can_be_ignored(files, side_file, capsys):
    assert transfer(files, "corrected.obj") == 0
    assert f"joints: LeftLeg as in {side_file} (--no-joints ignores it)\n" in capsys.readouterr().out
    assert transfer(files, "again.obj", "--joints", side_file, "--json") == 0
    assert json.loads(capsys.readouterr().out)["report"]["joints"] == [f"LeftLeg as in {side_file}"]
    assert transfer(files, "ignored.obj", "--no-joints") == 0
    assert "joints:" not in capsys.readouterr().out
    plain, corrected, again, ignored = (
        load_mesh(files / f"{name}.obj").vertices for name in ("plain", "corrected", "again", "ignored")
    )
    np.testing.assert_array_equal(plain, ignored)
    np.testing.assert_array_equal(corrected, again)
    assert np.abs(corrected - plain).max() > 1e-3


@pytest.mark.slow
def test_models_without_joints_ignore_a_side_file_and_refuse_a_given_one(files, side_file, capsys):
    assert transfer(files, "copy.obj", "-m", "copy") == 0
    assert "joints:" not in capsys.readouterr().out
    assert transfer(files, "copy.obj", "-m", "copy", "--joints", side_file) == 2
    assert "--joints: expected a model with joints (mime), found copy" in capsys.readouterr().err
    assert transfer(files, "copy.obj", "-m", "copy", "--save-joints", files / "x.json") == 2
    assert "--save-joints: expected a model with joints" in capsys.readouterr().err


def test_a_side_file_of_another_mesh_is_refused(files, side_file, capsys):
    side_file.write_text(side_file.read_text().replace(str(len(person().vertices)), "5310"))
    assert transfer(files, "x.obj") == 2
    assert "vertices, found those of a mesh with 5310" in capsys.readouterr().err


@pytest.mark.slow
def test_animate_takes_and_saves_joints_of_the_driving(files, capsys):
    words = ["animate", files / "hero.obj", files / "pose.obj", "-o", files / "clip.glb", "--no-preview"]
    saved = files / "driving.json"
    assert run([*map(str, words), "--save-driving-joints", str(saved)]) == 0
    assert json.loads(saved.read_text())["mesh"] == "pose.obj"
    assert run([*map(str, words), "--driving-joints", str(saved)]) == 0
    assert f"joints: 31 joints as in {saved}\n" in capsys.readouterr().out
