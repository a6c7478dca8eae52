"""`rig`: skeletons of bare meshes are right and can be written, rigs of files are kept, things are refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import rigs
from people import person
from zoo import ring

import mimesh
from mimesh.bodies import load_body
from mimesh.bodies.animals import animal
from mimesh.core.errors import InputError, RefusedMeshError
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.own_rig import has_rig

BODY = load_body()


@pytest.fixture(scope="module")
def rigged() -> mimesh.RiggedMesh:
    return mimesh.rig(person(0))


def node_names(path) -> set[str]:
    return {node.get("name", "") for node in open_document(path).gltf["nodes"]}


def test_joints_are_where_those_of_the_body_are(rigged):
    truth = mimesh.rig(dataclasses.replace(BODY.mesh(), up="+y"))
    height = np.ptp(BODY.vertices[:, 1])
    apart = [np.linalg.norm(truth.joints[name] - BODY.joints[BODY.joint(name)]) for name in truth.joints]
    assert np.mean(apart) < 0.01 * height
    assert (rigged.body, rigged.source) == ("human", "found")
    assert rigged.report["confidence"] > 0.5
    weights = rigged.skeleton.rig.weights
    assert weights.shape == (len(rigged.mesh.vertices), len(rigged.skeleton.names))
    np.testing.assert_allclose(weights.sum(axis=1), 1)


def test_the_file_has_bones_and_no_animation_and_moves_on_them(rigged, tmp_path):
    path = rigged.save(tmp_path / "rigged.glb")
    document = open_document(path).gltf
    assert len(document["skins"][0]["joints"]) == len(rigged.skeleton.names)
    assert "animations" not in document
    mesh = mimesh.load_mesh(path)
    assert has_rig(mesh)
    np.testing.assert_allclose(mesh.vertices, rigged.mesh.vertices, atol=1e-6)
    moved = mimesh.transfer(path, person(1, pose=1))
    assert moved.report["rig"] == "own"
    direct = mimesh.transfer(rigged.mesh, person(1, pose=1))
    # Four weights a vertex, and the rest pose is read from the bones.
    assert np.abs(moved.vertices - direct.vertices).mean() < 0.02 * np.ptp(direct.vertices, axis=0).max()


def test_bones_are_called_and_bound_as_a_program_expects(rigged, tmp_path):
    path = rigged.save(tmp_path / "mixamo.glb", names="mixamo", rest="T", root_bone=True)
    assert {"mixamorig:Hips", "mixamorig:LeftForeArm", "mixamorig:RightFoot"} <= node_names(path)
    arms = mimesh.load_mesh(path).vertices
    assert np.ptp(arms[:, 0]) > 0.9 * np.ptp(arms[:, 1]), "arms are horizontal"
    with pytest.raises(InputError, match="names: expected one of"):
        rigged.save(tmp_path / "other.glb", names="maya")
    for name in ("rigged.obj", "rigged.vrm"):
        with pytest.raises(InputError, match=r"expected \.glb, \.gltf or \.fbx"):
            rigged.save(tmp_path / name)


def test_the_rig_of_a_file_is_kept_with_all_else_or_replaced(tmp_path):
    path = rigs.character(tmp_path / "own.glb", frames=3)
    kept = mimesh.rig(path)
    assert kept.source == "file"
    assert any("has a rig, which is kept" in note for note in kept.notes)
    same = kept.save(tmp_path / "same.glb")
    before, after = (open_document(file).gltf for file in (path, same))
    for part in ("nodes", "skins", "animations", "meshes"):
        assert after.get(part) == before.get(part), part
    renamed = node_names(kept.save(tmp_path / "unreal.glb", names="unreal", root_bone=True))
    assert {"root", "pelvis", "thigh_l"} <= renamed
    with pytest.raises(InputError, match="rest: expected `rest="):
        kept.save(tmp_path / "t.glb", rest="T")
    replaced = mimesh.rig(path, hints=mimesh.Hints(rig="mimesh"))
    assert replaced.source == "found"
    assert len(open_document(replaced.save(tmp_path / "new.glb")).gltf["skins"]) == 1


def test_corrected_joints_stay_where_they_are_put(rigged):
    elbow = rigged.joints["LeftForeArm"] + [0.0, 0.03, 0.0]
    corrected = mimesh.rig(rigged.mesh, hints=mimesh.Hints(joints={"LeftForeArm": elbow}))
    assert corrected.source == "corrected"
    np.testing.assert_allclose(corrected.joints["LeftForeArm"], elbow, atol=1e-6)


def test_what_is_no_body_is_refused_unless_the_user_insists():
    with pytest.raises(RefusedMeshError, match=r"^ring: expected a person or a four-legged animal, found a shape"):
        mimesh.rig(ring())
    insisted = mimesh.rig(ring(), hints=mimesh.Hints(body="human"))
    assert any("ring does not look like a person" in note for note in insisted.notes)
    with pytest.raises(InputError, match="body: expected human, quadruped or auto, found other"):
        mimesh.rig(ring(), hints=mimesh.Hints(body="other"))


@pytest.mark.slow
def test_animals_are_rigged():
    cow = mimesh.rig(animal("cow"))
    assert cow.body == "quadruped"
    assert {"LeftHand", "RightFoot", "Tail1", "Jaw"} <= set(cow.joints)
