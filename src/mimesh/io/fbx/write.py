"""Write FBX files: a temporary .glb is exported by Blender, which runs as a process of its own.

find_blender      the Blender that is installed: the package `bpy` or the program
write_fbx         runs `blender_export.py` in it

Blender is under the GNU General Public License. Nothing of it is part of mimesh or loaded into its process: both
exchange files. The script that Blender runs uses Blender's Python interface, so it must have a licence compatible with
the GPL 3; that of mimesh (Apache 2.0) is, and the script needs no other.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from ...core.errors import InputError
from ..atomic import scratch_folder
from ..child_process import MIB, last_line
from ..gltf.document import open_document
from .plain_materials import plain_materials
from .timeline import joined_animations

SCRIPT = Path(__file__).with_name("blender_export.py")
VARIABLE = "BLENDER"
"""Environment variable that names the program, or a Python interpreter that has `bpy`."""
PACKAGE = "bpy==4.5.15"
"""Blender as a package, in the version that was tested; its wheels are for Python 3.11."""
SECONDS, SECONDS_PER_MIB = 300.0, 30.0
"""Longest run: starting Blender takes 2 to 5 s, a character of 13,000 vertices with 300 frames (1 MiB) 4 s."""


def find_blender(path: Path) -> list[str]:
    """Return the command that runs a Python script in Blender; the script's path is to be added.

    $BLENDER comes first, then the package `bpy` of this Python, then the program on the search path.

    Raises:
        InputError: there is none, so that `path` cannot be written.
    """
    named = os.environ.get(VARIABLE)
    if named:
        program = shutil.which(named)
        if program is None:
            raise InputError(f"{path}: expected Blender at {VARIABLE}={named}, found no program there; correct it")
        return _as_python(program) if Path(program).stem.lower().startswith("python") else _as_program(program)
    if importlib.util.find_spec("bpy") is not None:
        return _as_python(sys.executable)
    program = shutil.which("blender")
    if program is None:
        raise InputError(
            f"{path}: expected Blender to write FBX, found none; pip install {PACKAGE} (in Python 3.11), or install "
            f"the program and name it in {VARIABLE}, or write a .glb"
        )
    return _as_program(program)


def _as_program(program: str) -> list[str]:
    return [program, "--background", "--factory-startup", "--python-exit-code", "1", "--python"]


def _as_python(python: str) -> list[str]:
    # Without -P, modules beside the script could be imported in place of others of their names.
    return [python, "-P", "-X", "utf8"]


def write_fbx(glb: Path, target: Path, name: Path) -> None:
    """Export a .glb as .fbx: y up, in centimetres, one take for each animation, with embedded textures.

    Args:
        name: the file that error messages name.

    Raises:
        InputError: no Blender, or one that fails or does not end.
    """
    command = find_blender(name)
    document = open_document(glb)
    draft, timeline = joined_animations(document)
    surfaces = plain_materials(draft, document)
    with scratch_folder() as folder:
        scene, job = folder / "scene.glb", folder / "job.json"
        draft.save(scene)
        # The folder of embedded images is named after the file.
        written = folder / name.with_suffix(".fbx").name
        files = {"glb": str(scene), "fbx": str(written), "errors": str(folder / "errors")}
        Path(files["errors"]).touch()
        job.write_text(json.dumps(files | timeline | surfaces), encoding="utf-8", newline="\n")
        seconds = SECONDS + SECONDS_PER_MIB * scene.stat().st_size / MIB
        code = _run([*command, str(SCRIPT), "--", str(job)], folder, seconds, name)
        if code or not written.is_file():
            message = last_line(Path(files["errors"])) or last_line(folder / "output") or f"exit code {code}"
            raise InputError(
                f"{name}: expected Blender ({command[0]}) to write FBX, found '{message[:300]}'; "
                "try another version of Blender, or write a .glb"
            )
        shutil.copyfile(written, target)


def _run(command: list[str], folder: Path, seconds: float, name: Path) -> int:
    """Run Blender in a folder without the user's settings and add-ons, and return its exit code."""
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(folder / "user")}
    with Path(folder, "output").open("wb") as output:
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
                cwd=folder,
            )
        except OSError as error:
            raise InputError(
                f"{name}: expected Blender at {command[0]}, found '{error.strerror}'; correct it"
            ) from error
        try:
            return process.wait(seconds)
        except subprocess.TimeoutExpired as error:
            raise InputError(
                f"{name}: expected Blender to write it in {seconds:.0f} s, found it still running; write a .glb"
            ) from error
        finally:
            # Also on Ctrl-C: Blender does not outlive its caller.
            process.kill()
            process.wait()
