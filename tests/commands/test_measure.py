"""The commands evaluate, figure and generate, and transfer with the files that deformation transfer needs."""

import json

import numpy as np
import pytest
from networks import write_network
from people import person

from mimesh.cli import run
from mimesh.evaluate.tables import TABLES
from mimesh.io import load_mesh, save_mesh
from mimesh.methods.find import is_table_model


@pytest.fixture
def people(tmp_path):
    """identity.obj at rest; driving.obj and reference.obj of another person, posed and at rest; markers.txt."""
    for name, mesh in (("identity", person(0)), ("driving", person(1, pose=3)), ("reference", person(1))):
        save_mesh(mesh, tmp_path / f"{name}.obj")
    vertices = person(0).vertices
    markers = [vertices[:, k].argmax() for k in range(3)] + [vertices[:, k].argmin() for k in range(3)]
    (tmp_path / "markers.txt").write_text("# identity driving\n" + "".join(f"{v} {v}\n" for v in markers))
    return tmp_path


@pytest.mark.parametrize("marked", [False, True], ids=["index", "markers"])
def test_deformation_transfer_takes_its_third_mesh_and_markers(people, marked, capsys):
    out = people / "moved.obj"
    arguments = ["transfer", str(people / "identity.obj"), str(people / "driving.obj"), "-o", str(out)]
    arguments += ["-m", "deformation-transfer", "--reference", str(people / "reference.obj"), "--no-preview"]
    arguments += ["--up", "y", "--front", "z", "--driving-up", "y", "--driving-front", "z"]
    assert run([*arguments, *(["--markers", str(people / "markers.txt")] if marked else [])]) == 0
    truth = person(0, pose=3).vertices
    result = load_mesh(out).vertices
    error = np.linalg.norm((result - result.mean(axis=0)) - (truth - truth.mean(axis=0)), axis=1)
    assert error.mean() < 0.04
    assert "deformation-transfer" in capsys.readouterr().out


@pytest.mark.slow
def test_generate_figure_and_evaluate_print_json(tmp_path, capsys):
    network = str(write_network(tmp_path / "tiny.onnx"))
    assert run(["generate", "noise", "-o", str(tmp_path / "meshes"), "--pairs", "1", "--split", "val", "--json"]) == 0
    written = json.loads(capsys.readouterr().out)
    assert written["files"] == len([p for p in (tmp_path / "meshes").rglob("*") if p.is_file()])
    assert run(["figure", "npt-20", "-m", network, "--rows", "1", "-o", str(tmp_path / "f.png"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rows"] == 1
    arguments = ["evaluate", "human-wide", "-m", "copy", "--pairs", "1", "--dump", str(tmp_path / "worst"), "--json"]
    assert run(arguments) == 0
    assert {row["split"] for row in json.loads(capsys.readouterr().out)["results"]} == {"limits", "clips"}
    assert len(list((tmp_path / "worst").glob("copy-*.png"))) == 2


def test_a_table_leaves_out_rows_without_weights_and_says_how_to_make_them(tmp_path, monkeypatch, capsys):
    """As in an installed package, which has no folder `ablations`: the rows that can be measured are."""
    monkeypatch.chdir(tmp_path)
    methods = [row.method for row in TABLES["npt-2"].rows]
    missing = [method for method in methods if is_table_model(method)]
    assert len(missing) > 1
    others = [word for method in methods if method not in (*missing, "copy") for word in ("--without", method)]
    assert run(["table", "npt-2", "--pairs", "1", *others]) == 0
    out, err = capsys.readouterr()
    (note,) = [line for line in err.splitlines() if "weights" in line]
    assert "npt-concat1, npt-no-spadain, npt-no-edge, npt-equal by mimesh table npt-2 --train" in note
    assert "npt-full, npt-full-mixed by python scripts/train_on_gpu.py OUT" in note
    assert [line.split("`")[1] for line in out.splitlines() if line.startswith("| ") and "`" in line] == ["copy"]
    assert run(["table", "npt-2", "--pairs", "1", *others, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["left_out"] == missing


def test_a_table_without_any_weights_is_refused_before_work(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    methods = [row.method for row in TABLES["npt-2"].rows]
    words = [word for method in methods if method != "npt-full" for word in ("--without", method)]
    assert run(["table", "npt-2", *words]) == 2
    (message,) = capsys.readouterr().err.splitlines()
    assert "npt-full: expected weights in ablations, found no files" in message
    assert "make npt-full by python scripts/train_on_gpu.py OUT" in message
