"""The player's page: one deterministic file, safe for any names, and built from the current web sources."""

import base64
import hashlib
import html
import json
import re
from pathlib import Path

import numpy as np
import pytest
import zoo

import mimesh
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.pipeline.result import Result, Timer
from mimesh.view.pack import Panel
from mimesh.view.page import Download, player_page, web_file, write_player

WEB = Path(__file__).parents[2] / "web"
SOURCES = (".js", ".mjs", ".css", ".html", ".json")
INJECTION = "</script><script>alert(1)</script><!--"


def scene_of(page):
    """Parse the scene of a page."""
    return json.loads(re.search(r'id="mimesh-scene">(.*?)</script>', page, re.DOTALL).group(1))


def clip():
    """Make a clip of a moving cube."""
    mesh = zoo.cube()
    return Clip(mesh, mesh.vertices + np.linspace(0, 1, 5)[:, None, None], 10.0)


def test_the_bundle_is_built_from_the_sources_here():
    digest = hashlib.sha256()
    for path in sorted(p.relative_to(WEB).as_posix() for p in WEB.rglob("*") if p.suffix in SOURCES):
        if not path.startswith("node_modules/"):
            content = (WEB / path).read_bytes()
            digest.update(f"{path}\n{len(content)}\n".encode() + content)
    mark = f"/* mimesh-web {digest.hexdigest()[:32]} */"
    for name in ("player.js", "player.css", "studio.js", "studio.css"):
        assert web_file(name).startswith(mark), "web/ has changed since the bundle was built: run make web"
    assert "three.js authors" in web_file("player.js")
    assert "Permission is hereby granted" in web_file("player.js")
    assert len(web_file("studio.js")) < 40_000
    assert "WebGLRenderer" not in web_file("studio.js")  # three is bundled once


def test_a_page_is_small_and_loads_nothing():
    page = player_page([Panel("mesh", clip())], title="cube")
    assert len(page.encode()) < 1.5e6
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", page)
    assert "@import" not in web_file("player.css")
    assert "url(" not in web_file("player.css")


def test_the_same_input_gives_the_same_bytes(tmp_path):
    pages = [write_player(tmp_path / name, [Panel("mesh", clip())], title="cube") for name in ("a.html", "b.html")]
    assert pages[0].read_bytes() == pages[1].read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.html", "b.html"]


def test_names_and_notes_are_escaped(tmp_path):
    panels = [Panel("mesh", clip(), INJECTION)]
    download = Download(f"{INJECTION}.glb", None)
    page = player_page(panels, title=INJECTION, model=INJECTION, notes=[INJECTION], download=download)
    plain = player_page([Panel("mesh", clip())], title="x")
    for mark in ("<script", "</script", "<!--"):
        assert page.count(mark) == plain.count(mark)
    scene = scene_of(page)
    assert (scene["title"], scene["notes"], scene["panels"][0]["name"]) == (INJECTION, [INJECTION], INJECTION)
    name = "p\udce9"  # no valid text
    download = Download(f"{name}.glb", None)
    page = write_player(tmp_path / "x.html", [Panel("mesh", clip(), name)], title=name, download=download)
    assert scene_of(page.read_text())["download"]["href"] == "p%E9.glb"


def test_a_download_is_embedded_if_it_fits_and_linked_otherwise():
    noise = np.random.default_rng(0).bytes(200_000)
    options = {"title": "cube", "download": Download("my cube.glb", noise)}
    embedded = scene_of(player_page([Panel("mesh", clip())], **options))["download"]
    assert embedded["bytes"] == len(noise)
    linked = scene_of(player_page([Panel("mesh", clip())], budget=800_000, **options))["download"]
    assert linked == {"name": "my cube.glb", "href": "my%20cube.glb"}


def test_results_write_pages_and_notebook_frames(tmp_path):
    result = mimesh.transfer(zoo.cube(), zoo.cube(), "copy")
    page = result.player(tmp_path / "cube.html").read_text()
    assert [panel["role"] for panel in scene_of(page)["panels"]] == ["identity", "driving", "result"]
    frame = result._repr_html_()
    inner = html.unescape(re.search(r'srcdoc="([^"]*)"', frame).group(1))
    assert scene_of(inner)["model"] == "copy"
    assert "driving=" not in repr(result)


def test_a_page_never_overwrites_a_mesh(tmp_path):
    (tmp_path / "hero.obj").write_text("v 0 0 0\n")
    with pytest.raises(InputError, match=r"expected a name that ends in .html, found '.obj'"):
        mimesh.transfer(zoo.cube(), zoo.cube(), "copy").player(tmp_path / "hero.obj")
    assert (tmp_path / "hero.obj").read_text() == "v 0 0 0\n"


def test_a_result_without_inputs_has_no_page(tmp_path):
    result = Result(zoo.cube(), "copy", Timer(), {})
    assert result._repr_html_() is None
    with pytest.raises(InputError, match="without its inputs"):
        result.player(tmp_path / "cube.html")


def test_the_notice_names_the_bundled_version():
    version = json.loads((WEB / "package.json").read_text(encoding="utf-8"))["dependencies"]["three"]
    notices = (WEB.parent / "THIRD_PARTY.md").read_text(encoding="utf-8")
    assert f"**three.js** {version}," in notices
    assert "`src/mimesh/view/web/player.js`" in notices


def test_a_policy_admits_the_own_script_and_style_alone():
    page = player_page([Panel("result", clip())], title=INJECTION)
    policy = re.search(r'<meta http-equiv="Content-Security-Policy" content="(.*?)">', page)
    assert policy is not None
    assert page.index(policy[0]) < page.index("<title>")  # it counts for what comes after it
    sources = dict(part.split(" ", 1) for part in policy[1].split("; "))
    assert sources["default-src"] == "'none'"
    for name in ("script", "style"):
        [content] = re.findall(rf"<{name}>(.*?)</{name}>", page, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert sources[f"{name}-src"] == f"'sha256-{digest}'"
