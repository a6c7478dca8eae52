"""Where outputs go."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from people import walk

from mimesh.core.errors import InputError
from mimesh.io import save_clip

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
