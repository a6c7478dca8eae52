"""Commands that are killed before any of their operations on files lose nothing (scripts/measure_kills.py)."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "scripts" / "measure_kills.py"
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks, signals and /proc")


@pytest.mark.slow
def test_a_conversion_may_be_killed_before_any_operation(tmp_path):
    """It writes three files that belong together: an .obj, its .mtl and an image."""
    output = tmp_path / "kills.json"
    options = ["--commands", "convert", "--moments", "operation", "--kills", "28", "-o", str(output)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, str(SCRIPT), *options], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    report = json.loads(output.read_text())
    figures = report["commands"]["convert"]
    assert figures["violations"] == []
    # Every operation once, before and after that of a rename at least.
    assert figures["kills"] >= figures["operations"] > 10
    assert any("as before" in outcome for outcome in figures["outcomes"])
    assert any(outcome.endswith(" new") for outcome in figures["outcomes"])
