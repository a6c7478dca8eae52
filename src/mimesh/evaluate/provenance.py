"""Where figures and weights come from: the code's commit and the machine."""

from __future__ import annotations

import contextlib
import os
import platform
import subprocess
from functools import cache
from importlib import metadata
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
LIBRARIES = ("numpy", "scipy", "onnxruntime", "fast-simplification")
"""Whose versions might change a figure."""


@cache
def commit() -> str:
    """Short hash of the code's git commit, `-dirty` if files differ from it; `unknown` outside a checkout.

    It is asked once, because the code that runs is that of the first call or an earlier one.
    """
    commands = ["git ls-files --error-unmatch __init__.py", "git describe --always --dirty"]
    try:
        # The first fails where the package is installed inside a checkout of something else.
        done = [subprocess.run(c.split(), cwd=PACKAGE, capture_output=True, text=True, check=True) for c in commands]
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done[-1].stdout.strip()


def machine() -> str:
    """Processor architecture and cores, system and Python version."""
    return f"{platform.machine()}, {os.cpu_count()} cores, {platform.system()}, Python {platform.python_version()}"


def libraries() -> dict[str, str]:
    """Versions of LIBRARIES; those that are not installed (nothing here asks for them) are left out."""
    found: dict[str, str] = {}
    for name in LIBRARIES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found
