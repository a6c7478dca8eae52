"""Exports of the studio with bones: those of `animate`, with the names and formats that other programs expect."""

import sys

import numpy as np
import pygltflib
import pytest
from people import person, walk
from vrm_files import vrm
from waiting import finished, wait_until

from mimesh import animate, load_clip, save_clip, save_mesh
from mimesh.bodies.engine_rig import Layout
from mimesh.studio import make_session
from mimesh.studio.exports import formats
from mimesh.studio.fields import field_name
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


def exported(session, suffix, skinned=True, blendshapes=None, layout=None):
    """Export all results and return the export, once it is written or has failed."""
    number = session.export(suffix, [], skinned, blendshapes, layout or Layout())
    export = session.exports[number]
    wait_until(lambda: export.path is not None or export.error)
    return export


@pytest.mark.slow
def test_bones_are_named_and_arranged_as_by_animate(moved, tmp_path):
    session, files = moved
    result, layout, expected = animate(*files), Layout("unreal", True, "T", 20.0), tmp_path / "expected.glb"
    export = exported(session, ".glb", layout=layout)
    assert export.error == ""
    result.save_skinned(expected, names=layout.names, root_bone=layout.root_bone, rest=layout.rest, fps=layout.fps)
    mine, theirs = (pygltflib.GLTF2().load(path) for path in (export.path, expected))
    assert [node.name for node in mine.nodes] == [node.name for node in theirs.nodes]
    assert {"root", "pelvis", "upperarm_l"} <= {node.name for node in mine.nodes}
    mine, theirs = load_clip(export.path), load_clip(expected)
    assert mine.fps == theirs.fps == 20
    np.testing.assert_allclose(mine.vertices, theirs.vertices, atol=1e-6)
    assert any("sampled from 3 frames" in note for note in export.notes)
    bones = exported(session, ".vrma", skinned=False)
    assert bones.path.name == "hero-walk.vrma"
    assert bones.path.read_bytes() == result.save(tmp_path / "expected.vrma").read_bytes()


@pytest.mark.slow
def test_vrm_animations_of_a_mesh_with_a_rig_have_its_bones(moved, tmp_path):
    _, (_, driving) = moved
    vrm(tmp_path / "hero.vrm", named=True)
    session = make_session([tmp_path / "hero.vrm", driving], 2**26)
    try:
        finished(session)
        export = exported(session, ".vrma", skinned=False)
        assert export.error == ""
        expected = animate(tmp_path / "hero.vrm", driving).save(tmp_path / "expected.vrma")
        assert export.path.read_bytes() == expected.read_bytes()
    finally:
        session.close()


def test_messages_name_fields_of_the_page(tmp_path):
    for named, expected in (
        (("names",), "bone names"),
        (("rest", "T"), "“rest pose: T”"),
        (("rig", "mimesh"), "“bones: found on the surface”"),
        (("driving_up", ...), "up of the driving"),
    ):
        assert field_name(*named) == expected
    assert for_page(f"{tmp_path}/exports/3/files/a.vrma: expected", tmp_path) == "a.vrma: expected"


@pytest.mark.parametrize(
    ("suffix", "options", "words"),
    [
        (".vrma", {"layout": Layout("unreal")}, "bone names, root bone, rest pose: expected a .glb or .gltf"),
        (".pc2", {}, ".pc2: expected .glb, .gltf or .fbx for bones"),
        (".glb", {"skinned": False, "layout": Layout(root_bone=True)}, "expected with bones, found without"),
        (".fbx", {"skinned": False, "blendshapes": 3}, ".fbx: expected .glb or .gltf for blend shapes"),
    ],
)
@pytest.mark.parametrize("moved", ["copy"], indirect=True)
def test_layouts_that_a_format_cannot_have_are_refused(moved, suffix, options, words):
    assert words in exported(moved[0], suffix, **options).error


def test_fbx_says_that_it_needs_blender(monkeypatch):
    def needs():
        return next(entry["needs"] for entry in formats(True) if entry["suffix"] == ".fbx")

    monkeypatch.setenv("BLENDER", "/no/such/program")
    assert needs() == "Blender"
    monkeypatch.setenv("BLENDER", sys.executable)
    assert needs() == ""
