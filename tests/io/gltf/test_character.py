"""Rigged glTF and VRM files as characters: rest pose, facing, VRM's bones, clips, origin, and what is refused.

Animals are the same rig as was written, whatever they face, and have clips that pose it.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rigs
from animals import FEET, animal, bones, random_turns
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.bodies.joint_names import other_side
from mimesh.core.errors import InputError
from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.character import read_rigged_character
from mimesh.io.gltf.own_rig import read_own_rig
from mimesh.io.gltf.vrm import VRM_BONES

BODY = load_body()
BACK = Rotation.from_euler("y", 180, degrees=True).as_matrix()
LYING = Rotation.from_euler("x", -90, degrees=True).as_matrix()


def edited(path: Path, change: Callable[[dict], None]) -> Path:
    """Change the JSON of a .gltf file."""
    gltf = json.loads(path.read_text())
    change(gltf)
    path.write_text(json.dumps(gltf))
    return path


def node_of(gltf: dict, joint: str) -> int:
    return next(k for k, node in enumerate(gltf["nodes"]) if node["name"] == joint)


def joint_at(character, name: str) -> np.ndarray:
    return character.rig.joints[character.joints[name]]


def test_rest_is_the_bind_pose_whatever_the_nodes_and_their_scales(tmp_path):
    """Joint frames have a scale of 100, random axes, some mirrored; the nodes of the second file are in a pose."""
    rotmat = np.tile(np.eye(3), (len(BODY.parents), 1, 1))
    rotmat[BODY.joint("LeftArm")] = Rotation.from_euler("z", 70, degrees=True).as_matrix()
    rotation, translation = BODY.skinning_transforms(BODY.joints, rotmat)
    moved = np.tile(np.eye(4), (len(BODY.parents), 1, 1))
    moved[:, :3, :3], moved[:, :3, 3] = rotation, translation
    for options in ({}, {"moved": moved}):
        found = read_rigged_character(rigs.character(tmp_path / "a.glb", None, **options))
        np.testing.assert_allclose(found.rig.mesh.vertices, BODY.vertices[rigs.kept()], atol=1e-4)
        for name in ("Hips", "LeftHand", "RightFoot", "Head"):
            np.testing.assert_allclose(joint_at(found, name), BODY.joints[BODY.joint(name)], atol=1e-4)
        assert np.allclose(np.linalg.det(found.rig.T_world_joint), 1)
        assert found.meta.facing == "+z"


def test_feet_decide_where_names_and_the_rule_of_the_format_differ(tmp_path):
    backwards = read_rigged_character(rigs.character(tmp_path / "a.glb", turn=BACK))
    assert backwards.meta.facing == "-z"
    assert backwards.rig.joint_names[backwards.joints["LeftArm"]] == "LeftArm"
    viewers = read_rigged_character(rigs.character(tmp_path / "b.glb", name=other_side))
    assert viewers.meta.facing == "+z"
    assert viewers.rig.joint_names[viewers.joints["LeftArm"]] == "RightArm"
    for found in (backwards, viewers):
        assert joint_at(found, "LeftArm")[0] > 0
        assert joint_at(found, "LeftToeBase")[2] > joint_at(found, "LeftFoot")[2]


TRUNK_OF_TWO = {"spine": "Spine", "chest": "Spine1"}


@pytest.mark.parametrize("version", [0, 1])
def test_the_bones_of_vrm_count_before_names(tmp_path, version):
    """VRM 0 faces -z, VRM 1 +z. The joints have no names that say anything."""

    def humanoid(gltf: dict) -> None:
        joints = {bone: joint for bone, joint in VRM_BONES.items() if joint in BODY.joint_names} | TRUNK_OF_TWO
        del joints["upperChest"]
        nodes = {bone: 2 + BODY.joint(joint) for bone, joint in joints.items()}
        for k, node in enumerate(gltf["nodes"]):
            node["name"] = f"bone{k}"
        bones = {bone: {"node": node} for bone, node in nodes.items()}
        meta = {"authors": ["ann", "bob"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
        new = {"VRMC_vrm": {"humanoid": {"humanBones": bones}, "meta": meta}}
        rows = [{"bone": bone, "node": node} for bone, node in nodes.items()]
        old = {"VRM": {"humanoid": {"humanBones": rows}, "meta": {"author": "eve", "licenseName": "CC0"}}}
        gltf["extensions"] = new if version else old

    path = edited(rigs.character(tmp_path / "a.gltf", turn=None if version else BACK), humanoid)
    found = read_rigged_character(path, licence="License.txt")
    assert found.meta.facing == ("+z" if version else "-z")
    origin = ("ann, bob", "https://vrm.dev/licenses/1.0/") if version else ("eve", "CC0")
    assert (found.meta.maker, found.meta.licence) == origin
    assert found.rig.joint_names[found.joints["Spine1"]] == f"bone{2 + BODY.joint('Spine1')}"
    assert {"LeftForeArm", "RightLeg", "Head", "LeftToeBase"} <= found.joints.keys()
    assert joint_at(found, "LeftArm")[0] > 0


def test_damaged_extensions_of_vrm_leave_the_names(tmp_path):
    """What else is damaged: tests/io/gltf/test_vrm.py."""
    damaged = {"humanoid": {"humanBones": {"hips": {"node": 10**9}, "head": {"node": "x"}}}, "meta": []}
    extensions = {"VRMC_vrm": damaged, "VRM": [1]}
    path = edited(rigs.character(tmp_path / "a.gltf"), lambda gltf: gltf.update(extensions=extensions))
    found = read_rigged_character(path)
    assert found.rig.joint_names[found.joints["LeftArm"]] == "LeftArm"


def test_clips_move_the_surface_as_the_file_does(tmp_path):
    path = rigs.character(tmp_path / "a.gltf", turn=BACK, clips={"wave": rigs.exercise(rigs.figure())})
    found, clip = read_rigged_character(path), load_clip(path, fps=30.0)
    assert list(found.clips) == ["wave"]
    assert len(found.clips["wave"]) == len(clip) > 3
    assert np.ptp(clip.vertices, axis=0).max() > 0.1
    for t in (0, 2, len(clip) - 1):
        ours = found.rig.skinned(found.clip_transforms("wave", t)) @ BACK  # back to the file's axes
        np.testing.assert_allclose(ours, clip.vertices[t], atol=2e-4)


def test_a_sword_follows_its_joint_and_a_floor_is_left_out(tmp_path):
    def add(gltf: dict) -> None:
        gltf["nodes"] += [{"name": "floor", "mesh": 0}, {"name": "sword", "mesh": 0}]
        gltf["scenes"][0]["nodes"].append(len(gltf["nodes"]) - 2)
        gltf["nodes"][node_of(gltf, "LeftHand")].setdefault("children", []).append(len(gltf["nodes"]) - 1)

    alone = read_rigged_character(rigs.character(tmp_path / "a.gltf"))
    found = read_rigged_character(edited(rigs.character(tmp_path / "b.gltf"), add))
    count = len(alone.rig.weights)
    assert len(found.rig.weights) == 2 * count
    hand = found.joints["LeftHand"]
    rigid = ((found.rig.joint_of == hand) * found.rig.weights).sum(axis=1) == 1
    assert rigid.sum() >= count


def test_a_character_that_lies_in_its_file_is_read_as_it_stands_in_its_bind_pose(tmp_path):
    rig = read_rigged_character(rigs.character(tmp_path / "a.glb", turn=LYING)).rig
    assert np.ptp(rig.mesh.vertices, axis=0).argmax() in (0, 1)  # the T-pose may be wider than high
    assert rig.joints[rig.joint_names.index("Head"), 1] > rig.joints[rig.joint_names.index("LeftFoot"), 1]


def test_what_is_no_character_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected a thigh and an upper arm"):
        read_rigged_character(rigs.character(tmp_path / "b.glb", name=lambda name: f"x{BODY.joint(name)}"))


def frames(made, count: int = 3):
    return [(random_turns(t, made.order, 15), np.array([0.0, 0.05 * t, 0.1 * t])) for t in range(count)]


@pytest.mark.parametrize("detached", [(), FEET])
def test_an_animal_is_read_with_its_joints_and_clips(detached, tmp_path):
    made = animal(0, bones(4), detached)
    motion = frames(made)
    found = read_rigged_character(made.write(tmp_path / "cow.glb", {"go": motion}), "pack", body="quadruped")
    assert (found.meta.body_class, found.meta.facing, found.meta.pack) == ("quadruped", "+z", "pack")
    assert list(found.clips) == ["go"]
    for name in ("LeftForearm", "RightShin", "LeftToes", "Neck1", "Head", "Tail3"):
        np.testing.assert_allclose(found.rig.joints[found.joints[name]], made.joints[made.order.index(name)], atol=1e-5)
    for t, frame in enumerate(motion):
        posed = found.rig.skinned(found.clip_transforms("go", t))
        np.testing.assert_allclose(posed, made.posed(*frame), atol=2e-3)


def test_an_animal_is_turned_to_face_z(tmp_path):
    made = animal(0)
    straight = read_rigged_character(made.write(tmp_path / "a.glb", {"go": frames(made, 2)}), body="quadruped")
    for degrees, facing in ((180, "-z"), (90, "+x")):
        turn = Rotation.from_euler("y", degrees, degrees=True).as_matrix()
        path = made.write(tmp_path / "b.glb", {"go": frames(made, 2)}, turn=turn)
        turned = read_rigged_character(path, body="quadruped")
        assert (turned.meta.facing, list(turned.clips)) == (facing, ["go"])
        assert turned.joints == straight.joints
        np.testing.assert_allclose(turned.rig.joints, straight.rig.joints, atol=1e-5)
        np.testing.assert_allclose(turned.rig.mesh.vertices, straight.rig.mesh.vertices, atol=1e-5)
        for t in range(2):
            one, other = (read.rig.skinned(read.clip_transforms("go", t)) for read in (straight, turned))
            np.testing.assert_allclose(other, one, atol=2e-3)
        own = read_own_rig(load_mesh(path), body="quadruped").humanoid
        np.testing.assert_allclose(own.turn @ turn, np.eye(3), atol=1e-6)


def test_a_person_and_an_animal_are_no_rigs_of_the_other_body(tmp_path):
    with pytest.raises(InputError, match="expected a skin, found none"):
        read_own_rig(animal(0).mesh, body="quadruped")
    with pytest.raises(InputError, match=r"cow\.glb: expected a thigh and an upper arm"):
        read_own_rig(load_mesh(animal(0).write(tmp_path / "cow.glb")))
    with pytest.raises(InputError, match=r"man\.glb: expected"):
        read_own_rig(load_mesh(rigs.character(tmp_path / "man.glb")), body="quadruped")
    with pytest.raises(InputError, match=r"man\.glb: expected"):
        read_rigged_character(tmp_path / "man.glb", body="quadruped")
