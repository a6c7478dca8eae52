"""Firefox shows the player and the studio: a result is played and seeked in, the example is loaded and exported."""

import json
import subprocess

import pytest
import zoo
from client_programs import firefox

from mimesh import load_clip
from mimesh.core.mesh import Clip
from mimesh.view.pack import Panel
from mimesh.view.page import write_player

pytestmark = pytest.mark.client


def test_a_first_visitor_with_firefox(studio, tmp_path):
    mesh = zoo.cube()
    clip = Clip(mesh, mesh.vertices + [[[0.0, 0.1 * k, 0.0]] for k in range(20)], 10.0)
    page = write_player(tmp_path / "page.html", [Panel("identity", Clip.still(mesh)), Panel("result", clip)], title="A")
    origin, token, _ = studio
    arguments = [page.as_uri(), f"{origin}/?token={token}", str(tmp_path)]
    answer = subprocess.run([*firefox(), *arguments], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    seen = json.loads(answer.stdout)
    assert seen["problems"] == []
    assert seen["notice"] == ""
    assert seen["player"] == {"clock": "0.10 / 1.90 s", "playing": False, "frame": pytest.approx(1)}
    assert seen["written"] == ["dancer-jump.glb"]
    assert len(load_clip(tmp_path / "dancer-jump.glb")) == 30
