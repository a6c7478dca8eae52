"""Animals and other creatures in a studio, over HTTP: demos, what they are taken for, matched rigs and refusals."""

import numpy as np
import pytest
from creatures import BIRD, Boxes, flapping
from people import person
from waiting import wait_until

from mimesh import animate, load_clip, save_mesh
from mimesh.bodies.animals import ANIMALS
from mimesh.core.mesh import cut_clip
from mimesh.core.options import Hints, MotionOptions
from mimesh.motions.animal_clips import ANIMAL_MOTIONS
from mimesh.studio import make_session, operations
from mimesh.studio.operations import demo_clip

pytestmark = pytest.mark.usefixtures("kept")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A bird, a larger one without names that flaps its wings, the small one doing so, and a person."""
    folder = tmp_path_factory.mktemp("creatures")
    small, large = Boxes.of(BIRD), Boxes.of(BIRD, size=3.0).renamed(1)
    small.write(folder / "bird.glb")
    large.write(folder / "large.glb", flapping(large.names), np.linspace(0, 1, 4)[:, None] * [0.0, 0.0, 1.0])
    small.write(folder / "same.glb", flapping(small.names))
    save_mesh(person(0), folder / "hero.glb")
    return folder


@pytest.fixture(scope="module")
def session():
    session = make_session([], 2**24)
    yield session
    session.close()


@pytest.fixture
def client(session, visit, monkeypatch):
    """The page of an empty session, whose demos are clips of three frames."""
    monkeypatch.setattr(operations, "demo_clip", lambda motion: cut_clip(demo_clip(motion), 0, 9, 3))
    for number in [*session.identities, *([session.driving.number] if session.driving else [])]:
        session.remove(number)
    session.set_options({"model": "mime", "body": "auto", "root": "scale", "smooth": 0})
    return visit(session)


def upload(client, role, path):
    number = client.post("/api/uploads").json()["upload"]
    client.put(f"/api/uploads/{number}", params={"name": path.name}, content=path.read_bytes())
    assert client.post(f"/api/uploads/{number}/{role}").status_code == 200


def moved(client):
    """Wait until all results are there; return the state of the first mesh."""

    def first():
        meshes = client.get("/api/state").json()["identities"]
        ended = (mesh["outcome"] and mesh["outcome"]["state"] in ("done", "failed") for mesh in meshes)
        return meshes[0] if meshes and all(ended) else None

    return wait_until(first)


def vertices(session):
    """Return the frames of the result of the only mesh."""
    return next(iter(session.identities.values())).outcome.result.clip.vertices


@pytest.mark.slow
def test_animals_are_offered_and_their_joints_are_corrected(session, client):
    state = client.get("/api/state").json()
    assert state["animals"] == list(ANIMALS)
    assert state["animal_motions"] == list(ANIMAL_MOTIONS)
    demo = {"what": "both", "character": "cat", "motion": "dog walk"}
    assert client.post("/api/demo", json=demo).status_code == 200
    mesh = moved(client)
    assert (mesh["name"], mesh["shipped"], mesh["outcome"]["body"]) == ("cat", True, "quadruped")
    assert mesh["outcome"]["notes"] == []
    before, number = vertices(session), mesh["number"]
    found = client.get(f"/api/meshes/{number}/joints").json()
    joints = found["meshes"][str(number)]["joints"]
    assert {"LeftThigh", "RightFingers", "Tail6", "Head"} <= joints.keys() == found["parents"].keys()
    assert found["parents"]["Tail3"] == "Tail1", "joints without a handle are skipped"
    toes = [joints["LeftToes"][0] + 0.02, *joints["LeftToes"][1:]]
    assert client.post(f"/api/meshes/{number}/joints", json={"joints": {"LeftToes": toes}}).status_code == 200
    assert moved(client)["outcome"]["error"] == ""
    assert not np.array_equal(vertices(session), before)
    again = client.get(f"/api/meshes/{number}/joints").json()["meshes"][str(number)]["joints"]
    np.testing.assert_allclose(again["LeftToes"], toes, atol=1e-9)
    assert client.get(f"/api/meshes/{number}/joints.json").json()["joints"].keys() == {"LeftToes"}
    refused = client.post(f"/api/meshes/{number}/joints", json={"joints": {"LeftPaw": toes}})
    assert refused.status_code == 422


@pytest.mark.parametrize("demo", [{"character": "unicorn"}, {"motion": "dog flies"}])
def test_unknown_animals_are_refused(client, demo):
    response = client.post("/api/demo", json={"what": "both", **demo})
    assert response.status_code == 422
    assert "expected" in response.json()["error"]


@pytest.mark.slow
def test_meshes_that_do_not_correspond_are_refused_in_the_words_of_the_page(client, files):
    client.post("/api/demo", json={"what": "both", "character": "imp", "motion": "horse gallop"})
    error = moved(client)["outcome"]["error"]
    assert "imp is taken for a person, and horse-gallop for a four-legged animal: expected two of a kind" in error
    assert "“both meshes are: a person”" in error
    assert "--" not in error
    for number in (moved(client)["number"], client.get("/api/state").json()["driving"]["number"]):
        client.delete(f"/api/meshes/{number}")
    client.post("/api/options", json={"body": "other"})
    upload(client, "identity", files / "bird.glb")
    upload(client, "driving", files / "hero.glb")
    error = moved(client)["outcome"]["error"]
    assert "expected rigs in both files, or two shapes of one mesh" in error
    assert "deformation-transfer, of the command mimesh animate alone" in error


@pytest.mark.slow
def test_creatures_are_moved_and_exported_as_by_animate(session, client, files, tmp_path):
    birds = files / "bird.glb", files / "large.glb"
    upload(client, "identity", birds[0])
    upload(client, "driving", birds[1])
    mesh, expected = moved(client), animate(*birds)
    outcome, number = mesh["outcome"], mesh["number"]
    np.testing.assert_allclose(vertices(session), expected.clip.vertices, atol=1e-6)
    assert outcome["body"] == "other"
    assert outcome["confidence"] == expected.report["match"]["confidence"]
    assert "is moved as a creature with limbs of its own: 8 joints follow" in outcome["notes"][0]
    assert not any("--" in note for note in outcome["notes"])
    pose = client.post(f"/api/meshes/{number}/pose", json={"frame": 2}).content
    np.testing.assert_allclose(np.frombuffer(pose, "<f4").reshape(-1, 3), expected.clip.vertices[2], atol=1e-5)
    assert client.get(f"/api/meshes/{number}/joints").json() == {}
    export = client.post("/api/exports", json={"suffix": ".glb", "skinned": True}).json()["export"]
    wait_until(lambda: client.get("/api/state").json()["exports"][-1]["state"] != "writing")
    (tmp_path / "moved.glb").write_bytes(client.get(f"/api/exports/{export}").content)
    written = load_clip(tmp_path / "moved.glb")
    np.testing.assert_allclose(written.vertices, expected.clip.vertices, atol=1e-3)
    assert written.skeleton.has_joints
    client.post("/api/options", json={"root": "drop", "body": "other"})
    assert moved(client)["outcome"]["error"] == ""
    expected = animate(*birds, motion=MotionOptions(root="drop"), hints=Hints(body="other"))
    np.testing.assert_allclose(vertices(session), expected.clip.vertices, atol=1e-6)
    client.post("/api/options", json={"smooth": 0.1})
    assert moved(client)["outcome"]["error"].startswith("smoothing: expected the rig of a person")


@pytest.mark.slow
def test_the_same_skeleton_is_copied_as_by_animate(session, client, files):
    upload(client, "identity", files / "bird.glb")
    upload(client, "driving", files / "same.glb")
    outcome = moved(client)["outcome"]
    assert (outcome["body"], outcome["confidence"]) == ("copied", None)
    np.testing.assert_allclose(vertices(session), load_clip(files / "same.glb").vertices, atol=1e-6)
