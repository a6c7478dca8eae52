"""Where outputs go, and how large they may be."""

from __future__ import annotations

from pathlib import Path

import pytest
import zoo
from matrix import matrix
from people import walk

from mimesh.cli import run
from mimesh.core import output_size
from mimesh.core.errors import InputError
from mimesh.core.output_size import frames_size
from mimesh.io import save_clip, save_mesh


def transfer(files: Path, *options: str | Path) -> int:
    words = ["transfer", files / "hero.obj", files / "pose.obj", "-m", "copy", "--no-preview", *options]
    return run([str(word) for word in words])


def animate(files: Path, *options: str | Path) -> int:
    words = ["animate", files / "hero.obj", files / "walk", "-m", "copy", "--no-preview", *options]
    return run([str(word) for word in words])


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.mark.parametrize("slash", ["", "/"])
def test_a_folder_gets_the_usual_name(slash, files, capsys):
    folder = files / "results"
    if not slash:
        folder.mkdir()
    assert transfer(files, "-o", f"{folder}{slash}") == 0
    assert names(folder) == {"hero-pose.obj"}
    assert animate(files, "-o", f"{folder}{slash}") == 0
    assert names(folder) == {"hero-pose.obj", "hero-walk.glb"}
    assert transfer(files, "-o", f"{files / 'hero.obj'}/") == 2
    assert "expected a folder for the output, found a file" in capsys.readouterr().err
    assert transfer(files, "-o", " ") == 2
    assert "--output: expected a path, found an empty text" in capsys.readouterr().err


def test_frames_are_not_written_among_other_meshes(files):
    before = names(files)
    assert animate(files, "-o", f"{files}/.") == 0  # a folder that is there gets the usual name
    with pytest.raises(InputError, match="expected a new folder for frames, found hero"):
        save_clip(walk(), files)
    assert before <= names(files)
    assert not (files / "0000.obj").exists()


def test_a_capture_as_the_mesh_to_move_is_refused(files, capsys):
    (files / "dance.bvh").touch()
    for command in ("transfer", "animate"):
        assert run([command, str(files / "dance.bvh"), str(files / "hero.obj")]) == 2
        assert "found .bvh, which has joints alone; give it as DRIVING" in capsys.readouterr().err


def test_no_clobber_stops_before_the_work(files, capsys, monkeypatch):
    assert transfer(files, "-n") == 0
    before = (files / "hero-pose.obj").read_bytes()
    monkeypatch.setattr("mimesh.io.load_mesh", lambda *_: pytest.fail("the work has begun"))
    assert transfer(files, "-n") == 2
    assert "hero-pose.obj: expected nothing there with --no-clobber, found a file" in capsys.readouterr().err
    (files / "hero-walk.glb").touch()
    assert animate(files, "--no-clobber") == 2
    assert "hero-walk.glb: expected nothing there" in capsys.readouterr().err
    assert (files / "hero-pose.obj").read_bytes() == before


def test_no_clobber_heeds_the_files_beside_an_output(files, capsys):
    (files / "hero-pose.preview.html").touch()
    words = ["transfer", files / "hero.obj", files / "pose.obj", "-m", "copy", "-n"]
    assert run([str(word) for word in words]) == 2
    assert "hero-pose.preview.html" in capsys.readouterr().err
    (files / "x.ply").touch()
    assert run(["convert", str(files / "hero.obj"), str(files / "x.ply"), "-n"]) == 2
    (files / "x.png").touch()
    assert run(["render", str(files / "hero.obj"), "-o", str(files / "x.png"), "-n"]) == 2


@matrix(
    "suffix",
    [".glb", ".gltf", ".npz", ".npy", ".pc2", ".mdd", ".usda", ".usdc", ".abc"],
    quick=[".glb", ".npz", ".usdc"],
)
def test_estimated_sizes_are_near_those_of_files(suffix, tmp_path):
    if suffix.startswith(".us"):
        pytest.importorskip("pxr")
    if suffix == ".abc":
        pytest.importorskip("alembic3d")
    clip = walk()
    save_clip(clip, tmp_path / f"walk{suffix}")
    size = sum(path.stat().st_size for path in tmp_path.iterdir() if path.suffix != ".obj")
    estimate = frames_size(suffix, len(clip.mesh.vertices), len(clip))
    once = 200 * len(clip.mesh.vertices) + 20_000  # triangles, headers
    assert 0.7 * estimate < size < 1.3 * estimate + once


def test_too_large_outputs_are_refused_before_the_work_unless_asked_for(files, capsys, monkeypatch):
    monkeypatch.setattr(output_size, "LARGEST_OUTPUT", 250.0)
    for suffix in (".glb", ".npz", ""):
        assert animate(files, "-o", files / f"out{suffix}") == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "expected an output of at most 0 MB, found about" in line
        assert "--step" in line
        assert "--large" in line
        assert not (files / f"out{suffix}").exists()
        assert animate(files, "-o", files / f"out{suffix}", "--large", "-q") == 0
    assert run(["convert", str(files / "walk"), str(files / "walk.npz")]) == 2
    assert "--large" in capsys.readouterr().err
    assert run(["convert", str(files / "walk"), str(files / "walk.npz"), "--large"]) == 0


def test_what_was_not_expected_to_be_large_is_not_kept(files, capsys, monkeypatch):
    monkeypatch.setattr(output_size, "LARGEST_OUTPUT", 100.0)
    assert transfer(files) == 2
    assert "expected an output of at most 0 MB, found 0 MB to write" in capsys.readouterr().err
    assert not (files / "hero-pose.obj").exists()
    assert transfer(files, "--large") == 0
    save_mesh(zoo.cube(), files / "python.obj")  # Python has no limit


def test_the_size_of_a_large_output_is_told_before_the_work(files, capsys, monkeypatch):
    monkeypatch.setattr(output_size, "TOLD_OUTPUT", 300.0)
    assert animate(files) == 0
    assert "about 0 MB will be written" in capsys.readouterr().err
    assert animate(files, "-q") == 0
    assert capsys.readouterr().err == ""
