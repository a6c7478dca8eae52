"""The player's page in a browser, from a file and without a network: playback, buttons, keys, download."""

import dataclasses
import io
from pathlib import Path

import numpy as np
import pytest
import zoo
from PIL import Image

from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.view.pack import Panel
from mimesh.view.page import Download, write_player

CONTENT = np.random.default_rng(0).bytes(3000)


def textured_cube():
    """Make a cube with a red texture."""
    picture = io.BytesIO()
    Image.new("RGB", (4, 4), (200, 40, 30)).save(picture, "PNG")
    mesh = zoo.cube()
    uv = mesh.vertices[mesh.faces][..., :2]
    parts = (Part("all", 0, len(mesh.faces), Material("paint", (1.0, 1.0, 1.0, 1.0), picture.getvalue())),)
    return dataclasses.replace(mesh, corner_uv=uv, parts=parts)


def stretching(mesh, by):
    """Make a clip of a mesh that grows in height and travels along x."""
    height = 1 + np.linspace(0, by, 9)[:, None, None] * [0, 1, 0]
    offset = np.linspace(0, 3, 9)[:, None, None] * [1.0, 0, 0]
    return Clip(mesh, mesh.vertices * height + offset, 12.0)


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    mesh, folder = textured_cube(), tmp_path_factory.mktemp("page")
    panels = [
        Panel("identity", Clip.still(mesh)),
        Panel("driving", stretching(zoo.grid(9), 0.8)),
        Panel("result", stretching(mesh, 0.6)),
        Panel("truth", stretching(mesh, 0.9)),
    ]
    notes = ["a note", "another", "a third"]
    page = folder / "page.html"
    write_player(page, panels, title="A cube", model="copy", notes=notes, download=Download("cube.glb", CONTENT))
    return page.as_uri()


@pytest.fixture(scope="module")
def shared(watch_all, address):
    return watch_all(address)


@pytest.fixture
def watched(shared):
    """The page with its initial settings, paused."""
    shared.page.evaluate("""() => {
      const { stage, controls } = mimesh;
      controls.pause();
      controls.setLoop(true);
      controls.speed = 1;
      stage.set({ colours: "material", wireframe: false, overlay: false, follow: true, dark: false });
      stage.setTime(0);
      stage.resetView();
    }""")
    return shared


def differ(a, b):
    """Whether two pictures differ visibly."""
    return a.shape != b.shape or np.abs(a - b).max() > 8


def picture_at(watched, seconds=0.3):
    """Go to a time and take a picture."""
    watched.page.evaluate(f"mimesh.controls.seek({seconds})")
    return watched.picture()


@pytest.mark.slow
def test_playing_pausing_and_seeking_give_the_right_pictures(watched):
    first = watched.picture()
    watched.page.evaluate("mimesh.controls.speed = 0.1")  # slow enough that it is not over before it is paused
    watched.page.click("[data-name=play]")
    watched.page.wait_for_function("() => mimesh.stage.time > 0.05")
    watched.page.click("[data-name=play]")
    paused = watched.picture()
    assert differ(first, paused)
    watched.page.wait_for_timeout(100)
    np.testing.assert_array_equal(paused, watched.picture())
    early, late = picture_at(watched, 0.1), picture_at(watched, 0.6)
    assert differ(early, late)
    np.testing.assert_array_equal(early, picture_at(watched, 0.1))


@pytest.mark.slow
def test_playing_does_not_begin_before_the_start(watched):
    """The time of the first frame can be before that of the press."""
    times = watched.page.evaluate("""async () => {
      const { stage, controls } = mimesh, draw = window.requestAnimationFrame, times = [];
      stage.addEventListener("time", () => times.push(stage.time));
      window.requestAnimationFrame = (act) => draw(() => act(performance.now() - 50));
      controls.play();
      while (times.length < 3) await new Promise((done) => setTimeout(done, 10));
      controls.pause();
      window.requestAnimationFrame = draw;
      return times;
    }""")
    assert times[0] == 0
    assert times == sorted(times)


@pytest.mark.slow
def test_colours_change_the_picture(watched):
    before = picture_at(watched)
    for what in ("clay", "stretch", "error"):
        watched.page.click(f".segment[data-name={what}]")
        assert differ(before, watched.picture())
        assert watched.page.locator(".legend").is_visible() == (what != "clay")
        watched.page.click(".segment[data-name=material]")
        np.testing.assert_array_equal(before, watched.picture())


@pytest.mark.slow
def test_every_key_changes_the_picture(watched):
    picture_at(watched)
    before = watched.picture("body")
    for key in ("w", "c", "d", "o", "f", "ArrowRight", "ArrowLeft", "End", "Home", "Shift+?"):
        watched.page.keyboard.press(key)
        after = watched.picture("body")
        assert differ(before, after), key
        before = after
    assert watched.page.locator("dialog.help").is_visible()
    watched.page.keyboard.press("Shift+?")
    assert not watched.page.locator("dialog.help").is_visible()


@pytest.mark.slow
def test_the_camera_turns_and_is_reset(watched):
    before = picture_at(watched)
    watched.page.mouse.move(300, 250)
    watched.page.mouse.down()
    watched.page.mouse.move(420, 220, steps=4)
    watched.page.mouse.up()
    assert differ(before, watched.picture())
    watched.page.mouse.dblclick(300, 250)
    np.testing.assert_array_equal(before, watched.picture())


@pytest.mark.slow
def test_speed_and_loop_are_set(watched):
    watched.page.select_option("select.speed", "0.1")
    assert watched.page.evaluate("mimesh.controls.speed") == 0.1
    assert watched.page.evaluate("mimesh.controls.frame") == pytest.approx(1 / 12), "still panels have no rate"
    watched.page.click("[data-name=loop]")
    watched.page.evaluate("mimesh.controls.pause(); mimesh.controls.advance(60)")
    assert watched.page.evaluate("mimesh.stage.time === mimesh.stage.duration && !mimesh.controls.playing")


@pytest.mark.slow
def test_a_narrow_dark_touch_screen_is_supported(watch, address):
    size = {"width": 390, "height": 780}
    watched = watch(address, viewport=size, has_touch=True, is_mobile=True, color_scheme="dark")
    before = picture_at(watched)
    assert before[2, 2].max() < 90
    wide = watched.page.evaluate("document.documentElement.scrollWidth")
    assert wide <= 390
    watched.page.tap(".segment[data-name=stretch]")
    assert differ(before, watched.picture())
    boxes = [box.bounding_box() for box in watched.page.locator(".panel").all()]
    assert all(box["width"] > 150 and box["height"] > 60 for box in boxes)


@pytest.mark.slow
def test_a_page_is_ready_when_its_scene_is_drawn(watch, address):
    """The stage is drawn when its size changes, too: also while the scene is still being decoded."""
    late = "new Promise((done) => setTimeout(done, 500))"
    slow = f"async function () {{ await {late}; return decoded.call(this); }}"
    script = f"const decoded = Response.prototype.arrayBuffer; Response.prototype.arrayBuffer = {slow};"
    watched = watch(address, script=script)
    assert watched.page.evaluate("window.mimesh !== undefined && mimesh.stage.views.length === 4")


@pytest.mark.slow
def test_the_download_gives_the_same_bytes_and_controls_have_labels(watched):
    with watched.page.expect_download() as waiting:
        watched.page.click(".download")
    assert waiting.value.suggested_filename == "cube.glb"
    assert Path(waiting.value.path()).read_bytes() == CONTENT
    for control in watched.page.locator("button, select, input").all():
        assert control.get_attribute("aria-label") or control.inner_text()


@pytest.mark.slow
def test_points_and_a_single_pose_are_shown_without_a_play_bar(watch, tmp_path):
    panels = [Panel("mesh", Clip.still(zoo.point_cloud())), Panel("mesh", Clip.still(zoo.cube()))]
    watched = watch(write_player(tmp_path / "still.html", panels, title="still").as_uri())
    assert not watched.page.locator(".bar").is_visible()
    picture = watched.picture()
    left, right = np.array_split(picture, 2, axis=1)
    assert min(left.std(), right.std()) > 5


@pytest.mark.slow
def test_the_shadow_is_below_its_subject(watch, tmp_path):
    """A slab floats on the left and a small cube is on the right: the shadow on the floor is below the slab."""
    slab, small = (zoo.cube(),) * 2
    slab = slab.vertices * [0.6, 0.1, 0.6] + [-0.8, 0.5, 0]
    vertices = np.concatenate([slab, small.vertices * 0.05 + [1, 0, 0]])
    mesh = Mesh(vertices, np.concatenate([small.faces, small.faces + len(slab)]))
    page = write_player(tmp_path / "shadow.html", [Panel("mesh", Clip.still(mesh), front="+z")], title="shadow")
    watched = watch(page.as_uri())
    pictures = [watched.picture()]
    for name in ("subject", "shadow.floor"):
        watched.page.evaluate(f"mimesh.stage.views[0].{name}.visible = false; mimesh.stage.render()")
        pictures.append(watched.picture())
    both, shadow, neither = pictures
    subject, dark = (np.abs(a - b).sum(-1).sum(0) for a, b in ((both, shadow), (shadow, neither)))
    columns = np.arange(len(dark))
    middle, below = ((columns * weight).sum() / weight.sum() for weight in (subject, dark))
    assert dark.sum() > 1000
    assert abs(below - middle) < 0.1 * len(dark)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lacking", "words"),
    [
        ("delete window.DecompressionStream", "lacks DecompressionStream"),
        ("HTMLCanvasElement.prototype.getContext = () => null", "WebGL 2"),
    ],
)
def test_an_unsupported_browser_gets_a_message(watch, address, lacking, words):
    assert words in watch(address, script=lacking).page.locator(".refusal").inner_text()


@pytest.mark.slow
def test_the_policy_stops_foreign_scripts_and_requests(watch, tmp_path):
    page = tmp_path / "page.html"
    write_player(page, [Panel("result", Clip.still(textured_cube()))], title="A cube")
    watched = watch(page.as_uri())
    stopped = watched.page.evaluate("""async () => {
      const stopped = [];
      document.addEventListener("securitypolicyviolation", (event) => stopped.push(event.effectiveDirective));
      const script = document.createElement("script");
      script.textContent = "window.foreign = true";
      document.body.append(script);
      const image = document.createElement("img");
      image.src = "http://127.0.0.1:9/a.png";
      document.body.append(image);
      await fetch("http://127.0.0.1:9/").catch(() => {});
      await new Promise((done) => setTimeout(done, 200));
      return [window.foreign === true, stopped.sort()];
    }""")
    assert stopped[0] is False
    assert {"connect-src", "img-src", "script-src-elem"} <= set(stopped[1])
    watched.errors.clear()  # the browser reports what it stopped
    watched.requests[:] = [url for url in watched.requests if not url.startswith("http://127.0.0.1:9/")]
