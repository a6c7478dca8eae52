"""Native decoders in this process: starting a child takes half a second, and sound files need none.

Files that may be damaged stay in a child, and so do the tests of the child itself (tests/io/test_guarded.py).
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from mimesh.core.errors import InputError, one_line
from mimesh.io import child_process


def run_here(call: dict[str, Any], folder: Path, limits: Any, name: Path, progress: Any) -> int:
    """Do what `child_process._run` has a child do, without its limits."""
    module, _, function = call["function"].partition(":")
    more = {} if progress is None else {"progress": progress}
    with Path(folder, child_process.ERRORS_FILE).open("w", encoding="utf-8") as errors:
        try:
            arguments = {**call["arguments"], **more}
            getattr(import_module(module), function)(Path(call["source"]), Path(call["target"]), **arguments)
        except InputError as error:
            errors.write(str(error))
            return child_process.REFUSED
        except Exception as error:
            errors.write(one_line(child_process._cause(error)))
            return child_process.FAILED
    return 0
