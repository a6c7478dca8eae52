"""`mimesh studio` as a program: it prints its address, answers requests, and leaves no files."""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request

import pytest

from mimesh.studio import make_session


@pytest.fixture
def program(tmp_path):
    """A running studio, killed after the test."""
    command = [sys.executable, "-m", "mimesh", "studio", "--no-open", "--json"]
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)
    yield program
    program.kill()
    program.communicate()


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("missing.glb", "expected a file or folder"),
        ("--host 203.0.113.1", "expected a free port"),
        ("-m nothing", "--model: expected one of"),
    ],
)
def test_wrong_arguments_are_refused(line, words, call, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    code, _, err = call(f"studio --no-open {line}")
    assert (code, words in err.splitlines()[-1]) == (2, True)


def test_files_of_the_command_are_loaded(files):
    before = {path: path.stat().st_mtime_ns for path in files.rglob("*")}
    session = make_session([files / "hero.obj", files / "pose.ply", files / "walk"], 2**20, "copy")
    assert [item.name for item in session.identities.values()] == ["hero.obj", "pose.ply"]
    assert session.driving is not None
    assert session.driving.name == "walk"
    session.close()
    assert {path: path.stat().st_mtime_ns for path in files.rglob("*")} == before
