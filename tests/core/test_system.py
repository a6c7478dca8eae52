"""Systems that lack what Linux has, by stand-ins: no limits, files that cannot be renamed while open."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

import mimesh
from mimesh.core import system
from mimesh.core.errors import InputError
from mimesh.io.atomic import together, whole_file


def busy_replace(failures):
    """Return os.replace as on Windows while another program has the file open for the first calls."""
    calls = []

    def replace(source, target):
        calls.append(target)
        if len(calls) <= failures:
            raise PermissionError(13, "The process cannot access the file")
        os.replace(source, target)

    return replace, calls


def test_an_open_file_is_renamed_once_it_is_closed(tmp_path, monkeypatch):
    replace, calls = busy_replace(2)
    monkeypatch.setattr(system, "os", SimpleNamespace(name="nt", replace=replace))
    (tmp_path / "a").write_text("a")
    system.rename(tmp_path / "a", tmp_path / "b")
    assert (tmp_path / "b").read_text() == "a"
    assert len(calls) == 3


def test_a_file_that_stays_open_is_an_error_and_nothing_appears(tmp_path, monkeypatch):
    replace, calls = busy_replace(10**6)
    monkeypatch.setattr(system, "RENAME_SECONDS", 0.1)
    stand_in = SimpleNamespace(name="nt", replace=replace)
    monkeypatch.setattr(system, "os", stand_in)
    with pytest.raises(InputError, match=r"b\.txt: expected a place to write to, found 'The process cannot"):
        write_together(tmp_path / "b.txt")
    assert len(calls) > 1
    assert list(tmp_path.iterdir()) == []


def write_together(path):
    with together(), whole_file(path) as temporary:
        temporary.write_text("b")


def test_other_systems_do_not_wait_for_permission(tmp_path, monkeypatch):
    replace, calls = busy_replace(10**6)
    monkeypatch.setattr(system, "os", SimpleNamespace(name="posix", replace=replace))
    with pytest.raises(PermissionError):
        system.rename(tmp_path / "a", tmp_path / "b")
    assert len(calls) == 1


def test_without_limits_a_child_is_not_limited(monkeypatch):
    monkeypatch.setitem(sys.modules, "resource", None)
    system.limit_process(1, 1)  # on Linux nothing could be done after this
    system.limit_processor_time(0)
    assert len(bytearray(2**20)) == 2**20


@pytest.mark.skipif(os.name == "nt", reason="Windows has no limits")
def test_limits_hold_in_a_child():
    code = "from mimesh.core.system import limit_process; limit_process(2**29, 2**20); bytearray(2**30)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)
    assert b"MemoryError" in done.stderr or sys.platform == "darwin"


def test_cores_without_an_affinity(monkeypatch):
    monkeypatch.setattr(system, "os", SimpleNamespace(cpu_count=lambda: 7))
    assert system.usable_cores() == 7


def test_memory_without_proc(monkeypatch):
    class NoFile:
        def __init__(self, _):
            pass

        def exists(self):
            return False

    monkeypatch.setattr(system, "Path", NoFile)
    assert system.resident_memory() is None


def test_texts_are_written_alike_on_all_systems():
    """Without these two, Windows writes other line ends and the encoding of the user's language."""
    source = Path(mimesh.__file__).parent
    calls = [
        (path.name, node)
        for path in source.rglob("*.py")
        if path.name != "blender_export.py"  # runs in Blender
        if ".write_text" in (text := path.read_text(encoding="utf-8"))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "write_text"
    ]
    assert len(calls) > 5
    assert [name for name, call in calls if {"encoding", "newline"} - {word.arg for word in call.keywords}] == []


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="this system does not block signals")
def test_ctrl_c_does_not_reach_processes_started_while_it_is_held():
    program = "import os, signal; os.kill(os.getpid(), signal.SIGINT); print('alive')"
    with system.ctrl_c_held():
        held = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert held.stdout == "alive\n"
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
