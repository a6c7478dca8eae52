"""Sessions without a server: results equal those of `mimesh`, the newest request counts, and jobs can be stopped."""

import json
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from grouped_options import grouped
from matrix import matrix
from people import person, walk
from waiting import finished, wait_until

from mimesh import Hints, InputError, Mesh, animate, capture, save_clip, save_mesh, transfer
from mimesh.bodies.animals import animal
from mimesh.core.mesh import Part
from mimesh.motions.animal_clips import gait_clip
from mimesh.studio import make_session
from mimesh.studio.exports import Order
from mimesh.studio.jobs import Cancelled, Worker
from mimesh.studio.state import describe


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A small person to move, another in a pose, and three frames of a third who walks."""
    folder = tmp_path_factory.mktemp("inputs")
    save_mesh(person(0), folder / "hero.obj")
    save_mesh(person(2, 1), folder / "pose.obj")
    save_clip(walk(frames=3), folder / "walk.npz")
    return folder


@pytest.fixture
def session(files):
    """A session with the model `copy`, which takes no time."""
    session = make_session([files / "hero.obj", files / "walk.npz"], 2**20, "copy")
    yield session
    session.close()


@pytest.fixture(scope="module")
def mime_session(files, model):
    """A session with a tiny network of the kind of `mime`, for all tests that need joints."""
    session = make_session([files / "hero.obj", files / "walk.npz"], 2**20, model)
    yield session
    session.close()


@pytest.mark.slow
def test_animations_of_joints_without_a_mesh_can_be_chosen(files, tmp_path):
    """A library of motions, as game packs have them, with two animations."""
    path = tmp_path / "motions.gltf"
    capture(files / "walk.npz").save(path)
    document = json.loads(path.read_text())
    walking = document["animations"][0]
    document["animations"] = [{**walking, "name": "Walk"}, {**walking, "name": "Again"}]
    path.write_text(json.dumps(document))
    session = make_session([files / "hero.obj", path], 2**20, "copy")
    try:
        finished(session)
        assert session.driving.animations == ("Walk", "Again")
        assert describe(session)["driving"]["animations"] == ("Walk", "Again")
    finally:
        session.close()


def test_errors_of_cancelled_work_are_nobodys(capsys):
    """Its inputs may have been replaced while it ran."""
    worker, began, go = Worker(), threading.Event(), threading.Event()

    def fail(progress):
        began.set()
        assert go.wait(10)
        raise TypeError("object of type 'NoneType' has no len()")

    cancelled, reported = worker.submit("a", fail), worker.submit("b", fail)
    assert began.wait(10)
    worker.cancel("a")
    go.set()
    assert isinstance(cancelled.exception(10), Cancelled)
    assert isinstance(reported.exception(10), TypeError)
    assert capsys.readouterr().err.count("Traceback") == 1
    worker.close()


def test_a_refused_change_changes_nothing(session):
    finished(session)
    driving = session.driving
    for changes in ({"up": "+z", "fps": -5}, {"up": "+z", "fps": 1e9}, {"fps": 12, "up": -1}, {"front": ["+x"]}):
        with pytest.raises(InputError, match="expected"):
            session.set_item(driving.number, changes)
    assert (driving.up, driving.front, driving.fps) == (None, None, None)


def only_item(session):
    """Return the only mesh to move."""
    return next(iter(session.identities.values()))


def test_results_are_those_of_animate(mime_session, files, model):
    expected = animate(files / "hero.obj", files / "walk.npz", model)
    result = finished(mime_session).outcome.result
    np.testing.assert_array_equal(result.clip.vertices, expected.clip.vertices)
    assert result.fps == expected.fps
    assert result.notes == expected.notes
    pose = mime_session.pose(only_item(mime_session).number, 2).result(20)
    np.testing.assert_allclose(pose, expected.clip.vertices[2], atol=1e-5)
    options = {"root": "drop", "refine": True, "smooth": 0.2}
    mime_session.set_options(options)
    expected = animate(files / "hero.obj", files / "walk.npz", model, **grouped(**options))
    result = finished(mime_session).outcome.result
    np.testing.assert_allclose(result.clip.vertices, expected.clip.vertices, atol=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("kept")
def test_the_body_is_found_or_given(tmp_path):
    dog = gait_clip("dog", "walk", seconds=0.1, fps=10.0)
    save_mesh(animal("cat"), tmp_path / "cat.ply")
    save_mesh(dog.mesh.with_vertices(dog.vertices[0]), tmp_path / "dog.ply")  # a pose, which is read as a clip
    session = make_session([tmp_path / "cat.ply", tmp_path / "dog.ply"], 2**20)
    result = finished(session).outcome.result
    state = describe(session)
    assert state["identities"][0]["outcome"]["body"] == "quadruped"
    for item, which in ((state["identities"][0], "identity"), (state["driving"], "driving")):
        axes = result.report[which]
        assert (item["facing"]["up"], item["facing"]["front"]) == (axes["up"], axes["front"]) == ("+y", "+z")
    session.set_options({"body": "human"})
    assert finished(session).outcome.result.report["body"] == "human"
    session.set_options({"model": "copy", "body": "quadruped"})
    assert finished(session).outcome.current, "models without bodies ignore the option"
    assert describe(session)["identities"][0]["outcome"]["body"] == ""
    session.close()


def test_parts_are_chosen_of_both_meshes(files, model, tmp_path):
    two = person(0), person(2, 1)
    starts = np.cumsum([0, *(len(mesh.faces) for mesh in two)])
    vertices = np.concatenate([two[0].vertices, two[1].vertices + [3.0, 0, 0]])
    faces = np.concatenate([two[0].faces, two[1].faces + len(two[0].vertices)])
    parts = tuple(Part(name, *map(int, starts[k : k + 2])) for k, name in enumerate(("hero", "twin")))
    save_mesh(Mesh(vertices, faces, "scene", parts=parts), tmp_path / "scene.obj")
    session = make_session([tmp_path / "scene.obj", tmp_path / "scene.obj"], 2**20, model)
    finished(session)
    assert describe(session)["identities"][0]["parts"] == describe(session)["driving"]["parts"] == ("hero", "twin")
    session.set_item(only_item(session).number, {"part": "hero"})
    driving = describe(session)["driving"]["number"]
    session.set_item(driving, {"part": "twin"})
    moved = finished(session).outcome.result.clip.vertices[0]
    hints = Hints(part="hero", driving_part="twin")
    expected = transfer(tmp_path / "scene.obj", tmp_path / "scene.obj", model, hints=hints)
    np.testing.assert_array_equal(moved, expected.vertices)
    hero = len(two[0].vertices)
    np.testing.assert_allclose(moved[hero:], vertices[hero:], atol=1e-5)
    assert np.abs(moved[:hero] - vertices[:hero]).max() > 0.05
    with pytest.raises(InputError, match="expected one of its parts, found 'dog'"):
        session.set_item(driving, {"part": "dog"})
    session.close()


def test_models_are_those_of_animate_and_poses_those_of_transfer(session, files):
    expected = animate(files / "hero.obj", files / "walk.npz", "copy")
    result = finished(session).outcome.result
    np.testing.assert_allclose(result.clip.vertices, expected.clip.vertices, atol=1e-6)
    session.set_driving(files / "pose.obj", "pose.obj")
    expected = transfer(files / "hero.obj", files / "pose.obj", "copy")
    np.testing.assert_array_equal(finished(session).outcome.result.clip.vertices[0], expected.vertices)


def test_invalid_options_are_refused(session):
    for options in (
        {"model": "/etc/passwd"},
        {"body": "fish"},
        {"root": "up"},
        {"smooth": -1},
        {"smooth": float("nan")},
        {"ground": 1},
        {"contacts": 1},
    ):
        with pytest.raises(InputError, match="expected"):
            session.set_options(options)
    with pytest.raises(InputError, match="two axes"):
        session.set_item(only_item(session).number, {"up": "y", "front": "-y"})


def test_unreadable_files_give_an_error_and_others_go_on(session, tmp_path):
    bad = tmp_path / "bad.glb"
    bad.write_text("hello")
    session.add_identities([bad])
    wait_until(lambda: any(item.error for item in session.identities.values()))
    message = next(item.error for item in session.identities.values() if item.error)
    assert "expected" in message
    assert finished(session).outcome.current, "other meshes are not affected"


def test_the_state_is_json_and_a_mesh_is_removed_with_its_result(session):
    finished(session)
    state = json.loads(json.dumps(describe(session)))
    assert state["driving"]["frames"] == 3
    assert state["identities"][0]["outcome"]["state"] == "done"
    session.remove(only_item(session).number)
    assert not session.identities
    assert describe(session)["scene"].count(".") >= 1


def test_the_newest_job_of_a_key_counts_and_urgent_ones_run_between_frames():
    worker, started, order = Worker(), threading.Event(), []

    def long(progress):
        for t in range(500):
            started.set()
            time.sleep(0.002)
            progress(t, 500)
        order.append("long")

    clip = worker.submit("clip", long)
    started.wait()
    poses = [worker.submit("pose", lambda progress, k=k: order.append(k), urgent=True) for k in range(5)]
    poses[-1].result(5)
    assert order[-1] == 4
    assert not clip.done()
    assert all(isinstance(pose.exception(), Cancelled | type(None)) for pose in poses)
    worker.cancel("clip")
    assert isinstance(clip.exception(1), Cancelled)
    worker.close()
    assert isinstance(worker.submit("late", long).exception(1), Cancelled)


def test_results_are_computed_after_stopping(session, files):
    finished(session)
    session.set_options({"root": "keep"})
    session.stop(only_item(session).number)
    wait_until(lambda: only_item(session).outcome.stopped or only_item(session).outcome.current)
    session.set_options({"root": "scale"})
    assert finished(session).outcome.current


MOVING = """#usda 1.0
(
 startTimeCode = 0
 endTimeCode = 86000
)
def Mesh "m" {
 point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
 point3f[] points.timeSamples = { 0: [(0, 0, 0), (1, 0, 0), (0, 1, 0)], 9: [(0, 0, 0), (1, 0, 0), (0, 2, 0)] }
 int[] faceVertexCounts = [3]
 int[] faceVertexIndices = [0, 1, 2]
}
"""
"""An hour of a triangle, which takes seconds to read."""


@pytest.mark.skipif(sys.platform != "linux", reason="the children of a thread are listed by Linux only")
@matrix("end", ["remove", "close"], quick=["remove"])
def test_reading_in_a_child_is_stopped_at_once(end, session, tmp_path):
    pytest.importorskip("pxr")

    def children():
        threads = Path("/proc/self/task").iterdir()
        return [number for thread in threads for number in (thread / "children").read_text().split()]

    (tmp_path / "long.usda").write_text(MOVING)
    before = set(children())
    number = session.set_driving(tmp_path / "long.usda", "long.usda")
    wait_until(lambda: set(children()) - before)
    start = time.monotonic()
    if end == "remove":
        session.remove(number)
    else:
        session.close()
    wait_until(lambda: not set(children()) - before, 2.0)
    assert time.monotonic() - start < 2.0
    assert session.driving is None or session.driving.content is None


def test_skinned_exports_need_a_model_with_joints(session, files):
    session.set_options({"root": "keep"})
    outcome = finished(session).outcome
    assert outcome.current, "models without joints ignore their options"
    number = session.export(Order(skinned=True))
    wait_until(lambda: session.exports[number].error)
    assert "another with the model" in session.exports[number].error


def test_closing_deletes_the_files(files):
    session = make_session([files / "hero.obj"], 2**20)
    folder = session.uploads.folder
    assert folder.is_dir()
    session.close()
    assert not folder.exists()
