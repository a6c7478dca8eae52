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
from mimesh.bodies.hands import body_with_fingers
from mimesh.bodies.joint_names import finger_joints
from mimesh.core.errors import InputError, RefusedMeshError
from mimesh.core.frame_buffer import LazyFrames
from mimesh.core.normalization import ORIENTATIONS, ROTATIONS
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.draft import Draft
from mimesh.io.gltf.own_rig import has_rig
from mimesh.io.gltf.scene import node_parents, world_matrices
from mimesh.io.gltf.vrm import PUBLIC_LICENSE, read_origin, vrm_bones
from mimesh.motions.bone_motion import misplaced_bones

BODY = load_body()
CC0 = "https://creativecommons.org/publicdomain/zero/1.0/"


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
    laid_out = rigged.laid_out(mimesh.Layout("mixamo", root_bone=True, rest="T"))
    assert set(laid_out.names) <= node_names(path)
    np.testing.assert_allclose(laid_out.mesh.vertices, arms, atol=1e-5)
    assert laid_out.deviation(LazyFrames.stored(arms[None])) < 1e-5, "its one frame is that pose"
    assert np.ptp(arms[:, 0]) > 0.9 * np.ptp(arms[:, 1]), "arms are horizontal"
    with pytest.raises(InputError, match="names: expected one of"):
        rigged.save(tmp_path / "other.glb", names="maya")
    with pytest.raises(InputError, match=r"expected one of \.glb \.gltf \.fbx \.vrm for bones, found '\.obj'"):
        rigged.save(tmp_path / "rigged.obj")


def check_origin(place: dict[str, np.ndarray], vertices: np.ndarray) -> None:
    """The origin of a VRM is on the ground below the hips (tpose.md)."""
    np.testing.assert_allclose([*place["Hips"][[0, 2]], vertices[:, 1].min()], 0, atol=1e-5)


@pytest.mark.parametrize(("up", "front"), [("+z", "-y"), pytest.param("+y", "+z", marks=pytest.mark.slow)])
def test_a_vrm_is_a_person_in_the_t_pose_in_the_axes_of_vrm(up, front, tmp_path):
    mesh = person(0)
    turn = ROTATIONS[ORIENTATIONS.index((up, front))]
    rigged = mimesh.rig(mesh.with_vertices((mesh.vertices + [1, 2, 3]) @ turn), hints=mimesh.Hints(up=up, front=front))
    path = rigged.save(tmp_path / "hero.vrm", names="mixamo", author=["A", "B"], license=CC0)
    document = open_document(path)
    meta = document.gltf["extensions"]["VRMC_vrm"]["meta"]
    assert (meta["authors"], meta["licenseUrl"]) == (["A", "B"], "https://vrm.dev/licenses/1.0/")
    assert read_origin(document) == ("A, B", CC0)
    bones = vrm_bones(document)
    assert {"Hips", "Spine", "Head", "LeftHand", "RightFoot"} <= bones.keys()
    place = {name: world_matrices(document)[node][:3, 3] for name, node in bones.items()}
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        arm, leg = place[f"{side}Hand"] - place[f"{side}Arm"], place[f"{side}Foot"] - place[f"{side}UpLeg"]
        np.testing.assert_allclose(arm / np.linalg.norm(arm), [sign, 0, 0], atol=1e-6)
        np.testing.assert_allclose(leg / np.linalg.norm(leg), [0, -1, 0], atol=1e-6)
    vertices = mimesh.load_mesh(path).vertices
    check_origin(place, vertices)
    assert np.ptp(vertices[:, 0]) > 0.9 * np.ptp(vertices[:, 1])
    assert np.ptp(vertices[:, 1]) == pytest.approx(np.ptp(BODY.vertices[:, 1]), rel=0.1)
    assert mimesh.rig(path).source == "file"


def test_a_vrm_keeps_the_file_with_its_own_bones_in_the_t_pose(tmp_path):
    def away(draft: Draft) -> None:
        draft.gltf["nodes"].append({"translation": [1, 2, 3], "children": draft.gltf["scenes"][0]["nodes"]})
        draft.gltf["scenes"][0]["nodes"] = [len(draft.gltf["nodes"]) - 1]

    path, _, _ = rigs.of_kind(tmp_path / "own.glb", "A-pose", change=away)
    kept = mimesh.rig(path)
    document = open_document(kept.save(tmp_path / "own.vrm", author="A", license=PUBLIC_LICENSE))
    assert "animations" not in document.gltf
    assert "otherLicenseUrl" not in document.gltf["extensions"]["VRMC_vrm"]["meta"]
    assert len(document.gltf["skins"]) == len(open_document(path).gltf["skins"])
    place = {name: world_matrices(document)[node][:3, 3] for name, node in vrm_bones(document).items()}
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        arm, leg = place[f"{side}Hand"] - place[f"{side}Arm"], place[f"{side}Foot"] - place[f"{side}UpLeg"]
        np.testing.assert_allclose(arm / np.linalg.norm(arm), [sign, 0, 0], atol=1e-5)
        np.testing.assert_allclose(leg / np.linalg.norm(leg), [0, -1, 0], atol=1e-5)
    check_origin(place, mimesh.load_mesh(tmp_path / "own.vrm").vertices)
    # A VRM stays the one that it is, with its own meta.
    again = open_document(mimesh.rig(tmp_path / "own.vrm").save(tmp_path / "again.vrm"))
    assert again.gltf["extensions"] == document.gltf["extensions"]


HELD = {
    "thighs on the spine, arms on the neck": {
        **dict.fromkeys(("LeftUpLeg", "RightUpLeg"), "LowerBack"),
        **dict.fromkeys(("LeftShoulder", "RightShoulder"), "Neck"),
    },
    "thighs and feet beside all": dict.fromkeys(("LeftUpLeg", "RightUpLeg", "LeftFoot", "RightFoot"), ""),
}
"""Joints of rigs that hang on another joint than in VRM ("": on the armature)."""


@pytest.mark.parametrize("hold", HELD.values(), ids=HELD)
def test_bones_of_a_vrm_hang_on_the_bones_that_vrm_demands(hold, tmp_path):
    """They stay where they are, and so do the vertices: the file is that of a rig in which they hang there."""
    usual, _, _ = rigs.of_kind(tmp_path / "usual.glb", "A-pose", moving=False)
    held, _, _ = rigs.of_kind(tmp_path / "held.glb", "A-pose", moving=False, hold=hold)
    for path in (usual, held):
        mimesh.rig(path).save(path.with_suffix(".vrm"), author="A", license=PUBLIC_LICENSE)
    document, expected = (open_document(path.with_suffix(".vrm")) for path in (held, usual))
    bones = vrm_bones(document)
    assert misplaced_bones(bones, node_parents(open_document(held))).keys() == hold.keys()
    assert misplaced_bones(bones, node_parents(document)) == {}
    np.testing.assert_allclose(world_matrices(document)[2:-1], world_matrices(expected)[2:-1], atol=1e-4)
    vertices = mimesh.load_mesh(held.with_suffix(".vrm")).vertices
    np.testing.assert_allclose(vertices, mimesh.load_mesh(usual.with_suffix(".vrm")).vertices, atol=1e-5)
    assert not any(node.get("children") == [] for node in document.gltf["nodes"])


def test_hips_that_are_no_topmost_bone_go_above_the_others():
    """Of a chain armature, spine, hips, thigh with the chest beside the hips: spine and chest go below the hips."""
    nodes = {"Hips": 2, "LowerBack": 1, "Spine": 4, "LeftUpLeg": 3, "LeftLeg": 5}
    assert misplaced_bones(nodes, [-1, 0, 1, 2, 1, 3]) == {"Hips": 0, "LowerBack": 2}
    assert misplaced_bones(nodes, [-1, 2, 0, 2, 1, 3]) == {}


def test_what_a_vrm_cannot_be_is_refused(rigged, tmp_path):
    path = tmp_path / "hero.vrm"
    with pytest.raises(InputError, match=r"expected author and license for a \.vrm, found no author"):
        rigged.save(path)
    with pytest.raises(InputError, match="license: expected a URL, found 'MIT'"):
        rigged.save(path, author="A", license="MIT")
    with pytest.raises(InputError, match="expected a T-pose without a root bone"):
        rigged.save(path, author="A", license=CC0, rest="A")
    animal_rig = dataclasses.replace(rigged, body="quadruped")
    with pytest.raises(InputError, match=r"expected a person for a \.vrm, found a four-legged animal"):
        animal_rig.save(path, author="A", license=CC0)
    assert not path.exists()


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


@pytest.mark.slow
def test_hands_that_show_fingers_get_joints_of_them():
    body = body_with_fingers()
    mesh = dataclasses.replace(body.mesh(), up="+y")
    found = mimesh.rig(mesh)
    assert found.report["fingers"] == ["left", "right"]
    place = dict(zip(found.skeleton.names, found.skeleton.rig.joints, strict=True))
    for side in ("Left", "Right"):
        apart = [np.linalg.norm(place[name] - body.joints[body.joint(name)]) for name in finger_joints(side)]
        assert np.mean(apart) < 0.01, "metres"
    weights = found.skeleton.rig.weights
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    tip = mesh.vertices[:, 0].argmax()
    assert found.skeleton.names[weights[tip].argmax()] == "LeftHandMiddle3"
    assert not any("HandMiddle" in name for name in found.joints), "joints of fingers cannot be corrected"
    plain = mimesh.rig(mesh, fingers=False)
    assert plain.report["fingers"] == []
    assert len(plain.skeleton.names) == len(found.skeleton.names) - 30


def test_corrected_joints_stay_where_they_are_put_also_far_from_the_origin(rigged):
    away = np.array([0.0, 0.0, 1e5])
    elbow = rigged.joints["LeftForeArm"] + [0.0, 0.03, 0.0] + away
    mesh = rigged.mesh.with_vertices(rigged.mesh.vertices + away)
    corrected = mimesh.rig(mesh, hints=mimesh.Hints(joints={"LeftForeArm": elbow}))
    assert corrected.source == "corrected"
    np.testing.assert_allclose(corrected.joints["LeftForeArm"], elbow, atol=1e-6)
    assert any("far from the origin" in note for note in corrected.notes)
    assert not any("far from the origin" in note for note in rigged.notes)


@pytest.mark.slow
def test_what_is_no_body_is_refused_unless_the_user_insists():
    with pytest.raises(
        RefusedMeshError, match=r"^ring: expected a person or a four-legged animal, found a shape"
    ) as refused:
        mimesh.rig(ring())
    insisted = mimesh.rig(ring(), hints=mimesh.Hints(body="human"))
    (note,) = (note for note in insisted.notes if "ring does not look like a person" in note)
    for words in (str(refused.value), note):
        assert "up=..." in words
        assert "driving" not in words
        assert "rigs in both files" not in words
    with pytest.raises(InputError, match="body: expected human, quadruped or auto, found other"):
        mimesh.rig(ring(), hints=mimesh.Hints(body="other"))


def test_a_network_of_ones_own_knows_one_body(model):
    rigged = mimesh.rig(person(0), model)
    assert (rigged.body, rigged.source) == ("human", "found")
    with pytest.raises(InputError, match=r"body: expected human with the model .*, found quadruped"):
        mimesh.rig(person(0), model, hints=mimesh.Hints(body="quadruped"))


@pytest.mark.slow
def test_animals_are_rigged():
    cow = mimesh.rig(animal("cow"))
    assert cow.body == "quadruped"
    assert {"LeftHand", "RightFoot", "Tail1", "Jaw"} <= set(cow.joints)
