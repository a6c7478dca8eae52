"""A native decoder that crashes, loops or allocates ends its child process, and the caller gets one line."""

import os
import signal
import subprocess
import sys
import tempfile
import time

import pytest

from mimesh.core.budgets import no_limits
from mimesh.core.errors import LONGEST_MESSAGE, InputError
from mimesh.io.child_process import MIB, Limits, child_result, watched

LIMITS = Limits(1024 * MIB, 4 * MIB, 20, 30.0)
DECODERS = """
import ctypes, json, os, sys, time
from mimesh.core.budgets import check_clip_size
from mimesh.core.errors import InputError

def copy(source, target, times=1):
    target.write_bytes(source.read_bytes() * times)

def crash(source, target):
    ctypes.string_at(0)

def loop(source, target):
    while True:
        pass

def sleep(source, target):
    time.sleep(600)

def allocate(source, target):
    malloc = ctypes.CDLL(None).malloc
    malloc.restype = ctypes.c_void_p
    while malloc(ctypes.c_size_t(2**26)):
        pass
    raise MemoryError

def fill(source, target):
    with target.open("wb") as file:
        while True:
            file.write(bytes(2**20))

def write(source, target, size):
    check_clip_size(1, size, source)
    target.write_bytes(bytes(size))

def nothing(source, target):
    pass

def refuse(source, target):
    raise InputError(f"{source}: expected bread, found stone; bake it again")

def fail(source, target):
    raise KeyError("two\\nlines")

def count(source, target, progress, seconds):
    for number in range(1, 4):
        end = time.process_time() + seconds
        while time.process_time() < end:
            pass
        progress(number, 3)
    target.write_bytes(b"done")

def babble(source, target):
    raise InputError(f"{source}: expected bread, found {'stone' * 10**6}; bake it\\nagain")

def wait(source, target):
    (source.parent / "writing").write_text(str(os.getpid()))
    (source.parent / "writing").rename(source.parent / "number")
    time.sleep(600)

def environment(source, target):
    target.write_text(json.dumps([dict(os.environ), sys.stdin.read()]))
"""


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run one of DECODERS on a file of two bytes and return the bytes of its result."""
    (tmp_path / "test_decoders.py").write_text(DECODERS)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    (tmp_path / "a.xyz").write_bytes(b"ab")

    def call(name, limits=LIMITS, progress=None, **arguments):
        path = tmp_path / "a.xyz"
        with child_result(f"test_decoders:{name}", path, path, limits, progress, **arguments) as result:
            return result.read_bytes()

    return call


def message_of(run, *arguments, **options):
    with pytest.raises(InputError) as caught:
        run(*arguments, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_result_is_a_file_that_is_deleted_afterwards(run, tmp_path):
    assert run("copy", times=3) == b"ababab"
    assert [path.name for path in (tmp_path / "tmp").iterdir()] == []


def test_crash_is_an_input_error(run):
    assert "a.xyz: expected a file that can be read, found that its decoder crashed" in message_of(run, "crash")


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGXCPU"), reason="a system without limits on processor time")
def test_endless_loop_is_ended_by_processor_time(run):
    limits = Limits(LIMITS.memory, LIMITS.output, 1, 60.0)
    start = time.monotonic()
    assert "found that its decoder does not end" in message_of(run, "loop", limits)
    assert time.monotonic() - start < 30


@pytest.mark.slow
def test_waiting_is_ended_by_the_clock(run):
    assert "found that its decoder does not end" in message_of(run, "sleep", Limits(LIMITS.memory, MIB, 20, 1.0))


@pytest.mark.skipif(sys.platform != "linux", reason="a system without a limit on memory")
def test_memory_is_limited(run):
    assert "needs more than 1,024 MiB of memory" in message_of(run, "allocate")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a system without a limit on file sizes")
def test_output_is_limited(run):
    assert "4 MiB" in message_of(run, "fill")


def test_lifted_budgets_hold_in_the_child_and_lift_its_limits(run):
    size = 12_000_000
    assert "expected at most 10,000,000 vertices" in message_of(run, "write", size=size)
    with no_limits():
        assert len(run("write", size=size)) == size > LIMITS.output


@pytest.mark.slow
def test_missing_result_is_an_input_error(run):
    assert "found 0 bytes" in message_of(run, "nothing")


def test_input_error_of_the_child_is_that_of_the_caller(run, tmp_path):
    assert message_of(run, "refuse") == f"{tmp_path / 'a.xyz'}: expected bread, found stone; bake it again"


def test_other_exceptions_become_one_line(run):
    assert "KeyError" in message_of(run, "fail")


def test_child_gets_neither_environment_nor_input(run, monkeypatch):
    import json

    monkeypatch.setenv("SECRET", "x")
    variables, typed = json.loads(run("environment"))
    assert typed == ""
    assert set(variables) <= {
        "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "SYSTEMROOT", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS", "PXR_WORK_THREAD_LIMIT", "USDC_USE_PREAD",
        "TMPDIR", "TEMP", "TMP", "LC_CTYPE", "__CF_USER_TEXT_ENCODING",
    }  # fmt: skip


@pytest.mark.skipif(not os.path.isdir("/proc"), reason="a system without /proc")
def test_interrupted_caller_leaves_no_child(run, monkeypatch):
    started = []

    class Interrupted(subprocess.Popen):
        def wait(self, timeout=None):
            if timeout is not None:
                started.append(self.pid)
                raise KeyboardInterrupt
            return super().wait()

    monkeypatch.setattr(subprocess, "Popen", Interrupted)
    with pytest.raises(KeyboardInterrupt):
        run("sleep")
    assert not os.path.isdir(f"/proc/{started[0]}")


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGXCPU"), reason="a system without limits on processor time")
def test_each_report_starts_the_limit_of_time_again(run):
    calls = []
    limits = Limits(LIMITS.memory, LIMITS.output, 1, 60.0)
    assert run("count", limits, lambda done, total: calls.append((done, total)), seconds=0.6) == b"done"
    assert calls[-1] == (3, 3)
    assert "does not end" in message_of(run, "count", limits, lambda done, total: None, seconds=20)


@pytest.mark.slow
def test_long_message_keeps_its_end_and_the_name_of_the_file(run, tmp_path):
    message = message_of(run, "babble")
    assert message.startswith(f"{tmp_path / 'a.xyz'}: expected bread")
    assert message.endswith("bake it again")
    assert len(message) < 2 * LONGEST_MESSAGE


class Unwanted(Exception):
    pass


def is_running(number):
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.skipif(sys.platform == "win32", reason="processes are tested for with a signal")
def test_child_that_is_no_longer_wanted_ends_at_once(run, tmp_path):
    asked = []

    def check():
        if (tmp_path / "number").exists():
            asked.append(time.monotonic())
            raise Unwanted

    with pytest.raises(Unwanted), watched(check):
        run("wait")
    assert time.monotonic() - asked[0] < 2
    assert not is_running(int((tmp_path / "number").read_text()))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a child with its parent")
def test_child_of_a_killed_parent_ends(run, tmp_path):
    program = f"""
import sys
from pathlib import Path
from mimesh.io.child_process import child_result
sys.path.insert(0, {str(tmp_path)!r})
path = Path({str(tmp_path / "a.xyz")!r})
with child_result("test_decoders:wait", path, path):
    pass
"""
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    parent = subprocess.Popen([sys.executable, "-c", program], env=environment)
    try:
        wait_for((tmp_path / "number").exists)
    finally:
        parent.kill()
        parent.wait()
    child = int((tmp_path / "number").read_text())
    wait_for(lambda: not is_running(child))


def wait_for(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)
