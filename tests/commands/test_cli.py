"""The `mimesh` command on good input: files, output and exit codes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import zoo

import mimesh
from mimesh.cli import COMMANDS, command_name, run
from mimesh.io import load_clip, load_mesh, save_mesh

MIMESH = Path(sys.executable).with_name("mimesh")


def test_help_names_every_command_and_imports_nothing_heavy():
    script = (
        "import sys; from mimesh.cli import run; run(['--help']);"
        "heavy = {'numpy', 'scipy', 'PIL', 'torch', 'onnxruntime', 'rich', 'jaxtyping'} & set(sys.modules);"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all(command_name(command) in done.stdout for command in COMMANDS)


@pytest.mark.parametrize("command", [command_name(c) for c in COMMANDS])
def test_every_command_has_help_and_json(command, capsys):
    assert run([command, "--help"]) == 0
    assert "--json" in capsys.readouterr().out


def test_every_test_set_is_in_the_help():
    from mimesh.commands.measure import PROTOCOLS
    from mimesh.evaluate.run import FOLDERS, WITHOUT_FOLDER

    assert set(PROTOCOLS.replace(" or ", ", ").split(", ")) == {*WITHOUT_FOLDER, *FOLDERS}


def test_version(capsys):
    assert run(["--version"]) == 0
    assert capsys.readouterr().out == f"mimesh {mimesh.__version__}\n"


def test_transfer_prints_its_output_and_the_next_command(files, capsys):
    assert run(["transfer", str(files / "hero.obj"), str(files / "pose.ply"), "-m", "copy"]) == 0
    output = files / "hero-pose.obj"
    text = capsys.readouterr()
    assert str(output) in text.out
    assert f"next: open {files / 'hero-pose.preview.html'} in a browser" in text.out
    assert text.err == ""
    assert len(load_mesh(output).vertices) == 8
    assert (files / "hero-pose.preview.png").stat().st_size > 1000


def test_transfer_json_is_one_object_with_the_documented_keys(files, capsys):
    args = ["transfer", str(files / "hero.obj"), str(files / "pose.ply"), "-m", "copy", "--no-preview", "--json"]
    assert run(args) == 0
    lines = capsys.readouterr().out.splitlines()
    facts = json.loads(lines[0])
    assert len(lines) == 1
    assert set(facts) == {"output", "replaced", "model", "vertices", "frames", "fps", "seconds", "report"}
    assert not facts["replaced"]
    assert set(facts["seconds"]) == {"load", "prepare", "drive", "refine", "write"}
    assert facts["output"] == str(files / "hero-pose.obj")
    assert (facts["model"], facts["vertices"], facts["frames"], facts["fps"]) == ("copy", 8, 1, None)
    assert facts["report"]["pictures"] == []
    assert not list(files.glob("*.preview.*"))


def test_a_second_run_says_that_it_replaced_the_file_of_the_first(files, capsys):
    args = ["transfer", str(files / "hero.obj"), str(files / "pose.ply"), "-m", "copy", "--no-preview"]
    assert run(args) == 0
    assert "replaced" not in capsys.readouterr().out
    assert run(args) == 0
    assert f"{files / 'hero-pose.obj'} (replaced): 8 vertices" in capsys.readouterr().out


def test_frames_that_are_written_again_are_replaced_too(files, capsys):
    args = ["animate", str(files / "hero.obj"), str(files / "walk"), "-m", "copy", "--fps", "10", "--no-preview"]
    assert run([*args, "-o", str(files / "frames")]) == 0
    assert "replaced" not in capsys.readouterr().out
    assert run([*args, "-o", str(files / "frames")]) == 0
    assert f"{files / 'frames'} (replaced): 8 vertices" in capsys.readouterr().out


def test_transfer_equals_the_python_function(files):
    output = files / "out.npz"
    args = ["transfer", str(files / "hero.obj"), str(files / "pose.ply"), "-m", "copy", "-o", str(output), "-q"]
    assert run([*args, "--no-preview"]) == 0
    expected = mimesh.transfer(files / "hero.obj", files / "pose.ply", "copy")
    np.testing.assert_array_equal(load_mesh(output).vertices, expected.vertices)


def test_animate_writes_a_glb_a_picture_and_a_page(files, capsys):
    assert run(["animate", str(files / "hero.obj"), str(files / "walk"), "-m", "copy", "--fps", "10"]) == 0
    assert (files / "hero-walk.glb").exists()
    assert "mimesh-scene" in (files / "hero-walk.preview.html").read_text()
    assert (files / "hero-walk.preview.png").exists()
    text = capsys.readouterr()
    assert "3 frames at 10 per second" in text.out
    assert text.err == ""


def test_open_opens_the_page_in_the_browser(files, capsys, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or len(opened) == 1)
    args = ["transfer", str(files / "hero.obj"), str(files / "pose.ply"), "-m", "copy", "-q", "--open"]
    assert run(args) == 0
    assert opened == [(files / "hero-pose.preview.html").as_uri()]
    assert capsys.readouterr() == ("", "")
    assert run(args) == 0
    assert "no browser was found" in capsys.readouterr().err
    assert run([*args, "--no-preview"]) == 2
    assert "--open: expected a page" in capsys.readouterr().err


def test_render_writes_a_page_of_any_files(files, capsys):
    page = files / "both.html"
    assert run(["render", str(files / "hero.obj"), str(files / "walk"), "-o", str(page)]) == 0
    assert '"role":"mesh"' in page.read_text()
    assert run(["render", str(files / "hero.obj"), "--truth", str(files / "hero.obj"), "-o", str(page)]) == 0
    assert '"role":"truth"' in page.read_text()
    capsys.readouterr()
    save_mesh(zoo.tetrahedron(), files / "other.obj")
    assert run(["render", str(files / "hero.obj"), "--truth", str(files / "other.obj"), "-o", str(page)]) == 2
    assert "expected the truth to have 8 vertices, found 4" in capsys.readouterr().err


def test_animate_takes_a_range_and_writes_folders(files, capsys):
    args = ["animate", str(files / "hero.obj"), str(files / "walk"), "-m", "copy", "--start", "1", "--fps", "24"]
    assert run([*args, "-o", str(files / "moved"), "--no-preview", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["frames"], facts["fps"]) == (2, 24)
    assert len(load_clip(files / "moved")) == 2


def test_quiet_prints_nothing(files, capsys):
    assert run(["animate", str(files / "hero.obj"), str(files / "walk"), "-m", "copy", "-q", "--no-preview"]) == 0
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("output", ["hero.obj", "pose.ply"])
def test_inputs_are_not_overwritten(files, output, capsys):
    before = (files / output).read_bytes()
    args = ["transfer", str(files / "hero.obj"), str(files / "pose.ply"), "-m", "copy", "-o", str(files / output)]
    assert run(args) == 2
    assert "apart from the inputs" in capsys.readouterr().err
    assert (files / output).read_bytes() == before


def test_outputs_of_other_formats_have_previews_of_their_own(files):
    for name in ("both.obj", "both.ply"):
        args = ["transfer", str(files / "hero.obj"), str(files / "pose.ply"), "-m", "copy", "-o", str(files / name)]
        assert run([*args, "-q"]) == 0
    assert (files / "both.preview.png").exists()
    assert (files / "both.ply.preview.html").exists()


def test_an_empty_path_and_a_mesh_for_a_clip_are_refused_with_the_way(files, capsys):
    assert run(["animate", str(files / "hero.obj"), ""]) == 2
    assert "expected a path, found an empty text" in capsys.readouterr().err
    assert run(["animate", str(files / "hero.obj"), str(files / "pose.ply"), "-o", str(files / "x.obj")]) == 2
    assert f"name it without a suffix: -o {files / 'x'}" in capsys.readouterr().err


@pytest.mark.parametrize("given", ["--reference", "--markers"])
@pytest.mark.parametrize("name", ["x.obj", "x.preview.png", "x.preview.html"])
def test_reference_and_markers_are_not_overwritten(files, given, name, capsys):
    (files / name).write_text("0 0\n")
    args = ["transfer", str(files / "hero.obj"), str(files / "pose.ply"), "-m", "deformation-transfer"]
    assert run([*args, given, str(files / name), "-o", str(files / "x.obj")]) == 2
    assert "apart from the inputs" in capsys.readouterr().err
    assert (files / name).read_text() == "0 0\n"


def test_hard_link_to_an_input_is_not_overwritten(files, capsys):
    (files / "other.obj").hardlink_to(files / "hero.obj")
    args = ["transfer", str(files / "hero.obj"), str(files / "pose.ply"), "-m", "copy", "-o", str(files / "other.obj")]
    assert run(args) == 2
    assert "apart from the inputs" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform != "linux", reason="file names are text on other systems")
def test_file_names_that_are_no_text_are_printed_escaped(files):
    odd = os.fsdecode(bytes(files) + b"/p\xe9.ply")
    (files / "pose.ply").rename(odd)
    done = subprocess.run([MIMESH, "transfer", files / "hero.obj", odd, "-m", "copy"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "p\\udce9" in done.stdout


@pytest.mark.parametrize("output", ["walk", "walk/000.obj", "walk/new"])
def test_nothing_is_written_into_the_driving_folder(files, output, capsys):
    before = sorted((files / "walk").iterdir())
    args = ["animate", str(files / "hero.obj"), str(files / "walk"), "-m", "copy", "-o", str(files / output)]
    assert run(args) == 2
    assert "apart from the inputs" in capsys.readouterr().err
    assert sorted((files / "walk").iterdir()) == before


def test_look_prints_text_and_json(files, capsys):
    assert run(["look", str(files / "hero.obj"), str(files / "walk")]) == 0
    assert "hero.obj" in capsys.readouterr().out
    assert run(["look", str(files / "hero.obj"), str(files / "walk"), "--json"]) == 0
    hero, walk = json.loads(capsys.readouterr().out)["files"]
    assert (hero["vertices"], hero["frames"], walk["frames"]) == (8, 1, 3)


def test_models_lists_all_models(capsys):
    from mimesh.methods.find import MODELS

    assert run(["models", "--json"]) == 0
    assert [m["name"] for m in json.loads(capsys.readouterr().out)["models"]] == [*MODELS, "mime-quadruped"]
    assert run(["models"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in MODELS)
    assert "\\n" not in shown


@pytest.mark.slow
def test_doctor_passes_on_this_installation(capsys):
    assert run(["doctor", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["ok"]
    assert {check["name"] for check in facts["checks"]} >= {"shipped body", "shipped networks", "self check"}


def test_doctor_lists_what_is_optional(capsys, monkeypatch):
    def version(package):
        if package in ("ufbx", "DracoPy", "av"):
            raise metadata.PackageNotFoundError(package)
        return "1.0"

    monkeypatch.setattr("mimesh.tools.doctor.metadata.version", version)
    monkeypatch.setattr("mimesh.tools.doctor._transfer", lambda: "skipped")
    monkeypatch.setenv("BLENDER", "nowhere")
    assert run(["doctor", "--json"]) == 0
    found = {check["name"]: check["found"] for check in json.loads(capsys.readouterr().out)["checks"]}
    assert found["ufbx"] == "not installed (pip install 'mimesh[fbx]' to read FBX)"
    assert found["DracoPy"] == "not installed (pip install 'mimesh[compressed]' for Draco and meshopt glTF)"
    assert found["usd-core"] == found["alembic3d"] == "1.0"
    assert "mimesh[video]" in found["av"]
    assert "blender" in found


def test_doctor_reports_a_failed_check(capsys, monkeypatch):
    monkeypatch.setattr("mimesh.tools.doctor._transfer", lambda: 1 / 0)
    assert run(["doctor"]) == 1
    assert "FAIL  self check          ZeroDivisionError" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(("body", "motion"), [("human", "jump"), ("quadruped", "horse-gallop")])
def test_demo_writes_its_files(body, motion, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("mimesh.tools.demo.FRAMES", 2)
    monkeypatch.setattr("mimesh.tools.preview.TILE", (90, 110))
    assert run(["demo", "-o", str(tmp_path / "demo"), "--json", "--body", body]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["frames"], facts["motion"], facts["report"]["body"]) == (2, motion, body)
    names = {"identity.obj", "driving.obj", "driving.glb", "result.glb", "preview.png", "player.html"}
    assert {path.name for path in (tmp_path / "demo").iterdir() if path.suffix != ".mtl"} == names
    assert (
        load_mesh(tmp_path / "demo" / "result.glb").faces.shape
        == load_mesh(tmp_path / "demo" / "identity.obj").faces.shape
    )


def test_demo_of_another_body_is_refused(tmp_path, capsys):
    assert run(["demo", "-o", str(tmp_path), "--body", "fish"]) == 2
    assert "expected human or quadruped, found 'fish'" in capsys.readouterr().err


def test_evaluate_prints_a_table_or_json(tmp_path, capsys):
    args = ["evaluate", "human-npt", "-m", "copy", "--pairs", "1"]
    assert run(args) == 0
    assert "copy" in capsys.readouterr().out
    assert run([*args, "--json", "-o", str(tmp_path / "x.json")]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert set(printed) == {"protocol", "version", "metrics", "provenance", "sets", "left_out", "results"}
    assert printed["results"] == json.loads((tmp_path / "x.json").read_text())["results"]


@pytest.mark.parametrize("args", [["train", "npt"], ["export", "x.safetensors", "-o", "x.onnx"]])
def test_missing_extra_is_refused_with_the_install_command(args, capsys, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert run(args) == 2
    assert "pip install 'mimesh[train]'" in capsys.readouterr().err


@pytest.mark.parametrize("args", [["nonsense"], ["look", "a.obj", "--wrong"], ["render", "a.obj"]])
def test_wrong_usage_is_one_line(args, capsys):
    assert run(args) == 2
    text = capsys.readouterr()
    assert text.out == ""
    assert text.err.startswith("mimesh: ")
    assert len(text.err.splitlines()) == 1
    assert "--help" in text.err


def test_bug_is_reported_as_one(files, capsys, monkeypatch):
    def broken(path):
        raise RuntimeError("no luck")

    monkeypatch.setattr("mimesh.tools.inspect.inspect_file", broken)
    assert run(["look", str(files / "hero.obj")]) == 1
    error = capsys.readouterr().err
    assert "RuntimeError: no luck" in error
    assert "bug of mimesh" in error
    assert len(error.splitlines()) < 15


def test_interrupt_exits_with_130(files, capsys, monkeypatch):
    def stopped(path):
        raise KeyboardInterrupt

    monkeypatch.setattr("mimesh.tools.inspect.inspect_file", stopped)
    assert run(["look", str(files / "hero.obj")]) == 130
    assert capsys.readouterr().err == "mimesh: stopped\n"


def test_closed_pipe_is_no_error(files):
    many = [str(files / "hero.obj")] * 20
    process = subprocess.Popen([MIMESH, "look", *many], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    with process.stderr as errors:
        assert errors.read() == b""
    assert process.wait() == 0


@pytest.mark.slow
def test_wheel_works_in_a_fresh_environment(tmp_path):
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", tmp_path, root], check=True)
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    binaries = tmp_path / "venv" / "bin"
    (wheel,) = tmp_path.glob("mimesh-*.whl")
    subprocess.run([binaries / "pip", "install", "-q", "-c", root / "constraints.txt", wheel], check=True)
    done = subprocess.run([binaries / "mimesh", "doctor"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    subprocess.run([binaries / "mimesh", "demo", "-q"], cwd=tmp_path, check=True)
    assert (tmp_path / "mimesh-demo" / "result.glb").stat().st_size > 1e6
