"""Runs a command under strace and lists its network calls and the paths that it created or opened for writing."""

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
