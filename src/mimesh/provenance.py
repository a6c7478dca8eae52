"""Where figures and weights come from: the code's commit and the machine."""

from __future__ import annotations

import platform
import subprocess
from pathlib import Path


def commit() -> str:
    """Short hash of the code's git commit, `-dirty` if files differ from it; `unknown` outside a checkout."""
    command = ["git", "describe", "--always", "--dirty"]
    try:
        done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()


def machine() -> str:
    """Processor architecture, system and Python version."""
    return f"{platform.machine()}, {platform.system()}, Python {platform.python_version()}"
