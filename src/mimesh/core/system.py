"""What differs between Linux, macOS and Windows: processes, renaming, limits.

Everything else in the package is the same on all three. Where a system lacks something, the function says so.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .errors import InputError

RENAME_SECONDS = 2.0
"""How long a rename is tried on Windows, where other programs (a search index, a virus scanner) open new files."""
PR_SET_PDEATHSIG = 1
"""Option of `prctl` on Linux: the signal that a process gets when its parent ends."""


def usable_cores() -> int:
    """Return the number of processor cores that this process may use; only Linux can tell them from all cores."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def rename(source: Path, target: Path) -> None:
    """Rename a file, replacing `target`; on Windows again for a while if another program has one of them open.

    Raises:
        OSError: it cannot be renamed; on Windows also a `target` that stays open in another program.
    """
    until = time.monotonic() + RENAME_SECONDS
    while True:
        try:
            return os.replace(source, target)
        except PermissionError:
            if os.name != "nt" or target.is_dir() or time.monotonic() > until:
                raise
        time.sleep(0.05)


def refuse_pipe(path: str | Path) -> None:
    """Check that an input is no pipe, socket or device: reading one may wait for ever, and formats need to go back.

    A path such as /dev/stdin counts as what it leads to, which may be a file.

    Raises:
        InputError: it is one.
    """
    path = Path(path)
    if path.exists() and not path.is_file() and not path.is_dir():
        raise InputError(f"{path}: expected a file, found a pipe or a device; save what comes from it as a file first")


def resident_memory() -> float | None:
    """Return the memory of this process in MiB; None where the system does not tell (macOS, Windows)."""
    pages = Path("/proc/self/statm")
    if not pages.exists():
        return None
    return round(int(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20, 1)


def end_with_parent() -> None:
    """Have the system end this process when its parent is killed, which then cannot do it itself (Linux)."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


@contextlib.contextmanager
def ctrl_c_held() -> Iterator[None]:
    """Block Ctrl-C in this thread: processes that are started meanwhile never get it (not on Windows).

    They inherit the mask of the thread. Other threads of this process still get the signal, so it may not wait.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def limit_process(memory: int, output: int) -> None:
    """Limit the address space and the size of files (bytes) of this process, and write no core files.

    As far as the system has these limits: macOS has none on the address space, Windows none at all.
    """
    for key, value in {"RLIMIT_AS": memory, "RLIMIT_FSIZE": output, "RLIMIT_CORE": 0}.items():
        _limit(key, value, hard_too=True)


def limit_processor_time(seconds: int) -> None:
    """Limit the processor time of this process from now on (seconds), as far as the system can; not on Windows."""
    resource = _resource()
    if resource is not None:
        usage = resource.getrusage(resource.RUSAGE_SELF)
        _limit("RLIMIT_CPU", math.ceil(usage.ru_utime + usage.ru_stime) + seconds, hard_too=False)


def _limit(key: str, value: int, hard_too: bool) -> None:
    resource = _resource()
    kind = getattr(resource, key, None)
    if resource is None or kind is None:
        return
    hard = resource.getrlimit(kind)[1]
    value = value if hard == resource.RLIM_INFINITY else min(value, hard)
    with contextlib.suppress(ValueError, OSError):  # macOS refuses some of them
        resource.setrlimit(kind, (value, value if hard_too else hard))


def _resource() -> Any:
    try:
        import resource
    except ImportError:
        return None
    return resource
