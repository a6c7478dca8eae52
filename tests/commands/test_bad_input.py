"""Wrong input to the command: exit code 2, one line that says what to do, no traceback, no files left."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zoo

from mimesh.cli import run
from mimesh.io import save_mesh

MIMESH = Path(sys.executable).with_name("mimesh")


def _obj(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def missing_file(folder: Path) -> Path:
    return folder / "nowhere.obj"


def empty_mesh(folder: Path) -> Path:
    return _obj(folder / "empty.obj", "# nothing here\n")


def nan_coordinates(folder: Path) -> Path:
    return _obj(folder / "nan.obj", "v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n")


def infinite_coordinates(folder: Path) -> Path:
    return _obj(folder / "inf.obj", "v 0 0 0\nv inf 0 0\nv 0 1 0\nf 1 2 3\n")


def face_index_out_of_range(folder: Path) -> Path:
    return _obj(folder / "range.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n")


def zero_area(folder: Path) -> Path:
    return _obj(folder / "line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")


def one_point(folder: Path) -> Path:
    return _obj(folder / "point.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n")


def wrong_suffix(folder: Path) -> Path:
    return _obj(folder / "mesh.docx", "v 0 0 0\n")


def no_suffix(folder: Path) -> Path:
    return _obj(folder / "mesh", "v 0 0 0\n")


def truncated_glb(folder: Path) -> Path:
    save_mesh(zoo.cube(), folder / "whole.glb")
    content = (folder / "whole.glb").read_bytes()
    (folder / "whole.glb").unlink()
    (folder / "half.glb").write_bytes(content[: len(content) // 2])
    return folder / "half.glb"


def glb_of_noise(folder: Path) -> Path:
    (folder / "noise.glb").write_bytes(np.random.default_rng(0).bytes(500))
    return folder / "noise.glb"


def zero_bytes(folder: Path) -> Path:
    return _obj(folder / "zero.ply", "")


def truncated_ply(folder: Path) -> Path:
    save_mesh(zoo.cube(), folder / "cut.ply")
    content = (folder / "cut.ply").read_bytes()
    (folder / "cut.ply").write_bytes(content[:-40])
    return folder / "cut.ply"


def folder_without_meshes(folder: Path) -> Path:
    (folder / "notes").mkdir()
    (folder / "notes" / "readme.txt").write_text("nothing to see")
    return folder / "notes"


def frames_of_different_topology(folder: Path) -> Path:
    (folder / "mixed").mkdir()
    for t, mesh in enumerate((zoo.cube(), zoo.cube(), zoo.tetrahedron())):
        save_mesh(dataclasses.replace(mesh, source=None), folder / "mixed" / f"{t}.obj")
    return folder / "mixed"


BAD_MESHES = (
    missing_file,
    empty_mesh,
    nan_coordinates,
    infinite_coordinates,
    face_index_out_of_range,
    zero_area,
    one_point,
    wrong_suffix,
    no_suffix,
    truncated_glb,
    glb_of_noise,
    zero_bytes,
    truncated_ply,
)
BAD_CLIPS = (folder_without_meshes, frames_of_different_topology)
Maker = Callable[[Path], Path]


@pytest.fixture
def good(tmp_path: Path) -> Path:
    save_mesh(zoo.cube(), tmp_path / "good.obj")
    return tmp_path / "good.obj"


def check(args: list[str], bad: Path, capsys) -> None:
    """Check that a command exits with 2 and one line about the bad file, and leaves the folder unchanged."""
    folder = bad.parent
    before = sorted(folder.rglob("*"))
    assert run(args) == 2
    text = capsys.readouterr()
    assert text.out == ""
    assert text.err.startswith("mimesh: ")
    assert len(text.err.splitlines()) == 1
    assert bad.name in text.err
    assert "expected" in text.err
    assert "found" in text.err
    assert ";" in text.err
    assert "Traceback" not in text.err
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("make", BAD_MESHES)
def test_bad_identity(make: Maker, good: Path, capsys):
    bad = make(good.parent)
    check(["transfer", str(bad), str(good), "-m", "copy"], bad, capsys)


@pytest.mark.parametrize("make", BAD_MESHES)
def test_bad_driving_mesh(make: Maker, good: Path, capsys):
    bad = make(good.parent)
    check(["transfer", str(good), str(bad), "-m", "copy", "--json"], bad, capsys)


@pytest.mark.parametrize("make", BAD_MESHES + BAD_CLIPS)
def test_bad_clip(make: Maker, good: Path, capsys):
    bad = make(good.parent)
    check(["animate", str(good), str(bad), "-m", "copy"], bad, capsys)


@pytest.mark.parametrize("make", BAD_MESHES + BAD_CLIPS)
def test_bad_file_to_look_at_or_render(make: Maker, good: Path, capsys):
    bad = make(good.parent)
    check(["look", str(bad)], bad, capsys)
    check(["render", str(bad), "-o", str(good.parent / "x.png")], bad, capsys)


@pytest.mark.parametrize("make", [face_index_out_of_range, truncated_glb, frames_of_different_topology])
def test_bad_input_in_a_separate_process(make: Maker, good: Path):
    bad = make(good.parent)
    before = sorted(good.parent.rglob("*"))
    done = subprocess.run([MIMESH, "animate", good, bad, "-m", "copy"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert bad.name in done.stderr
    assert sorted(good.parent.rglob("*")) == before


@pytest.mark.parametrize(
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
)
def test_bad_option(args: list[str], part: str, good: Path, capsys, monkeypatch):
    monkeypatch.chdir(good.parent)
    assert run(args) == 2
    text = capsys.readouterr()
    assert (text.out, len(text.err.splitlines())) == ("", 1)
    assert part in text.err
    assert list(good.parent.iterdir()) == [good]
