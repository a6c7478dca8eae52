"""The commands evaluate and generate, and transfer with the files that deformation transfer needs."""

import json
from pathlib import Path

import numpy as np
import pytest
from people import person

from mimesh.evaluate.tables import TABLES
from mimesh.io import load_mesh, save_mesh
from mimesh.methods.find import is_table_model


@pytest.fixture
def people(tmp_path, monkeypatch):
    """identity.obj at rest; driving.obj and reference.obj of another person, posed and at rest; markers.txt."""
    monkeypatch.chdir(tmp_path)
    for name, mesh in (("identity", person(0)), ("driving", person(1, pose=3)), ("reference", person(1))):
        save_mesh(mesh, f"{name}.obj")
    vertices = person(0).vertices
    markers = [vertices[:, k].argmax() for k in range(3)] + [vertices[:, k].argmin() for k in range(3)]
    Path("markers.txt").write_text("# identity driving\n" + "".join(f"{v} {v}\n" for v in markers))


@pytest.mark.parametrize("more", ["", " --markers markers.txt"], ids=["index", "markers"])
def test_deformation_transfer_takes_its_third_mesh_and_markers(people, more, call):
    line = "transfer identity.obj driving.obj -o moved.obj -m deformation-transfer --reference reference.obj"
    code, out, _ = call(f"{line} --no-preview --up y --front z --driving-up y --driving-front z{more}")
    assert (code, "deformation-transfer" in out) == (0, True)
    truth = person(0, pose=3).vertices
    result = load_mesh("moved.obj").vertices
    error = np.linalg.norm((result - result.mean(axis=0)) - (truth - truth.mean(axis=0)), axis=1)
    assert error.mean() < 0.04


@pytest.mark.slow
def test_generate_and_evaluate_print_json(files, call):
    written = json.loads(call("generate noise -o meshes --pairs 1 --split val --json").out)
    assert written["files"] == len([path for path in Path("meshes").rglob("*") if path.is_file()])
    figures = json.loads(call("evaluate human-wide -m copy --pairs 1 --dump worst --json").out)
    assert {row["split"] for row in figures["results"]} == {"limits", "clips"}
    assert len(list(Path("worst").glob("copy-*.png"))) == 2


def test_a_table_leaves_out_rows_without_weights_and_says_how_to_make_them(files, call):
    """As in an installed package, which has no folder `ablations`: the rows that can be measured are."""
    methods = [row.method for row in TABLES["npt-2"].rows]
    missing = [method for method in methods if is_table_model(method)]
    assert len(missing) > 1
    others = "".join(f" --without {method}" for method in methods if method not in (*missing, "copy"))
    code, out, err = call(f"table npt-2 --pairs 1 -o table.json{others}")
    (note,) = [line for line in err.splitlines() if "weights" in line]
    assert "npt-concat1, npt-no-spadain, npt-no-edge, npt-equal by mimesh table npt-2 --train" in note
    assert "npt-full, npt-full-mixed by python scripts/train_on_gpu.py OUT" in note
    assert "not here; call this in the root of a checkout, which has some of them, or make " in note
    shown = [line.split("`")[1] for line in out.splitlines() if line.startswith("| ") and "`" in line]
    assert (code, shown) == (0, ["copy"])
    Path("ablations").mkdir()
    ended = call(f"table npt-2 --pairs 1 -o table.json{others}")
    assert "not here; make npt-concat1" in ended.err
    assert json.loads(call(f"table npt-2 --pairs 1 -o table.json{others} --json").out)["left_out"] == missing


def test_a_table_without_any_weights_is_refused_before_work(files, call):
    methods = [row.method for row in TABLES["npt-2"].rows]
    code, _, err = call("table npt-2" + "".join(f" --without {method}" for method in methods if method != "npt-full"))
    assert (code, len(err.splitlines())) == (2, 1)
    assert "npt-full: expected weights in ablations, found no files" in err
    assert "make npt-full by python scripts/train_on_gpu.py OUT" in err
