"""Outputs appear whole and together; left over temporary files are deleted; symbolic links stay."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import zoo

from mimesh.cli import run
from mimesh.core import system
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Material, Part
from mimesh.io import atomic, load_mesh, save_clip, save_mesh
from mimesh.io.atomic import PREFIX, scratch_folder, together, whole_file, whole_folder, written

posix = pytest.mark.skipif(os.name == "nt", reason="Windows has neither these locks nor pipes with names")


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


@pytest.mark.parametrize("command", ["transfer", "animate"])
def test_a_result_without_its_page_does_not_appear(command, pair, capsys):
    output = {"transfer": "out.obj", "animate": "out.glb"}[command]
    (pair / "out.preview.html").mkdir()
    arguments = [command, str(pair / "hero.obj"), str(pair / "pose.obj"), "-m", "npt-maxpool", "-o", str(pair / output)]
    assert run(arguments) == 2
    assert "out.preview.html: expected a place" in capsys.readouterr().err
    assert names(pair) == ["hero.obj", "out.preview.html", "pose.obj"]


def killed_writer(folder: Path, program: str) -> None:
    """Start a process that writes to a folder, and kill it while it does."""
    code = "import sys, time; from pathlib import Path; from mimesh.io.atomic import *; p = Path(sys.argv[1])\n"
    with subprocess.Popen([sys.executable, "-c", code + program, str(folder)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        process.kill()


@posix
def test_temporary_files_of_a_killed_run_go_with_the_next(tmp_path):
    program = (
        "with together(), whole_file(p / 'a.obj'), whole_folder(p / 'f') as f, scratch_folder(p):\n"
        "  (f / '0.obj').write_text('0'); print(flush=True); time.sleep(100)"
    )
    killed_writer(tmp_path, program)
    assert len(names(tmp_path)) == 3
    (tmp_path / ".mimesh-notes").write_text("not ours")
    (tmp_path / f"{PREFIX}link").symlink_to(tmp_path / ".mimesh-notes")
    write(tmp_path / "b.obj", "b")
    assert names(tmp_path) == [".mimesh-notes", f"{PREFIX}link", "b.obj"]


KILL_AT_RENAME = """
import json, os, signal, sys
left = int(sys.argv[2])
def hook(event, arguments):
    global left
    if event == "os.rename":
        left -= 1
        if left < 0:
            os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(hook)
with together():
    for name in ("a.txt", "b.txt", "f/0.txt"):
        with whole_file(p / name) as temporary:
            temporary.write_text("new")
"""


def killed_at_rename(folder: Path, number: int) -> list[str | None]:
    """Kill a run before one of its three renames, of which two replace files; return the contents of all three."""
    for name in ("a.txt", "f/0.txt"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("old")
    code = "import sys; from pathlib import Path; from mimesh.io.atomic import *; p = Path(sys.argv[1])\n"
    command = [sys.executable, "-c", code + KILL_AT_RENAME, str(folder), str(number)]
    assert subprocess.run(command).returncode == -9
    return contents(folder)


def contents(folder: Path) -> list[str | None]:
    paths = [folder / name for name in ("a.txt", "b.txt", "f/0.txt")]
    return [path.read_text() if path.exists() else None for path in paths]


@posix
@pytest.mark.parametrize("number", [0, 1, 2])
def test_renames_that_a_killed_run_has_left_are_done_by_the_next(number, tmp_path):
    before: list[str | None] = ["old", None, "old"]
    assert killed_at_rename(tmp_path, number) == ["new"] * number + before[number:]
    write(tmp_path / "c.txt", "c")
    assert contents(tmp_path) == (["new"] * 3 if number else before)
    write(tmp_path / "f" / "c.txt", "c")
    assert names(tmp_path) == ["a.txt", *(["b.txt"] if number else []), "c.txt", "f"]
    assert names(tmp_path / "f") == ["0.txt", "c.txt"]


@posix
@pytest.mark.parametrize("number", [1, 2])
def test_frames_of_a_new_folder_are_renamed_by_the_next_run(number, tmp_path):
    head, _, _ = KILL_AT_RENAME.partition("with together")
    code = f"import sys; from pathlib import Path; from mimesh.io.atomic import *; p = Path(sys.argv[1])\n{head}"
    code += "with whole_folder(p / 'f') as folder:\n    for name in 'abc': (folder / name).write_text('new')"
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path), str(number)]).returncode == -9
    assert names(tmp_path / "f") == ["a", "b", "c"][:number]
    write(tmp_path / "c.txt", "c")
    assert names(tmp_path / "f") == ["a", "b", "c"]
    assert names(tmp_path) == ["c.txt", "f"]


@posix
@pytest.mark.parametrize("change", ["replaced", "deleted", "made"])
def test_renames_are_not_done_over_what_has_changed_since(change, tmp_path):
    killed_at_rename(tmp_path, 1)
    if change == "made":
        (tmp_path / "b.txt").write_text("mine")
    else:
        (tmp_path / "f" / "0.txt").unlink()
        if change == "replaced":
            (tmp_path / "f" / "0.txt").write_text("mine")
    before = contents(tmp_path)
    write(tmp_path / "c.txt", "c")
    assert contents(tmp_path) == before
    assert not [name for name in names(tmp_path) if name.startswith(PREFIX)]


@posix
@pytest.mark.parametrize("target", ["../outside.txt", "{}/outside.txt"])
def test_a_list_of_renames_reaches_nothing_outside_its_folder(target, tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    target = target.format(tmp_path)
    rows = []
    for name in ("done", "left"):
        path = folder / f"{PREFIX}{name}"
        path.write_text(name)
        facts = path.stat()
        rows.append([path.name, target, [facts.st_dev, facts.st_ino, facts.st_mtime_ns, facts.st_size], None])
    (folder / f"{PREFIX}done").rename(folder / "done.txt")
    rows[0][1] = "done.txt"
    listed = folder / f"{PREFIX}all-1{atomic.RENAMES}"
    listed.write_text(json.dumps(rows))
    write(folder / "c.txt", "c")
    assert not (tmp_path / "outside.txt").exists()
    assert names(folder) == ["c.txt", "done.txt"]


@posix
@pytest.mark.parametrize(
    "text",
    [
        "",
        "[[",
        "[]",
        "[[1]]",
        "{}",
        "[3]",
        '"text"',
        "[[null, null, null, null]]",
        '[["a", "b"]]',
        '[["\\u0000", "b", 1, 2]]',
    ],
)
def test_a_damaged_list_of_renames_is_deleted(text, tmp_path):
    (tmp_path / f"{PREFIX}all-1{atomic.RENAMES}").write_text(text)
    write(tmp_path / "c.txt", "c")
    assert names(tmp_path) == ["c.txt"]


@posix
def test_a_killed_runs_folder_in_the_temporary_folder_goes_with_the_next_run(tmp_path, monkeypatch):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    killed_writer(tmp_path, "with scratch_folder() as f: (f / 'a').touch(); print(flush=True); time.sleep(100)")
    assert len(names(temporary)) == 1
    code = "import sys; from mimesh.io.atomic import *\nwith whole_file(sys.argv[1]) as t: t.write_text('c')"
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "c.txt")], check=True)
    assert names(temporary) == []


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


@posix
def test_temporary_files_of_a_running_run_stay(tmp_path):
    with together():
        with whole_file(tmp_path / "a.txt") as temporary:
            # Some libraries write another file and rename it.
            (tmp_path / "other").write_text("a")
            os.replace(tmp_path / "other", temporary)
        with whole_file(tmp_path / "b.txt") as second, whole_folder(tmp_path / "f") as folder:
            (folder / "0").write_text("0")
            before = names(tmp_path)
            code = "import sys; from mimesh.io.atomic import *\nwith whole_file(sys.argv[1]) as t: t.write_text('c')"
            subprocess.run([sys.executable, "-c", code, str(tmp_path / "c.txt")], check=True)
            assert names(tmp_path) == sorted([*before, "c.txt"])
            second.write_text("b")
    assert names(tmp_path) == ["a.txt", "b.txt", "c.txt", "f"]


def test_without_locks_only_old_files_go(tmp_path, monkeypatch):
    monkeypatch.setattr(atomic, "has_locks", lambda: False)
    monkeypatch.setattr(system, "has_locks", lambda: False)
    old, young = tmp_path / f"{PREFIX}old.obj", tmp_path / f"{PREFIX}young.obj"
    for path in (old, young):
        path.write_text("")
    os.utime(old, (0.0, time.time() - 2 * atomic.STALE_SECONDS))
    write(tmp_path / "a.txt", "a")
    assert names(tmp_path) == [young.name, "a.txt"]


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


def test_a_scratch_folder_goes(tmp_path):
    with scratch_folder(tmp_path) as folder:
        (folder / "a").write_text("a")
    assert names(tmp_path) == []
