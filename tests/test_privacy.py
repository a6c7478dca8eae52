"""Nothing leaves the machine: no telemetry, no connection, no file but those that docs/systems.md names."""

from __future__ import annotations

import ipaddress
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import httpx2
import pytest
from people import person, walk
from waiting import wait_until

from mimesh.io import save_clip, save_mesh
from mimesh.methods.onnx_runtime import SWITCH, import_onnxruntime

FILE_CALLS = ("open", "openat", "openat2", "creat", "mknod", "mknodat", "mkdir", "mkdirat", "truncate")
"""System calls that write to their first path."""
MOVING_CALLS = ("rename", "renameat", "renameat2", "link", "linkat", "symlink", "symlinkat")
"""System calls that write to their last path."""
WRITING = re.compile(r"O_(WRONLY|RDWR|CREAT|TRUNC|APPEND|TMPFILE)")
# io_uring can read, write and connect without any of the other calls. "?" allows for architectures that lack a call.
TRACED = "network," + ",".join(f"?{name}" for name in (*FILE_CALLS, *MOVING_CALLS, "io_uring_setup"))
STRACE = ("strace", "--follow-forks", "--seccomp-bpf", "--decode-fds=path", "-qq", "-e", f"trace={TRACED}")

CALL = re.compile(r"^\d+ +(?P<name>\w+)\((?P<arguments>.*)$")
PATH = re.compile(r'(?:<(?P<folder>[^>]*)>(?:\(deleted\))?, )?"(?P<name>(?:[^"\\]|\\.)*)"')
"""A path argument, with the folder that it is relative to if the call takes one."""
ADDRESS = re.compile(r'inet_addr\("([^"]+)"\)|inet_pton\(AF_INET6, "([^"]+)"')


@dataclass
class Trace:
    """System calls of a command and of all processes that it started."""

    calls: list[str] = field(default_factory=list)
    """Network calls as strace prints them, io_uring among them."""
    written: list[Path] = field(default_factory=list)
    """Paths that were created, opened for writing, or renamed or linked to, attempts that failed included."""
    addresses: set[str] = field(default_factory=set)
    """IP addresses in any call, also those that the system filled in."""

    def outside(self, *folders: Path) -> list[Path]:
        """Return the written paths outside of these folders, except Python's bytecode and /dev/null."""
        inside = (path for path in self.written if any(path.is_relative_to(folder) for folder in folders))
        bytecode = (path for path in self.written if "__pycache__" in path.parts)
        return sorted({*self.written} - {*inside, *bytecode, Path("/dev/null")})

    def names(self) -> set[str]:
        """Return the names of the network calls."""
        return {call.partition("(")[0] for call in self.calls}

    def foreign(self) -> set[str]:
        """Return the addresses that are not loopback addresses."""
        return {address for address in self.addresses if not ipaddress.ip_address(address).is_loopback}


def require_strace() -> None:
    """Skip the test, with strace's message, if strace is missing or not permitted."""
    if shutil.which("strace") is None:
        pytest.skip("strace is not installed")
    probe = subprocess.run([*STRACE, "-o", os.devnull, "true"], capture_output=True, text=True)
    if probe.returncode:
        pytest.skip(f"strace cannot trace here: {probe.stderr.strip() or 'no reason given'}")


def traced(command: list[str], output: Path) -> list[str]:
    """Return the command line that runs `command` and writes its trace to `output`."""
    return [*STRACE, "-o", str(output), *command]


def read_trace(output: Path, folder: Path) -> Trace:
    """Parse a trace of a command that ran in `folder`."""
    text, trace = output.read_text(errors="replace"), Trace()
    trace.addresses = {ipv4 or ipv6 for ipv4, ipv6 in ADDRESS.findall(text)}
    for line in text.splitlines():
        found = CALL.match(line)
        if found is None:  # a signal, or the second half of a call whose arguments were printed before
            continue
        name, arguments = found["name"], found["arguments"]
        if name not in FILE_CALLS + MOVING_CALLS:
            trace.calls.append(f"{name}({arguments}")
        elif not name.startswith("open") or WRITING.search(arguments):
            paths = [folder / (path["folder"] or "") / path["name"] for path in PATH.finditer(arguments)]
            trace.written.append(Path(os.path.normpath(paths[0 if name in FILE_CALLS else -1])))
    return trace


SECONDS = 120
"""Limit of a traced command, far above what it takes on a busy machine."""
IDLE = 9
"""Seconds that the studio is left running: onnxruntime 1.31.1 asks a name server 8.8 s after its import."""
KEPT = ("PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "OMP_NUM_THREADS")
"""Environment variables that traced programs get; not those that tell them of continuous integration or of a cache."""


@dataclass(frozen=True)
class Place:
    """Empty folders that stand for the user's, in one that is not the temporary folder of the tests."""

    root: Path

    @property
    def environment(self) -> dict[str, str]:
        """Variables under which a program finds its caches and temporary files in these folders."""
        kept = {name: os.environ[name] for name in KEPT if name in os.environ}
        return {**kept, "HOME": str(self.home), "XDG_CACHE_HOME": str(self.home / "caches"), "TMPDIR": str(self.tmp)}

    @property
    def home(self) -> Path:
        return self.root / "home"

    @property
    def tmp(self) -> Path:
        return self.root / "tmp"

    @property
    def output(self) -> Path:
        return self.root / "output"

    def trace(self, *command: str) -> Trace:
        """Run a command under strace in the home folder."""
        output = self.root / "trace.txt"
        done = subprocess.run(
            traced(list(command), output),
            cwd=self.home,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=SECONDS,
        )
        assert done.returncode == 0, done.stderr
        return read_trace(output, self.home)

    def leftovers(self) -> list[Path]:
        """What lies in the home folder and in the temporary folder."""
        return [*self.home.rglob("*"), *self.tmp.rglob("*")]


@pytest.fixture
def place(tmp_path):
    place = Place(tmp_path)
    for folder in (place.home, place.home / "caches", place.tmp, place.output):
        folder.mkdir()
    return place


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """A person as `hero.obj`, another in a pose as `pose.obj`, and a walk as `walk.glb`."""
    folder = tmp_path_factory.mktemp("inputs")
    save_mesh(person(0), folder / "hero.obj")
    save_mesh(person(1, 3), folder / "pose.obj")
    save_clip(walk(), folder / "walk.glb")
    return folder


STUB = f"""
import os
VALUE, CALLED = os.environ.get("{SWITCH}"), []
def disable_telemetry_events(): CALLED.append(True)
"""


@pytest.mark.parametrize(
    ("set_by_user", "value", "called"), [(None, "1", True), ("", "1", True), ("0", "0", False), ("true", "true", False)]
)
def test_telemetry_is_disabled_before_the_import_unless_the_user_chose(
    set_by_user, value, called, tmp_path, monkeypatch
):
    (tmp_path / "onnxruntime.py").write_text(STUB)
    monkeypatch.syspath_prepend(tmp_path)
    with mock.patch.dict(os.environ), mock.patch.dict(sys.modules):
        os.environ.pop(SWITCH, None)
        if set_by_user is not None:
            os.environ[SWITCH] = set_by_user
        sys.modules.pop("onnxruntime", None)
        module = import_onnxruntime()
        assert (module.VALUE, bool(module.CALLED)) == (value, called)
        assert import_onnxruntime() is module
        assert len(module.CALLED) == called


def test_a_program_that_imported_onnxruntime_before_has_decided(tmp_path, monkeypatch):
    (tmp_path / "onnxruntime.py").write_text(STUB)
    monkeypatch.syspath_prepend(tmp_path)
    with mock.patch.dict(os.environ), mock.patch.dict(sys.modules):
        os.environ.pop(SWITCH, None)
        sys.modules.pop("onnxruntime", None)
        import onnxruntime

        module = import_onnxruntime()
        assert module is onnxruntime
        assert not module.CALLED
        assert SWITCH not in os.environ


@pytest.mark.slow
def test_opening_a_network_leaves_no_file(place):
    code = "from mimesh.methods import find_model; find_model('npt')"
    subprocess.run([sys.executable, "-c", code], cwd=place.home, env=place.environment, check=True, timeout=SECONDS)
    assert place.leftovers() == [place.home / "caches"]


FORBIDDEN = """
import os, socket, sys, threading
def ask(family, kind, address):
    with socket.socket(family, kind) as one:
        try:
            one.connect(address)  # of a datagram socket: sends nothing
        except OSError:
            pass
for thread in [
    threading.Thread(target=ask, args=(socket.AF_INET, socket.SOCK_DGRAM, ("192.0.2.1", 53))),
    threading.Thread(target=ask, args=(socket.AF_INET6, socket.SOCK_DGRAM, ("2001:db8::1", 53))),
    threading.Thread(target=ask, args=(socket.AF_UNIX, socket.SOCK_STREAM, sys.argv[1] + "/socket")),
]:
    thread.start()
folder = os.open(sys.argv[1], os.O_RDONLY)
os.close(os.open("device", os.O_WRONLY | os.O_CREAT, dir_fd=folder))
os.mkdir("cache")
os.rename("device", "cache/device")
os.symlink("nowhere", "link")
open("/dev/null", "w").close()
open(sys.executable, "rb").close()
"""


def test_a_trace_shows_connections_and_files(place):
    require_strace()
    trace = place.trace(sys.executable, "-c", FORBIDDEN, str(place.home))
    assert trace.foreign() == {"192.0.2.1", "2001:db8::1"}
    assert sum("connect(" in call for call in trace.calls) == 3
    names = {"device", "cache", "cache/device", "link"}
    assert trace.outside(place.tmp) == sorted(place.home / name for name in names)
    assert trace.outside(place.root) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "files", "more", "pictures"),
    [
        ("transfer", ("hero.obj", "pose.obj"), ("--no-preview",), ()),
        ("animate", ("hero.obj", "walk.glb"), (), ("result.preview.png", "result.preview.html")),
        ("rig", ("hero.obj",), (), ("result.preview.png",)),
        ("capture", ("walk.glb",), (), ()),
    ],
)
def test_a_command_connects_to_nothing_and_writes_its_output_alone(command, files, more, pictures, inputs, place):
    require_strace()
    paths = [str(inputs / name) for name in files]
    trace = place.trace(sys.executable, "-m", "mimesh", command, *paths, "-o", str(place.output / "result.glb"), *more)
    assert trace.calls == []
    assert trace.outside(place.output, place.tmp) == []
    assert place.leftovers() == [place.home / "caches"]
    assert {path.name for path in place.output.iterdir()} == {"result.glb", *pictures}


@pytest.mark.slow
def test_the_studio_answers_on_loopback_and_writes_to_its_temporary_folder_alone(inputs, place):
    require_strace()
    output = place.root / "trace.txt"
    command = traced([sys.executable, "-m", "mimesh", "studio", "--no-open", "--json"], output)
    options = {"cwd": place.home, "env": place.environment, "start_new_session": True}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options) as program:
        try:
            page = Page(json.loads(program.stdout.readline())["address"])
            with page.client:
                page.drop("identity", inputs / "hero.obj")
                page.drop("driving", inputs / "walk.glb")
                assert page.export(".glb").startswith(b"glTF")
                time.sleep(IDLE)
            os.killpg(program.pid, signal.SIGINT)  # strace does not take it, the studio does
            errors = program.communicate(timeout=SECONDS)[1]
        finally:
            program.kill()
    assert (program.returncode, errors) == (0, b"")
    trace = read_trace(output, place.home)
    assert {"bind", "listen"} <= trace.names()
    assert not trace.names() & {"connect", "io_uring_setup"}
    assert trace.addresses == {"127.0.0.1"}
    kinds = {call.split(", ")[0] for call in trace.calls if call.startswith("socket")}
    assert kinds <= {"socket(AF_INET", "socketpair(AF_UNIX"}
    assert not [call for call in trace.calls if "SOCK_DGRAM" in call or "sun_path" in call]
    assert trace.outside(place.tmp) == []
    assert place.leftovers() == [place.home / "caches"]


class Page:
    """What the page of a studio asks for, at the address that the command prints; asks no proxy and no name server."""

    def __init__(self, address: str) -> None:
        origin, _, token = address.partition("/?token=")
        headers = {"x-mimesh-token": token, "origin": origin}
        self.client = httpx2.Client(base_url=origin, headers=headers, timeout=SECONDS, trust_env=False)

    def ask(self, method: str, path: str, **request: Any) -> httpx2.Response:
        return self.client.request(method, f"/api/{path}", **request).raise_for_status()

    def drop(self, role: str, path: Path) -> None:
        number = self.ask("POST", "uploads").json()["upload"]
        self.ask("PUT", f"uploads/{number}", params={"name": path.name}, content=path.read_bytes())
        self.ask("POST", f"uploads/{number}/{role}")

    def export(self, suffix: str) -> bytes:
        """The result as a file, once all that moves has been moved."""
        self.wait_for(lambda state: [(mesh["outcome"] or {}).get("state") for mesh in state["identities"]] == ["done"])
        number = self.ask("POST", "exports", json={"suffix": suffix}).json()["export"]
        self.wait_for(lambda state: [one["state"] for one in state["exports"]] == ["ready"])
        return self.ask("GET", f"exports/{number}").content

    def wait_for(self, reached: Callable[[dict], bool]) -> None:
        wait_until(lambda: reached(self.ask("GET", "state").json()), SECONDS)
