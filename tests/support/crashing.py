"""What workers of a batch do in tests: a module of its own, because their processes import it."""

from __future__ import annotations

import os
from typing import Any

from mimesh.jobs.run import BatchTask


def repeat_or_crash(task: BatchTask) -> dict[str, Any]:
    """Return the driving's name and the number of this process, or crash as a native library does."""
    if task.job.driving == "crash":
        os.abort()
    return {"value": task.job.driving, "process": os.getpid()}
