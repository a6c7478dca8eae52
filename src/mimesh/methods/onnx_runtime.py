"""Import onnxruntime without its telemetry, and open networks with it. Nothing else in this project imports it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

SWITCH = "ORT_DISABLE_TELEMETRY"
"""Environment variable that onnxruntime reads once, while it is imported; its Privacy.md describes it."""
THREADS = "MIMESH_THREADS"
"""Environment variable: threads of each network, 2 by default. `--threads` and `mimesh batch` set it. Waiting threads
do not spin: on two busy cores the second one costs nothing (benchmarks/threads.json)."""
MOST_SESSIONS = 4
"""Networks that a process keeps open: mime's two, that of hands, and one of a user."""


def import_onnxruntime() -> ModuleType:
    """Import onnxruntime with its telemetry disabled and return the module.

    Official builds send events to their vendor and keep a database and a device identifier in the user's cache folder,
    from the import on. If the user has set the variable to any value, or the program has imported onnxruntime before,
    nothing is changed.
    """
    first = "onnxruntime" not in sys.modules
    if first and not os.environ.get(SWITCH):
        os.environ[SWITCH] = "1"
    import onnxruntime

    if first and os.environ[SWITCH] == "1":
        # Older builds for Windows report to the system's event log; they ignore the variable and have only this switch.
        onnxruntime.disable_telemetry_events()
    return onnxruntime


def open_session(path: Path) -> InferenceSession:
    """Open a network on the CPU; while its file does not change, a process opens it once (0.25 s for that of mime).

    A file that is no network raises one of onnxruntime's errors.
    """
    facts = path.stat()
    return _opened(path.resolve(), facts.st_mtime_ns, facts.st_size, int(os.environ.get(THREADS) or 2))


@lru_cache(maxsize=MOST_SESSIONS)
def _opened(path: Path, modified: int, size: int, threads: int) -> InferenceSession:
    onnxruntime = import_onnxruntime()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3  # warnings about graph clean-up are not for users
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")  # idle threads would take time from others

    class Session(onnxruntime.InferenceSession):
        """A network that another process opens again where what holds it is unpickled."""

        def __reduce__(self) -> tuple[Callable[[Path], InferenceSession], tuple[Path]]:
            return open_session, (path,)

    # Without a fallback, as there is no other provider: it would print the error of a damaged file.
    return Session(str(path), options, providers=["CPUExecutionProvider"], enable_fallback=0)
