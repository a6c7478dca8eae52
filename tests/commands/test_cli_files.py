"""The `mimesh` command keeps existing files, notes what a format cannot hold, and refuses odd arguments."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import zoo

from mimesh.cli import run
from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.io import load_mesh, save_clip, save_mesh


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """hero.glb, with a material, and pose.obj."""
    cube = zoo.cube()
    hero = dataclasses.replace(cube, parts=(Part("all", 0, 12, Material("red", (1.0, 0.0, 0.0, 1.0))),))
    save_mesh(hero, tmp_path / "hero.glb")
    pose = load_mesh(tmp_path / "hero.glb")  # with the vertices that `copy` needs
    save_mesh(Mesh(pose.vertices * [1, 2, 1], pose.faces), tmp_path / "pose.obj")
    return tmp_path


def transfer(files, *more):
    arguments = ["transfer", str(files / "hero.glb"), str(files / "pose.obj"), "-m", "copy", "--no-preview"]
    return run([*arguments, *map(str, more)])


def test_existing_material_library_is_not_overwritten(files):
    (files / "out.mtl").write_text("newmtl mine\n")
    assert transfer(files, "-o", files / "out.obj") == 0
    assert (files / "out.mtl").read_text() == "newmtl mine\n"
    assert "mtllib out-2.mtl" in (files / "out.obj").read_text()
    assert transfer(files, "-o", files / "out.obj") == 0  # our own file may be overwritten
    assert sorted(path.name for path in files.glob("*.mtl")) == ["out-2.mtl", "out.mtl"]


@pytest.mark.parametrize("suffix", [".off", ".npz", ".stl", ".ply"])
def test_what_a_format_cannot_hold_is_noted(files, suffix, capsys):
    assert transfer(files, "-o", files / f"out{suffix}", "--json") == 0
    notes = json.loads(capsys.readouterr().out)["report"]["notes"]
    assert any("materials" in note and f"out{suffix}" in note for note in notes)


def test_nothing_is_noted_where_nothing_is_lost(files, capsys):
    assert transfer(files, "-o", files / "out.glb", "--json") == 0
    assert not any("left out" in note for note in json.loads(capsys.readouterr().out)["report"]["notes"])


def test_look_prints_the_good_files_beside_a_bad_one(files, capsys):
    (files / "bad.obj").write_text("")
    assert run(["look", str(files / "bad.obj"), str(files / "pose.obj")]) == 2
    text = capsys.readouterr()
    assert "pose.obj" in text.out
    assert "bad.obj: expected a mesh, found an empty file" in text.err


def test_no_next_command_after_a_movie(files, capsys):
    assert run(["convert", str(files / "pose.obj"), str(files / "pose.gif")]) == 0
    assert "next:" not in capsys.readouterr().out


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
def test_terminated_run_leaves_no_partial_file(files, tmp_path):
    save_clip(Clip(zoo.cube(), np.repeat(zoo.cube().vertices[None], 2000, axis=0)), files / "long.npz")
    out = tmp_path / "out"
    command = [sys.executable, "-m", "mimesh", "convert", str(files / "long.npz"), str(out / "frames"), "-q"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE)
    while process.poll() is None and not (out.is_dir() and list(out.iterdir())):
        time.sleep(0.001)
    process.terminate()
    _, error = process.communicate(timeout=60)
    assert (process.returncode, error.decode().strip()) == (130, "mimesh: stopped")
    assert not list(out.iterdir())
