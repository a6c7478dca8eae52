"""Run a command of mimesh that gets a signal just before its n-th operation on files of some folders.

    python scripts/kill_at_operation.py '{"at": 5, "signal": 9, "folders": ["/tmp/out"]}' convert a.obj /tmp/out/b.obj

Operations are those that Python reports (PEP 578): opening a file to write, renaming, linking, deleting, making and
deleting folders. With `"at": 0` there is no signal, and the last line on stderr is the number of operations.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

OPERATIONS = ("os.rename", "os.link", "os.remove", "os.mkdir", "os.rmdir", "os.chmod")


class Operations:
    """Counts operations on files of folders; before number `at` the process gets a signal."""

    def __init__(self, folders: list[str], at: int, signal: int) -> None:
        self.folders, self.at, self.signal, self.count = tuple(folders), at, signal, 0

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if event == "open":
            path, _, flags = arguments
            if not (flags or 0) & (os.O_WRONLY | os.O_RDWR):
                return
            paths: tuple[Any, ...] = (path,)
        elif event in OPERATIONS:
            paths = arguments
        else:
            return
        if any(isinstance(path, (str, Path)) and str(path).startswith(self.folders) for path in paths):
            self.count += 1
            if self.count == self.at:
                os.kill(os.getpid(), self.signal)


def main() -> None:
    """Run the command."""
    options, arguments = json.loads(sys.argv[1]), sys.argv[2:]
    operations = Operations(options["folders"], options["at"], options.get("signal", 0))
    sys.addaudithook(operations)
    from mimesh.cli import main as command

    try:
        command(arguments)
    finally:
        if not options["at"]:
            print(operations.count, file=sys.stderr)


if __name__ == "__main__":
    main()
