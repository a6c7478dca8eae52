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
from mimesh.core.mesh import Clip
from mimesh.io import save_clip, save_mesh

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


TRANSFER = "transfer good.obj good.obj -o x.obj "
ANIMATE = "animate good.obj walk.glb -o x.glb "
TWO = "animate good.obj walk.glb run.npz -o x.glb "
RENDER = "render good.obj --size 40 -o "
REFUSED = {
    TRANSFER + "-m nonsense": "--model: expected one of",
    TRANSFER + "-m lost.onnx": "lost.onnx",
    TRANSFER + "-m copy -o x.docx": "x.docx",
    TRANSFER + "-m copy --up w": "--up",
    TRANSFER + "-m copy --ensemble 0": "--ensemble",
    TRANSFER + "-m copy --seed -1": "--seed",
    TRANSFER + "-m copy -o good.obj/x.obj": "good.obj",
    TRANSFER + "-m deformation-transfer": "--reference",
    TRANSFER + "-m deformation-transfer --reference gone.obj": "gone.obj",
    TRANSFER + "-m deformation-transfer --reference good.obj --markers gone.txt": "gone.txt: expected a file of",
    TRANSFER + "--joints nowhere.json": "nowhere.json: expected a file of joints, found none",
    TRANSFER + "--save-joints x.txt": "expected a .json file for the joints",
    "transfer . good.obj": "expected the file of the mesh to move",
    "transfer nowhere good.obj": "expected the file of the mesh to move",
    "animate .. good.obj": "expected the file of the mesh to move",
    "animate good.obj nope": "nothing of that name",
    "animate good.obj good.obj -m copy -o x.avi": "x.avi",
    ANIMATE + "-m copy --fps 0": "--fps",
    ANIMATE + "-m copy --start 7": "walk: expected --start and --stop within its 2 frames, found 7 to the end",
    ANIMATE + "-m copy --step 0": "--step",
    ANIMATE + "--morphs --names unreal": "expected joints in a .glb, .gltf or .fbx, found x.glb without",
    ANIMATE + "--morphs --root-bone": "expected joints in a .glb, .gltf or .fbx, found x.glb without",
    ANIMATE + "--blendshapes 3 --rest T": "expected joints in a .glb, .gltf or .fbx, found x.glb without",
    ANIMATE + "-o x.abc --output-fps 30": "expected joints in a .glb, .gltf or .fbx, found x.abc without",
    ANIMATE + "--names maya": "--names: expected one of own, mixamo, unreal, vrm, godot, rigify",
    ANIMATE + "--rest sitting": "--rest: expected one of file, T, A, found 'sitting'",
    ANIMATE + "--output-fps 0": "--output-fps: expected a positive frame rate, found 0",
    ANIMATE + "--morphs --skinned": "--morphs: expected it without --skinned",
    ANIMATE + "--morphs -o x.abc": "expected an output in one of .fbx .glb .gltf, found '.abc'",
    TWO + "-o x.abc": ".fbx or .vrma for 2 clips, found '.abc'",
    TWO + "--morphs": "for 2 clips, found --morphs",
    TWO + "--save-driving-joints x.json": "expected one clip with it, found 2",
    TWO + "-o walk.glb": "expected an output apart from the inputs",
    TWO + "-m copy": "expected a model with joints (mime), found copy",
    RENDER + "x.docx": "x.docx",
    RENDER + "x.gif --strip": "x.gif",
    RENDER + "x.png --strip --turntable": "--turntable",
    RENDER + "x.png good.obj --turntable": "one file",
    RENDER + "x.png --view inside": "inside",
    RENDER + "x.png --background beige": "--background: expected paper, white, dark, none or #rrggbb",
    RENDER + "x.jpg --background none": "expected a .png for --background none",
    RENDER + "x.png --track": "expected a movie of a clip with --track",
    RENDER + "x.gif --track --turntable": "found --turntable; leave it out",
    RENDER + "x.html": "expected no --size with a page",
    RENDER + "x.mp4 --strip": "expected a picture (.png or .jpg) for --strip",
    RENDER + "x.png --strip --stretch good.obj": "found --strip and --stretch",
    RENDER + "x.png --truth other.obj": "expected the truth to have 8 vertices, found 4",
    RENDER + "x.png --stretch other.obj": "expected the reference to have 8 vertices, found 4",
    "evaluate nonsense -m copy": "nonsense",
    "evaluate human-npt -m nonsense --pairs 1": "nonsense",
    "evaluate cross-body -m npt": "--data",
    "evaluate cross-body -m npt --data .": "expected",
    "evaluate characters -m npt": "--data",
    "evaluate characters -m npt --data .": "expected",
    "table npt-9": "expected a",
    "figure npt-1 -o x.png": "expected a",
    "export lost.safetensors -o x.onnx": "lost.safetensors",
    "train nonsense": "nonsense",
    "train npt --config lost.yaml -o x": "lost.yaml",
    "train npt --resume lost": "lost",
}
"""Command line -> part of the one line that it gives."""


@matrix("line", REFUSED, quick=lambda line: line.split()[0] not in ("export", "train"))  # which load PyTorch
def test_bad_option(line, good, capsys):
    cube = zoo.cube()
    for name in ("walk.glb", "run.npz"):
        save_clip(Clip(cube, np.stack([cube.vertices, cube.vertices + 1])), good / name)
    save_mesh(zoo.tetrahedron(), good / "other.obj")
    before = sorted(good.rglob("*"))
    assert run(line.split()) == 2
    text = capsys.readouterr()
    assert (text.out, len(text.err.splitlines())) == ("", 1)
    assert text.err.startswith("mimesh: ")
    assert REFUSED[line] in text.err
    assert sorted(good.rglob("*")) == before
