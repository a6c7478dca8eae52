"""axe-core finds nothing wrong with the pages in any of their states, and every control has a name and a tooltip.

MIMESH_AXE names a folder in which npm has installed axe-core; by default it is .clients/axe.
"""

import os
from pathlib import Path

import numpy as np
import pytest
import zoo
from people import person, walk

from mimesh import save_clip, save_mesh
from mimesh.core.mesh import Clip
from mimesh.view.pack import Panel
from mimesh.view.page import Download, write_player

pytestmark = pytest.mark.slow

FOLDER = Path(os.environ.get("MIMESH_AXE", Path(__file__).parents[2] / ".clients" / "axe"))
WITHOUT_TOOLTIP = """() => [...document.querySelectorAll("button, select, input, a[href]")]
  .filter((control) => control.checkVisibility() && !control.closest("dialog"))
  .filter((control) => !control.title && !control.closest("label")?.title)
  .map((control) => control.outerHTML)"""
UNNAMED_ICONS = """() => [...document.querySelectorAll(".tool, .icon")]
  .filter((icon) => !icon.getAttribute("aria-label") || !icon.title)
  .map((icon) => icon.outerHTML)"""


@pytest.fixture(scope="module")
def check():
    """A function that checks a page as it is now."""
    script = FOLDER / "node_modules" / "axe-core" / "axe.min.js"
    if not script.is_file():
        pytest.skip(f"no axe-core in {FOLDER}: run make axe with Node.js installed, or set MIMESH_AXE")
    source = script.read_text(encoding="utf-8")

    def check_page(page, state: str) -> None:
        page.evaluate(f"() => {{ if (!window.axe) {{ {source} }} }}")
        found = page.evaluate("() => axe.run()")
        assert found["passes"], "rules were checked"
        lines = [f"{rule['id']}: {node['failureSummary']}" for rule in found["violations"] for node in rule["nodes"]]
        assert not lines, (state, lines)
        assert page.evaluate(WITHOUT_TOOLTIP) == [], state
        assert page.evaluate(UNNAMED_ICONS) == [], state

    return check_page


@pytest.fixture(scope="module")
def player(tmp_path_factory):
    """The address of a page with all that the player has: four roles, a clip, notes and a download."""
    mesh = zoo.cube()
    clip = Clip(mesh, np.stack([mesh.vertices, mesh.vertices + [3.0, 0, 0]]), 1.0)
    panels = [Panel("identity", Clip.still(mesh)), *(Panel(role, clip) for role in ("driving", "result", "truth"))]
    download = Download("cube.glb", b"content")
    page = tmp_path_factory.mktemp("page") / "page.html"
    write_player(page, panels, title="A cube", model="copy", notes=["one", "two", "three"], download=download)
    return page.as_uri()


def test_the_player_is_accessible(check, watch, player):
    page = watch(player, reduced_motion="reduce").page
    for theme in ("light", "dark"):
        page.evaluate(f"() => mimesh.stage.set({{ dark: {str(theme == 'dark').lower()}, colours: 'stretch' }})")
        page.wait_for_selector(".legend:visible")
        check(page, theme)
    page.keyboard.press("Shift+?")
    page.wait_for_selector("dialog.help[open]")
    check(page, "help")
    page.get_by_role("button", name="Close").click()
    page.set_viewport_size({"width": 390, "height": 780})
    check(page, "narrow")


def test_a_player_that_cannot_start_is_accessible(check, watch, player):
    check(watch(player, script="delete window.DecompressionStream").page, "refused")


def test_the_studio_is_accessible(check, studio, watch_all, tmp_path):
    save_mesh(person(0), tmp_path / "hero.glb")
    save_clip(walk(frames=3), tmp_path / "walk.npz")
    (tmp_path / "bad.glb").write_text("this is not a mesh")
    origin, token, _ = studio
    size = {"width": 1366, "height": 768}
    opened = watch_all(f"{origin}/?token={token}", (origin, "data:", "blob:"), reduced_motion="reduce", viewport=size)
    page = opened.page
    page.wait_for_selector("#welcome:visible")
    check(page, "empty")
    page.set_input_files("#identities input[data-role]", str(tmp_path / "bad.glb"))
    page.wait_for_selector("#notice:visible")
    check(page, "error")
    page.get_by_label("Remove bad.glb").click()
    page.set_input_files("#identities input[data-role]", str(tmp_path / "hero.glb"))
    page.set_input_files("#driving input[data-role] >> nth=0", str(tmp_path / "walk.npz"))
    page.wait_for_selector("#write:enabled")
    page.click("#write")
    page.wait_for_selector("#export .row[data-state=ready]")
    page.click("#bones summary")
    page.click("#identities .row summary")
    check(page, "result")
    page.get_by_label("What", exact=True).select_option("rig")
    page.get_by_label("Format").select_option(".vrm")
    check(page, "rig with author and licence")
    page.get_by_label("What", exact=True).select_option("motion")
    check(page, "motion")
    page.click("#correct")
    page.wait_for_selector("svg.joints circle")
    page.get_by_label("Joint", exact=True).select_option("identity Head")
    for theme in ("joints", "joints in the dark"):
        check(page, theme)
        page.evaluate("() => mimesh.stage.set({ dark: true })")
    page.set_viewport_size({"width": 390, "height": 780})
    check(page, "narrow")
