"""Wrong input to the command: exit code 2, one line that says what to do, no traceback, no files left."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from itertools import cycle, product
from pathlib import Path

import numpy as np
import pytest
import zoo
from matrix import matrix

from mimesh.cli import run
from mimesh.io import save_mesh

MIMESH = Path(sys.executable).with_name("mimesh")
BAD_MESHES = {
    "nowhere.obj": None,
    "empty.obj": b"# nothing here\n",
    "nan.obj": b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n",
    "inf.obj": b"v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n",
    "range.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "line.obj": b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n",
    "point.obj": b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n",
    "mesh.docx": b"v 0 0 0\n",
    "mesh": b"v 0 0 0\n",
    "noise.glb": np.random.default_rng(0).bytes(500),
    "zero.ply": b"",
    "half.glb": "cut",
    "half.ply": "cut",
}
"""File name -> contents; None for no file, "cut" for the first half of a sound one."""
BAD_CLIPS = ("notes", "mixed")
"""Folders: one without meshes, and one of frames of different topology."""
COMMANDS = {
    "identity": ["transfer", "BAD", "good.obj", "-m", "copy"],
    "driving": ["transfer", "good.obj", "BAD", "-m", "copy", "--json"],
    "clip": ["animate", "good.obj", "BAD", "-m", "copy"],
    "look": ["look", "BAD"],
    "render": ["render", "BAD", "-o", "x.png"],
}
CLIPS_TOO = ("clip", "look", "render")


@pytest.fixture
def good(tmp_path: Path, monkeypatch) -> Path:
    """The folder of the test, with good.obj."""
    monkeypatch.chdir(tmp_path)
    save_mesh(zoo.cube(), tmp_path / "good.obj")
    return tmp_path


def write_bad(name: str) -> None:
    """Write one of BAD_MESHES or BAD_CLIPS."""
    if name in BAD_CLIPS:
        Path(name).mkdir()
        Path(name, "readme.txt").write_text("nothing to see")
        for t, mesh in enumerate((zoo.cube(), zoo.cube(), zoo.tetrahedron()) if name == "mixed" else ()):
            save_mesh(dataclasses.replace(mesh, source=None), Path(name, f"{t}.obj"))
    elif BAD_MESHES[name] == "cut":
        save_mesh(zoo.cube(), name)
        content = Path(name).read_bytes()
        Path(name).write_bytes(content[: len(content) // 2])
    elif BAD_MESHES[name] is not None:
        Path(name).write_bytes(BAD_MESHES[name])


@matrix(
    ("command", "name"),
    [*product(COMMANDS, BAD_MESHES), *product(CLIPS_TOO, BAD_CLIPS)],
    quick=[*zip(cycle(COMMANDS), BAD_MESHES, strict=False), ("clip", "mixed"), ("look", "notes")],
)
def test_a_bad_file_is_refused_by_every_command(command, name, good, capsys):
    write_bad(name)
    before = sorted(good.rglob("*"))
    assert run([name if word == "BAD" else word for word in COMMANDS[command]]) == 2
    text = capsys.readouterr()
    assert text.out == ""
    assert text.err.startswith("mimesh: ")
    assert len(text.err.splitlines()) == 1
    assert all(word in text.err for word in (name, "expected", "found", ";"))
    assert sorted(good.rglob("*")) == before


def test_bad_input_in_a_separate_process(good):
    write_bad("mixed")
    before = sorted(good.rglob("*"))
    done = subprocess.run([MIMESH, "animate", "good.obj", "mixed", "-m", "copy"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert "mixed" in done.stderr
    assert sorted(good.rglob("*")) == before


@matrix(
    ("args", "part"),
    [
        (["transfer", "good.obj", "good.obj", "-m", "nonsense", "-o", "x.obj"], "--model"),
        (["transfer", "good.obj", "good.obj", "-m", "lost.onnx", "-o", "x.obj"], "lost.onnx"),
        (["transfer", "good.obj", "good.obj", "-m", "copy", "-o", "x.docx"], "x.docx"),
        (["transfer", "good.obj", "good.obj", "-m", "copy", "-o", "x.obj", "--up", "w"], "--up"),
        (["transfer", "good.obj", "good.obj", "-m", "copy", "-o", "x.obj", "--ensemble", "0"], "--ensemble"),
        (["transfer", "good.obj", "good.obj", "-m", "copy", "-o", "good.obj/x.obj"], "good.obj"),
        (["animate", "good.obj", "good.obj", "-m", "copy", "-o", "x.avi"], "x.avi"),
        (["animate", "good.obj", "good.obj", "-m", "copy", "-o", "x.glb", "--fps", "0"], "--fps"),
        (["animate", "good.obj", "good.obj", "-m", "copy", "-o", "x.glb", "--start", "7"], "--start"),
        (["animate", "good.obj", "good.obj", "-m", "copy", "-o", "x.glb", "--step", "0"], "--step"),
        (["render", "good.obj", "-o", "x.docx"], "x.docx"),
        (["render", "good.obj", "--strip", "-o", "x.gif"], "x.gif"),
        (["render", "good.obj", "--strip", "--turntable", "-o", "x.png"], "--turntable"),
        (["render", "good.obj", "good.obj", "--turntable", "-o", "x.png"], "one file"),
        (["render", "good.obj", "--view", "inside", "-o", "x.png"], "inside"),
        (["evaluate", "nonsense", "-m", "copy"], "nonsense"),
        (["evaluate", "human-npt", "-m", "nonsense", "--pairs", "1"], "nonsense"),
        (["export", "lost.safetensors", "-o", "x.onnx"], "lost.safetensors"),
        (["train", "nonsense"], "nonsense"),
        (["train", "npt", "--config", "lost.yaml", "-o", "x"], "lost.yaml"),
        (["train", "npt", "--resume", "lost"], "lost"),
    ],
    quick=lambda case: case[0][0] not in ("export", "train"),  # which load PyTorch
)
def test_bad_option(args, part, good, capsys):
    assert run(args) == 2
    text = capsys.readouterr()
    assert (text.out, len(text.err.splitlines())) == ("", 1)
    assert part in text.err
    assert [path.name for path in good.iterdir()] == ["good.obj"]
