"""Exports of the studio with bones: those of `animate`, with the names and formats that other programs expect."""

import sys

import numpy as np
import pygltflib
import pytest
from people import person, walk
from vrm_files import vrm
from waiting import finished, wait_until

from mimesh import Hints, MotionOptions, animate, capture, load_clip, rig, save_clip, save_mesh
from mimesh.bodies.engine_rig import Layout
from mimesh.io.gltf.vrm import PUBLIC_LICENSE
from mimesh.studio import make_session
from mimesh.studio.exports import Order, formats
from mimesh.studio.items import Item, field_name
from mimesh.studio.operations import for_page


@pytest.fixture(scope="module", params=["mime"])
def moved(request, tmp_path_factory):
    """A session with the finished result of a small person, by a model, and the files that it was made from."""
    folder = tmp_path_factory.mktemp("files")
    files = folder / "hero.glb", folder / "walk.npz"
    save_mesh(person(0), files[0])
    save_clip(walk(frames=3), files[1])
    session = make_session(list(files), 2**26, request.param)
    assert not finished(session).outcome.error
    yield session, files
    session.close()


def exported(session, suffix, **options):
    """Export and return the export, once it is written or has failed."""
    export = session.exports[session.export(Order(suffix=suffix, **options))]
    wait_until(lambda: export.path is not None or export.error)
    return export


@pytest.mark.slow
def test_bones_are_named_and_arranged_as_by_animate(moved, tmp_path):
    session, files = moved
    result, layout, expected = animate(*files), Layout("unreal", True, "T", 20.0), tmp_path / "expected.glb"
    export = exported(session, ".glb", skinned=True, layout=layout)
    assert export.error == ""
    result.save_skinned(expected, names=layout.names, root_bone=layout.root_bone, rest=layout.rest, fps=layout.fps)
    mine, theirs = (pygltflib.GLTF2().load(path) for path in (export.path, expected))
    assert [node.name for node in mine.nodes] == [node.name for node in theirs.nodes]
    assert {"root", "pelvis", "upperarm_l"} <= {node.name for node in mine.nodes}
    mine, theirs = load_clip(export.path), load_clip(expected)
    assert mine.fps == theirs.fps == 20
    np.testing.assert_allclose(mine.vertices, theirs.vertices, atol=1e-6)
    assert any("sampled from 3 frames" in note for note in export.notes)
    bones = exported(session, ".vrma")
    assert bones.path.name == "hero-walk.vrma"
    assert bones.path.read_bytes() == result.save(tmp_path / "expected.vrma").read_bytes()


@pytest.mark.slow
def test_files_have_as_many_weights_a_vertex_as_asked(moved, visit, tmp_path):
    (session, files), expected = moved, tmp_path / "expected.glb"
    client, wanted = visit(session), {"suffix": ".glb", "skinned": True, "influences": 8}
    assert client.post("/api/exports", json=wanted | {"influences": 6}).status_code == 422
    animate(*files, motion=MotionOptions(influences=8)).save_skinned(expected)
    for order, content in (
        (wanted, expected.read_bytes()),
        ({"what": "rig", "influences": 8}, rig(files[0]).save(tmp_path / "rig.glb", influences=8).read_bytes()),
    ):
        assert downloaded(client, **order)[1] == content
        assert b"JOINTS_1" in content


@pytest.mark.slow
def test_vrm_animations_of_a_mesh_with_a_rig_have_its_bones(moved, tmp_path):
    _, (_, driving) = moved
    vrm(tmp_path / "hero.vrm", named=True)
    session = make_session([tmp_path / "hero.vrm", driving], 2**26)
    try:
        finished(session)
        export = exported(session, ".vrma")
        assert export.error == ""
        expected = animate(tmp_path / "hero.vrm", driving).save(tmp_path / "expected.vrma")
        assert export.path.read_bytes() == expected.read_bytes()
    finally:
        session.close()


@pytest.fixture
def still():
    """A session with a small person and no driving, and one with a walk and no mesh to move; nothing is computed."""
    sessions = make_session([], 2**26), make_session([], 2**26)
    item = Item(sessions[0].next_number(), "hero.obj", content=person(0))
    sessions[0].identities[item.number] = item
    sessions[1].driving = Item(sessions[1].next_number(), "walk.npz", content=walk(frames=3))
    yield sessions
    for session in sessions:
        session.close()


def downloaded(client, **order):
    """Export as the page does; return the state of the export and its file."""
    number = client.post("/api/exports", json=order).json()["export"]
    exports = wait_until(lambda: _written(client.get("/api/state").json()["exports"]))
    return exports[-1], client.get(f"/api/exports/{number}").content


def _written(exports):
    return exports if all(export["state"] != "writing" for export in exports) else None


@pytest.mark.slow
def test_rigs_need_a_mesh_alone_and_have_its_corrections_and_layout(still, visit, tmp_path):
    session, client = still[0], visit(still[0])
    (item,) = session.identities.values()
    joint = rig(item.content).joints["LeftForeArm"] + [0.02, 0.0, 0.0]
    session.set_item(item.number, {"up": "+y"})
    session.set_joints(item.number, {"LeftForeArm": joint.tolist()})
    layout = {"names": "unreal", "root_bone": True, "rest": "T"}
    export, content = downloaded(client, what="rig", suffix=".glb", **layout)
    assert (export["name"], export["error"]) == ("hero-rigged.glb", "")
    expected = rig(item.content, hints=Hints(up="+y", joints={"LeftForeArm": joint}))
    assert expected.source == "corrected"
    assert content == expected.save(tmp_path / "expected.glb", **layout).read_bytes()


@pytest.mark.slow
def test_rigs_as_vrm_have_author_and_licence(still, visit, tmp_path):
    client, made_by = visit(still[0]), {"author": "Ada", "license": PUBLIC_LICENSE}
    export, _ = downloaded(client, what="rig", suffix=".vrm", author=" ")
    assert export["error"].startswith("hero-rigged.vrm: expected author and licence for a .vrm, found no author and")
    export, content = downloaded(client, what="rig", suffix=".vrm", **made_by)
    (item,) = still[0].identities.values()
    assert content == rig(item.content).save(tmp_path / "expected.vrm", **made_by).read_bytes()


@pytest.mark.slow
def test_motions_need_a_driving_alone_and_are_smoothed(still, visit, tmp_path):
    session, client = still[1], visit(still[1])
    session.set_options({"smooth": 0.1, "body": "human"})
    for suffix in (".bvh", ".vrma"):
        export, content = downloaded(client, what="motion", suffix=suffix)
        assert (export["name"], export["error"]) == (f"walk{suffix}", "")
        expected = capture(session.driving.content, hints=Hints(body="human"), smooth=0.1)
        assert content == expected.save(tmp_path / f"walk{suffix}").read_bytes()


def test_what_cannot_be_exported_is_refused(still, visit):
    mesh, clip = map(visit, still)
    answer = mesh.post("/api/exports", json={"what": "shape"})
    assert (answer.status_code, answer.json()["error"][:23]) == (422, "what: expected one of r")
    for client, what, suffix, words in (
        (mesh, "motion", ".bvh", "expected a driving motion, found none"),
        (clip, "rig", ".glb", "expected a mesh to move, found none"),
        (mesh, "result", ".glb", "expected a mesh to move and a driving motion, found none"),
        (mesh, "rig", "/../../a.glb", "format: expected one of .glb .gltf .fbx .vrm, found"),
        (clip, "motion", ".obj", "format: expected one of .bvh .fbx .glb .gltf .vrma, found"),
    ):
        assert words in downloaded(client, what=what, suffix=suffix)[0]["error"]
    for session, client, what, suffix in ((still[0], mesh, "rig", ".glb"), (still[1], clip, "motion", ".bvh")):
        session.set_options({"model": "copy"})
        assert "another with the model" in downloaded(client, what=what, suffix=suffix)[0]["error"]
        item = next(iter(session.identities.values()), session.driving)
        item.content = None
        assert "expected a file that has been read" in downloaded(client, what=what, suffix=suffix)[0]["error"]


def test_messages_name_fields_of_the_page(tmp_path):
    for named, expected in (
        (("names",), "bone names"),
        (("rest", "T"), "“rest pose: T”"),
        (("rig", "mimesh"), "“bones: found on the surface”"),
        (("driving_up", ...), "up of the driving"),
        (("ground", False), "“feet on the ground: off”"),
    ):
        assert field_name(*named) == expected
    assert for_page(f"{tmp_path}/exports/3/files/a.vrma: expected", tmp_path) == "a.vrma: expected"


@pytest.mark.parametrize(
    ("suffix", "options", "words"),
    [
        (".vrma", {"layout": Layout("unreal")}, "bone names, root bone, rest pose: expected a .glb or .gltf"),
        (".pc2", {"skinned": True}, ".pc2: expected .glb, .gltf or .fbx for bones"),
        (".glb", {"layout": Layout(root_bone=True)}, "expected with bones, found without"),
        (".glb", {"influences": 8}, "expected with bones, found without"),
    ],
)
@pytest.mark.parametrize("moved", ["copy"], indirect=True)
def test_layouts_that_a_format_cannot_have_are_refused(moved, suffix, options, words):
    assert words in exported(moved[0], suffix, **options).error


def test_fbx_says_that_it_needs_blender(monkeypatch):
    def needs():
        return next(entry["needs"] for entry in formats("result", True) if entry["suffix"] == ".fbx")

    monkeypatch.setenv("BLENDER", "/no/such/program")
    assert needs() == "Blender"
    monkeypatch.setenv("BLENDER", sys.executable)
    assert needs() == ""
