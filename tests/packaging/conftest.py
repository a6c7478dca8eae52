"""What the script of a release defines."""

import runpy
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def script() -> dict:
    return runpy.run_path(str(Path(__file__).parents[2] / "scripts" / "release.py"))
