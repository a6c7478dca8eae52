"""The keys that `rig` and `capture` print with --json are those that docs/commands.md lists."""

import json
import re
from pathlib import Path
from typing import NotRequired, get_origin, get_type_hints

import pytest
from people import person, walk

from mimesh.io import save_clip, save_mesh
from mimesh.pipeline.report import CaptureReport, RigReport

PAGE = Path(__file__).parents[2] / "docs" / "commands.md"
ROW = re.compile(r"^\| `([\w.]+)` \| (both|rig|capture)(, optional)? \| [^|]+ \| [^|]+ \|$", re.MULTILINE)


def documented(command: str) -> dict[str, bool]:
    """Return the keys of a command, and whether each is always there."""
    return {key: not optional for key, of, optional in ROW.findall(PAGE.read_text()) if of in ("both", command)}


def keys(facts: dict) -> set[str]:
    """Return the keys of printed facts, as the page writes them."""
    return {key for key in facts if key != "report"} | {f"report.{key}" for key in facts["report"]}


@pytest.mark.slow
@pytest.mark.parametrize("command", ["rig", "capture"])
def test_printed_keys_are_those_of_the_page(command, tmp_path, monkeypatch, call):
    monkeypatch.chdir(tmp_path)
    save_mesh(person(0), tmp_path / "hero.obj")
    save_clip(walk(frames=3), tmp_path / "walk.npz")
    listed = documented(command)
    printed = keys(json.loads(call(f"{command} {'hero.obj' if command == 'rig' else 'walk.npz'} --json").out))
    assert printed <= listed.keys()
    assert {key for key, always in listed.items() if always} <= printed


@pytest.mark.parametrize(("command", "report"), [("rig", RigReport), ("capture", CaptureReport)])
def test_the_page_lists_all_keys_of_the_report(command, report):
    listed = {key.removeprefix("report."): always for key, always in documented(command).items() if "." in key}
    added = {"corrected", "notes"} | ({"pictures"} if command == "rig" else set())  # by the command
    hints = get_type_hints(report, include_extras=True)
    assert listed.keys() == hints.keys() | added
    optional = {key for key, hint in hints.items() if get_origin(hint) is NotRequired}
    assert {key for key, always in listed.items() if not always} == optional
