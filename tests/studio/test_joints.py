"""Corrected joints in a studio: results are those of `animate`, side files are found, wrong ones are said."""

import json

import numpy as np
import pytest
from people import person, walk
from starlette.testclient import TestClient
from waiting import finished

from mimesh import InputError, animate, save_clip, save_mesh
from mimesh.core.joint_corrections import JointCorrections
from mimesh.io.joint_file import load_corrections, save_corrections
from mimesh.pipeline.corrections import shown_bones
from mimesh.studio import make_session
from mimesh.studio.app import make_app
from mimesh.studio.security import AccessControl
from mimesh.studio.state import describe


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    save_mesh(person(0), folder / "hero.obj")
    save_clip(walk(frames=3), folder / "walk.npz")
    return folder


def result(session):
    """Wait for the result of the only mesh; returns the item and the result."""
    item = finished(session)
    return item, item.outcome.result


@pytest.fixture(scope="module")
def session(files):
    session = make_session([files / "hero.obj", files / "walk.npz"], 2**20)
    yield session
    session.close()


@pytest.mark.slow
def test_corrections_give_the_result_of_animate_and_can_be_taken_back(session, files):
    item, plain = result(session)
    found = session.joints(item.number).result(60)
    joints = found["meshes"][str(item.number)]["joints"]
    assert joints.keys() == found["parents"].keys() == shown_bones().keys()
    assert len(joints) == 23
    knee = [joints["LeftLeg"][0] + 0.05, *joints["LeftLeg"][1:]]
    session.set_joints(item.number, {"LeftLeg": knee})
    elbow = found["meshes"][str(session.driving.number)]["joints"]["LeftForeArm"]
    session.set_joints(session.driving.number, {"LeftForeArm": elbow})
    expected = animate(
        files / "hero.obj", files / "walk.npz", joints={"LeftLeg": knee}, driving_joints={"LeftForeArm": elbow}
    )
    item, corrected = result(session)
    np.testing.assert_array_equal(corrected.clip.vertices, expected.clip.vertices)
    again = session.joints(item.number).result(60)
    assert again["meshes"][str(item.number)]["joints"]["LeftLeg"] == pytest.approx(knee)
    state = describe(session)
    assert state["identities"][0]["joints"]["corrected"] == {"LeftLeg": knee}
    session.set_joints(item.number, {})
    session.set_joints(session.driving.number, {})
    np.testing.assert_array_equal(result(session)[1].clip.vertices, plain.clip.vertices)


@pytest.mark.parametrize(
    ("positions", "message"),
    [
        ({"LeftKnee": [0, 0, 0]}, "did you mean LeftLeg"),
        ({"LeftLeg": [0, 0]}, "three finite numbers"),
        ({"LeftLeg": [99, 0, 0]}, "near hero.obj"),
        (["LeftLeg"], "expected an object of positions"),
        (None, "expected an object of positions"),
    ],
)
def test_wrong_positions_are_refused(session, positions, message):
    item, _ = result(session)
    with pytest.raises(InputError, match=message):
        session.set_joints(item.number, positions)
    assert item.corrections is None


def test_side_files_are_used_and_their_errors_said(files, tmp_path):
    for name in ("hero.obj", "walk.npz"):
        (tmp_path / name).write_bytes((files / name).read_bytes())
    save_corrections(JointCorrections.of({"Head": person(0).vertices.mean(axis=0)}), tmp_path / "hero.joints.json")
    (tmp_path / "walk.joints.json").write_text('{"joints": {"Heads": [0, 0, 0]}}')
    session = make_session([tmp_path / "hero.obj", tmp_path / "walk.npz"], 2**20, "copy")
    try:
        result(session)
        state = describe(session)
        assert list(state["identities"][0]["joints"]["corrected"]) == ["Head"]
        assert "did you mean Head" in state["driving"]["joints"]["error"]
        assert state["driving"]["joints"]["corrected"] == {}
    finally:
        session.close()


def test_requests_for_joints(session, tmp_path):
    item, _ = result(session)
    app = AccessControl(make_app(session, lambda: False), "secret", "127.0.0.1", 8123)
    address = "http://127.0.0.1:8123"
    with TestClient(app, base_url=address, headers={"origin": address}) as client:
        client.get("/?token=secret")
        found = client.get(f"/api/meshes/{item.number}/joints").json()
        head = found["meshes"][str(item.number)]["joints"]["Head"]
        assert client.post(f"/api/meshes/{item.number}/joints", json={"joints": {"Head": head}}).status_code == 200
        refused = client.post(f"/api/meshes/{item.number}/joints", json={"joints": {"Hat": head}})
        assert refused.status_code == 422
        assert "expected names of joints" in refused.json()["error"]
        response = client.get(f"/api/meshes/{item.number}/joints.json")
        assert "hero.joints.json" in response.headers["content-disposition"]
        path = tmp_path / "hero.joints.json"
        path.write_text(json.dumps(response.json()))
        assert load_corrections(path).positions["Head"] == pytest.approx(head, rel=1e-6)
        assert client.get("/api/meshes/999/joints").status_code == 204
        assert client.get("/api/meshes/999/joints.json").status_code == 422
        client.post(f"/api/meshes/{item.number}/joints", json={"joints": {}})
