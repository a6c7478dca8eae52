"""Find the external programs that tests run; a missing one skips the test with how to install it."""

import functools
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from mimesh.core.threads import LINEAR_ALGEBRA

ROOT = Path(__file__).parents[2]
CLIENTS = ROOT / ".clients"


def blender() -> Path:
    """Return the Python interpreter that can import `bpy`."""
    python = Path(os.environ.get("MIMESH_BPY", CLIENTS / "bpy" / "bin" / "python"))
    if not _answers(python, "-I", "-c", "import bpy"):
        pytest.skip(f"no Blender at {python}: run make clients, or set MIMESH_BPY to a Python that has bpy")
    return python


def run_in_blender(script: str, archive: Path, folder: Path, user: Path) -> None:
    """Run a script of this folder in Blender, with the extension's archive and a folder for its results.

    Args:
        user: empty folder for Blender's settings.
    """
    # Artists set no number of threads: what tests run with must not hide what mimesh then loads.
    own = {name: value for name, value in os.environ.items() if name not in LINEAR_ALGEBRA}
    environment = own | {"BLENDER_USER_RESOURCES": str(user)}
    path = Path(__file__).with_name(script)
    subprocess.run([blender(), "-I", path, archive, folder], check=True, env=environment)


def validator() -> list[str]:
    """Return the command that prints the Khronos validator's report on a glTF file as JSON; its path is to be added."""
    folder, node = Path(os.environ.get("MIMESH_VALIDATOR", CLIENTS / "validator")), shutil.which("node")
    if node is None or not (folder / "node_modules" / "gltf-validator").is_dir():
        pytest.skip(f"no glTF validator in {folder}: run make clients with Node.js installed, or set MIMESH_VALIDATOR")
    return [node, str(Path(__file__).with_name("validate.cjs")), str(folder / "node_modules" / "gltf-validator")]


def three() -> list[str]:
    """Return the command that plays a skinned glTF file in three.js; the file and times in seconds are to be added."""
    return _three("play_skinned.mjs", "three-vrm")


def three_vrm_animation() -> list[str]:
    """Return the command that plays a VRM animation; avatar, animation and times in seconds are to be added."""
    return _three("play_vrma.mjs", "three-vrm-animation")


def three_joints() -> list[str]:
    """Return the command that plays joints without a mesh in three.js; file and times in seconds are to be added."""
    return _three("play_joints.mjs", "three-vrm")


def firefox() -> list[str]:
    """Return the command that walks through the pages in Firefox; player, studio and a folder are to be added."""
    folder, node = Path(os.environ.get("MIMESH_PUPPETEER", CLIENTS / "puppeteer")), shutil.which("node")
    modules, named = folder / "node_modules", os.environ.get("MIMESH_FIREFOX")
    program = next(filter(None, map(shutil.which, [named] if named else ["firefox", "firefox-esr"])), None)
    if program is None:
        pytest.skip("no Firefox on PATH: apt-get install firefox-esr, or set MIMESH_FIREFOX to its path")
    if node is None or not (modules / "puppeteer-core").is_dir():
        pytest.skip(f"no puppeteer-core in {folder}: run make clients with Node.js installed, or set MIMESH_PUPPETEER")
    command = [node, str(Path(__file__).with_name("walk_firefox.mjs")), str(modules), program]
    if os.environ.get("DISPLAY"):
        return command
    screen = shutil.which("xvfb-run")
    if screen is None or shutil.which("xauth") is None:
        pytest.skip("no display and no Xvfb, and Firefox has no WebGL without a window: apt-get install xvfb xauth")
    return [screen, "-a", "-s", "-screen 0 1400x900x24", *command]


def _three(script: str, package: str) -> list[str]:
    """Return the command that runs a script with the folder of three.js and the packages of three-vrm."""
    folder, node = Path(os.environ.get("MIMESH_THREE", CLIENTS / "three")), shutil.which("node")
    modules = folder / "node_modules"
    if node is None or not (modules / "three").is_dir() or not (modules / "@pixiv" / package).is_dir():
        pytest.skip(
            f"no three.js and {package} in {folder}: run make clients with Node.js installed, or set MIMESH_THREE"
        )
    return [node, str(Path(__file__).with_name(script)), str(modules)]


@functools.cache
def _answers(program: Path, *arguments: str) -> bool:
    return program.is_file() and not subprocess.run([program, *arguments], capture_output=True).returncode
