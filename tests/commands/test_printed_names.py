"""Names in files reach neither the terminal nor a written file of text with their control characters."""

from __future__ import annotations

import ast
import csv
import dataclasses
import io
import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import zoo

import mimesh
from mimesh.__main__ import run
from mimesh.commands.terminal import progress
from mimesh.core.mesh import Material, Part
from mimesh.core.printable import plain, printable
from mimesh.io import load_mesh, save_mesh
from mimesh.jobs.command import print_summary
from mimesh.jobs.run import BatchResult
from mimesh.jobs.table import BatchJob

NAME = "a\x1b]0;owned\x07\u202eb\n  looks         fine\r\x9b2J\u2066\x00"
"""Sets the title of a terminal, reverses text, adds a line, goes back to its begin, and clears the screen."""
BAD = set("\x1b\x07\u202e\r\x9b\u2066\x00\x85\u2028")
SOURCE = Path(mimesh.__file__).parent


@pytest.fixture
def hostile(tmp_path):
    """A .glb whose part and material have NAME."""
    cube = dataclasses.replace(zoo.cube(), name=NAME, parts=(Part(NAME, 0, 12, Material(NAME, (1.0, 0.0, 0.0, 1.0))),))
    save_mesh(cube, tmp_path / "cube.glb")
    return tmp_path / "cube.glb"


def test_all_lines_escape_names(hostile, call, monkeypatch):
    monkeypatch.chdir(hostile.parent)
    code, out, _ = call("look cube.glb")
    assert code == 0
    assert not BAD & set(out)
    assert "a\\x1b]0;owned\\x07\\u202eb\\n  looks" in out
    assert "\n  looks         fine" not in out
    assert "no\\x1b[31m\\u202efile.obj: expected" in call("look no\x1b[31m\u202efile.obj").err
    assert not BAD & set(call("render --size \x1b[31m a.obj -o b.png").err)  # an error of usage
    hostile.rename("h\x1bo\u202e.glb")
    code, out, err = call("convert h\x1bo\u202e.glb h\x1b.stl")
    assert (code, BAD & set(out + err)) == (0, set())
    assert "next: mimesh look" in out


def test_commands_that_are_printed_are_quoted_for_a_shell(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("a [1]").mkdir()
    save_mesh(zoo.cube(), "a [1]/b c.obj")
    assert run(["transfer", "a [1]/b c.obj", "a [1]/b c.obj", "-m", "copy", "-o", "a [1]/d e.obj"]) == 0
    assert shlex.split(capsys.readouterr().out.splitlines()[-1])[:3] == ["next:", "open", "a [1]/d e.preview.html"]
    assert run(["convert", "a [1]/b c.obj", "a [1]/f.vrma"]) == 2
    assert "mimesh animate CHARACTER 'b c.obj' -o f.vrma" in capsys.readouterr().err
    folder = tmp_path / "a [1]"
    files = {kind: folder / f"batch.{kind}" for kind in ("csv", "json")}
    print_summary(BatchResult([], [], 1.0, 1, files), quiet=False)
    assert shlex.split(capsys.readouterr().out.splitlines()[-1]) == ["next:", "open", str(files["csv"])]


@pytest.mark.parametrize("title", ["{0}", "{task.nothing}", "[red]x[/nothing]", "\x1b]0;t\x07"])
def test_progress_shows_a_name_as_it_is(title, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    monkeypatch.setenv("TERM", "xterm")
    with progress(f"frames of {title}", False) as advance:
        assert advance is not None
        advance(1, 2)
    assert "\x1b]0;" not in terminal.getvalue()
    assert f"frames of {printable(title)}"[:12] in terminal.getvalue()


def test_obj_and_mtl_have_plain_names_that_belong_together(hostile):
    assert run(["convert", str(hostile), str(hostile.with_name("o\x1b\u202eut.obj")), "-q"]) == 0
    written = [path for path in hostile.parent.iterdir() if path.suffix in (".obj", ".mtl")]
    for path in written:
        assert not BAD & set(path.read_text())
    [obj] = [path for path in written if path.suffix == ".obj"]
    [part] = load_mesh(obj).parts
    assert part.material is not None
    assert part.material.base_color[0] == 1.0  # found in the library


@pytest.mark.parametrize("name", ["back\\", "\ud800", "C:\\x\\"])
def test_names_that_would_break_an_obj(name, tmp_path):
    mesh = dataclasses.replace(zoo.cube(), parts=(Part(name, 0, 12, Material(name, (0.0, 1.0, 0.0, 1.0))),))
    save_mesh(mesh, tmp_path / "a.obj")
    again = load_mesh(tmp_path / "a.obj")
    assert len(again.faces) == 12
    assert again.parts[0].material.base_color[1] == 1.0


def test_the_table_of_a_batch_has_escaped_text(tmp_path):
    job = BatchJob("jobs.csv:3", "transfer", f"{NAME}.obj", "b.obj", "out.obj")
    files = {kind: tmp_path / f"a.{kind}" for kind in ("csv", "json")}
    BatchResult([job], [{"state": "failed", "error": NAME, "notes": [NAME]}], 1.0, 1, files).save()
    text = (tmp_path / "a.csv").read_text(encoding="utf-8")
    assert not (BAD - {"\r"}) & set(text)
    [row] = csv.DictReader(text.splitlines())
    assert row["error"] == row["notes"] == printable(NAME)
    assert json.loads((tmp_path / "a.json").read_text())["each"][0]["error"] == NAME


def test_every_text_for_a_terminal_goes_through_say():
    allowed = {"core/printable.py", "io/child_process.py"}  # to a file
    found = set()
    for path in SOURCE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        calls = (node for node in ast.walk(ast.parse(text if "print" in text else "")) if isinstance(node, ast.Call))
        if any(isinstance(call.func, ast.Name) and call.func.id == "print" for call in calls):
            found.add(path.relative_to(SOURCE).as_posix())
    assert found == allowed


def test_plain_names_keep_their_length_and_other_scripts():
    assert plain("Ärmel 袖\x1b") == "Ärmel 袖_"


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="a pipe for stdout")
def test_a_narrow_encoding_of_stdout_prints_escapes(hostile):
    environment = {**os.environ, "PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0"}
    command = [sys.executable, "-m", "mimesh", "convert", str(hostile), str(hostile.with_name("h袖.stl"))]
    done = subprocess.run(command, env=environment, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert b"h\\u8896.stl" in done.stdout
