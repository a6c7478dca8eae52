"""Run a command under strace; list its network calls and the paths that it created or opened for writing."""

from __future__ import annotations

import ipaddress
import os
import re
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import pytest

FILE_CALLS = ("open", "openat", "openat2", "creat", "mknod", "mknodat", "mkdir", "mkdirat", "truncate")
"""System calls whose first path is what they write to."""
MOVING_CALLS = ("rename", "renameat", "renameat2", "link", "linkat", "symlink", "symlinkat")
"""Those whose last path is."""
WRITING = re.compile(r"O_(WRONLY|RDWR|CREAT|TRUNC|APPEND|TMPFILE)")
# io_uring could read, write and connect without any of the other calls. "?" is for architectures that lack a call.
TRACED = "network," + ",".join(f"?{name}" for name in (*FILE_CALLS, *MOVING_CALLS, "io_uring_setup"))
STRACE = ("strace", "--follow-forks", "--seccomp-bpf", "--decode-fds=path", "-qq", "-e", f"trace={TRACED}")

CALL = re.compile(r"^\d+ +(?P<name>\w+)\((?P<arguments>.*)$")
PATH = re.compile(r'(?:<(?P<folder>[^>]*)>(?:\(deleted\))?, )?"(?P<name>(?:[^"\\]|\\.)*)"')
"""An argument that is a path, after the folder that it is relative to if the call takes one."""
ADDRESS = re.compile(r'inet_addr\("([^"]+)"\)|inet_pton\(AF_INET6, "([^"]+)"')


@dataclass
class Trace:
    """What a command and all processes that it started asked the system for."""

    calls: list[str] = field(default_factory=list)
    """Network calls as strace prints them, io_uring among them."""
    written: list[Path] = field(default_factory=list)
    """Paths that were created, opened for writing, or renamed or linked to, attempts that failed included."""
    addresses: set[str] = field(default_factory=set)
    """IP addresses in any call, also those that the system filled in."""

    def outside(self, *places: Path) -> list[Path]:
        """The written paths that lie in none of these places and are neither bytecode of Python nor /dev/null."""
        inside = (path for path in self.written if any(path.is_relative_to(place) for place in places))
        bytecode = (path for path in self.written if "__pycache__" in path.parts)
        return sorted({*self.written} - {*inside, *bytecode, Path("/dev/null")})

    def names(self) -> set[str]:
        """The names of the network calls."""
        return {call.partition("(")[0] for call in self.calls}

    def foreign(self) -> set[str]:
        """The addresses that are not of this machine's loopback."""
        return {address for address in self.addresses if not ipaddress.ip_address(address).is_loopback}


def require_strace() -> None:
    """Skip the test where nothing can be traced, with what strace says."""
    if shutil.which("strace") is None:
        pytest.skip("strace is not installed")
    probe = subprocess.run([*STRACE, "-o", os.devnull, "true"], capture_output=True, text=True)
    if probe.returncode:
        pytest.skip(f"strace cannot trace here: {probe.stderr.strip() or 'no reason given'}")


def traced(command: list[str], output: Path) -> list[str]:
    """The command line that runs `command` and writes its trace to `output`."""
    return [*STRACE, "-o", str(output), *command]


def read_trace(output: Path, folder: Path) -> Trace:
    """Parse a trace of a command that ran in `folder`."""
    text, trace = output.read_text(errors="replace"), Trace()
    trace.addresses = {one or other for one, other in ADDRESS.findall(text)}
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
