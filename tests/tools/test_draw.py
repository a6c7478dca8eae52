"""`mimesh render` from end to end: the kind of picture for each file, all options, and movies read back."""

import json
import re

import numpy as np
import pytest
import zoo
from PIL import Image

from mimesh.__main__ import run
from mimesh.core.mesh import Clip
from mimesh.io import save_clip, save_mesh


@pytest.fixture
def files(tmp_path, monkeypatch):
    """A cube, a cube 20 % taller, and a clip of six frames in which the cube grows and moves."""
    cube = zoo.cube()
    save_mesh(cube, tmp_path / "cube.obj")
    save_mesh(cube.with_vertices(cube.vertices * [1, 1.2, 1]), tmp_path / "tall.obj")
    grown = np.stack([cube.vertices * [1, 1 + 0.04 * t, 1] + [0, 0, 0.5 * t] for t in range(6)])
    save_clip(Clip(cube, grown, 10.0), tmp_path / "grow.glb")
    save_clip(Clip(cube, grown, 10.0), tmp_path / "grow")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def draw(capsys, *args):
    assert run(["render", *args, "--size", "40", "--json"]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)["kind"]


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image)


def frames(path):
    with Image.open(path) as image:
        return getattr(image, "n_frames", 1)


@pytest.mark.parametrize(
    ("line", "kind"),
    [
        ("cube.obj -o x.png", "contact sheet"),
        ("cube.obj grow -o x.png", "strip"),
        ("grow.glb --animation 0 -o x.png", "strip"),
        ("grow.glb --sheet -o x.jpg", "contact sheet"),
        ("tall.obj --truth cube.obj -o x.png", "heat map"),
        ("grow.glb -o x.gif", "movie"),
        ("grow.glb --truth cube.obj -o x.gif", "heat movie"),
        ("grow --truth grow.glb --track -o x.webp", "heat movie"),
    ],
)
def test_kind_of_picture_follows_from_files_and_options(files, line, kind, capsys):
    *args, path = line.split()
    assert draw(capsys, *args, path) == kind
    assert (files / path).stat().st_size > 100
    assert frames(path) == (6 if path.endswith(("gif", "webp")) else 1)


def test_movie_of_a_mesh_turns(files, capsys, monkeypatch):
    monkeypatch.setattr("mimesh.tools.draw.TURN", 3)
    assert draw(capsys, "cube.obj", "-o", "x.gif") == "turning movie"
    assert frames("x.gif") == 3


@pytest.mark.slow
def test_mp4_has_the_frames_size_and_rate(files, capsys):
    av = pytest.importorskip("av")
    assert draw(capsys, "grow", "cube.obj", "--fps", "10", "--track", "-o", "x.mp4") == "movie"
    with av.open("x.mp4") as container:
        stream = container.streams.video[0]
        found = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert float(stream.average_rate) == 10
    assert len(found) == 6
    assert found[0].shape[1] == 80
    assert np.abs(found[0].astype(int) - found[5]).max() > 20


def test_frames_are_chosen_by_start_stop_and_step(files, capsys):
    draw(capsys, "grow.glb", "--start", "1", "--step", "2", "-o", "x.gif")
    assert frames("x.gif") == 3
    draw(capsys, "grow.glb", "--start", "2", "--stop", "3", "-o", "one.png")
    assert pixels("one.png").shape[1] < 60
    assert run(["render", "grow.glb", "--start", "9", "-o", "x.gif"]) == 2
    assert "within its 6 frames" in capsys.readouterr().err


def test_truth_is_cut_as_the_clip_is(files, capsys):
    for name in ("x.gif", "x.png"):
        draw(capsys, "grow.glb", "--truth", "grow.glb", "--start", "2", "--step", "2", "-o", name)
    assert frames("x.gif") == 2
    assert run(["render", "grow", "--truth", "grow", "--start", "2", "--fps", "10", "-o", "x.html"]) == 0
    clip, truth = json.loads(re.search(r'mimesh-scene">(.*?)</script>', (files / "x.html").read_text())[1])["panels"]
    assert (clip["stream"], clip["fps"], clip["centre"]) == (truth["stream"], truth["fps"], truth["centre"])


def test_an_animation_of_a_mesh_is_refused(files, capsys):
    assert run(["render", "cube.obj", "--animation", "Run", "-o", "x.png"]) == 2
    assert "--animation" in capsys.readouterr().err


def test_backgrounds_labels_and_width(files, capsys):
    draw(capsys, "cube.obj", "--background", "#204060", "--no-labels", "--width", "64", "-o", "x.png")
    image = pixels("x.png")
    assert image.shape == (40, 64, 3)
    assert image[0, 0].tolist() == [0x20, 0x40, 0x60]
    draw(capsys, "cube.obj", "--background", "none", "-o", "x.png")
    found = pixels("x.png")
    assert found.shape[2] == 4
    assert (found[0, 0, 3], found[20, 17, 3]) == (0, 255)
    draw(capsys, "cube.obj", "--background", "dark", "-o", "x.png")
    assert pixels("x.png")[41:].max() > 120  # captions are light on a dark background
