"""Run a function of this package in a child process with limits: native decoders read files that nobody has checked.

A damaged or malicious file can make a C or C++ library crash, loop, or allocate all memory. In a child process this
ends the child, and the caller gets an InputError of one line. The child has a limit on memory, processor time, clock
time and the size of the files it writes (Linux; other systems have fewer, see `_limit_resources`), and of the
environment only what Python needs to start. It writes its result to a file, and its errors to another.

The limits protect against damage by accident and against denial of service. They are no sandbox: a decoder that a file
takes over has the user's rights.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from ..core.errors import InputError

MIB = 2**20
"""Bytes."""
KEPT_VARIABLES = ("SYSTEMROOT", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH")
"""Environment variables that a Python interpreter may need to start and to load its libraries."""
THREADS = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""NumPy's libraries reserve address space for each thread, which the limit on memory counts."""
BOOT = "import json, sys; call = json.loads(sys.argv[1]); sys.path[:] = call.pop('path'); "
BOOT += f"from {__name__} import run_call; run_call(call)"
"""Program of the child. It starts isolated (`python -I`), so the modules are found by the parent's search path."""
REFUSED, NO_MEMORY, FAILED = 3, 4, 5
"""Exit codes of the child: InputError, MemoryError, any other exception."""
LONGEST_MESSAGE = 2000
"""Bytes of an error of the child that are shown."""


@dataclass(frozen=True)
class Limits:
    """What a child process may use."""

    memory: int
    """Bytes of address space, libraries included."""
    output: int
    """Bytes of each file that it writes."""
    cpu_seconds: int
    clock_seconds: float

    @classmethod
    def for_size(cls, size: int) -> Limits:
        """Return limits for an input of `size` bytes: far more than any sound file of that size was seen to need."""
        # Seven FBX files of two makers need 160 MiB of address space with all libraries, 15 bytes of memory and 0.15
        # microseconds for each of their bytes, and give 1.1 bytes.
        return cls(2048 * MIB + 64 * size, 1024 * MIB + 32 * size, 60 + size // MIB, 180 + size / MIB)


@contextlib.contextmanager
def child_result(
    function: str, source: Path, name: Path, limits: Limits | None = None, **arguments: Any
) -> Iterator[Path]:
    """Run a function in a child process, and yield the file that it wrote; it is deleted at the end of the block.

    Args:
        function: "package.module:function". It is called as function(source, target, **arguments), writes the file
            `target`, and may raise InputError. `arguments` are values that JSON has.
        source: the file to read.
        name: file that error messages name.
        limits: by default those for the size of `source`.

    Raises:
        InputError: the function raised one, crashed, ran out of memory or time, or wrote nothing.
    """
    limits = limits or Limits.for_size(source.stat().st_size)
    with tempfile.TemporaryDirectory(prefix="mimesh-", ignore_cleanup_errors=True) as folder:
        target, errors = Path(folder, "result"), Path(folder, "errors")
        call = {"function": function, "source": str(source.absolute()), "target": str(target), "arguments": arguments}
        call |= {"limits": asdict(limits), "path": [str(Path(entry).absolute()) for entry in sys.path]}
        code = _run(call, errors, limits, name)
        message = last_line(errors)
        if code == REFUSED:
            raise InputError(message.replace(str(source.absolute()), str(name)))
        if code != 0:
            raise InputError(f"{name}: expected a file that can be read, found {_reason(code, message, limits)}")
        size = target.stat().st_size if target.is_file() else 0
        if not 0 < size <= limits.output:
            raise InputError(
                f"{name}: expected up to {limits.output // MIB:,} MiB from its decoder, found {size:,} bytes; "
                "the file is damaged, export it again"
            )
        yield target


def run_call(call: dict[str, Any]) -> None:
    """Run the call that the parent has sent, in the child: set the limits, call the function, and end the process."""
    _limit_resources(Limits(**call["limits"]))
    module, _, function = call["function"].partition(":")
    try:
        getattr(import_module(module), function)(Path(call["source"]), Path(call["target"]), **call["arguments"])
        code = 0
    except InputError as error:
        code = REFUSED
        print(error, file=sys.stderr)
    except MemoryError:
        code = NO_MEMORY
    except Exception as error:
        # Whatever a library raises on a damaged file: the parent makes one line of it.
        code = FAILED
        print(" ".join(repr(error).split()), file=sys.stderr)
    sys.stderr.flush()
    # Destructors of native objects may crash after a result was written; nothing of this process is needed any more.
    os._exit(code)


def _run(call: dict[str, Any], errors: Path, limits: Limits, name: Path) -> int:
    """Start the child, wait for it, and return its exit code, negative for a signal."""
    environment = {key: os.environ[key] for key in KEPT_VARIABLES if key in os.environ} | THREADS
    environment |= {key: str(errors.parent) for key in ("TMPDIR", "TEMP", "TMP")}
    command = [sys.executable, "-I", "-X", "utf8", "-c", BOOT, json.dumps(call)]
    with errors.open("wb") as error_file:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=error_file,
            env=environment,
            cwd=errors.parent,
            start_new_session=True,
        )
        try:
            return process.wait(limits.clock_seconds)
        except subprocess.TimeoutExpired as error:
            raise InputError(f"{name}: expected a file that can be read, found {_too_slow()}") from error
        finally:
            # Also on Ctrl-C: no decoder outlives its caller.
            process.kill()
            process.wait()


def _limit_resources(limits: Limits) -> None:
    """Set the limits of this process, as far as the system has them.

    macOS has no limit on the address space, Windows none at all: there the parent's clock ends a child, and the size of
    the result is checked.
    """
    try:
        import resource
    except ImportError:
        return
    wanted = {
        "RLIMIT_AS": limits.memory,
        "RLIMIT_CPU": limits.cpu_seconds,
        "RLIMIT_FSIZE": limits.output,
        "RLIMIT_CORE": 0,
    }
    for key, value in wanted.items():
        kind = getattr(resource, key, None)
        if kind is None:
            continue
        hard = resource.getrlimit(kind)[1]
        value = value if hard == resource.RLIM_INFINITY else min(value, hard)
        with contextlib.suppress(ValueError, OSError):  # macOS refuses some of them
            resource.setrlimit(kind, (value, value))


def _reason(code: int, message: str, limits: Limits) -> str:
    """Describe why a child failed, and what to do, from its exit code."""
    if code == NO_MEMORY or "MemoryError" in message or "bad_alloc" in message:
        memory = f"{limits.memory // MIB:,} MiB"
        return f"that it needs more than {memory} of memory; the file is damaged or too large, export it again"
    if code in (-getattr(signal, "SIGXCPU", 24), -getattr(signal, "SIGKILL", 9)):
        return _too_slow()
    if code == -getattr(signal, "SIGXFSZ", 25) or "File too large" in message:
        return f"more than {limits.output // MIB:,} MiB in it; the file is damaged, export it again"
    if code < 0 or code != FAILED:
        return f"that its decoder crashed (exit code {code}); the file is damaged, export it again"
    return f"'{message[:200]}'; the file is damaged, export it again"


def _too_slow() -> str:
    return "that its decoder does not end; the file is damaged or too large, export it again"


def last_line(path: Path) -> str:
    """Return the last line of a text file, or what is left of it where it is long."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - LONGEST_MESSAGE, 0))
        lines = file.read().decode("utf-8", "replace").strip().splitlines()
    return lines[-1].strip() if lines else ""
