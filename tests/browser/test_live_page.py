"""The live page in a browser: it shows frames as they come, and says when none can come any more."""

from __future__ import annotations

import numpy as np
import pytest
import zoo
from grouped_options import grouped

import mimesh
from mimesh.core.mesh import Mesh
from mimesh.studio.live_page import LivePage

pytestmark = pytest.mark.slow


def test_frames_are_shown_as_they_come(watch):
    cube = zoo.cube()
    axes = {"up": "+y", "front": "+z", "driving_up": "+y", "driving_front": "+z"}
    session = mimesh.prepare(cube, Mesh(cube.vertices * 3, cube.faces, name="driving"), "copy", **grouped(**axes))
    vertices, flat = session.driving.vertices, session.driving.vertices * [1.0, 0.3, 1.0]
    page = LivePage(session)
    try:
        origin = page.address.split("?")[0]
        watched = watch(page.address, allowed=(origin, "data:", "blob:"))
        assert watched.page.locator(".chip").all_text_contents() == ["copy", "waiting"]
        page.show(vertices, session.pose(vertices))
        watched.page.wait_for_selector("html[data-live='1']")
        tall = watched.picture()
        page.show(flat, session.pose(flat))
        watched.page.wait_for_selector("html[data-live='2']")
        low = watched.picture()
        assert watched.page.locator(".chip").all_text_contents() == ["copy", "live"]
        for half in (slice(0, 360), slice(360, 720)):  # driving and result
            assert np.abs(tall[:, half] - low[:, half]).max() > 30
        top = watched.page.evaluate("mimesh.stage.views.map(({ panel }) => Math.max(...panel.fixedPose))")
        assert top == pytest.approx([flat.max(), session.pose(flat).max()])
    finally:
        page.close()
    watched.page.wait_for_selector("html[data-live='']")
    assert watched.page.locator(".chip").all_text_contents()[1] == "no connection"
    watched.page.goto("about:blank")
    watched.errors[:] = [line for line in watched.errors if "ERR_CONNECTION_REFUSED" not in line]
