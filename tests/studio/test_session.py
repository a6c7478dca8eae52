"""The desk without a server: what is made is what `mimesh` makes, the newest wish wins, and stopping stops."""

import dataclasses
import threading
import time

import numpy as np
import pytest
from people import person, walk

from mimesh import InputError, animate, save_clip, save_mesh, transfer
from mimesh.studio import make_desk
from mimesh.studio.jobs import Cancelled, Worker
from mimesh.studio.state import described


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A small person to move, another in a pose, and three frames of a third who walks."""
    folder = tmp_path_factory.mktemp("given")
    save_mesh(person(0), folder / "hero.obj")
    save_mesh(person(2, 1), folder / "pose.obj")
    save_clip(walk(frames=3), folder / "walk.npz")
    return folder


@pytest.fixture
def desk(files):
    """With the model that is done at once."""
    desk = make_desk([files / "hero.obj", files / "walk.npz"], 2**20, "copy")
    yield desk
    desk.close()


@pytest.fixture(scope="module")
def reader(files):
    """With the model that reads both surfaces, which takes a second; for all tests that need it."""
    desk = make_desk([files / "hero.obj", files / "walk.npz"], 2**20)
    yield desk
    desk.close()


def until(met, seconds=20.0):
    """Wait for something that the worker does."""
    end = time.monotonic() + seconds
    while not met():
        assert time.monotonic() < end
        time.sleep(0.005)


def only(desk):
    return next(iter(desk.identities.values()))


def done(desk):
    until(lambda: (outcome := only(desk).outcome) is not None and (outcome.current or outcome.error))
    return only(desk).outcome


def test_results_are_those_of_animate(reader, files):
    ours = animate(files / "hero.obj", files / "walk.npz")
    result = done(reader).result
    np.testing.assert_array_equal(result.clip.vertices, ours.clip.vertices)
    assert result.fps == ours.fps
    assert result.notes == ours.notes
    pose = reader.pose(only(reader).number, 2).result(20)
    np.testing.assert_allclose(pose, ours.clip.vertices[2], atol=1e-5)


def test_options_are_those_of_animate(reader, files):
    given = {"root": "drop", "refine": True, "smooth": 0.2}
    reader.set_options(given)
    ours = animate(files / "hero.obj", files / "walk.npz", **given)
    np.testing.assert_allclose(done(reader).result.clip.vertices, ours.clip.vertices, atol=1e-6)


def test_models_are_those_of_animate(desk, files):
    ours = animate(files / "hero.obj", files / "walk.npz", "copy")
    np.testing.assert_allclose(done(desk).result.clip.vertices, ours.clip.vertices, atol=1e-6)


def test_a_pose_is_that_of_transfer(desk, files):
    desk.set_driving(files / "pose.obj", "pose.obj")
    ours = transfer(files / "hero.obj", files / "pose.obj", "copy")
    np.testing.assert_array_equal(done(desk).result.clip.vertices[0], ours.vertices)


def test_options_that_make_no_sense_are_refused(desk):
    for given in ({"model": "/etc/passwd"}, {"root": "up"}, {"smooth": -1}, {"smooth": float("nan")}, {"ground": 1}):
        with pytest.raises(InputError, match="expected"):
            desk.set_options(given)
    with pytest.raises(InputError, match="two axes"):
        desk.set_item(only(desk).number, {"up": "y", "front": "-y"})


def test_what_cannot_be_read_is_said_without_a_path(desk, tmp_path):
    bad = tmp_path / "bad.glb"
    bad.write_text("hello")
    desk.add_identities([bad])
    until(lambda: any(item.error for item in desk.identities.values()))
    said = next(item.error for item in desk.identities.values() if item.error)
    assert "expected" in said
    assert done(desk).current, "the others go on"


def test_the_state_is_plain(desk):
    import json

    done(desk)
    state = json.loads(json.dumps(described(desk)))
    assert state["driving"]["frames"] == 3
    assert state["identities"][0]["outcome"]["state"] == "done"


def test_removing_takes_the_result_along(desk):
    done(desk)
    desk.remove(only(desk).number)
    assert not desk.identities
    assert described(desk)["scene"].count(".") >= 1


def test_the_newest_wish_wins_and_urgent_ones_go_between_frames():
    worker, begun, order = Worker(), threading.Event(), []

    def long(progress):
        for t in range(500):
            begun.set()
            time.sleep(0.002)
            progress(t, 500)
        order.append("long")

    clip = worker.put("clip", long)
    begun.wait()
    wishes = [worker.put("pose", lambda progress, k=k: order.append(k), urgent=True) for k in range(5)]
    wishes[-1].result(5)
    assert order[-1] == 4
    assert not clip.done()
    assert all(isinstance(wish.exception(), Cancelled | type(None)) for wish in wishes)
    worker.drop("clip")
    assert isinstance(clip.exception(1), Cancelled)
    worker.close()
    assert isinstance(worker.put("late", long).exception(1), Cancelled)


def test_stopping_keeps_the_desk_working(desk, files):
    done(desk)
    desk.set_options({"root": "keep"})
    desk.stop(only(desk).number)
    until(lambda: only(desk).outcome.stopped or only(desk).outcome.current)
    desk.set_options({"root": "scale"})
    assert done(desk).current


def test_joints_need_a_model_with_joints(desk, files):
    desk.set_options({"root": "keep"})
    outcome = done(desk)
    assert outcome.current, "options of joints are not asked of others"
    number = desk.export(".glb", [], True, None)
    until(lambda: desk.exports[number].error)
    assert "another model" in desk.exports[number].error


def test_nothing_is_left(files):
    desk = make_desk([files / "hero.obj"], 2**20)
    folder = desk.workplace.folder
    assert folder.is_dir()
    desk.close()
    assert not folder.exists()
    assert dataclasses.is_dataclass(desk.options)
