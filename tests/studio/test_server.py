"""The studio's server: access control, uploads and their limits, errors, and exports."""

import contextlib
import dataclasses
import io
import json
import zipfile

import gltf_samples as samples
import numpy as np
import pytest
from people import person, walk
from studio_client import HOST, PORT, TOKEN
from waiting import finished, wait_until

from mimesh import load_mesh, save_clip, save_mesh, transfer
from mimesh.core.errors import InputError
from mimesh.studio import make_session, state
from mimesh.view.pack import pack_scene

LIMIT = 2**20
TRIANGLE = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.fixture
def session():
    session = make_session([], LIMIT, "copy")
    yield session
    session.close()


@pytest.fixture
def client(session, visit):
    """A browser with the cookie."""
    return visit(session)


def upload(client, role, files):
    """Upload files (name: bytes) for a role and return the last response, or the first refusal."""
    number = client.post("/api/uploads").json()["upload"]
    for name, content in files.items():
        response = client.put(f"/api/uploads/{number}", params={"name": name}, content=content)
        if response.status_code != 200:
            return response
    return client.post(f"/api/uploads/{number}/{role}")


def refused(response, words, status=422):
    """Check that a request was refused with an error that has these words."""
    assert response.status_code == status
    assert words in response.json()["error"]


def wait_until_idle(client):
    """Wait until nothing is read, computed or written, and return the state."""

    def idle():
        state = client.get("/api/state").json()
        driving = state["driving"]
        ready = driving and driving["state"] == "ready"
        for mesh in [*state["identities"], *([driving] if driving else [])]:
            outcome = mesh["outcome"]
            # Between reading and moving a mesh has no outcome yet.
            waits = mesh is not driving and mesh["state"] == "ready" and ready and outcome is None
            if waits or mesh["state"] == "reading" or (outcome or {}).get("state") == "moving":
                return None
        return None if any(export["state"] == "writing" for export in state["exports"]) else state

    return wait_until(idle)


def stored_files(session):
    """List the files in the session's folder."""
    return {
        str(path.relative_to(session.uploads.folder)) for path in session.uploads.folder.rglob("*") if path.is_file()
    }


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 403),
        ({"cookie": f"mimesh-studio-{PORT}=wrong"}, 403),
        ({"x-mimesh-token": "secret "}, 403),
        ({"x-mimesh-token": TOKEN}, 200),
        ({"x-mimesh-token": TOKEN, "host": "evil.example"}, 421),
        ({"x-mimesh-token": TOKEN, "host": f"evil.example:{PORT}"}, 421),
        ({"x-mimesh-token": TOKEN, "host": f"127.0.0.1.evil.example:{PORT}"}, 421),
        ({"x-mimesh-token": TOKEN, "host": f"localhost:{PORT}"}, 200),
        ({"x-mimesh-token": TOKEN, "origin": "http://evil.example"}, 403),
        ({"x-mimesh-token": TOKEN, "origin": "null"}, 200),
    ],
)
def test_requests_need_the_token_and_the_own_host(session, visit, headers, status):
    response = visit(session, entered=False).get("/api/state", headers=headers)
    assert response.status_code == status
    assert "default-src 'none'" in response.headers["content-security-policy"]
    assert response.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", f"https://{HOST}", "http://127.0.0.1:1"])
def test_changes_need_the_own_origin(session, client, origin):
    del client.headers["origin"]
    for path in ("/api/uploads", "/api/demo", "/api/options", "/api/exports"):
        response = client.post(path, headers={} if origin is None else {"origin": origin})
        assert response.status_code == 403
    assert not session.identities
    assert not list((session.uploads.folder).iterdir())


def test_the_token_becomes_a_cookie_hidden_from_scripts(session, visit):
    browser = visit(session, entered=False)
    response = browser.get(f"/?token={TOKEN}", follow_redirects=False)
    assert (response.status_code, response.headers["location"]) == (303, "/")
    assert "HttpOnly" in response.headers["set-cookie"]
    assert "SameSite=strict" in response.headers["set-cookie"]
    assert browser.get("/?token=guess").status_code == 200, "the cookie is enough now"


def test_only_files_of_the_page_are_served(client):
    assert "mimesh studio" in client.get("/").text
    for name in ("player.js", "studio.js", "studio.css"):
        assert client.get(f"/static/{name}").status_code == 200
    foreign = ("player.css", "..%2fscene.py", "%2e%2e/scene.py")
    for path in (*(f"/static/{name}" for name in foreign), "/etc/passwd", "//etc/passwd"):
        assert client.get(path).status_code == 404


def test_too_large_files_are_refused_and_deleted(session, client):
    refused(upload(client, "identity", {"big.obj": b"v" * (LIMIT + 1)}), "1 MiB", 413)
    number = client.post("/api/uploads").json()["upload"]
    chunks = (b"v" * 2**16 for _ in range(40))  # a stream without a length
    assert client.put(f"/api/uploads/{number}", params={"name": "big.obj"}, content=chunks).status_code == 413
    assert stored_files(session) == set()
    found = [
        client.put(f"/api/uploads/{number}", params={"name": f"{k}.bin"}, content=b"x" * LIMIT).status_code
        for k in range(5)
    ]
    assert found == [200] * 4 + [413], "the limit of all uploads together"
    client.delete(f"/api/uploads/{number}")
    assert stored_files(session) == set()
    assert session.uploads.used == 0


NAMES = {
    "../../evil.obj": "evil.obj",
    "/etc/evil.obj": "etc/evil.obj",
    "..\\..\\evil.obj": "evil.obj",
    "C:\\Windows\\evil.obj": "Windows/evil.obj",
    "a/../b/./evil.obj": "a/b/evil.obj",
    "ev\x00il.obj": "evil.obj",
    "\u202egpj.obj": "gpj.obj",
    "..\uff0fevil.obj": "evil.obj",
    "CON.obj": "_CON.obj",
    "nul": "_nul",
    ".hidden.obj": "hidden.obj",
    "tail.obj. ": "tail.obj",
    "a" * 400 + ".obj": "a" * 116 + ".obj",
    "ü" * 200 + ".obj": "ü" * 58 + ".obj",
    "pose <1>?.obj": "pose _1__.obj",
    "Pose mit Leerzeichen.obj": "Pose mit Leerzeichen.obj",
}
"""Name in the browser -> where the file is stored."""


def test_names_cannot_leave_their_folder(session, client):
    for name, stored in NAMES.items():
        number = client.post("/api/uploads").json()["upload"]
        response = client.put(f"/api/uploads/{number}", params={"name": name}, content=TRIANGLE)
        assert response.status_code == 200
        assert f"uploads/{number}/{stored}" in stored_files(session)
    assert len(stored_files(session)) == len(NAMES)


@pytest.mark.parametrize("name", ["", "..", "/", "\\", ". . .", "\x00", "/".join("a" * 12) + "/b.obj"])
def test_empty_names_are_refused(session, client, name):
    number = client.post("/api/uploads").json()["upload"]
    response = client.put(f"/api/uploads/{number}", params={"name": name}, content=TRIANGLE)
    assert stored_files(session) == set() or response.json()["name"] == "file"


def test_two_files_of_one_name_are_refused(session, client):
    refused(upload(client, "identity", {"a.obj": TRIANGLE, "../a.obj": TRIANGLE}), "different names")


@pytest.mark.parametrize("name", ["../../evil.obj", "/tmp/evil.obj", "..\\evil.obj"])
def test_files_cannot_leave_their_folder(session, client, name):
    assert upload(client, "identity", {name: TRIANGLE}).status_code == 200
    wait_until_idle(client)
    (stored,) = stored_files(session)
    assert stored.startswith("uploads/")
    assert stored.endswith("evil.obj")


@pytest.mark.parametrize(
    ("role", "files", "words"),
    [
        ("identity", {"text.glb": b"hello there"}, "text.glb: expected"),
        ("identity", {"empty.obj": b""}, "empty file"),
        ("identity", {"points.obj": b"v 0 0 0\nv 0 0 0\n"}, "expected a mesh with some size"),
        ("identity", {"nan.obj": b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"}, "nan.obj"),
        ("driving", {"bad.bvh": b"HIERARCHY\n"}, "bad.bvh"),
        ("driving", {"a/1.obj": TRIANGLE, "a/2.obj": TRIANGLE + b"v 2 2 2\n"}, "2.obj"),
    ],
)
def test_unreadable_files_give_an_error_message(client, role, files, words):
    assert upload(client, role, files).status_code == 200
    state = wait_until_idle(client)
    item = state["driving"] if role == "driving" else state["identities"][0]
    assert item["state"] == "failed"
    assert words in item["error"]
    assert not [word for word in ("/tmp", "Traceback", "bug") if word in item["error"]]
    assert client.delete(f"/api/meshes/{item['number']}").status_code == 200


@pytest.mark.parametrize("files", [{"notes.txt": b"hello"}, {f"{k}.obj": TRIANGLE for k in range(20)}, {}])
def test_uploads_without_a_mesh_are_refused(session, client, files):
    refused(upload(client, "identity", files), "expected")
    assert stored_files(session) == set()


@pytest.mark.parametrize(
    "body", [b"[" * 2**15, b"[]", b"{", b"\xff", b'{"model": 3}', b'{"nothing": 1}', b'{"smooth": NaN}', b"1" * 2**17]
)
def test_invalid_options_are_refused(client, body):
    response = client.post("/api/options", content=body)
    assert response.status_code in (413, 422)
    assert "expected" in response.json()["error"]


def test_shipped_characters_are_loaded_by_name(client):
    assert {"imp", "dancer"} < set(client.get("/api/state").json()["characters"])
    assert client.post("/api/demo", json={"what": "identity", "character": "/etc/passwd"}).status_code == 422
    assert client.post("/api/demo", json={"what": "driving", "motion": "/etc/passwd"}).status_code == 422
    for name in ("imp", "stork"):
        client.post("/api/demo", json={"what": "identity", "character": name})
    found = wait_until_idle(client)["identities"]
    facts = [(mesh["name"], mesh["shipped"], mesh["state"]) for mesh in found]
    assert facts == [("imp", True, "ready"), ("stork", True, "ready")]


def test_the_number_of_meshes_is_limited(session, client, monkeypatch):
    monkeypatch.setattr("mimesh.studio.session.MOST_IDENTITIES", 1)
    assert upload(client, "identity", {"a.obj": TRIANGLE}).status_code == 200
    refused(upload(client, "identity", {"b.obj": TRIANGLE}), "remove some")
    assert len(stored_files(session)) == 1


def test_unknown_numbers_are_refused_but_the_pose_of_a_removed_mesh_is_no_error(client):
    for method, path in (("DELETE", "/api/meshes/99"), ("POST", "/api/uploads/9/identity")):
        assert client.request(method, path).status_code == 422
    assert client.get("/api/exports/99").status_code == 404
    assert client.post("/api/uploads/9/unknown").status_code == 404
    # Another page may just have removed the mesh; browsers log every other status as an error.
    response = client.post("/api/meshes/99/pose", json={"frame": 0})
    assert (response.status_code, response.content) == (204, b"")


def test_the_pose_of_a_mesh_that_is_refused_is_no_error_beside_that_of_its_row(session, client, monkeypatch):
    def refuse(item):
        raise InputError("a dog, and a person: expected two of a kind; give another driving")

    upload(client, "identity", {"a.obj": TRIANGLE})
    (mesh,) = wait_until_idle(client)["identities"]
    monkeypatch.setattr(session, "_prepare", refuse)
    response = client.post(f"/api/meshes/{mesh['number']}/pose", json={"frame": 0})
    assert (response.status_code, response.content) == (204, b"")


def test_results_are_exported(session, client, tmp_path):
    """The export equals `transfer` (with the quick model `copy`); two meshes come as one archive."""
    save_mesh(person(0), tmp_path / "hero.obj")
    content = (tmp_path / "hero.obj").read_bytes()
    assert upload(client, "identity", {"hero.obj": content}).status_code == 200
    assert upload(client, "driving", {"pose.obj": content}).status_code == 200
    (hero,) = wait_until_idle(client)["identities"]
    assert hero["outcome"]["state"] == "done"
    expected = transfer(tmp_path / "hero.obj", tmp_path / "hero.obj", "copy").vertices
    response = client.post(f"/api/meshes/{hero['number']}/pose", json={"frame": 0})
    np.testing.assert_allclose(np.frombuffer(response.content, "<f4").reshape(-1, 3), expected, atol=1e-6)
    assert client.post("/api/exports", json={"suffix": ".obj"}).status_code == 200
    (export,) = wait_until_idle(client)["exports"]
    response = client.get(f"/api/exports/{export['number']}")
    assert response.headers["content-disposition"] == 'attachment; filename="hero-pose.obj"'
    (tmp_path / "back.obj").write_bytes(response.content)
    np.testing.assert_allclose(load_mesh(tmp_path / "back.obj").vertices, expected, atol=1e-6)
    upload(client, "identity", {"hero.obj": content})
    wait_until_idle(client)
    client.post("/api/exports", json={"suffix": ".ply"})
    export = wait_until_idle(client)["exports"][-1]
    pack = zipfile.ZipFile(io.BytesIO(client.get(f"/api/exports/{export['number']}").content))
    assert pack.namelist() == ["hero-pose-2.ply", "hero-pose.ply"]
    client.post("/api/exports", json={"suffix": "/../../evil.obj"})
    assert "format: expected" in wait_until_idle(client)["exports"][-1]["error"]
    assert client.get("/api/scene").json()["scene"]["format"] == "mimesh-scene"


def test_the_scene_is_encoded_once_and_shows_30_frames_a_second(tmp_path, visit, monkeypatch):
    """A capture has 120 as a rule: four times the time and the size, for what a screen does not show."""
    packed = []
    monkeypatch.setattr(
        state, "pack_scene", lambda *args, **more: packed.append(pack_scene(*args, **more)) or packed[-1]
    )
    save_mesh(person(0), tmp_path / "hero.obj")
    save_clip(dataclasses.replace(walk(frames=9), fps=120.0), tmp_path / "walk.npz")
    session = make_session([tmp_path / "hero.obj", tmp_path / "walk.npz"], 2**20, "copy")
    with contextlib.closing(session):
        client = visit(session)
        wait_until_idle(client)
        first, again = (client.get("/api/scene") for _ in range(2))
        assert first.headers["content-type"] == "application/json"
        assert first.content == again.content
        assert len(packed) == 1
        assert [(panel["frames"], panel["fps"]) for panel in first.json()["scene"]["panels"][1:]] == 2 * [(3, 30.0)]
        assert len(finished(session).outcome.result.frames) == 9
        session.set_item(session.driving.number, {"fps": 60})
        wait_until_idle(client)
        frames = [panel["frames"] for panel in client.get("/api/scene").json()["scene"]["panels"]]
        assert (frames, len(packed)) == ([1, 5, 5], 2)


def test_a_driving_file_of_several_animations_says_which_is_taken(tmp_path, visit):
    sample = samples.hero()
    (walking,) = sample.gltf["animations"]
    sample.gltf["animations"] = [{**walking, "name": "Walk"}, {**walking, "name": "Run"}]
    session = make_session([sample.glb(tmp_path / "moves.glb"), sample.glb(tmp_path / "moves.glb")], 2**20, "copy")
    with contextlib.closing(session):
        driving = wait_until_idle(visit(session))["driving"]
        assert driving["notes"] == ["moves.glb has 2 animations: the first, Walk, is taken; animation takes another"]
        session.set_item(session.driving.number, {"animation": "Run"})
        assert wait_until_idle(visit(session))["driving"]["notes"] == []


def test_removing_meshes_deletes_their_upload(session, client):
    upload(client, "identity", {"a.obj": TRIANGLE, "b.obj": TRIANGLE})
    first, second = (mesh["number"] for mesh in wait_until_idle(client)["identities"])
    client.delete(f"/api/meshes/{first}")
    assert len(stored_files(session)) == 2, "the other mesh uses the upload"
    client.delete(f"/api/meshes/{second}")
    assert stored_files(session) == set()


def test_the_state_is_sent_after_a_change(client):
    state = wait_until_idle(client)
    assert json.dumps(state)
    client.post("/api/options", json={"root": "drop"})
    assert client.get("/api/state", params={"since": state["version"]}).json()["options"]["root"] == "drop"
