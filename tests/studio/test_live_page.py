"""The page of a live session: its scene, the newest frame, and who is admitted."""

from __future__ import annotations

import http.client
import json
import re
import threading
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
import zoo

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
    return mimesh.prepare(cube, driving, "copy", **axes)


@pytest.fixture
def page(session):
    with LivePage(session) as page:
        yield page


class Browser:
    """A connection that keeps the page's cookie."""

    def __init__(self, page: LivePage) -> None:
        parts = urlsplit(page.address)
        self.connection = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=20)
        self.cookie = ""
        response = self.get(f"/?{parts.query}")
        assert response.status == 303
        self.cookie = (response.getheader("set-cookie") or "").split(";")[0]

    def get(self, path: str, **headers: str) -> http.client.HTTPResponse:
        self.connection.request("GET", path, headers={"cookie": self.cookie, **headers})
        response = self.connection.getresponse()
        self.content = response.read()
        return response


@pytest.fixture
def browser(page):
    browser = Browser(page)
    yield browser
    browser.connection.close()


def test_the_page_has_both_meshes_and_loads_the_player(browser):
    assert browser.get("/").status == 200
    text = browser.content.decode()
    assert "<driving>" not in text
    found = re.search(r'id="mimesh-scene">(.*?)</script>', text)
    assert found
    scene = json.loads(found[1])
    assert [panel["role"] for panel in scene["panels"]] == ["driving", "result"]
    assert scene["live"] == "/frame"
    for name in re.findall(r'"(/static/[^"]+)"', text):
        assert browser.get(name).status == 200
        assert len(browser.content) > 1000
    assert browser.get("/static/studio.js").status == 404


def test_the_newest_frame_is_sent_and_others_are_skipped(page, browser, session):
    vertices = session.driving.vertices
    for k in range(3):
        page.show(vertices + k, session.pose(vertices + k))
    response = browser.get("/frame?after=")
    assert response.getheader("x-frame") == "3"
    sent = np.frombuffer(browser.content, "<f4").reshape(2, -1, 3)
    assert np.allclose(sent, [vertices + 2, session.pose(vertices + 2)], atol=1e-6)
    threading.Timer(0.1, page.show, (vertices, session.pose(vertices))).start()
    started = time.monotonic()
    assert browser.get("/frame?after=3").getheader("x-frame") == "4"
    assert time.monotonic() - started > 0.05


def test_without_a_new_frame_the_answer_is_empty(page, browser, session, monkeypatch):
    monkeypatch.setattr(live_page, "TIMEOUT", 0.05)
    assert browser.get("/frame?after=").status == 204
    page.show(session.driving.vertices, session.identity.vertices)
    assert browser.get("/frame?after=1").status == 204
    assert browser.get("/frame?after=77").getheader("x-frame") == "1"  # a page that was open before the last start


def test_only_this_machine_and_its_browser_are_admitted(page, browser):
    assert urlsplit(page.address).hostname == "127.0.0.1"
    assert browser.get("/frame", host="example.org").status == 421
    assert browser.get("/frame", origin="http://example.org").status == 403
    browser.cookie = ""
    for path in ("/", "/frame", "/static/player.js", "/?token=wrong"):
        assert browser.get(path).status == 403


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
