"""Find the external programs that tests run; a missing one skips the test with how to install it."""

import functools
import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CLIENTS = ROOT / ".clients"


def blender() -> Path:
    """Return the Python interpreter that can import `bpy`."""
    python = Path(os.environ.get("MIMESH_BPY", CLIENTS / "bpy" / "bin" / "python"))
    if not _answers(python, "-I", "-c", "import bpy"):
        pytest.skip(f"no Blender at {python}: run make clients, or set MIMESH_BPY to a Python that has bpy")
    return python


def validator() -> list[str]:
    """Return the command that prints the Khronos validator's report on a glTF file as JSON; its path is to be added."""
    folder, node = Path(os.environ.get("MIMESH_VALIDATOR", CLIENTS / "validator")), shutil.which("node")
    if node is None or not (folder / "node_modules" / "gltf-validator").is_dir():
        pytest.skip(f"no glTF validator in {folder}: run make clients with Node.js installed, or set MIMESH_VALIDATOR")
    return [node, str(Path(__file__).with_name("validate.cjs")), str(folder / "node_modules" / "gltf-validator")]


@functools.cache
def _answers(program: Path, *arguments: str) -> bool:
    return program.is_file() and not subprocess.run([program, *arguments], capture_output=True).returncode
