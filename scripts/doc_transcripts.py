"""Runs the commands whose output the documentation quotes, in a temporary folder with generated input files."""

from __future__ import annotations

import contextlib
import io
import shlex
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from trouble_cases import BODY, hero, shield, step

from mimesh import animate, save_clip, save_mesh
from mimesh.cli import run
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
    "markers": ("mimesh transfer hero.obj pose.obj -m deformation-transfer",),
}
"""Name of a transcript -> its commands, run in this order."""


def transcripts() -> dict[str, list[Transcript]]:
    """Run all of COMMANDS in one folder and return their output."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        _write_inputs()
        return {name: [run_command(command) for command in commands] for name, commands in COMMANDS.items()}


def run_command(command: str) -> Transcript:
    """Run a command in this process and return its output."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        run(shlex.split(command)[1:])
    return Transcript(command, out.getvalue().rstrip())


def _write_inputs() -> None:
    """The files that the commands name."""
    moving = driving_clip(BODY)
    for mesh, name in ((hero(), "hero.obj"), (hero(), "hero.stl"), (step(), "pose.obj")):
        save_mesh(mesh, name)
    save_clip(moving, "walk")
    animate(hero(), moving, stop=4).save_skinned("rigged.glb")
    scans = Path("scans")
    scans.mkdir()
    for t in range(3):
        scan = moving.mesh.with_vertices(moving.vertices[t].astype(np.float64)) if t < 2 else shield().identity
        save_mesh(scan, scans / f"scan_{t:03}.obj")
