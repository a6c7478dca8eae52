"""A picture or a page that fails costs nothing but itself."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path

import pytest
from people import person, walk

import mimesh
from mimesh.io import load_mesh, save_clip, save_mesh
from mimesh.tools import demo, preview


def fails(*_, **__):
    raise ValueError("Target count\n must be less")


@pytest.mark.parametrize("command", ["transfer", "animate", "rig"])
def test_the_result_is_there_with_one_note(command, model, files, call, monkeypatch):
    save_mesh(person(0), Path("a.obj"))
    save_clip(walk(), Path("walk.npz"))
    save_mesh(person(1, pose=2), Path("pose.obj"))
    monkeypatch.setattr(preview, "rig_picture" if command == "rig" else "result_picture", fails)
    more = {"transfer": " pose.obj", "animate": " walk.npz", "rig": ""}[command]
    ended = call(f"{command} a.obj{more} -m {model} --body human -o out.glb --json")
    assert ended.code == 0
    report = json.loads(ended.out)["report"]
    (note,) = [note for note in report["notes"] if "not written" in note]
    assert note.endswith("preview.png was not written (ValueError: Target count must be less); the result is complete")
    assert report["pictures"] == []
    assert len(load_mesh("out.glb").vertices) == len(person(0).vertices)
    if command != "rig":
        assert Path(report["page"]).is_file()


def test_a_demo_without_pictures_has_its_result(tmp_path, model, monkeypatch):
    monkeypatch.setattr(demo, "animate", lambda *inputs, **_: mimesh.animate(person(0), walk(), model))
    monkeypatch.setattr(demo, "inputs", lambda body: (person(0), walk()))
    monkeypatch.setattr(demo, "draw", fails)
    facts = demo.run_demo(tmp_path)
    assert [Path(path).name for path in facts["files"]] == [
        *("identity.obj", "driving.obj", "driving.glb", "result.glb"),
        "player.html",
    ]
    assert facts["notes"] == [
        "preview.png was not written (ValueError: Target count must be less); the result is complete"
    ]
    assert (tmp_path / "result.glb").is_file()


def test_drawing_and_reading_have_bars(files, call, monkeypatch):
    """They can take longer than the rest."""
    titles = []

    @contextlib.contextmanager
    def noted(what, quiet):
        titles.append((what, quiet))
        yield None

    monkeypatch.setattr("mimesh.commands.move.progress", noted)
    monkeypatch.setattr("mimesh.commands.terminal.progress", noted)
    assert call("transfer hero.obj pose.obj -m copy").code == 0
    assert call("look hero.obj pose.obj").code == 0
    assert call("render hero.obj -o sheet.png --quiet").code == 0
    assert titles[-4:] == [("preview", False), ("reading", False), ("reading", True), ("frames", True)]
