"""Outputs appear whole and together; left over temporary files are deleted; symbolic links stay."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import zoo
from matrix import matrix

from mimesh.__main__ import run
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Material, Part
from mimesh.io import atomic, load_mesh, save_clip, save_mesh
from mimesh.io.atomic import PREFIX, together, whole_file, whole_folder, written

posix = pytest.mark.skipif(os.name == "nt", reason="Windows has no pipes with names")


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def write(path: Path, text: str) -> None:
    with whole_file(path) as temporary:
        temporary.write_text(text)


def test_files_of_a_block_appear_at_its_end(tmp_path):
    with together():
        write(tmp_path / "a.txt", "a")
        with together():
            write(tmp_path / "b.txt", "b")
        with whole_folder(tmp_path / "frames") as folder:
            write(folder / "0.txt", "0")
            assert (folder / "0.txt").read_text() == "0"  # inside a temporary folder at once
        assert all(name.startswith(PREFIX) for name in names(tmp_path))
        assert written(tmp_path / "a.txt").read_text() == "a"
        write(tmp_path / "a.txt", "again")
    assert names(tmp_path) == ["a.txt", "b.txt", "frames"]
    assert (tmp_path / "a.txt").read_text() == "again"
    assert names(tmp_path / "frames") == ["0.txt"]
    assert written(tmp_path / "a.txt") == tmp_path / "a.txt"


@posix
@pytest.mark.parametrize("mask", [0o022, 0o077])
def test_files_have_the_rights_of_new_ones(tmp_path, mask):
    before = os.umask(mask)
    try:
        write(tmp_path / "a.txt", "a")
        with whole_file(tmp_path / "b.txt") as temporary:  # a writer that makes a file of its own
            temporary.unlink()
            temporary.touch(0o600)
    finally:
        os.umask(before)
    for name in ("a.txt", "b.txt"):
        assert (tmp_path / name).stat().st_mode & 0o777 == 0o666 & ~mask


def write_all(folder: Path, files: tuple[str, ...], error: BaseException | None = None, taken: Path | None = None):
    """Write files and a folder of frames together; at last raise an error, or take the name of one of them."""
    with together():
        for file in files:
            write(folder / file, "new")
        with whole_folder(folder / "frames") as frames:
            write(frames / "0.txt", "0")
        if taken is not None:
            (taken / "0.txt").mkdir(parents=True)
        if error is not None:
            raise error


@pytest.mark.parametrize("error", [InputError("a: no"), KeyboardInterrupt()])
def test_nothing_appears_after_a_failure(error, tmp_path):
    (tmp_path / "b.txt").write_text("old")
    with pytest.raises(type(error)):
        write_all(tmp_path, ("a.txt", "b.txt"), error)
    assert names(tmp_path) == ["b.txt"]
    assert (tmp_path / "b.txt").read_text() == "old"


def test_a_file_that_cannot_get_its_name_takes_the_others_back(tmp_path):
    (tmp_path / "old.txt").write_text("old")
    with pytest.raises(InputError, match=r"0.txt: expected a place to write to"):
        write_all(tmp_path, ("old.txt", "new.txt"), taken=tmp_path / "frames")
    assert names(tmp_path) == ["frames", "old.txt"]
    assert names(tmp_path / "frames") == ["0.txt"]
    assert (tmp_path / "old.txt").read_text() == "old"


def test_frames_of_a_folder_appear_together(tmp_path):
    (tmp_path / "out" / "0001.obj").mkdir(parents=True)
    clip = Clip(zoo.cube(), np.stack([zoo.cube().vertices] * 2))
    with pytest.raises(InputError, match="expected a place"):
        save_clip(clip, tmp_path / "out", suffix=".obj")
    assert names(tmp_path / "out") == ["0001.obj"]


def test_an_obj_appears_with_its_library_and_images_or_not_at_all(tmp_path):
    cube = dataclasses.replace(zoo.cube(), parts=(Part("a", 0, 12, Material("red", (1.0, 0.0, 0.0, 1.0))),))
    (tmp_path / "a.obj").mkdir()
    with pytest.raises(InputError, match="expected a place"):
        save_mesh(cube, tmp_path / "a.obj")
    assert names(tmp_path) == ["a.obj"]


@pytest.fixture
def pair(tmp_path):
    cube = zoo.cube()
    save_mesh(cube, tmp_path / "hero.obj")
    save_mesh(cube.with_vertices(cube.vertices * [1, 2, 1]), tmp_path / "pose.obj")
    return tmp_path


@matrix("command", ["transfer", "animate"], quick=["transfer"])
def test_a_result_without_its_page_appears_with_a_note(command, pair, capsys):
    output = {"transfer": "out.obj", "animate": "out.glb"}[command]
    (pair / "out.preview.html").mkdir()
    arguments = [command, str(pair / "hero.obj"), str(pair / "pose.obj"), "-m", "copy", "-o", str(pair / output)]
    assert run(arguments) == 0
    assert "note: out.preview.html was not written (" in capsys.readouterr().out
    assert names(pair) == sorted(["hero.obj", output, "out.preview.html", "out.preview.png", "pose.obj"])


KILLED = """
import os, signal, sys
from pathlib import Path
from mimesh.io.atomic import together, whole_file
left = int(sys.argv[2])
def hook(event, _):
    global left
    if event == "os.rename":
        left -= 1
        if left < 0:
            os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(hook)
with together():
    for name in ("a.txt", "b.txt", "f/0.txt"):
        with whole_file(Path(sys.argv[1]) / name) as temporary:
            temporary.write_text("new")
"""


@posix
@matrix("renames", [0, 1, 2], quick=[1])
def test_a_run_that_is_killed_leaves_every_file_old_or_whole_and_new(renames, tmp_path):
    (tmp_path / "f").mkdir()
    files = [tmp_path / name for name in ("a.txt", "b.txt", "f/0.txt")]
    for file in (files[0], files[2]):
        file.write_text("old")
    assert subprocess.run([sys.executable, "-c", KILLED, str(tmp_path), str(renames)]).returncode == -signal.SIGKILL
    before = ["old", None, "old"]
    contents = [file.read_text() if file.exists() else None for file in files]
    assert contents == ["new"] * renames + before[renames:]


def test_temporary_files_of_a_killed_run_go_a_day_later(tmp_path):
    old, folder, young = (tmp_path / f"{PREFIX}{name}" for name in ("old.obj", "folder", "young.obj"))
    folder.mkdir()
    for path in (old, folder / "0.obj", young):
        path.write_text("")
    for path in (old, folder):
        os.utime(path, (0.0, time.time() - 2 * atomic.STALE_SECONDS))
    (tmp_path / ".mimesh-notes").write_text("not ours")
    write(tmp_path / "b.obj", "b")
    assert names(tmp_path) == [".mimesh-notes", young.name, "b.obj"]


def test_folders_that_a_killed_run_would_leave_for_good_are_not_made():
    """Only those of `atomic` are recognised by the next run; the studio removes its own (`studio/uploads.py`)."""
    package = Path(atomic.__file__).parents[1]
    makers = ("TemporaryDirectory", "mkdtemp", "NamedTemporaryFile")
    found = {
        str(path.relative_to(package))
        for path in package.rglob("*.py")
        if any(maker in path.read_text(encoding="utf-8") for maker in makers)
    }
    assert found == {"studio/uploads.py"}


@pytest.mark.parametrize("there", [True, False])
def test_a_link_stays_and_its_target_is_replaced(there, tmp_path):
    (tmp_path / "data").mkdir()
    target, link = tmp_path / "data" / "big.obj", tmp_path / "latest.obj"
    link.symlink_to(Path("data") / "big.obj")
    if there:
        target.write_text("old")
    save_mesh(zoo.cube(), link)
    assert link.is_symlink()
    assert len(load_mesh(target).faces) == 12
    assert names(tmp_path / "data") == ["big.obj"]


def test_a_linked_frame_stays_a_link(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "0000.obj").symlink_to(tmp_path / "kept.obj")
    save_clip(Clip.still(zoo.cube()), tmp_path / "out", suffix=".obj")
    assert (tmp_path / "out" / "0000.obj").is_symlink()
    assert len(load_mesh(tmp_path / "kept.obj").faces) == 12


@posix
def test_a_pipe_is_no_output(pair, capsys):
    os.mkfifo(pair / "out.obj")
    assert run(["convert", str(pair / "hero.obj"), str(pair / "out.obj")]) == 2
    assert "out.obj: expected a file to write, found a pipe or a device" in capsys.readouterr().err
    assert (pair / "out.obj").is_fifo()
