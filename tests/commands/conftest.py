"""Files for commands, and small pictures: what is in them is tested in tests/render and tests/tools."""

from pathlib import Path

import pytest
import zoo

from mimesh.io import save_mesh


@pytest.fixture(autouse=True)
def small_pictures_and_no_way_it_stands(monkeypatch):
    """How a cube stands takes a network seconds to find, and tests/tools/test_inspect.py asks it."""
    monkeypatch.setattr("mimesh.tools.preview.TILE", (60, 72))
    monkeypatch.setattr("mimesh.tools.inspect._stands", lambda mesh, rig: None)


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """A folder with hero.obj, pose.obj, pose.ply and walk/ (three frames), all of one topology."""
    cube = zoo.cube()
    save_mesh(cube, tmp_path / "hero.obj")
    for name in ("pose.obj", "pose.ply"):
        save_mesh(cube.with_vertices(cube.vertices * [1, 2, 1]), tmp_path / name)
    for t in range(3):
        save_mesh(cube.with_vertices(cube.vertices * [1, 1 + t / 4, 1]), tmp_path / "walk" / f"{t:03}.obj")
    return tmp_path
