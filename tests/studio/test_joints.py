"""Corrected joints in a studio: results are those of `animate`, side files are found, wrong ones are said."""

import json

import numpy as np
import pytest
from people import person, walk
from waiting import finished

from mimesh import InputError, animate, save_clip, save_mesh
from mimesh.core.joint_corrections import JointCorrections
from mimesh.core.options import Hints
from mimesh.io.joint_file import load_corrections, save_corrections
from mimesh.pipeline.known import shown_bones
from mimesh.studio import make_session
from mimesh.studio.state import describe

pytestmark = pytest.mark.usefixtures("kept")


@pytest.fixture
def files(tmp_path):
    save_mesh(person(0), tmp_path / "hero.obj")
    save_clip(walk(frames=3), tmp_path / "walk.npz")
    return tmp_path


@pytest.fixture
def start(files):
    """A function that starts a session of the files, and returns it with its finished mesh."""
    opened = []

    def session(model):
        opened.append(make_session([files / "hero.obj", files / "walk.npz"], 2**20, model))
        return opened[-1], finished(opened[-1])

    yield session
    for one in opened:
        one.close()


@pytest.mark.slow
def test_corrections_give_the_result_of_animate_and_can_be_taken_back(start, files, visit):
    session, item = start("mime")
    page, plain, number = visit(session), item.outcome.result, item.number
    found = page.get(f"/api/meshes/{number}/joints").json()
    joints = found["meshes"][str(number)]["joints"]
    assert joints.keys() == found["parents"].keys() == shown_bones().keys()
    assert len(joints) == 23
    knee = [joints["LeftLeg"][0] + 0.05, *joints["LeftLeg"][1:]]
    session.set_joints(number, {"LeftLeg": knee})
    elbow = found["meshes"][str(session.driving.number)]["joints"]["LeftForeArm"]
    session.set_joints(session.driving.number, {"LeftForeArm": elbow})
    expected = animate(
        files / "hero.obj",
        files / "walk.npz",
        hints=Hints(joints={"LeftLeg": knee}, driving_joints={"LeftForeArm": elbow}),
    )
    corrected = finished(session).outcome.result
    np.testing.assert_array_equal(corrected.clip.vertices, expected.clip.vertices)
    again = session.joints(number).result(60)
    assert again["meshes"][str(number)]["joints"]["LeftLeg"] == pytest.approx(knee)
    assert describe(session)["identities"][0]["joints"]["corrected"] == {"LeftLeg": knee}
    session.set_joints(number, {})
    session.set_joints(session.driving.number, {})
    np.testing.assert_array_equal(finished(session).outcome.result.clip.vertices, plain.clip.vertices)


def test_joints_are_set_and_downloaded_and_wrong_ones_refused(start, files, visit):
    session, item = start("copy")
    page, address = visit(session), f"/api/meshes/{item.number}/joints"
    for positions, message in (
        ({"LeftKnee": [0, 0, 0]}, "did you mean LeftLeg"),
        ({"LeftLeg": [0, 0]}, "three finite numbers"),
        ({"LeftLeg": [99, 0, 0]}, "near hero.obj"),
        (["LeftLeg"], "expected an object of positions"),
        (None, "expected an object of positions"),
    ):
        with pytest.raises(InputError, match=message):
            session.set_joints(item.number, positions)
        assert item.corrections is None
    head = person(0).vertices.mean(axis=0).tolist()
    refused = page.post(address, json={"joints": {"Hat": head}})
    assert refused.status_code == 422
    assert "expected names of joints" in refused.json()["error"]
    assert page.post(address, json={"joints": {"Head": head}}).status_code == 200
    response = page.get(f"{address}.json")
    assert "hero.joints.json" in response.headers["content-disposition"]
    path = files / "hero.joints.json"
    path.write_text(json.dumps(response.json()))
    assert load_corrections(path).positions["Head"] == pytest.approx(head, rel=1e-6)
    assert page.get(address).json() == {}, "the model has none"
    assert page.get("/api/meshes/999/joints").status_code == 204
    assert page.get("/api/meshes/999/joints.json").status_code == 422


def test_side_files_are_used_and_their_errors_said(start, files):
    save_corrections(JointCorrections.of({"Head": person(0).vertices.mean(axis=0)}), files / "hero.joints.json")
    (files / "walk.joints.json").write_text('{"joints": {"Heads": [0, 0, 0]}}')
    session, _ = start("copy")
    state = describe(session)
    assert list(state["identities"][0]["joints"]["corrected"]) == ["Head"]
    assert "did you mean Head" in state["driving"]["joints"]["error"]
    assert state["driving"]["joints"]["corrected"] == {}
