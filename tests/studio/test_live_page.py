"""The page of a live session: its scene, the newest frame, and who is admitted."""

from __future__ import annotations

import json
import re
import threading
import time
from urllib.parse import urlsplit

import httpx2
import numpy as np
import pytest
import zoo
from grouped_options import grouped

import mimesh
from mimesh import InputError
from mimesh.core.mesh import Mesh
from mimesh.studio import live_page
from mimesh.studio.live_page import LivePage


@pytest.fixture(scope="module")
def session():
    """A cube, which takes over the vertices of another one."""
    cube = zoo.cube()
    driving = Mesh(2 * cube.vertices, cube.faces, name="<driving>")
    axes = {f"{which}{axis}": value for which in ("", "driving_") for axis, value in (("up", "+y"), ("front", "+z"))}
    return mimesh.prepare(cube, driving, "copy", **grouped(**axes))


@pytest.fixture
def page(session):
    with LivePage(session) as page:
        yield page


@pytest.fixture
def browser(page):
    """A browser that has the page's cookie."""
    with httpx2.Client(base_url=page.address.split("?")[0], timeout=20, trust_env=False) as browser:
        assert browser.get(page.address).status_code == 303
        yield browser


def test_the_page_has_both_meshes_and_loads_the_player(browser):
    text = browser.get("/").text
    assert "<driving>" not in text
    found = re.search(r'id="mimesh-scene">(.*?)</script>', text)
    assert found
    scene = json.loads(found[1])
    assert [panel["role"] for panel in scene["panels"]] == ["driving", "result"]
    assert scene["live"] == "/frame"
    for name in re.findall(r'"(/static/[^"]+)"', text):
        assert len(browser.get(name).raise_for_status().content) > 1000
    assert browser.get("/static/studio.js").status_code == 404


def test_the_newest_frame_is_sent_and_others_are_skipped(page, browser, session):
    vertices = session.driving.vertices
    for k in range(3):
        page.show(vertices + k, session.pose(vertices + k))
    response = browser.get("/frame?after=")
    assert response.headers["x-frame"] == "3"
    sent = np.frombuffer(response.content, "<f4").reshape(2, -1, 3)
    assert np.allclose(sent, [vertices + 2, session.pose(vertices + 2)], atol=1e-6)
    threading.Timer(0.1, page.show, (vertices, session.pose(vertices))).start()
    started = time.monotonic()
    assert browser.get("/frame?after=3").headers["x-frame"] == "4"
    assert time.monotonic() - started > 0.05


def test_without_a_new_frame_the_answer_is_empty(page, browser, session, monkeypatch):
    monkeypatch.setattr(live_page, "TIMEOUT", 0.05)
    assert browser.get("/frame?after=").status_code == 204
    page.show(session.driving.vertices, session.identity.vertices)
    assert browser.get("/frame?after=1").status_code == 204
    assert browser.get("/frame?after=77").headers["x-frame"] == "1"  # a page that was open before the last start


def test_only_this_machine_and_its_browser_are_admitted(page, browser):
    assert urlsplit(page.address).hostname == "127.0.0.1"
    assert browser.get("/frame", headers={"host": "example.org"}).status_code == 421
    assert browser.get("/frame", headers={"origin": "http://example.org"}).status_code == 403
    browser.cookies.clear()
    for path in ("/", "/frame", "/static/player.js", "/?token=wrong"):
        assert browser.get(path).status_code == 403


def test_frames_of_other_meshes_are_refused(page, session):
    vertices = session.driving.vertices
    with pytest.raises(InputError, match="expected vertices of shapes"):
        page.show(vertices[:-1], session.identity.vertices)


def test_the_port_is_free_again_and_one_that_is_taken_is_refused(session):
    with LivePage(session) as page:
        port = urlsplit(page.address).port
        with pytest.raises(InputError, match="expected a free port"):
            LivePage(session, port=port)
    with LivePage(session, port=port) as again:
        assert urlsplit(again.address).port == port
