"""Wrong input to the command: exit code 2, one line that says what to do, no traceback, no files left, no waiting."""

from __future__ import annotations

import dataclasses
import importlib.util
import os
import signal
import subprocess
import sys
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
import zoo
from matrix import matrix

from mimesh.core.mesh import Clip
from mimesh.io import save_clip, save_mesh

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
REFUSING = ("transfer BAD good.obj -m copy", "transfer good.obj BAD -m copy --json", "look BAD", "render BAD -o x.png")
ANIMATION = "animate good.obj BAD -m copy"
BAD_FILES = [
    *zip(cycle((*REFUSING, ANIMATION)), BAD_MESHES, strict=False),
    pytest.param(ANIMATION, "mixed", marks=pytest.mark.slow),
    ("look BAD", "notes"),
]
"""A command line for each bad file: all commands read files by the same functions."""


@pytest.fixture
def good(tmp_path: Path, monkeypatch) -> Path:
    """The folder of the test, with good.obj."""
    monkeypatch.chdir(tmp_path)
    save_mesh(zoo.cube(), tmp_path / "good.obj")
    return tmp_path


def write_bad(name: str) -> None:
    """Write one of BAD_MESHES, or a folder without meshes, or one of frames of different topology."""
    if name in ("notes", "mixed"):
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


def refused(line: str, call, folder: Path) -> str:
    """Run a command that fails; return the one line that it prints, after which no file is left."""
    before = sorted(folder.rglob("*"))
    code, out, err = call(line)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert err.startswith("mimesh: ")
    assert sorted(folder.rglob("*")) == before
    return err


@pytest.mark.parametrize(("line", "name"), BAD_FILES)
def test_a_bad_file_is_refused(line, name, good, call):
    write_bad(name)
    message = refused(line.replace("BAD", name), call, good)
    assert all(word in message for word in (name, "expected", "found", ";"))


@pytest.mark.parametrize("output", ["x.usdc", "x.mp4"])
@pytest.mark.parametrize(
    "verb", ["convert noise.glb", "transfer noise.glb good.obj -o", "animate noise.glb good.obj -o"]
)
def test_what_writes_a_format_is_looked_for_before_a_file_is_read(verb, output, good, call, monkeypatch):
    find = importlib.util.find_spec
    hidden = ("pxr", "av")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name in hidden else find(name, *rest))
    write_bad("noise.glb")
    library = "usd-core to write USD" if output == "x.usdc" else "PyAV to write MP4"
    assert f"{output}: expected {library}, found it not installed" in refused(f"{verb} {output}", call, good)


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
    TRANSFER + "-m copy -o good.obj/": "expected a folder for the output, found a file",
    TRANSFER + "-m copy --open --no-preview": "--open: expected a page",
    TRANSFER + "-m copy --threads 0": "--threads: expected 1 or more, found 0",
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
    "animate good.obj good.obj -m copy -o x.obj": "name it without a suffix: -o x",
    "convert walk.glb x.npz --animation Walk --animation Run": "--animation: expected it once, found Walk, Run",
    "render walk.glb -o x.png --animation Walk --animation Run": "--animation: expected it once, found Walk, Run",
    "render good.obj --truth other.obj -o x.html": "expected the truth to have 8 vertices, found 4",
    "demo --body fish": "expected human or quadruped, found 'fish'",
    "nonsense": "--help",
    "look good.obj --wrong": "--help",
    "render good.obj": "--help",
    ANIMATE + "-m copy --fps 0": "--fps",
    ANIMATE + "-m copy --start 7": "walk: expected --start and --stop within its 2 frames, found 7 to the end",
    ANIMATE + "-m copy --step 0": "--step",
    ANIMATE + "--morphs --names unreal": "expected joints in a .glb, .gltf or .fbx, found x.glb without",
    ANIMATE + "--morphs --root-bone": "expected joints in a .glb, .gltf or .fbx, found x.glb without",
    ANIMATE + "--morphs --rest T": "expected joints in a .glb, .gltf or .fbx, found x.glb without",
    ANIMATE + "-o x.usdc --output-fps 30": "expected joints in a .glb, .gltf or .fbx, found x.usdc without",
    ANIMATE + "--names maya": "--names: expected one of own, mixamo, unreal, vrm, godot, rigify",
    ANIMATE + "--names ureal": "found 'ureal'; did you mean unreal?",
    ANIMATE + "--rest sitting": "--rest: expected one of file, T, A, found 'sitting'",
    ANIMATE + "--output-fps 0": "--output-fps: expected a frame rate from 0.001 to 10,000, found 0",
    ANIMATE + "--output-fps 1e9": "--output-fps: expected a frame rate from 0.001 to 10,000, found 1e+09",
    ANIMATE + "--morphs --skinned": "--morphs: expected it without --skinned",
    ANIMATE + "--morphs -o x.usdc": "expected an output in one of .fbx .glb .gltf, found '.usdc'",
    TWO + "-o x.usdc": ".fbx or .vrma for 2 clips, found '.usdc'",
    TWO + "--morphs": "for 2 clips, found --morphs",
    TWO + "--save-driving-joints x.json": "expected one clip with it, found 2",
    TWO + "-o walk.glb": "expected an output apart from the inputs",
    TWO + "-m copy": "expected a model with joints (mime), found copy",
    RENDER + "x.docx": "x.docx",
    RENDER + "x.gif --strip": "x.gif",
    RENDER + "x.gif --strip --turntable": "--turntable",
    RENDER + "x.gif good.obj --turntable": "one file",
    RENDER + "x.png --turntable": "expected a movie (.gif .mp4 .webp) for --turntable",
    RENDER + "x.png --view inside": "inside",
    RENDER + "x.png --background beige": "--background: expected paper, white, dark, none or #rrggbb",
    RENDER + "x.jpg --background none": "expected a .png for --background none",
    RENDER + "x.png --track": "expected a movie of a clip with --track",
    RENDER + "x.gif --track --turntable": "found --turntable; leave it out",
    RENDER + "x.html": "expected no --size with a page",
    RENDER + "x.mp4 --strip": "expected a picture (.png or .jpg) for --strip",
    RENDER + "x.png --strip --truth good.obj": "found --strip and --truth",
    RENDER + "x.png --truth other.obj": "expected the truth to have 8 vertices, found 4",
    "evaluate nonsense -m copy": "nonsense",
    "evaluate human-npt -m nonsense --pairs 1": "nonsense",
    "evaluate human-npt -m ,": "--model: expected one model or more",
    "evaluate cross-body -m npt": "--data",
    "evaluate cross-body -m npt --data .": "expected",
    "evaluate characters -m npt": "--data",
    "evaluate characters -m npt --data .": "expected",
    "evaluate human-npt -m npt --data .": "--data: expected none with human-npt",
    "table npt-9": "expected a",
    "export lost.safetensors -o x.onnx": "lost.safetensors",
    "train nonsense": "nonsense",
    "train npt --config lost.yaml -o x": "lost.yaml",
    "train npt --resume lost": "lost",
}
"""Command line -> part of the one line that it gives."""


@matrix("line", REFUSED, quick=lambda line: line.split()[0] not in ("export", "train"))  # which load PyTorch
def test_bad_option(line, good, call):
    cube = zoo.cube()
    for name in ("walk.glb", "run.npz"):
        save_clip(Clip(cube, np.stack([cube.vertices, cube.vertices + 1])), good / name)
    save_mesh(zoo.tetrahedron(), good / "other.obj")
    assert REFUSED[line] in refused(line, call, good)


@pytest.fixture
def deadline():
    """Fail where a pipe is waited for."""

    def fail(*_):
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(120)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes in folders")
@matrix(
    "line",
    [
        "look PIPE.npz",
        "look /dev/zero",
        "transfer PIPE.obj good.obj",
        "animate good.obj PIPE.bvh",
        "convert PIPE.glb b.obj",
        "batch PIPE.csv --quiet",
        "train npt --config PIPE.yaml",
        TRANSFER + "-m deformation-transfer --markers PIPE.txt",
        TRANSFER + "-m PIPE.onnx",
        TRANSFER + "--joints PIPE.json",
    ],
    quick=lambda line: not line.startswith("train"),  # which loads PyTorch
)
def test_pipes_and_devices_are_refused_and_never_waited_for(line, good, deadline, call):
    for word in line.split():
        if word.startswith("PIPE"):
            os.mkfifo(word)
    message = refused(line, call, good)
    assert "found a pipe or a device; save what comes from it as a file first" in message


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no such device")
def test_stdin_may_be_a_file_but_not_a_pipe():
    command = [sys.executable, "-m", "mimesh", "look", "/dev/stdin"]
    done = subprocess.run(command, input=b"v 0 0 0\n", capture_output=True, timeout=60)
    assert (done.returncode, b"found a pipe or a device" in done.stderr) == (2, True)
