"""Runs the commands whose output the documentation quotes, in a temporary folder with generated input files."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from trouble_cases import BODY, hero, shield, step

from mimesh import animate, save_clip, save_mesh
from mimesh.bodies.characters import character
from mimesh.cli import run
from mimesh.io import save_bvh
from mimesh.motions.procedural import walk_motion
from mimesh.tools.demo import driving_clip


class Transcript(NamedTuple):
    """A command and its output."""

    command: str
    output: str


COMMANDS = {
    "first": ("mimesh look hero.obj", "mimesh transfer hero.obj pose.obj"),
    "clip": ("mimesh animate hero.obj walk/ --fps 15",),
    "morphs": ("mimesh animate hero.obj walk/ --fps 15 --morphs -o hero-morphs.glb --no-preview",),
    "stl": ("mimesh transfer hero.stl pose.obj --no-preview",),
    "scan": ("mimesh animate hero.obj scans/",),
    "one-frame": ("mimesh animate hero.obj pose.obj --no-preview",),
    "rigged": ("mimesh look rigged.glb", "mimesh transfer rigged.glb pose.obj --no-preview"),
    "rate": ("mimesh animate hero.obj walk/ --fps 15 --stop 4 -o hero-walk.pc2 --no-preview",),
    "engine": (
        "mimesh animate hero.obj walk.bvh --names unreal --root-bone --output-fps 30 -o hero-unreal.glb --no-preview",
        "mimesh look hero-unreal.glb",
    ),
    "own-rig": ("mimesh animate rigged.glb walk.bvh --names unreal -o rigged-unreal.glb --no-preview",),
    "many": ("mimesh batch heroes/ motions/ -o 'out/{identity}-{driving}.glb' --workers 2",),
    "markers": ("mimesh transfer hero.obj pose.obj -m deformation-transfer",),
}
"""Name of a transcript -> its commands, run in this order."""
ELAPSED = re.compile(r"^\w+( \d+/\d+)?, \d+ s\n|, [\d.]+ s(?: left)?(?=$|\])|(?<=done;) [\d.]+ s,", re.MULTILINE)
"""Times in the output of commands that compute, and the lines that tell progress where there is no terminal. They are
left out: they depend on the machine and on what else it does; docs/models.md has measured ones."""


def transcripts() -> dict[str, list[Transcript]]:
    """Run all of COMMANDS in one folder and return their output."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        _write_inputs()
        return {name: [run_command(command) for command in commands] for name, commands in COMMANDS.items()}


def run_command(command: str) -> Transcript:
    """Run a command in this process and return its output, without elapsed times."""
    out, arguments = io.StringIO(), shlex.split(command)[1:]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        run(arguments)
    # `look` prints the lengths of clips, not times that have passed.
    text = out.getvalue() if arguments[0] == "look" else ELAPSED.sub("", out.getvalue())
    return Transcript(command, text.rstrip())


def _write_inputs() -> None:
    """The files that the commands name."""
    moving = driving_clip(BODY)
    for mesh, name in ((hero(), "hero.obj"), (hero(), "hero.stl"), (step(), "pose.obj")):
        save_mesh(mesh, name)
    save_clip(moving, "walk")
    save_bvh(walk_motion(BODY, 3, 26, seconds=2.0, fps=30.0), BODY, "walk.bvh")
    _write_folders()
    animate(hero(), moving, stop=4).save_skinned("rigged.glb")
    scans = Path("scans")
    scans.mkdir()
    for t in range(3):
        scan = moving.mesh.with_vertices(moving.vertices[t].astype(np.float64)) if t < 2 else shield().identity
        save_mesh(scan, scans / f"scan_{t:03}.obj")


def _write_folders() -> None:
    """The characters and motions of the batch."""
    for folder in ("heroes", "motions"):
        Path(folder).mkdir()
    for name in ("slim", "brute"):
        save_mesh(character(name), f"heroes/{name}.glb")
    for name, number in (("walk", 26), ("stroll", 27)):
        save_bvh(walk_motion(BODY, 3, number, seconds=1.0, fps=30.0), BODY, f"motions/{name}.bvh")
