"""Where outputs go, and how large they may be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zoo
from matrix import matrix
from people import walk

from mimesh.core import output_size
from mimesh.core.errors import InputError
from mimesh.core.output_size import frames_size
from mimesh.io import save_clip, save_mesh

TRANSFER = "transfer hero.obj pose.obj -m copy --no-preview "
ANIMATE = "animate hero.obj walk -m copy --no-preview "


def names(folder: str = ".") -> set[str]:
    return {path.name for path in Path(folder).iterdir()}


@pytest.mark.parametrize("slash", ["", "/"])
def test_a_folder_gets_the_usual_name(slash, files, call):
    if not slash:
        Path("results").mkdir()
    assert call(f"{TRANSFER} -o results{slash}").code == 0
    assert names("results") == {"hero-pose.obj"}
    assert call(f"{ANIMATE} -o results{slash}").code == 0
    assert names("results") == {"hero-pose.obj", "hero-walk.glb"}


def test_frames_are_not_written_among_other_meshes(files, call):
    before = names()
    assert call(f"{ANIMATE} -o {files}/.").code == 0  # a folder that is there gets the usual name
    with pytest.raises(InputError, match="expected a new folder for frames, found hero"):
        save_clip(walk(), files)
    assert before <= names()
    assert "0000.obj" not in names()


@pytest.mark.parametrize("command", ["transfer", "animate"])
def test_a_capture_as_the_mesh_to_move_is_refused(command, files, refuses):
    Path("dance.bvh").touch()
    np.savez("amass.npz", poses=np.zeros((2, 156)), trans=np.zeros((2, 3)), mocap_framerate=30.0)
    for name in ("dance.bvh", "amass.npz"):
        refuses(f"{command} {name} hero.obj", "found a file of joints alone; give it as DRIVING")


def test_an_output_without_a_suffix_is_refused_before_the_work(files, refuses, monkeypatch):
    np.savez("amass.npz", poses=np.zeros((2, 156)), trans=np.zeros((2, 3)), mocap_framerate=30.0)
    monkeypatch.setattr("mimesh.pipeline.transfer", lambda *_, **__: pytest.fail("the work has begun"))
    refuses("transfer amass.npz hero.obj -o out", "out: expected ")


@pytest.mark.parametrize(
    ("line", "there"),
    [
        (TRANSFER, "hero-pose.obj"),
        ("transfer hero.obj pose.obj -m copy", "hero-pose.preview.html"),
        (ANIMATE, "hero-walk.glb"),
        ("convert hero.obj x.ply", "x.ply"),
        ("render hero.obj -o x.png", "x.png"),
    ],
)
def test_no_clobber_stops_before_the_work(line, there, files, refuses, monkeypatch):
    monkeypatch.setattr("mimesh.io.load_mesh", lambda *_: pytest.fail("the work has begun"))
    Path(there).touch()
    refuses(f"{line} -n", f"{there}: expected nothing there with --no-clobber, found a file")
    assert Path(there).read_bytes() == b""


@matrix(
    "suffix",
    [".glb", ".gltf", ".npz", ".pc2", ".usda", ".usdc"],
    quick=[".glb", ".npz", ".pc2"],
)
def test_estimated_sizes_are_near_those_of_files(suffix, tmp_path):
    if suffix.startswith(".us"):
        pytest.importorskip("pxr")
    clip = walk()
    save_clip(clip, tmp_path / f"walk{suffix}")
    size = sum(path.stat().st_size for path in tmp_path.iterdir() if path.suffix != ".obj")
    estimate = frames_size(suffix, len(clip.mesh.vertices), len(clip))
    once = 200 * len(clip.mesh.vertices) + 20_000  # triangles, headers
    assert 0.7 * estimate < size < 1.3 * estimate + once


@pytest.mark.parametrize(
    "line", [*(f"{ANIMATE} -o out{suffix}" for suffix in (".glb", ".npz", "")), "convert walk x.npz"]
)
def test_too_large_outputs_are_refused_before_the_work_unless_asked_for(line, files, call, monkeypatch):
    monkeypatch.setattr(output_size, "LARGEST_OUTPUT", 250.0)
    before = names()
    code, _, err = call(line)
    assert (code, len(err.splitlines())) == (2, 1)
    assert "expected an output of at most 0 MB, found about" in err
    assert "--step" in err or line.startswith("convert")
    assert "--large" in err
    assert names() == before
    assert call(line + " --large").code == 0


def test_what_was_not_expected_to_be_large_is_not_kept(files, call, refuses, monkeypatch):
    monkeypatch.setattr(output_size, "LARGEST_OUTPUT", 100.0)
    refuses(TRANSFER, "expected an output of at most 0 MB, found 0 MB to write")
    assert "hero-pose.obj" not in names()
    assert call(TRANSFER + "--large").code == 0
    save_mesh(zoo.cube(), files / "python.obj")  # Python has no limit


def test_the_size_of_a_large_output_is_told_before_the_work(files, call, monkeypatch):
    monkeypatch.setattr(output_size, "TOLD_OUTPUT", 300.0)
    assert "about 0 MB will be written" in call(ANIMATE).err
    assert call(ANIMATE + "-q").err == ""
