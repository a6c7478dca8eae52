"""Files for commands, and small pictures: what is in them is tested in tests/view and tests/tools."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
import zoo

from mimesh.__main__ import run
from mimesh.io import save_mesh


class Ended(NamedTuple):
    """How a command ended: its exit code, and what it printed."""

    code: int
    out: str
    err: str


@pytest.fixture(autouse=True)
def small_pictures_and_no_way_it_stands(monkeypatch):
    """How a cube stands takes a network seconds to find, and tests/tools/test_inspect.py asks it."""
    monkeypatch.setattr("mimesh.tools.preview.TILE", (60, 72))
    monkeypatch.setattr("mimesh.tools.inspect._stance", lambda mesh: None)


@pytest.fixture
def call(capsys) -> Callable[[str], Ended]:
    """A function that runs a command line, whose words have no spaces in them."""

    def ended(line: str) -> Ended:
        capsys.readouterr()
        code = run(line.split())
        return Ended(code, *capsys.readouterr())

    return ended


@pytest.fixture
def refuses(call) -> Callable[[str, str], None]:
    """A function that checks that a command line is refused, with some words in the message."""

    def check(line: str, words: str) -> None:
        code, _, err = call(line)
        assert code == 2, err
        assert words in err

    return check


@pytest.fixture
def files(tmp_path: Path, monkeypatch) -> Path:
    """The current folder, with hero.obj, pose.obj, pose.ply and walk/ (three frames), all of one topology."""
    monkeypatch.chdir(tmp_path)
    cube = zoo.cube()
    save_mesh(cube, "hero.obj")
    for name in ("pose.obj", "pose.ply"):
        save_mesh(cube.with_vertices(cube.vertices * [1, 2, 1]), name)
    for t in range(3):
        save_mesh(cube.with_vertices(cube.vertices * [1, 1 + t / 4, 1]), Path("walk") / f"{t:03}.obj")
    return tmp_path
