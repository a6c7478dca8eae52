"""The studio's page in a browser, from files that are chosen and dropped to a file that is downloaded."""

import base64
import contextlib
import threading

import gltf_samples as samples
import numpy as np
import pygltflib
import pytest
from creatures import BIRD, Boxes, flapping
from people import person, walk

from mimesh import animate, capture, load_clip, rig, save_clip, save_mesh
from mimesh.bodies.animals import animal
from mimesh.io.gltf.vrm import PUBLIC_LICENSE
from mimesh.motions.animal_clips import gait_clip

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("kept")]

SIZE = {"width": 760, "height": 480}
HERO = ".row[data-state='done']:has-text('hero.glb')"
DROP = """([role, name, text]) => {
  const transfer = new DataTransfer();
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  transfer.items.add(new File([bytes], name));
  const send = (type, target) =>
    target.dispatchEvent(new DragEvent(type, { dataTransfer: transfer, bubbles: true, cancelable: true }));
  send("dragenter", document.body);
  const target = document.querySelector(`#drop [data-role=${role}]`);
  if (!target.checkVisibility()) throw new Error("the drop target is not visible");
  send("drop", target);
}"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A small person as .glb and .obj, three frames of another who walks, and files without a mesh."""
    folder = tmp_path_factory.mktemp("files")
    save_mesh(person(0), folder / "hero.glb")
    save_mesh(person(0), folder / "hero.obj")
    save_clip(walk(frames=3), folder / "walk.npz")
    (folder / "bad.glb").write_text("this is not a mesh")
    (folder / "flat.obj").write_text("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n")
    return folder


@pytest.fixture(scope="module")
def studio_page(studio, watch_all):
    """The page, opened once; it must send no request to other machines and log no error."""
    origin, token, _ = studio
    # Without motion, so that drawing in software leaves time for the rest.
    options = {"viewport": SIZE, "reduced_motion": "reduce"}
    return watch_all(f"{origin}/?token={token}", allowed=(origin, "data:", "blob:"), **options)


@pytest.fixture
def fresh(studio, studio_page):
    """The page of an empty session, with the model `copy`, which takes no time."""
    session = studio[2]
    session.set_options({"model": "copy"})
    for number in [*session.identities, *([session.driving.number] if session.driving else [])]:
        session.remove(number)
    studio_page.page.wait_for_selector("#welcome:not([hidden])")
    return studio_page


def choose(page, role, *paths):
    page.set_input_files(f"#{'driving' if role == 'driving' else 'identities'} input[data-role]", list(map(str, paths)))


def drop(page, role, path):
    page.evaluate(DROP, [role, path.name, base64.b64encode(path.read_bytes()).decode()])


def wait_and_pause(page):
    """Wait until the stage shows the server's scene, and pause it."""
    page.wait_for_function(
        "() => mimesh.live.state?.scene === document.documentElement.dataset.scene && !mimesh.live.loading"
    )
    page.evaluate("() => mimesh.controls.pause()")


def test_a_scene_that_loads_and_an_animation_that_is_taken_are_told(fresh, files, tmp_path):
    """Of a long clip the scene takes seconds to come, in which the stage of a page that was opened again is empty."""
    page, sample = fresh.page, samples.hero()
    (walking,) = sample.gltf["animations"]
    sample.gltf["animations"] = [{**walking, "name": "Walk"}, {**walking, "name": "Run"}]
    choose(page, "driving", sample.glb(tmp_path / "moves.glb"))
    page.wait_for_selector("#driving .note:has-text('moves.glb has 2 animations: the first, Walk, is taken')")
    wait_and_pause(page)
    held = []
    page.route("**/api/scene", lambda route: held.append(route))
    page.reload()
    page.wait_for_selector("#loading:not([hidden])")
    page.wait_for_selector("#doing:has-text('loading the scene')")
    (route,) = held
    route.continue_()
    page.unroute("**/api/scene")
    wait_and_pause(page)
    assert page.query_selector("#loading").is_hidden()
    assert page.query_selector("#doing").is_hidden()


def changed_pixels(before, after):
    """Count the pixels that differ visibly."""
    return int((np.abs(before - after).max(axis=-1) > 24).sum())


@contextlib.contextmanager
def sized(page, width, height):
    """Give the window another size for a while."""
    page.set_viewport_size({"width": width, "height": height})
    yield
    page.set_viewport_size(SIZE)


def test_chosen_and_dropped_files_become_downloads(fresh, files, tmp_path):
    page = fresh.page
    page.select_option("#model select", "mime")
    choose(page, "identity", files / "hero.glb")
    drop(page, "driving", files / "walk.npz")
    page.wait_for_selector(HERO)
    wait_and_pause(page)
    page.evaluate("() => mimesh.stage.setTime(0)")
    first = fresh.picture()
    page.evaluate("() => mimesh.stage.setTime(mimesh.stage.duration)")
    assert changed_pixels(first, fresh.picture()) > 2000, "the result plays"

    def download():
        with page.expect_download() as waiting:
            page.click("#write")
        path = tmp_path / waiting.value.suggested_filename
        waiting.value.save_as(path)
        return path

    animate(files / "hero.glb", files / "walk.npz").save_skinned(tmp_path / "expected.glb")
    path = download()
    assert path.name == "hero-walk.glb"
    back, written = load_clip(path), load_clip(tmp_path / "expected.glb")
    np.testing.assert_allclose(back.vertices, written.vertices, atol=1e-6)
    assert back.fps == written.fps
    page.click("#bones summary")
    page.get_by_label("Bone names").select_option("unreal")
    page.get_by_label("Root bone").check()
    names = {node.name for node in pygltflib.GLTF2().load(download()).nodes}
    assert {"root", "pelvis", "upperarm_l"} <= names
    page.get_by_label("Root bone").uncheck()
    page.get_by_label("Bone names").select_option("own")
    page.get_by_label("Format").select_option(".vrma")
    assert page.get_by_label("Bone names").is_disabled(), "those of VRM"
    assert download().name == "hero-walk.vrma"
    page.get_by_label("Format").select_option(".obj" if page.locator("option[value='.obj']").count() else ".npz")
    assert page.get_by_label("With bones").is_disabled()
    page.get_by_label("Format").select_option(".glb")
    page.click("#bones summary")
    page.reload()
    page.wait_for_selector(HERO)
    assert page.locator("#model select").first.input_value() == "mime", "reloading loses nothing"


def test_rigs_and_motions_are_exported_by_keyboard(fresh, files, tmp_path):
    page = fresh.page
    what, form = page.get_by_label("What", exact=True), page.get_by_label("Format")

    def download():
        with page.expect_download() as waiting:
            page.focus("#write")
            page.keyboard.press("Enter")
        path = tmp_path / waiting.value.suggested_filename
        waiting.value.save_as(path)
        return path

    choose(page, "identity", files / "hero.glb")
    page.wait_for_selector("#identities .row[data-state=ready]")
    what.focus()
    page.keyboard.press("ArrowDown")
    assert what.input_value() == "rig"
    assert page.locator("#write").is_disabled(), "copy has no joints"
    page.select_option("#model select", "mime")
    page.wait_for_selector("#write:enabled")
    path = download()
    assert path.read_bytes() == rig(files / "hero.glb").save(tmp_path / "expected.glb").read_bytes()
    assert path.name == "hero-rigged.glb"
    assert page.get_by_label("Author").is_hidden()
    form.select_option(".vrm")
    page.get_by_label("Author").fill("Ada")
    page.get_by_label("Licence").fill(PUBLIC_LICENSE)
    assert download().name == "hero-rigged.vrm"
    what.select_option("motion")
    assert page.locator("#bones").is_hidden()
    assert page.locator("#write").is_disabled(), "there is no driving"
    page.get_by_label("Remove hero.glb").click()
    choose(page, "driving", files / "walk.npz")
    page.wait_for_selector("#write:enabled")
    path = download()
    assert path.read_bytes() == capture(files / "walk.npz").save(tmp_path / "expected.bvh").read_bytes()
    assert path.name == "walk.bvh"
    what.select_option("result")


def test_export_stays_in_sight_below_many_meshes(fresh, files, studio):
    page = fresh.page
    with sized(page, 1366, 768):
        studio[2].add_identities(4 * [files / "hero.obj"])
        page.wait_for_function("() => document.querySelectorAll('#identities .row').length === 4")
        box = page.locator("#write").bounding_box()
        assert box["y"] + box["height"] <= 768
        first = page.locator("#side h2").all_inner_texts()
        assert [title.split("\n")[-1] for title in first[:3]] == ["Meshes to move", "Driving motion", "Export"]


def test_animals_are_found_and_refused_with_people(fresh, files, tmp_path):
    dog = gait_clip("dog", "walk", seconds=0.1, fps=10.0)
    save_mesh(animal("cat"), tmp_path / "cat.glb")
    save_mesh(dog.mesh.with_vertices(dog.vertices[0]), tmp_path / "dog.ply")
    page = fresh.page
    body, smoothing = page.get_by_label("Both meshes are"), page.locator("#model").get_by_label("Feet on the ground")
    assert body.is_disabled(), "only mime has several bodies"
    assert smoothing.is_disabled()
    page.select_option("#model select", "mime")
    choose(page, "identity", tmp_path / "cat.glb")
    drop(page, "driving", tmp_path / "dog.ply")
    row = "#identities .row:has-text('cat.glb')"
    page.wait_for_selector(f"{row}[data-state=done]:has-text('moved as a four-legged animal in')")
    assert body.is_enabled()
    assert smoothing.is_enabled()
    wait_and_pause(page)
    with sized(page, 1100, 600):
        page.click("[data-name=joints]")
        page.wait_for_selector("svg.joints circle[aria-label^='LeftThigh']")
        assert page.locator("svg.joints").count() == 2
        page.click("[data-name=joints]")
        choose(page, "identity", files / "hero.glb")
        error = page.wait_for_selector("#identities .row:has-text('hero.glb') .error:visible").inner_text()
        assert "hero is taken for a person, and dog for a four-legged animal" in error
        assert "“both meshes are: a person”" in error
        assert page.locator(row).get_attribute("data-state") == "done", "the other mesh is still moved"


def test_unreadable_files_give_messages_and_the_page_stays_usable(fresh, files):
    page = fresh.page
    choose(page, "identity", files / "bad.glb", files / "flat.obj")
    page.wait_for_function("() => document.querySelectorAll('#identities .row[data-state=failed]').length === 2")
    text = page.inner_text("#identities")
    assert "bad.glb: expected" in text
    shown = page.inner_text("#notice p")
    assert shown.startswith(("bad.glb: ", "flat.obj: "))
    page.click("#notice button")
    assert page.inner_text("#notice p") not in ("", shown), "the other problem remains"
    assert "flat.obj: expected a mesh with some size" in text
    for word in ("Traceback", 'File "', "/tmp/"):
        assert word not in text
    drop(page, "driving", files / "bad.glb")
    page.wait_for_selector("#driving .row[data-state=failed] .error")
    for cross in page.locator(".side .row .icon").all()[::-1]:
        cross.click()
    page.wait_for_selector("#welcome:not([hidden])")
    assert not page.locator("#notice").is_visible(), "nothing is wrong any more"


def test_two_meshes_are_moved_and_exported(fresh, files, studio):
    page, session = fresh.page, studio[2]
    choose(page, "identity", files / "hero.glb", files / "hero.obj")
    choose(page, "driving", files / "hero.obj")
    page.wait_for_function("() => document.querySelectorAll('#identities .row[data-state=done]').length === 2")
    wait_and_pause(page)
    page.wait_for_function("() => mimesh.stage.views.length === 3")
    with page.expect_download() as download:
        page.click("#write")
    assert download.value.suggested_filename == "2 meshes.zip"
    page.locator("#identities .row .icon").first.click()
    page.wait_for_function("() => mimesh.stage.views.length === 3 && mimesh.stage.views[0].panel.role === 'identity'")
    assert len(session.identities) == 1


def test_the_slider_shows_poses_while_the_clip_is_computed(fresh, files, studio, monkeypatch):
    """The clip is delayed; the pose under the slider is shown nevertheless."""
    from mimesh.studio import operations

    page, proceed, compute = fresh.page, threading.Event(), operations.compute_result

    def wait(*arguments):
        while not proceed.wait(0.01):
            arguments[-1](0, 1)
        return compute(*arguments)

    monkeypatch.setattr(operations, "compute_result", wait)
    choose(page, "identity", files / "hero.glb")
    choose(page, "driving", files / "walk.npz")
    page.wait_for_selector(".panel.waiting")
    wait_and_pause(page)
    page.evaluate("() => mimesh.stage.setTime(0)")
    page.wait_for_function("() => mimesh.stage.views.at(-1).panel.fixedPose")
    assert page.locator(".panel-result.waiting.posed").count() == 1, "the caption says that it is a pose only"
    first = fresh.picture(".panel-result")
    page.evaluate("() => mimesh.stage.setTime(mimesh.stage.duration)")
    page.wait_for_function("() => mimesh.live.requests.size === 0")
    assert changed_pixels(first, fresh.picture(".panel-result")) > 500
    proceed.set()
    page.wait_for_selector(HERO)
    page.wait_for_function("() => !mimesh.stage.views.at(-1).panel.fixedPose")


def test_keyboard_theme_and_narrow_windows_work(fresh, monkeypatch):
    from mimesh.studio import operations

    monkeypatch.setattr(operations, "demo_mesh", lambda name: person(0))
    monkeypatch.setattr(operations, "demo_clip", lambda motion: walk(frames=2))
    page = fresh.page
    page.focus("#welcome button")
    page.keyboard.press("Enter")
    page.wait_for_selector("#identities .row[data-state=done]")
    groups = page.locator("#character optgroup, #motion optgroup").evaluate_all("(all) => all.map((one) => one.label)")
    assert groups == 2 * ["People", "Four-legged animals"]
    page.select_option("#character", "imp")
    page.wait_for_selector("#identities .row[data-state=done]:has-text('imp')")
    wait_and_pause(page)
    light = fresh.picture("#side")
    page.keyboard.press("d")
    assert changed_pixels(light, fresh.picture("#side")) > 10_000
    page.keyboard.press("d")
    with sized(page, 400, 760):
        assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth"), "nothing exceeds the window"


def test_animals_and_other_creatures_are_chosen_and_moved(fresh, tmp_path):
    page = fresh.page
    with sized(page, 1100, 600):
        page.get_by_role("button", name="Try animals").click()
        page.wait_for_selector("#identities .row:has-text('cow')")
        page.wait_for_selector("#driving .rows:has-text('horse gallop')")
        page.get_by_label("Remove cow").click()
        page.select_option("#model select", "mime")
        page.get_by_label("Both meshes are").select_option("other")
        large = Boxes.of(BIRD, size=3.0).renamed(1)
        choose(page, "driving", large.write(tmp_path / "large.glb", flapping(large.names)))
        choose(page, "identity", Boxes.of(BIRD).write(tmp_path / "bird.glb"))
        page.wait_for_selector("#identities .row:has-text('moved as a creature (confidence 0.84) in')")
        assert "8 joints follow those of large.glb" in page.inner_text("#identities .note")
        wait_and_pause(page)
        page.click("[data-name=joints]")
        page.wait_for_selector("text=These rigs are followed as they are: no joints to correct.")
        page.click("[data-name=joints]")
        page.get_by_label("Both meshes are").select_option("auto")


def joint_place(page, name, panel="identity"):
    """Return the place of a joint's handle in the window, once it has not moved for a third of a second.

    Handles are made anew, and are not there for a moment, when a new result is shown.
    """
    handle, boxes = page.locator(f".panel-{panel} circle[aria-label^='{name} of']"), []
    for _ in range(200):
        boxes.append(handle.bounding_box() if handle.count() else None)
        if len(boxes) > 3 and boxes[-1] and all(box == boxes[-1] for box in boxes[-4:]):
            box = boxes[-1]
            return np.array([box["x"] + box["width"] / 2, box["y"] + box["height"] / 2])
        page.wait_for_timeout(100)
    raise AssertionError(f"{name} keeps moving: {boxes[-4:]}")


def test_joints_are_dragged_moved_by_keys_and_reset(fresh, files, studio):
    page, session = fresh.page, studio[2]
    page.select_option("#model select", "mime")
    choose(page, "identity", files / "hero.glb")
    choose(page, "driving", files / "walk.npz")
    page.wait_for_selector(HERO)
    wait_and_pause(page)
    page.set_viewport_size({"width": 1100, "height": 600})
    page.click("[data-name=joints]")
    page.wait_for_selector("svg.joints circle")
    assert page.locator("svg.joints circle").count() == 2 * 23
    before = joint_place(page, "LeftForeArm")
    page.mouse.move(*before)
    page.mouse.down()
    page.mouse.move(*before + [10, 6], steps=3)
    page.mouse.move(*before + [20, 12])
    page.mouse.up()
    page.wait_for_function("() => 'LeftForeArm' in mimesh.live.state.identities[0].joints.corrected")
    page.wait_for_selector(HERO)
    # The joint of the new fit lies near the place it was dragged to, not at it.
    np.testing.assert_allclose(joint_place(page, "LeftForeArm") - before, [20, 12], atol=3)
    assert page.locator("circle.corrected").count() == 1
    assert "Corrected by hand: LeftForeArm" in page.inner_text("#identities")
    # The keyboard: choose a joint in the list, then use the arrow keys; they do not move the time.
    page.select_option(".joint-bar select", "driving Head")
    page.evaluate("async () => { mimesh.live.key = ''; await mimesh.live.load(); }")  # new panels, as after a result
    head, time = joint_place(page, "Head", "driving"), page.evaluate("() => mimesh.stage.time")
    page.keyboard.press("Shift+ArrowRight")
    page.wait_for_function("() => 'Head' in mimesh.live.state.driving.joints.corrected")
    np.testing.assert_allclose(joint_place(page, "Head", "driving") - head, [10, 0], atol=3)  # near, as above
    assert page.evaluate("() => mimesh.stage.time") == time
    with page.expect_download() as download:
        page.click(".joint-bar a")
    assert download.value.suggested_filename == "walk.joints.json"
    page.keyboard.press("Escape")
    page.click("text=Undo")
    page.wait_for_function("() => !('Head' in mimesh.live.state.driving.joints.corrected)")
    page.locator(".panel-identity circle[aria-label^='LeftForeArm of']").dblclick()
    page.wait_for_function("() => !Object.keys(mimesh.live.state.identities[0].joints.corrected).length")
    page.click("text=Undo")
    page.wait_for_function("() => 'LeftForeArm' in mimesh.live.state.identities[0].joints.corrected")
    page.click("text=Reset all")
    page.wait_for_function("() => !Object.keys(mimesh.live.state.identities[0].joints.corrected).length")
    assert all(item.corrections is None for item in (*session.identities.values(), session.driving))
    page.click("[data-name=joints]")
    assert page.locator("svg.joints").count() == 0
    page.set_viewport_size({"width": 760, "height": 480})
