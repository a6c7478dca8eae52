"""`mimesh studio` as a program: it prints its address, answers requests, and leaves no files."""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from mimesh.cli import run


@pytest.fixture
def program(tmp_path):
    """A running studio, killed after the test."""
    command = [sys.executable, "-m", "mimesh", "studio", "--no-open", "--json"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)
    yield program
    program.kill()
    program.communicate()


def test_interrupt_ends_the_studio_and_leaves_no_files(program, tmp_path):
    address = json.loads(program.stdout.readline())["address"]
    state = f"{address.partition('?')[0]}api/state"
    request = urllib.request.Request(state, headers={"x-mimesh-token": address.partition("token=")[2]})
    with urllib.request.urlopen(request, timeout=20) as answer:
        assert json.load(answer)["identities"] == []
    assert list(tmp_path.glob("mimesh-studio-*"))
    begin = time.monotonic()
    program.send_signal(signal.SIGINT)
    out, errors = program.communicate(timeout=10)
    assert time.monotonic() - begin < 3, "a second on a quiet machine"
    assert program.returncode == 0
    assert (out, errors) == (b"", b"")
    assert list(tmp_path.iterdir()) == []


def test_leftovers_of_a_killed_studio_are_removed(tmp_path):
    from mimesh.studio.uploads import remove_leftovers

    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    names = [f"mimesh-studio-{ended.pid}-x", f"mimesh-studio-{os.getpid()}-x", "mimesh-studio-old", "other-1-x"]
    for name in names:
        (tmp_path / name / "uploads").mkdir(parents=True)
    target = tmp_path / f"mimesh-studio-{ended.pid}-link"
    target.symlink_to(tmp_path / "other-1-x")
    remove_leftovers(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*names[1:], target.name])
    assert (tmp_path / "other-1-x" / "uploads").is_dir()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["missing.glb"], "expected a file or folder"),
        (["--host", "203.0.113.1"], "expected a free port"),
        (["-m", "nothing"], "--model: expected one of"),
    ],
)
def test_wrong_arguments_are_refused(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert run(["studio", "--no-open", *arguments]) == 2
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert words in error


def test_missing_extra_is_refused_with_the_install_command(capsys, monkeypatch):
    import importlib.util

    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "uvicorn" else find(name))
    assert run(["studio"]) == 2
    assert "pip install 'mimesh[viewer]'" in capsys.readouterr().err


def test_files_of_the_command_are_loaded(tmp_path):
    from mimesh.studio import make_session

    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    folder = tmp_path / "walk"
    folder.mkdir()
    for path in (tmp_path / "a.obj", tmp_path / "b.obj", folder / "1.obj", folder / "2.obj"):
        path.write_text(triangle)
    before = {path: path.stat().st_mtime_ns for path in Path(tmp_path).rglob("*")}
    session = make_session([tmp_path / "a.obj", tmp_path / "b.obj", folder], 2**20, "copy")
    assert [item.name for item in session.identities.values()] == ["a.obj", "b.obj"]
    assert session.driving is not None
    assert session.driving.name == "walk"
    session.close()
    assert {path: path.stat().st_mtime_ns for path in Path(tmp_path).rglob("*")} == before
