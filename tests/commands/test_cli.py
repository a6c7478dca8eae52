"""The `mimesh` command on good input: files, output and exit codes."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import time
import zipfile
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest
import zoo

import mimesh
from mimesh.__main__ import COMMANDS, command_line, run
from mimesh.core.mesh import Clip, Material, Part
from mimesh.io import load_clip, load_mesh, save_clip, save_mesh
from mimesh.methods.find import MODELS
from mimesh.tools.demo import inputs

MIMESH = Path(sys.executable).with_name("mimesh")
TRANSFER = "transfer hero.obj pose.ply -m copy "
ANIMATE = "animate hero.obj walk -m copy --fps 10 "


def test_help_names_every_command_and_imports_nothing_heavy():
    script = (
        "import sys; from mimesh.__main__ import run; run(['--help']);"
        "heavy = {'numpy', 'scipy', 'PIL', 'torch', 'onnxruntime', 'rich', 'jaxtyping'} & set(sys.modules);"
        "sys.exit(f'loaded {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all(command.__name__ in done.stdout for command in COMMANDS)


def test_every_command_has_help_and_json(call):
    for name, command in command_line().commands.items():
        assert command.help, name
        assert any("--json" in parameter.opts for parameter in command.params), name
    assert "--json" in call("look --help").out


def test_every_test_set_is_in_the_help():
    from mimesh.commands.measure import PROTOCOLS
    from mimesh.evaluate.run import FOLDERS, WITHOUT_FOLDER

    assert set(PROTOCOLS.replace(" or ", ", ").split(", ")) == {*WITHOUT_FOLDER, *FOLDERS}


def test_version(call):
    assert call("--version").out == f"mimesh {mimesh.__version__}\n"


def test_transfer_prints_its_output_and_the_next_command(files, call):
    code, out, err = call(TRANSFER)
    assert (code, err) == (0, "")
    assert "hero-pose.obj: 8 vertices" in out
    assert "next: open hero-pose.preview.html in a browser" in out
    expected = mimesh.transfer("hero.obj", "pose.ply", "copy")
    np.testing.assert_allclose(load_mesh("hero-pose.obj").vertices, expected.vertices, atol=1e-6)
    assert Path("hero-pose.preview.png").stat().st_size > 1000
    # An output of another format has previews of its own.
    assert call(TRANSFER + "-o hero-pose.ply -q") == (0, "", "")
    assert {"hero-pose.preview.png", "hero-pose.ply.preview.html"} <= {path.name for path in files.iterdir()}


def test_transfer_json_is_one_object_with_the_documented_keys(files, call):
    code, out, _ = call(TRANSFER + "--no-preview --json")
    assert (code, len(out.splitlines())) == (0, 1)
    facts = json.loads(out)
    assert set(facts) == {"output", "replaced", "model", "vertices", "frames", "fps", "seconds", "report"}
    assert set(facts["seconds"]) == {"load", "prepare", "drive", "refine", "write"}
    assert (facts["output"], facts["replaced"]) == ("hero-pose.obj", False)
    assert (facts["model"], facts["vertices"], facts["frames"], facts["fps"]) == ("copy", 8, 1, None)
    assert facts["report"]["pictures"] == []
    assert not list(files.glob("*.preview.*"))


@pytest.mark.parametrize(
    ("line", "output"), [(TRANSFER, "hero-pose.obj"), (ANIMATE + "-o frames", "frames")], ids=["file", "folder"]
)
def test_a_second_run_says_that_it_replaced_the_file_of_the_first(line, output, files, call):
    assert "replaced" not in call(line + " --no-preview").out
    assert f"{output} (replaced): 8 vertices" in call(line + " --no-preview").out


def test_animate_writes_a_glb_a_picture_and_a_page(files, call):
    code, out, err = call(ANIMATE)
    assert (code, err) == (0, "")
    assert "3 frames at 10 per second" in out
    assert len(load_clip("hero-walk.glb")) == 3
    assert "mimesh-scene" in Path("hero-walk.preview.html").read_text()
    assert Path("hero-walk.preview.png").exists()


def test_animate_takes_a_range_and_writes_folders(files, call):
    facts = json.loads(call(ANIMATE + "--start 1 --fps 24 -o moved --no-preview --json").out)
    assert (facts["frames"], facts["fps"]) == (2, 24)
    assert len(load_clip("moved")) == 2


def test_open_opens_the_page_in_the_browser(files, call, monkeypatch):
    opened = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or len(opened) == 1)
    assert call(TRANSFER + "-q --open") == (0, "", "")
    assert opened == [(files / "hero-pose.preview.html").as_uri()]
    assert "no browser was found" in call(TRANSFER + "-q --open").err


def test_render_writes_a_page_of_any_files(files, call):
    assert call("render hero.obj walk -o both.html").code == 0
    assert '"role":"mesh"' in Path("both.html").read_text()
    assert call("render hero.obj --truth hero.obj -o both.html").code == 0
    assert '"role":"truth"' in Path("both.html").read_text()


@pytest.mark.parametrize(
    ("line", "name"),
    [
        (TRANSFER + "-o hero.obj", "hero.obj"),
        (TRANSFER + "-o pose.ply", "pose.ply"),
        (TRANSFER + "-o link.obj", "link.obj"),
        *((f"{ANIMATE} -o {name}", "walk/000.obj") for name in ("walk", "walk/000.obj", "walk/new")),
        ("transfer hero.obj pose.ply -m deformation-transfer --reference x.obj -o x.obj", "x.obj"),
        ("transfer hero.obj pose.ply -m deformation-transfer --markers x.preview.html -o x.obj", "x.preview.html"),
    ],
)
def test_inputs_are_not_overwritten(line, name, files, refuses):
    Path("link.obj").hardlink_to("hero.obj")
    for given in ("x.obj", "x.preview.html"):
        Path(given).write_text("0 0\n")
    before, names = Path(name).read_bytes(), sorted(files.rglob("*"))
    refuses(line, "apart from the inputs")
    assert (Path(name).read_bytes(), sorted(files.rglob("*"))) == (before, names)


@pytest.mark.parametrize("words", [["animate", "hero.obj", ""], [*TRANSFER.split(), "-o", " "]])
def test_empty_paths_are_refused(words, files, capsys):
    assert run(words) == 2
    assert "expected a path, found an empty text" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="file names are text on other systems")
def test_file_names_that_are_no_text_are_printed_escaped(files):
    odd = os.fsdecode(b"p\xe9.ply")
    Path("pose.ply").rename(odd)
    command = [MIMESH, "transfer", "hero.obj", odd, "-m", "copy", "--no-preview"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "p\\udce9" in done.stdout


def test_look_prints_text_and_json_and_the_good_files_beside_a_bad_one(files, call):
    hero, walk = json.loads(call("look hero.obj walk --json").out)["files"]
    assert (hero["vertices"], hero["frames"], walk["frames"]) == (8, 1, 3)
    Path("bad.obj").touch()
    code, out, err = call("look bad.obj hero.obj walk")
    assert (code, "hero.obj" in out, "walk" in out) == (2, True, True)
    assert "bad.obj: expected a mesh, found an empty file" in err


def test_models_lists_all_models(call):
    assert [m["name"] for m in json.loads(call("models --json").out)["models"]] == [*MODELS, "mime-quadruped"]
    out = call("models").out
    assert all(name in out for name in MODELS)
    assert "\\n" not in out


def test_doctor_lists_what_is_optional_and_a_failed_check(call, monkeypatch):
    def version(package):
        if package in ("ufbx", "DracoPy", "av"):
            raise metadata.PackageNotFoundError(package)
        return "1.0"

    monkeypatch.setattr("mimesh.tools.doctor.metadata.version", version)
    monkeypatch.setattr("mimesh.tools.doctor._networks", lambda: "skipped")
    monkeypatch.setattr("mimesh.tools.doctor._transfer", lambda: 1 / 0)
    monkeypatch.setenv("BLENDER", "nowhere")
    code, out, _ = call("doctor --json")
    found = {check["name"]: check["found"] for check in json.loads(out)["checks"]}
    assert (code, found["self check"]) == (1, "ZeroDivisionError: division by zero")
    assert found["ufbx"] == "not installed (pip install 'mimesh[fbx]' to read FBX)"
    assert found["DracoPy"] == "not installed (pip install 'mimesh[compressed]' for Draco and meshopt glTF)"
    assert found["usd-core"] == "1.0"
    assert "mimesh[video]" in found["av"]
    assert "blender" in found
    lines = call("doctor").out.splitlines()
    assert any(line.startswith("FAIL  self check          ZeroDivisionError") for line in lines)
    assert any(line.startswith("-     ufbx ") for line in lines)
    assert any(line.startswith("ok    usd-core ") for line in lines)


@pytest.mark.slow
def test_demo_writes_its_files(files, call, monkeypatch):
    monkeypatch.setattr("mimesh.tools.demo.FRAMES", 2)
    facts = json.loads(call("demo -o demo --json").out)
    assert (facts["frames"], facts["motion"], facts["report"]["body"]) == (2, "jump", "human")
    names = {"identity.obj", "driving.obj", "driving.glb", "result.glb", "preview.png", "player.html"}
    assert {path.name for path in Path("demo").iterdir() if path.suffix != ".mtl"} == names
    assert load_mesh("demo/result.glb").faces.shape == load_mesh("demo/identity.obj").faces.shape


def test_the_demo_has_animals():
    cow, gallop = inputs("quadruped")
    assert (cow.name, gallop.mesh.name) == ("cow", "horse-gallop")


def test_evaluate_prints_a_table_and_json(files, call):
    code, out, _ = call("evaluate human-npt -m copy --pairs 1 -o x.json")
    assert (code, "copy" in out) == (0, True)
    printed = json.loads(call("evaluate human-npt -m copy --pairs 1 -o x.json --json").out)  # what was measured is kept
    assert set(printed) == {"protocol", "version", "metrics", "provenance", "sets", "left_out", "results"}
    assert printed["results"] == json.loads(Path("x.json").read_text())["results"]


@pytest.mark.parametrize(
    ("line", "extra"), [("train npt", "train"), ("export x.safetensors -o x.onnx", "train"), ("studio", "viewer")]
)
def test_missing_extra_is_refused_with_the_install_command(line, extra, refuses, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    refuses(line, f"pip install 'mimesh[{extra}]'")


@pytest.mark.parametrize("error", [RuntimeError("no luck \x1b[31m"), KeyboardInterrupt()], ids=["bug", "interrupt"])
def test_bugs_are_reported_and_an_interrupt_exits_with_130(error, files, call, monkeypatch):
    def broken(path):
        raise error

    monkeypatch.setattr("mimesh.tools.inspect.inspect_file", broken)
    code, _, err = call("look hero.obj")
    if isinstance(error, KeyboardInterrupt):
        assert (code, err) == (130, "mimesh: stopped\n")
        return
    assert code == 1
    assert "RuntimeError: no luck \\x1b[31m\n" in err
    assert "bug of mimesh" in err
    assert len(err.splitlines()) < 15


@pytest.mark.slow
def test_closed_pipe_is_no_error():
    process = subprocess.Popen([MIMESH, "models"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    with process.stderr as errors:
        assert errors.read() == b""
    assert process.wait() == 0


@pytest.fixture
def painted(files):
    """hero.glb, with a material, and posed.obj, which has its vertices in a pose."""
    red = Part("all", 0, 12, Material("red", (1.0, 0.0, 0.0, 1.0)))
    save_mesh(dataclasses.replace(zoo.cube(), parts=(red,)), "hero.glb")
    hero = load_mesh("hero.glb")
    save_mesh(mimesh.Mesh(hero.vertices * [1, 2, 1], hero.faces), "posed.obj")
    return "transfer hero.glb posed.obj -m copy --no-preview --json -o "


def test_existing_material_library_is_not_overwritten(painted, call):
    Path("out.mtl").write_text("newmtl mine\n")
    for _ in range(2):  # our own file may be overwritten
        assert call(painted + "out.obj").code == 0
        assert Path("out.mtl").read_text() == "newmtl mine\n"
        assert "mtllib out-2.mtl" in Path("out.obj").read_text()
        assert sorted(path.name for path in Path().glob("*.mtl")) == ["out-2.mtl", "out.mtl"]


@pytest.mark.parametrize(("suffix", "noted"), [(".npz", True), (".stl", True), (".glb", False)])
def test_what_a_format_cannot_hold_is_noted(painted, suffix, noted, call):
    notes = json.loads(call(f"{painted} out{suffix}").out)["report"]["notes"]
    assert any("materials" in note and f"left out of out{suffix}" in note for note in notes) == noted


def test_no_next_command_after_a_movie(files, call):
    code, out, _ = call("convert pose.obj pose.gif")
    assert (code, "next:" in out) == (0, False)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
def test_terminated_run_leaves_no_partial_file(files):
    save_clip(Clip(zoo.cube(), np.repeat(zoo.cube().vertices[None], 2000, axis=0)), "long.npz")
    out = files / "out"
    command = [sys.executable, "-m", "mimesh", "convert", "long.npz", str(out / "frames"), "-q"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE)
    while process.poll() is None and not (out.is_dir() and list(out.iterdir())):
        time.sleep(0.001)
    process.terminate()
    _, error = process.communicate(timeout=60)
    assert (process.returncode, error.decode().strip()) == (130, "mimesh: stopped")
    assert not list(out.iterdir())


@pytest.mark.slow
def test_wheel_has_all_files_and_works_without_the_checkout(tmp_path):
    """In this environment: `make release` installs it with what it needs into an empty one."""
    root = Path(__file__).parents[2]
    subprocess.run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", tmp_path, root], check=True)
    (wheel,) = tmp_path.glob("mimesh-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "installed")
    listed = subprocess.run(["git", "ls-files", "src"], cwd=root, capture_output=True, text=True, check=True).stdout
    files = [Path(name).relative_to("src") for name in listed.splitlines() if (root / name).is_file()]
    assert [name for name in files if not (tmp_path / "installed" / name).is_file()] == []
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "installed")}
    where = [sys.executable, "-c", "import mimesh; print(mimesh.__file__)"]
    doctor = [sys.executable, "-m", "mimesh", "doctor", "--json"]
    found, facts = (
        subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True).stdout
        for command in (where, doctor)
    )
    assert Path(found.strip()).is_relative_to(tmp_path)
    assert json.loads(facts)["ok"], facts
    assert {check["name"] for check in json.loads(facts)["checks"]} >= {"shipped body", "shipped networks"}
