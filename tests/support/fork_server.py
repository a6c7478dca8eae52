"""Processes that have a native library loaded and fork for each call: a child that decodes a file costs milliseconds.

The child is what `child_process` makes of it, with its limits and its end; only its start is another one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from mimesh.io import child_process

PROGRAM = """
import json, os, signal, sys
from importlib import import_module
import_module(sys.argv[1])
from mimesh.io.child_process import run_call
for line in sys.stdin:
    call = json.loads(line)
    child = os.fork()
    if not child:
        os.dup2(os.open(call["errors"], os.O_WRONLY | os.O_CREAT), 2)
        signal.alarm(int(call["limits"]["clock_seconds"]))
        run_call(call)
    _, status, used = os.wait4(child, 0)
    print(os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime, flush=True)
"""


class ForkServer:
    """Runs calls of `child_process`; `run` takes the place of `child_process._run`."""

    def __init__(self) -> None:
        self.seconds = 0.0
        """Processor time of all children."""
        self._processes: dict[str, subprocess.Popen[str]] = {}

    def run(self, call: dict[str, Any], folder: Path, limits: Any, name: Path, progress: Any) -> int:
        module = call["function"].partition(":")[0]
        if module not in self._processes:
            command = [sys.executable, "-c", PROGRAM, module]
            environment = os.environ | child_process.VARIABLES | {"PYTHONPATH": os.pathsep.join(call["path"])}
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
            self._processes[module] = subprocess.Popen(command, env=environment, text=True, **pipes)
        process = self._processes[module]
        errors = folder / child_process.ERRORS_FILE
        errors.touch()
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(call | {"errors": str(errors)}) + "\n")
        process.stdin.flush()
        code, seconds = process.stdout.readline().split()
        self.seconds += float(seconds)
        if progress is not None and (counts := child_process._read_counts(folder / child_process.COUNTS_FILE)):
            progress(*counts)
        return int(code)

    def close(self) -> None:
        for process in self._processes.values():
            process.communicate()
