"""What is printed about usage: help, what is missing, near names, completion, the log, the progress and tables."""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from matrix import matrix
from threadpoolctl import threadpool_info

from mimesh.__main__ import COMMANDS
from mimesh.bodies.engine_names import SCHEMES
from mimesh.commands import about, options, terminal
from mimesh.core.errors import did_you_mean
from mimesh.core.options import Hints, Layout, ModelOptions, values_of
from mimesh.methods.find import MODELS, NETWORK_OF_BODY
from mimesh.methods.onnx_models import PAIRINGS
from mimesh.methods.onnx_runtime import THREADS
from mimesh.pipeline.gltf_rigs import Stance
from mimesh.tools.inspect import UNLIKE

COPIED = "transfer hero.obj pose.obj -m copy --no-preview "
"""A transfer that needs no network."""


def test_no_command_prints_the_help_in_lines(call):
    code, out, err = call("")
    assert (code, out) == (2, "")
    assert err.startswith("Usage: mimesh")
    assert all(f"\n  {command.__name__} " in err for command in COMMANDS)


@pytest.mark.parametrize(
    ("line", "missing"),
    [("transfer", "IDENTITY} and {DRIVING"), ("transfer a", "DRIVING"), ("look", "FILE...")],
)
def test_missing_arguments_are_named_in_one_line_before_the_usage(line, missing, call):
    code, _, err = call(line)
    first, *usage = err.splitlines()
    assert code == 2
    assert missing.replace("{", "").replace("}", "") in first.replace("{", "").replace("}", "")
    assert first.startswith("mimesh: expected ")
    assert usage[0].startswith(f"Usage: mimesh {line.split()[0]} [OPTIONS]")


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("trnasfer a b", "transfer"),
        ("transfer a b --ouput c", "--output"),
        ("transfer a b --no-prview", "--no-preview"),
        ("table npt1", "npt-1"),
        ("evaluate human-npt -m nptt", "npt"),
        (COPIED + "-m anifomer", "aniformer"),
    ],
)
def test_near_names_are_suggested(line, meant, files, call):
    code, _, err = call(line)
    (line,) = err.splitlines()
    assert (code, f"did you mean {meant}?" in line.replace("'", "").replace("Did", "did")) == (2, True)


def test_far_names_are_not_suggested():
    assert did_you_mean("xyz", MODELS) == ""
    assert did_you_mean("MIME", MODELS) == "; did you mean mime?"


def test_values_that_shells_complete_are_those_that_are_checked():
    assert set(terminal.MODELS) == set(MODELS) == set(about.DESCRIPTIONS)
    assert set(values_of(Layout, "names")) == set(SCHEMES)
    assert set(values_of(ModelOptions, "pairing")) == {"auto", *PAIRINGS}
    assert set(values_of(Hints, "body")) == {"auto", "other", *NETWORK_OF_BODY}


def test_names_of_models_and_networks_are_completed(tmp_path, monkeypatch):
    for name in ("net.onnx", ".hidden.onnx", "notes.txt"):
        (tmp_path / name).touch()
    (tmp_path / "nets").mkdir()
    monkeypatch.chdir(tmp_path)
    assert terminal.complete_model("n") == ["npt", "npt-maxpool", "net.onnx", "nets/"]
    assert terminal.complete_model("./net") == ["./net.onnx", "./nets/"]
    assert terminal.complete_model(f"{tmp_path}/.h") == [f"{tmp_path}/.hidden.onnx"]
    assert terminal.complete_model("nowhere/") == []


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("mimesh transfer a b -m np", ["npt", "npt-maxpool"]),
        ("mimesh animate a b --root k", ["keep"]),
        ("mimesh tran", ["transfer"]),
    ],
)
def test_a_shell_gets_completions(words, expected, files, call, monkeypatch):
    monkeypatch.setenv("_MIMESH_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    code, out, _ = call("")
    assert (code, out.split()) == (0, expected)


def test_completion_is_installed_only_when_asked(tmp_path):
    environment = os.environ | {"HOME": str(tmp_path), "SHELL": "/bin/bash"}

    def call(option: str) -> str:
        # The shell is found among the parents of the process; a second command keeps bash there.
        code = f'"{sys.executable}" -c "from mimesh.__main__ import main; main([\'{option}\'])" && true'
        done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, env=environment, check=True)
        return done.stdout

    assert "_MIMESH_COMPLETE" in call("--show-completion")
    assert list(tmp_path.rglob("*")) == []
    call("--install-completion")
    assert ".bash_completions" in (tmp_path / ".bashrc").read_text()


def test_verbose_tells_times_axes_and_method_on_stderr(files, call):
    code, out, err = call(COPIED + "-v")
    lines = err.splitlines()
    assert (code, "info:" in out) == (0, False)
    assert lines[0].startswith("info: times: load ")
    assert any(line.startswith("info: identity: up ") for line in lines)
    assert any(line.startswith("info: driving: up ") for line in lines)
    assert "info: method: copy (given by -m)" in lines
    assert call(COPIED).err == ""
    assert logging.getLogger(options.LOGGER).handlers == []


THREADS_OF = """
import os, sys
from mimesh.__main__ import run
sys.modules["torch"] = None  # takes seconds to load, and is refused as if it were missing
run(sys.argv[1:])
print(*[os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MIMESH_THREADS")])
"""


@matrix(
    ("arguments", "given", "expected"),
    [
        (["look", "x"], {}, "1 1 None"),
        (["look", "x", "--threads", "3"], {"OMP_NUM_THREADS": "2"}, "3 3 3"),
        (["look", "x"], {"OMP_NUM_THREADS": "2"}, "2 None None"),
        (["train", "x"], {}, "None None None"),
    ],
    quick=lambda case: "--threads" in case[0],
)
def test_threads_before_libraries_are_loaded(arguments, given, expected):
    unset = (*options.LINEAR_ALGEBRA, THREADS)
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    command = [sys.executable, "-c", THREADS_OF, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, env=environment | given, check=True)
    assert done.stdout.splitlines()[-1] == expected


def test_threads_of_loaded_libraries_are_set_back(files, call, monkeypatch):
    assert options.NETWORKS == THREADS
    monkeypatch.delenv(THREADS, raising=False)

    def threads() -> list[int]:
        return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]

    before, during = threads(), []
    monkeypatch.setattr("mimesh.pipeline.transfer", lambda *_, **__: during.append((threads(), os.environ[THREADS])))
    assert call(COPIED + "--threads 3").code == 1  # nothing is a result
    assert during == [([3] * len(before), "3")]
    assert (threads(), THREADS in os.environ) == (before, False)


@pytest.mark.parametrize(
    ("axes", "options"),
    [(("+z", "-y"), " --up=+z --front=-y"), (("+y", "+x"), " --up=+y --front=+x"), (("+y", "+z"), ""), (None, "")],
)
def test_look_names_the_axes_to_render_with(files, call, monkeypatch, axes, options):
    stance = axes and Stance(axes, "in some way")
    monkeypatch.setattr("mimesh.tools.inspect._stance", lambda mesh: stance)
    assert call("look hero.obj").out.splitlines()[-1] == f"next: mimesh render hero.obj -o sheet.png{options}"
    facts = json.loads(call("look hero.obj --json").out)["files"][0]
    assert (facts["axes"], facts["stands"]) == ((list(axes), "in some way") if axes else (None, UNLIKE))


def test_pictures_of_files_of_one_name_have_the_names_of_their_folders(files, call):
    for folder in ("knight", "mage"):
        Path("out", folder).mkdir(parents=True)
        shutil.copy("hero.obj", Path("out", folder, "run.obj"))
    printed = call("render out/knight/run.obj out/mage/run.obj hero.obj --sheet -o sheet.png").out
    assert "knight/run.obj, mage/run.obj, hero.obj" in printed.replace("\\", "/")


def test_progress_is_told_in_lines_where_there_is_no_terminal(capsys, monkeypatch):
    monkeypatch.setattr(terminal, "LINE_SECONDS", 0.01)
    with terminal.progress("frames", quiet=False) as advance:
        time.sleep(0.1)
        assert advance is not None
        advance(2, 5)
        time.sleep(0.1)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "frames, 0 s"
    assert lines[-1] == "frames 2/5, 0 s"
    with terminal.progress("frames", quiet=True) as advance:
        time.sleep(0.05)
    assert (advance, capsys.readouterr().err) == (None, "")


TABLE = "Of one test:\n\n| row | figure [e4] |\n|---|---|\n| `copy` of the driving vertices | 1.5 ± 0.2 |\n\nEnd."


def test_a_table_in_a_pipe_is_markdown(capsys):
    terminal.say_tables(TABLE)
    assert capsys.readouterr().out == TABLE + "\n"


@pytest.mark.parametrize("width", [30, 100])
def test_a_table_on_a_terminal_fits_it_and_loses_nothing(width, capsys, monkeypatch):
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", str(width))
    terminal.say_tables(TABLE)
    out = re.sub(r"\x1b\[\d*m", "", capsys.readouterr().out)
    assert max(map(len, out.splitlines())) <= width
    assert "|" not in out
    assert {"Of", "End.", "row", "figure", "[e4]", "copy", "vertices", "1.5", "±", "0.2"} <= set(out.split())
