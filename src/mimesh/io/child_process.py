"""Run a function of this package in a child process with limits: native decoders read files that nobody has checked.

A damaged or malicious file can make a C or C++ library crash, loop, or allocate all memory. In a child process this
ends the child, and the caller gets an InputError of one line. The child has a limit on memory, processor time, clock
time and the size of the files it writes (Linux; other systems have fewer, see `core.system`), and of the
environment only what Python needs to start. It writes its result to a file, its errors to another, and the number of
frames done to a third. `watched` lets the caller end it.

The limits protect against damage by accident and against denial of service. They are no sandbox: a decoder that a file
takes over has the user's rights.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from ..core.budgets import lift_limits, limits_are_lifted
from ..core.errors import LONGEST_MESSAGE, InputError, damaged, naming_options, on_command_line, one_line
from ..core.frame_buffer import Progress
from ..core.system import end_with_parent, limit_process, limit_processor_time
from .atomic import scratch_folder
from .beside import confined, confining_folder

MIB = 2**20
"""Bytes."""
KEPT_VARIABLES = ("SYSTEMROOT", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH")
"""Environment variables that a Python interpreter may need to start and to load its libraries."""
USE_PREAD = ("USDC_USE_PREAD", "1")
"""Variable for the library of USD, which else maps binary files: pages read of a long clip would stay in memory."""
THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "PXR_WORK_THREAD_LIMIT": "1"}
"""Variables that give each library one thread. Those of NumPy and USD reserve address space for each thread, which the
limit on memory counts.
"""
VARIABLES = {USE_PREAD[0]: USE_PREAD[1], **THREADS}
"""Variables that a child gets."""
BOOT = "import json, sys; call = json.loads(sys.argv[1]); sys.path[:] = call.pop('path'); "
BOOT += f"from {__name__} import run_call; run_call(call)"
"""Program of the child. It starts isolated (`python -I`), so the modules are found by the parent's search path."""
FULL_DISK = "a full disk"
TOO_SLOW = "that its decoder does not end; the file is damaged or too large, export it again"
REFUSED, NO_MEMORY, FAILED = 3, 4, 5
"""Exit codes of the child: InputError, MemoryError, any other exception."""
LAST_BYTES = 4 * LONGEST_MESSAGE + 100
"""Bytes at the end of the file of errors that are read; a character has up to four."""
POLL_SECONDS = 0.05
"""Between two looks at a running child: at its progress, and at whether it is still wanted."""
COUNTS = struct.Struct("<QQ")
"""Frames done and frames in all, as the child writes them."""
ERRORS_FILE, COUNTS_FILE = "errors", "counts"
"""Files beside the result that the child writes: its errors, and its progress."""
_CHECK: ContextVar[Callable[[], None] | None] = ContextVar("check", default=None)


@dataclass(frozen=True)
class Limits:
    """What a child process may use."""

    memory: int
    """Bytes of address space, libraries included."""
    output: int
    """Bytes of each file that it writes."""
    cpu_seconds: int
    """Since the child has imported its libraries, or reported progress."""
    clock_seconds: float
    """Since the child was started, or reported progress."""

    @classmethod
    def for_size(cls, size: int, cpu_seconds: int = 60) -> Limits:
        """Return limits for an input of `size` bytes: far more than any sound file of that size was seen to need.

        `cpu_seconds` is the processor time of a small one; each MiB gives another second.
        """
        # Seven FBX files of two makers need 160 MiB of address space with all libraries, 15 bytes of memory and 0.15
        # microseconds for each of their bytes, and give 1.1 bytes.
        return cls(2048 * MIB + 64 * size, 1024 * MIB + 32 * size, cpu_seconds + size // MIB, 180 + size / MIB)


UNLIMITED = Limits(2**60, 2**60, 10**9, 1e9)
"""Where the caller has lifted the budgets (`core.budgets`)."""


@contextlib.contextmanager
def watched(check: Callable[[], None]) -> Iterator[None]:
    """Call `check` every POLL_SECONDS while this context waits for a child; what it raises ends the child at once."""
    token = _CHECK.set(check)
    try:
        yield
    finally:
        _CHECK.reset(token)


@contextlib.contextmanager
def child_result(
    function: str,
    source: Path,
    name: Path,
    limits: Limits | None = None,
    progress: Progress | None = None,
    **arguments: Any,
) -> Iterator[Path]:
    """Run a function in a child process, and yield the file that it wrote; its folder is deleted after the block.

    Args:
        function: "package.module:function". It is called as function(source, target, **arguments), writes the file
            `target`, may write others beside it, and may raise InputError. `arguments` are values that JSON has. Files
            that `source` refers to are confined there as they are here (`beside.confined`).
        name: file that error messages name.
        limits: by default those for the size of `source`; without effect where the budgets are lifted.
        progress: the function gets a further argument `progress`, and what it reports is passed on to this. The limits
            of time then start again with each report.

    Raises:
        InputError: the function raised one, crashed, ran out of memory or time, or wrote nothing.
    """
    lifted = limits_are_lifted()
    limits = UNLIMITED if lifted else limits or Limits.for_size(source.stat().st_size)
    with scratch_folder() as folder:
        target = folder / "result"
        call = {"function": function, "source": str(source.absolute()), "target": str(target), "arguments": arguments}
        call |= {"limits": asdict(limits), "path": [str(Path(entry).absolute()) for entry in sys.path]}
        call |= {
            "lifted": lifted,
            "command_line": on_command_line(),
            "counts": None if progress is None else str(folder / COUNTS_FILE),
        }
        call["confined_to"] = None if (outer := confining_folder()) is None else str(outer)
        code = _run(call, folder, limits, name, progress)
        message = last_line(folder / ERRORS_FILE).replace(str(folder), str(folder.parent))
        if code == REFUSED:
            raise InputError(message.replace(str(source.absolute()), str(name)))
        if code != 0:
            raise InputError(f"{name}: expected a file that can be read, found {_reason(code, message, limits)}")
        size = target.stat().st_size if target.is_file() else 0
        if not 0 < size <= limits.output:
            raise damaged(name, f"up to {limits.output // MIB:,} MiB from its decoder", f"{size:,} bytes")
        yield target


def run_call(call: dict[str, Any]) -> None:
    """Run the call that the parent has sent, in the child: set the limits, call the function, and end the process."""
    limits, arguments = Limits(**call["limits"]), call["arguments"]
    module, _, function = call["function"].partition(":")
    end_with_parent()
    if call["lifted"]:
        lift_limits()
    try:
        imported = import_module(module)
        # After the imports, whose time depends on the machine and not on the file. Where the system has no limits, the
        # parent's clock ends the child, and the size of the result is checked.
        limit_process(limits.memory, limits.output)
        limit_processor_time(limits.cpu_seconds)
        if call["counts"] is not None:
            arguments["progress"] = _reporter(Path(call["counts"]), limits)
        folder = call["confined_to"]
        naming = naming_options() if call["command_line"] else contextlib.nullcontext()
        with naming, contextlib.nullcontext() if folder is None else confined(Path(folder)):
            getattr(imported, function)(Path(call["source"]), Path(call["target"]), **arguments)
        code = 0
    except InputError as error:
        code = REFUSED
        print(str(error), file=sys.stderr)
    except MemoryError:
        code = NO_MEMORY
    except Exception as error:
        # Whatever a library raises on a damaged file: the parent makes one line of it.
        code = FAILED
        print(one_line(_cause(error)), file=sys.stderr)
    sys.stderr.flush()
    # Destructors of native objects may crash after a result was written; nothing of this process is needed any more.
    os._exit(code)


def _cause(error: Exception) -> str:
    """Describe an exception of a library; the codec's own words would quote bytes of the file."""
    if isinstance(error, UnicodeError):
        return "text that is no UTF-8"
    return FULL_DISK if isinstance(error, OSError) and error.errno == errno.ENOSPC else f"'{repr(error)[:200]}'"


def _reporter(counts: Path, limits: Limits) -> Progress:
    """Return a function for the child to report progress with: it writes the counts, and starts its limit again."""
    file = counts.open("wb", buffering=0)

    def report(done: int, total: int) -> None:
        file.seek(0)
        file.write(COUNTS.pack(done, total))
        limit_processor_time(limits.cpu_seconds)

    return report


def _read_counts(counts: Path) -> tuple[int, int] | None:
    """Read what the child has reported last; None where it has not yet."""
    content = counts.read_bytes() if counts.exists() else b""
    return COUNTS.unpack(content) if len(content) == COUNTS.size else None


def _run(call: dict[str, Any], folder: Path, limits: Limits, name: Path, progress: Progress | None) -> int:
    """Start the child, wait for it, and return its exit code, negative for a signal."""
    environment = {key: os.environ[key] for key in KEPT_VARIABLES if key in os.environ} | VARIABLES
    environment |= {key: str(folder) for key in ("TMPDIR", "TEMP", "TMP")}
    command = [sys.executable, "-I", "-X", "utf8", "-c", BOOT, json.dumps(call)]
    with Path(folder, ERRORS_FILE).open("wb") as error_file:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=error_file,
            env=environment,
            cwd=folder,
            start_new_session=True,
        )
        try:
            return _wait(process, Path(folder, COUNTS_FILE), limits, name, progress)
        finally:
            # Also on Ctrl-C: no decoder outlives its caller.
            process.kill()
            process.wait()


def _wait(process: subprocess.Popen[bytes], counts: Path, limits: Limits, name: Path, progress: Progress | None) -> int:
    """Wait for the child, passing on its progress, and return its exit code."""
    check, seen, since, code = _CHECK.get(), None, time.monotonic(), None
    while code is None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = process.wait(POLL_SECONDS)
        if check is not None:
            check()
        if progress is not None and (now := _read_counts(counts)) not in (seen, None):
            seen, since = now, time.monotonic()
            progress(*now)
        if code is None and time.monotonic() - since > limits.clock_seconds:
            raise InputError(f"{name}: expected a file that can be read, found {TOO_SLOW}")
    return code


def _reason(code: int, message: str, limits: Limits) -> str:
    if code == NO_MEMORY or "MemoryError" in message or "bad_alloc" in message:
        memory = f"{limits.memory // MIB:,} MiB"
        return f"that it needs more than {memory} of memory; the file is damaged or too large, export it again"
    if code in (-getattr(signal, "SIGXCPU", 24), -getattr(signal, "SIGKILL", 9)):
        return TOO_SLOW
    if code == -getattr(signal, "SIGXFSZ", 25) or "File too large" in message:
        return f"more than {limits.output // MIB:,} MiB in it; the file is damaged, export it again"
    if code < 0 or code != FAILED:
        return f"that its decoder crashed (exit code {code}); the file is damaged, export it again"
    if message == FULL_DISK:
        return f"no room for its frames in {tempfile.gettempdir()}; free some, or set TMPDIR to another folder"
    return f"{message}; the file is damaged, export it again"


def last_line(path: Path) -> str:
    """Return the last line of a text file, or what is left of it where it is long."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - LAST_BYTES, 0))
        lines = file.read().decode("utf-8", "replace").strip().splitlines()
    return lines[-1].strip() if lines else ""
