"""What the studio's server lets through: who may ask, what may be uploaded, and what is answered in words."""

import io
import json
import time
import zipfile

import numpy as np
import pytest
from starlette.testclient import TestClient

from mimesh import load_mesh, save_mesh, transfer
from mimesh.bodies import load_body
from mimesh.studio import make_desk
from mimesh.studio import uploads as workplace
from mimesh.studio.app import make_app
from mimesh.studio.security import AccessControl
from mimesh.tools.demo import IDENTITY_SHAPE, person

TOKEN, PORT = "secret", 8123
HOST = f"127.0.0.1:{PORT}"
ORIGIN = {"origin": f"http://{HOST}"}
LIMIT = 2**20
TRIANGLE = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.fixture
def desk():
    desk = make_desk([], LIMIT, "copy")
    yield desk
    desk.close()


@pytest.fixture
def client(desk):
    """A browser that has been let in."""
    app = AccessControl(make_app(desk, lambda: False), TOKEN, "127.0.0.1", PORT)
    with TestClient(app, base_url=f"http://{HOST}", headers=ORIGIN) as client:
        assert client.get(f"/?token={TOKEN}").status_code == 200
        yield client


def sent(client, role, **files):
    """Upload files (name with _ for a dot: bytes) for a role; the last answer."""
    return sent_as(client, role, {name.replace("_", "."): content for name, content in files.items()})


def sent_as(client, role, files):
    number = client.post("/api/uploads").json()["upload"]
    for name, content in files.items():
        answer = client.put(f"/api/uploads/{number}", params={"name": name}, content=content)
        if answer.status_code != 200:
            return answer
    return client.post(f"/api/uploads/{number}/{role}")


def settled(client):
    """The state once nothing is read, moved or written any more."""
    for _ in range(2000):
        state = client.get("/api/state").json()
        meshes = [*state["identities"], *([state["driving"]] if state["driving"] else [])]
        busy = [
            mesh for mesh in meshes if mesh["state"] == "reading" or (mesh["outcome"] or {}).get("state") == "moving"
        ]
        if not busy and not any(one["state"] == "writing" for one in state["exports"]):
            return state
        time.sleep(0.01)
    raise AssertionError(state)


def zipped(**files):
    pack = io.BytesIO()
    with zipfile.ZipFile(pack, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return pack.getvalue()


MANY = zipped(**{f"{k}.obj": b"" for k in range(99)})


def everything(desk):
    return {str(path.relative_to(desk.workplace.folder)) for path in desk.workplace.folder.rglob("*") if path.is_file()}


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
def test_who_may_look(desk, headers, status):
    app = AccessControl(make_app(desk, lambda: False), TOKEN, "127.0.0.1", PORT)
    with TestClient(app, base_url=f"http://{HOST}") as stranger:
        answer = stranger.get("/api/state", headers=headers)
    assert answer.status_code == status
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", f"https://{HOST}", "http://127.0.0.1:1"])
@pytest.mark.parametrize("path", ["/api/uploads", "/api/demo", "/api/options", "/api/exports"])
def test_changes_come_from_our_page_alone(desk, client, path, origin):
    del client.headers["origin"]
    answer = client.post(path, headers={} if origin is None else {"origin": origin})
    assert answer.status_code == 403
    assert not desk.identities
    assert not list((desk.workplace.folder).iterdir())


def test_the_token_is_a_cookie_that_no_script_reads(desk):
    app = AccessControl(make_app(desk, lambda: False), TOKEN, "127.0.0.1", PORT)
    with TestClient(app, base_url=f"http://{HOST}", follow_redirects=False) as browser:
        answer = browser.get(f"/?token={TOKEN}")
        assert answer.status_code == 303
        assert answer.headers["location"] == "/"
        assert "HttpOnly" in answer.headers["set-cookie"]
        assert "SameSite=strict" in answer.headers["set-cookie"]
        assert browser.get("/?token=guess").status_code == 200, "the cookie opens it now"


def test_the_page_is_there_and_nothing_beside_it(client):
    assert "mimesh studio" in client.get("/").text
    for name in ("player.js", "studio.js", "studio.css"):
        assert client.get(f"/static/{name}").status_code == 200
    for path in (
        "/static/player.css",
        "/static/..%2fscene.py",
        "/static/%2e%2e/scene.py",
        "/etc/passwd",
        "//etc/passwd",
    ):
        assert client.get(path).status_code == 404


def test_too_large_a_file_is_refused_and_nothing_of_it_stays(desk, client):
    answer = sent(client, "identity", big_obj=b"v" * (LIMIT + 1))
    assert answer.status_code == 413
    assert "1 MiB" in answer.json()["error"]
    assert everything(desk) == set()
    assert desk.workplace.used == 0


def test_a_stream_that_lies_about_its_length_is_cut(desk, client):
    number = client.post("/api/uploads").json()["upload"]
    chunks = (b"v" * 2**16 for _ in range(40))
    answer = client.put(f"/api/uploads/{number}", params={"name": "big.obj"}, content=chunks)
    assert answer.status_code == 413
    assert everything(desk) == set()


def test_the_sum_has_a_limit_too(desk, client):
    number = client.post("/api/uploads").json()["upload"]
    found = [
        client.put(f"/api/uploads/{number}", params={"name": f"{k}.bin"}, content=b"x" * LIMIT).status_code
        for k in range(5)
    ]
    assert found == [200] * 4 + [413]
    client.delete(f"/api/uploads/{number}")
    assert everything(desk) == set()
    assert desk.workplace.used == 0


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("../../evil.obj", "evil.obj"),
        ("/etc/evil.obj", "etc/evil.obj"),
        ("..\\..\\evil.obj", "evil.obj"),
        ("C:\\Windows\\evil.obj", "Windows/evil.obj"),
        ("a/../b/./evil.obj", "a/b/evil.obj"),
        ("ev\x00il.obj", "evil.obj"),
        ("\u202egpj.obj", "gpj.obj"),
        ("..\uff0fevil.obj", "evil.obj"),
        ("CON.obj", "_CON.obj"),
        ("nul", "_nul"),
        (".hidden.obj", "hidden.obj"),
        ("tail.obj. ", "tail.obj"),
        ("a" * 400 + ".obj", "a" * 116 + ".obj"),
        ("ü" * 200 + ".obj", "ü" * 58 + ".obj"),
        ("pose <1>?.obj", "pose _1__.obj"),
        ("Pose mit Leerzeichen.obj", "Pose mit Leerzeichen.obj"),
    ],
)
def test_names_stay_in_their_folder(desk, client, name, kept):
    number = client.post("/api/uploads").json()["upload"]
    answer = client.put(f"/api/uploads/{number}", params={"name": name}, content=TRIANGLE)
    assert answer.status_code == 200
    assert everything(desk) == {f"uploads/{number}/{kept}"}


@pytest.mark.parametrize("name", ["", "..", "/", "\\", ". . .", "\x00", "/".join("a" * 12) + "/b.obj"])
def test_names_that_are_none_are_refused(desk, client, name):
    number = client.post("/api/uploads").json()["upload"]
    answer = client.put(f"/api/uploads/{number}", params={"name": name}, content=TRIANGLE)
    assert everything(desk) == set() or answer.json()["name"] == "file"


def test_two_files_of_one_name_are_refused(desk, client):
    answer = sent_as(client, "identity", {"a.obj": TRIANGLE, "../a.obj": TRIANGLE})
    assert answer.status_code == 422
    assert "different names" in answer.json()["error"]


@pytest.mark.parametrize(
    "content",
    [
        zipped(**{"../../evil.obj": TRIANGLE}),
        zipped(**{"/tmp/evil.obj": TRIANGLE}),
        zipped(**{"..\\evil.obj": TRIANGLE, "__MACOSX/._evil.obj": b"?"}),
    ],
)
def test_archives_do_not_leave_their_folder(desk, client, content):
    assert sent(client, "identity", all_zip=content).status_code == 200
    settled(client)
    assert all(name.startswith("uploads/") and name.endswith("evil.obj") for name in everything(desk))
    assert len(everything(desk)) == 1


def test_archives_are_counted_as_they_are_unpacked(desk, client):
    answer = sent(client, "identity", bomb_zip=zipped(**{"a.obj": bytes(LIMIT + 1)}))
    assert answer.status_code == 413
    assert everything(desk) == set()
    answer = sent(client, "identity", bomb_zip=zipped(**{f"{k}.obj": bytes(LIMIT) for k in range(5)}))
    assert answer.status_code == 413
    assert everything(desk) == set()
    assert desk.workplace.used == 0


def test_archives_of_too_many_files_are_not_even_listed(desk, client, monkeypatch):
    monkeypatch.setattr(workplace, "LARGEST_TABLE", 2000)
    assert sent(client, "identity", few_zip=zipped(**{f"{k}.obj": TRIANGLE for k in range(9)})).status_code == 200
    monkeypatch.setattr(zipfile, "ZipInfo", None)
    answer = sent(client, "identity", many_zip=MANY)
    assert answer.status_code == 422
    assert "table of contents" in answer.json()["error"]


def test_archives_that_are_none_are_said(desk, client):
    answer = sent(client, "identity", some_zip=b"PK\x03\x04 not really")
    assert answer.status_code == 422
    assert "some.zip: expected a .zip" in answer.json()["error"]


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
def test_bad_files_are_said_in_words(client, role, files, words):
    assert sent_as(client, role, files).status_code == 200
    state = settled(client)
    item = state["driving"] if role == "driving" else state["identities"][0]
    assert item["state"] == "failed"
    assert words in item["error"]
    assert "/tmp" not in item["error"]
    assert "Traceback" not in item["error"]
    assert "bug" not in item["error"]
    assert client.delete(f"/api/meshes/{item['number']}").status_code == 200


@pytest.mark.parametrize("files", [{"notes.txt": b"hello"}, {f"{k}.obj": TRIANGLE for k in range(20)}, {}])
def test_what_is_no_mesh_is_refused(desk, client, files):
    answer = sent_as(client, "identity", files)
    assert answer.status_code == 422
    assert "expected" in answer.json()["error"]
    assert everything(desk) == set()


@pytest.mark.parametrize(
    "body", [b"[" * 2**15, b"[]", b"{", b"\xff", b'{"model": 3}', b'{"nothing": 1}', b'{"smooth": NaN}', b"1" * 2**17]
)
def test_bodies_that_are_no_options(client, body):
    answer = client.post("/api/options", content=body)
    assert answer.status_code in (413, 422)
    assert "expected" in answer.json()["error"]


def test_the_cast_is_offered_by_name(client):
    assert {"imp", "dancer"} < set(client.get("/api/state").json()["characters"])
    assert client.post("/api/demo", json={"what": "identity", "character": "/etc/passwd"}).status_code == 422
    assert client.post("/api/demo", json={"what": "driving", "motion": "/etc/passwd"}).status_code == 422
    for name in ("imp", "stork"):
        client.post("/api/demo", json={"what": "identity", "character": name})
    found = settled(client)["identities"]
    assert [(mesh["name"], mesh["shipped"], mesh["state"]) for mesh in found] == [
        ("imp", True, "ready"),
        ("stork", True, "ready"),
    ]


def test_a_desk_has_an_end(desk, client, monkeypatch):
    monkeypatch.setattr("mimesh.studio.items.MOST_IDENTITIES", 1)
    assert sent(client, "identity", a_obj=TRIANGLE).status_code == 200
    answer = sent(client, "identity", b_obj=TRIANGLE)
    assert answer.status_code == 422
    assert "remove some" in answer.json()["error"]
    assert len(everything(desk)) == 1


def test_numbers_of_nothing(client):
    for method, path in (
        ("DELETE", "/api/meshes/99"),
        ("POST", "/api/meshes/99/pose"),
        ("POST", "/api/uploads/9/identity"),
    ):
        assert client.request(method, path).status_code == 422
    assert client.get("/api/exports/99").status_code == 404
    assert client.post("/api/uploads/9/throne").status_code == 404


def test_from_upload_to_export(desk, client, tmp_path):
    """With model copy, so that it is quick: the export is what `transfer` gives; two meshes come as one archive."""
    save_mesh(person(load_body(), IDENTITY_SHAPE), tmp_path / "hero.obj")
    content = (tmp_path / "hero.obj").read_bytes()
    desk.workplace.limit *= 16
    desk.workplace.sum_limit *= 16
    assert sent(client, "identity", hero_obj=content).status_code == 200
    assert sent(client, "driving", pose_obj=content).status_code == 200
    (hero,) = settled(client)["identities"]
    assert hero["outcome"]["state"] == "done"
    ours = transfer(tmp_path / "hero.obj", tmp_path / "hero.obj", "copy").vertices
    answer = client.post(f"/api/meshes/{hero['number']}/pose", json={"frame": 0})
    np.testing.assert_allclose(np.frombuffer(answer.content, "<f4").reshape(-1, 3), ours, atol=1e-6)
    assert client.post("/api/exports", json={"suffix": ".obj"}).status_code == 200
    (made,) = settled(client)["exports"]
    answer = client.get(f"/api/exports/{made['number']}")
    assert answer.headers["content-disposition"] == 'attachment; filename="hero-pose.obj"'
    (tmp_path / "back.obj").write_bytes(answer.content)
    np.testing.assert_allclose(load_mesh(tmp_path / "back.obj").vertices, ours, atol=1e-6)
    sent(client, "identity", hero_obj=content)
    settled(client)
    client.post("/api/exports", json={"suffix": ".ply"})
    made = settled(client)["exports"][-1]
    pack = zipfile.ZipFile(io.BytesIO(client.get(f"/api/exports/{made['number']}").content))
    assert pack.namelist() == ["hero-pose-2.ply", "hero-pose.ply"]
    client.post("/api/exports", json={"suffix": "/../../evil.obj"})
    assert "format: expected" in settled(client)["exports"][-1]["error"]
    assert client.get("/api/scene").json()["scene"]["format"] == "mimesh-scene"


def test_removing_a_mesh_removes_its_files(desk, client):
    sent(client, "identity", a_obj=TRIANGLE, b_obj=TRIANGLE)
    first, second = (mesh["number"] for mesh in settled(client)["identities"])
    client.delete(f"/api/meshes/{first}")
    assert len(everything(desk)) == 2, "the other still stands"
    client.delete(f"/api/meshes/{second}")
    assert everything(desk) == set()


def test_state_waits_for_a_change(client):
    state = settled(client)
    assert json.dumps(state)
    client.post("/api/options", json={"root": "drop"})
    assert client.get("/api/state", params={"since": state["version"]}).json()["options"]["root"] == "drop"
