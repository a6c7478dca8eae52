"""Builds Blender's extension once for all tests of it."""

import subprocess
import sys

import pytest
from client_programs import ROOT, blender


@pytest.fixture(scope="session")
def archive(tmp_path_factory):
    """Return the archive of the extension, for the Python of the Blender that is tested."""
    asked = [blender(), "-I", "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
    version = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.split()[-1]
    folder = tmp_path_factory.mktemp("dist")
    build = [sys.executable, ROOT / "scripts" / "build_blender.py", "--python", version]
    subprocess.run([*build, "--output", folder], check=True)
    (path,) = folder.glob("*.zip")
    return path
