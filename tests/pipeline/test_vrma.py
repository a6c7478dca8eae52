"""VRM animations as driving and as output, and morph targets that follow the driving's by name."""

import json

import numpy as np
import pytest
from engine_rigs import moving_rig
from foreign_names import renamed
from gltf_samples import Sample
from matrix import matrix
from people import person, walk
from rigs import character, figure
from scipy.spatial.transform import Rotation
from vrm_files import bone_positions, vrm, vrma

import mimesh
from mimesh.bodies import load_body
from mimesh.bodies.character_limbs import SIDES
from mimesh.core.errors import InputError
from mimesh.core.frame_buffer import LazyFrames
from mimesh.core.normalization import ORIENTATIONS, ROTATIONS
from mimesh.io import load_clip
from mimesh.io.gltf.document import open_document
from mimesh.motions.bone_motion import T_DIRECTIONS, bone_parents
from mimesh.pipeline.result import ClipResult, Timer
from mimesh.pipeline.vrm import _bone_motion

TURN = {0: np.diag([-1.0, 1.0, -1.0]), 1: np.eye(3)}
ARKIT = ("browInnerUp", "mouthSmileLeft", "jawOpen")
OTHERS = ("jaw_open", "cheekPuff", "MouthSmile_L")
WEIGHTS = np.random.default_rng(3).random((5, 3))


def turned(result, nodes):
    """World rotations of nodes since rest."""
    world = result.own.node_matrices(nodes)[..., :3, :3]
    return world @ np.linalg.inv(result.own.source.rest.T_world_node[nodes][:, :3, :3])


def mesh_node(path):
    return next(number for number, node in enumerate(open_document(path).gltf["nodes"]) if "mesh" in node)


@pytest.mark.parametrize("version", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_an_animation_turns_the_bones_of_a_vrm_exactly(version, tmp_path):
    path, rig, nodes = vrm(tmp_path / "a.vrm", version)
    drive, world, hips = vrma(tmp_path / "a.vrma", bone_positions(rig, "+z" if version else "-z"))
    result = mimesh.animate(path, drive, motion=mimesh.MotionOptions(ground=False))
    found, turn = turned(result, [nodes[bone] for bone in world]), TURN[version]
    assert len(world) == 52
    assert np.abs(found - turn @ np.stack(list(world.values()), axis=1) @ turn.T).max() < 1e-5
    moved = result.own.node_matrices([nodes["hips"]])[:, 0, :3, 3]
    assert np.abs((moved - moved[0]) @ turn.T - (hips - hips[0])).max() < 1e-5


@pytest.mark.slow
@matrix("version", [0, 1], quick=[0])
def test_a_written_animation_is_the_motion_of_the_vrm(version, tmp_path):
    path, rig, nodes = vrm(tmp_path / "a.vrm", version)
    drive, world, _ = vrma(tmp_path / "a.vrma", bone_positions(rig, "+z" if version else "-z"), frames=40, spread=0.1)
    first = mimesh.animate(path, drive, motion=mimesh.MotionOptions(ground=False))
    again = mimesh.animate(path, first.save(tmp_path / "b.vrma"), motion=mimesh.MotionOptions(ground=False))
    of_bones = [nodes[bone] for bone in world]
    assert np.abs(turned(first, of_bones) - turned(again, of_bones)).max() < 1e-4
    assert np.abs(first.clip.vertices - again.clip.vertices).max() < 1e-4
    gltf = open_document(tmp_path / "b.vrma").gltf
    assert "meshes" not in gltf
    assert gltf["extensions"]["VRMC_vrm_animation"]["specVersion"] == "1.0"
    assert not any("rotation" in node or "scale" in node for node in gltf["nodes"])
    paths = [(c["target"]["node"], c["target"]["path"]) for c in gltf["animations"][0]["channels"]]
    assert [node for node, path in paths if path == "translation"] == [0]
    # The rest pose is that of the VRM: its hips are as high.
    assert np.allclose(gltf["nodes"][0]["translation"], bone_positions(rig, "+z" if version else "-z")["hips"])


@pytest.mark.slow
def test_bones_that_stay_have_one_key(tmp_path):
    path, rig, _ = vrm(tmp_path / "a.vrm")
    drive, _, _ = vrma(tmp_path / "a.vrma", bone_positions(rig), frames=8, spread=0.0)
    mimesh.animate(path, drive, motion=mimesh.MotionOptions(ground=False)).save(tmp_path / "b.vrma")
    gltf = open_document(tmp_path / "b.vrma").gltf
    counts = [gltf["accessors"][sampler["input"]]["count"] for sampler in gltf["animations"][0]["samplers"]]
    assert counts[0] == 8  # the hips
    assert set(counts[1:]) == {1}


def limbs(motion):
    """Directions of the limbs, in frames: bones whose ends VRM's T-pose places."""
    index, parents = {name: k for k, name in enumerate(motion.joints)}, bone_parents(motion.joints)
    ends = [name for name in motion.joints if name in T_DIRECTIONS and name.endswith(("Arm", "Leg", "Foot", "Hand"))]
    return {
        name: motion.rotation[:, parents[index[name]]] @ (motion.rest[index[name]] - motion.rest[parents[index[name]]])
        for name in ends
    }


@pytest.mark.slow
@matrix("facing", [1.0, -1.0], quick=[-1.0])
def test_other_rigs_are_written_from_a_t_pose(facing, tmp_path):
    """Of a character with lowered arms and random axes of its joints; limbs point where the character's do."""
    body = load_body()
    rest = np.tile(np.eye(3), (len(body.parents), 1, 1))
    for side, sign in zip(SIDES, (-1, 1), strict=True):
        rest[body.joint(f"{side}Arm")] = Rotation.from_euler("z", sign * 40, degrees=True).as_matrix()
        rest[body.joint(f"{side}UpLeg")] = Rotation.from_euler("z", -sign * 8, degrees=True).as_matrix()
    path = character(tmp_path / "hero.glb", rest=rest, turn=np.diag([facing, 1.0, facing]), faces=600)
    _, rig, _ = vrm(tmp_path / "a.vrm")
    drive, _, _ = vrma(tmp_path / "a.vrma", bone_positions(rig))
    result = mimesh.animate(path, drive, motion=mimesh.MotionOptions(ground=False))
    motion = _bone_motion(result, "x", None, tmp_path / "x.vrma")
    joints, parents = motion.joints, motion.parents
    for name, direction in T_DIRECTIONS.items():
        if name in joints:
            k = joints.index(name)
            bone = motion.rest[k] - motion.rest[parents[k]]
            assert np.allclose(bone / np.linalg.norm(bone), direction)
    world = result.own.node_matrices([result.own.joints[name] for name in joints])[..., :3, 3]
    world = world @ np.diag([facing, 1.0, facing])
    for name, bones in limbs(motion).items():
        k = joints.index(name)
        expected = world[:, k] - world[:, parents[k]]
        assert np.allclose(bones, expected, atol=1e-4 * np.linalg.norm(expected[0])), name
    # And so they do on a VRM that gets the file.
    avatar, _, _ = vrm(tmp_path / "b.vrm")
    played = mimesh.animate(avatar, result.save(tmp_path / "c.vrma"), motion=mimesh.MotionOptions(ground=False))
    at = {joint: played.own.node_matrices([node])[:, 0, :3, 3] for joint, node in played.own.joints.items()}
    for name, bones in limbs(motion).items():
        found = at[name] - at[joints[parents[joints.index(name)]]]
        cosine = (found * bones).sum(axis=1) / np.linalg.norm(found, axis=1) / np.linalg.norm(bones, axis=1)
        assert cosine.min() > 1 - 1e-6, name


@matrix(("up", "front"), [("+y", "+z"), ("+z", "-x")], quick=[("+z", "-x")])
def test_joints_found_on_a_surface_become_bones(up, front, tmp_path):
    """The joints of the result are those of the shipped body, in the axes of the identity."""
    rig = moving_rig(3, fingers=True, up=up, front=front, arms=30.0)
    frames = LazyFrames.stored(np.tile(rig.mesh.vertices, (len(rig.root), 1, 1)))
    result = ClipResult(rig.mesh, frames, 24.0, "mime", Timer(), {"identity": {"up": up, "front": front}}, skeleton=rig)
    motion = _bone_motion(result, "x", None, tmp_path / "x.vrma")
    positions = rig.joint_positions() @ ROTATIONS[ORIENTATIONS.index((up, front))].T
    parents = bone_parents(motion.joints)
    for name, bones in limbs(motion).items():
        k = motion.joints.index(name)
        joint, parent = (rig.names.index(n) for n in (name, motion.joints[parents[k]]))
        # The fingers' bones and those of the limbs are in the axes of joints that are some degrees off.
        expected = positions[:, joint] - positions[:, parent]
        cosine = (expected * bones).sum(axis=1) / np.linalg.norm(expected, axis=1) / np.linalg.norm(bones, axis=1)
        assert np.degrees(np.arccos(cosine.min().clip(-1, 1))) < 5, name
    read = load_clip(result.save(tmp_path / "walk.vrma"))
    assert (len(read), read.fps) == (len(frames), 24.0)
    person = read.skeleton.person()
    shared = [name for name in motion.joints if name in person.joints]
    assert len(shared) == len(motion.joints) == 52
    found = person.rotation[:, [person.joints.index(name) for name in shared]]
    expected = ROTATIONS[ORIENTATIONS.index((up, front))] @ rig.rotation[:, [rig.names.index(n) for n in shared]]
    assert np.abs(found - expected).max() < 1e-4
    for options in ({"names": "mixamo"}, {"root_bone": True}, {"rest": "T"}):
        with pytest.raises(InputError, match="which has the bones of VRM; leave them out"):
            result.save_skinned(tmp_path / "walk.vrma", **options)
    result.save_skinned(tmp_path / "slow.vrma", fps=12.0)
    assert load_clip(tmp_path / "slow.vrma").fps == 12


def test_joints_that_vrm_requires_must_be_there(model, tmp_path):
    result = mimesh.animate(person(0), walk(faces=600), model)
    with pytest.raises(InputError, match=r"expected the bones that VRM requires, found none for Head, .*write a \.glb"):
        result.save(tmp_path / "walk.vrma")


@pytest.mark.slow
def test_several_clips_are_several_animations(tmp_path):
    path, rig, _ = vrm(tmp_path / "a.vrm")
    results = [mimesh.animate(path, vrma(tmp_path / f"{seed}.vrma", bone_positions(rig), seed)[0]) for seed in (1, 2)]
    mimesh.save_skinned(results, tmp_path / "all.vrma", animations=["walk", "run"])
    assert [entry["name"] for entry in open_document(tmp_path / "all.vrma").gltf["animations"]] == ["walk", "run"]


def test_a_neck_that_carries_the_arms_is_the_neck(model, tmp_path):
    """In 3ds Max Bipeds, the clavicles are below the neck."""
    hold = dict.fromkeys(("LeftShoulder", "RightShoulder", "Head"), "Neck")
    path = character(tmp_path / "a.glb", name=renamed("biped"), hold=hold, frames=1)
    result = mimesh.animate(path, walk(1, frames=3, faces=600), model)
    nodes = [node.get("name") for node in open_document(path).gltf["nodes"]]
    assert nodes[result.own.joints["Neck"]] == "Bip01 Neck"
    motion = _bone_motion(result, "walk", None, tmp_path / "a.vrma")
    assert {"spine", "chest", "upperChest", "neck", "head"} <= set(motion.bones)
    parents = dict(zip(motion.bones, (motion.bones[k] for k in motion.parents), strict=True))
    assert (parents["head"], parents["neck"], parents["leftShoulder"]) == ("neck", "upperChest", "upperChest")
    by_name = {name: motion.rotation[:, k] for k, name in enumerate(motion.bones)}
    neck, head = (result.own.node_matrices([nodes.index(name)])[:, 0, :3, :3] for name in ("Bip01 Neck", "Bip01 Head"))
    rest = result.own.source.rest.T_world_node
    for name, world in (("neck", neck), ("head", head)):
        since = world @ np.linalg.inv(rest[nodes.index(f"Bip01 {name.capitalize()}"), :3, :3])
        angle = Rotation.from_matrix(since).magnitude()
        np.testing.assert_allclose(Rotation.from_matrix(by_name[name]).magnitude(), angle, atol=1e-6)


@matrix("version", [0, 1], quick=[0])
def test_a_vrm_keeps_its_extensions(version, model, tmp_path):
    path, rig, _ = vrm(tmp_path / "a.vrm", version)
    drive, _, _ = vrma(tmp_path / "a.vrma", bone_positions(rig, "+z" if version else "-z"))
    mimesh.animate(path, drive).save_skinned(tmp_path / "b.glb")
    mimesh.transfer(path, person(3), model).save(tmp_path / "c.vrm")
    old = open_document(path).gltf
    for name in ("b.glb", "c.vrm"):
        new = open_document(tmp_path / name).gltf
        for key in ("extensions", "extensionsUsed", "materials", "meshes", "skins"):
            assert json.dumps(new[key]) == json.dumps(old[key]), key
        assert [node.get("name") for node in new["nodes"]] == [node.get("name") for node in old["nodes"]]


@matrix(
    ("named", "still", "copied"),
    [(True, False, False), (False, False, True), (True, True, True)],
    quick=[(True, False, False)],
    ids=["another skeleton", "the same skeleton", "a face alone"],
)
def test_targets_follow_those_of_their_name(named, still, copied, tmp_path):
    """The driving has other targets in another order, in other spellings."""
    path, _, _ = vrm(tmp_path / "a.vrm", targets=ARKIT)
    drive, _, _ = vrm(tmp_path / "b.vrm", targets=OTHERS, weights=WEIGHTS, named=named, still=still)
    result = mimesh.animate(path, drive, motion=mimesh.MotionOptions(ground=False))
    assert result.report.get("copied", False) is copied
    node = mesh_node(path)
    expected = np.stack([np.zeros(5), WEIGHTS[:, 2], WEIGHTS[:, 0]], axis=1)
    assert np.allclose(result.own.tracks[node, "weights"], expected, atol=1e-6)
    # The frames are those of the file with its morph targets.
    result.save_skinned(tmp_path / "c.glb")
    size = np.ptp(result.clip.mesh.vertices, axis=0).max()
    assert np.abs(load_clip(tmp_path / "c.glb").vertices - result.clip.vertices).max() < 1e-5 * size
    plain = mimesh.animate(
        path, vrm(tmp_path / "d.vrm", named=named, weights=None)[0], motion=mimesh.MotionOptions(ground=False)
    )
    assert np.abs(result.clip.vertices[2] - plain.clip.vertices[0]).max() > 1e-3


def test_expressions_move_the_targets_of_a_vrm(tmp_path):
    path, rig, _ = vrm(tmp_path / "a.vrm", targets=ARKIT)
    node = mesh_node(path)
    binds = {name: [{"node": node, "index": k, "weight": 0.5}] for k, name in enumerate(("aa", "blink", "mySmirk"))}
    expressions = {name: {"morphTargetBinds": rows} for name, rows in binds.items()}
    expressions["blink"]["isBinary"] = True
    expressions["happy"] = {"overrideMouth": "blend", "overrideBlink": "block", "morphTargetBinds": binds["mySmirk"]}
    path, rig, _ = vrm(tmp_path / "a.vrm", targets=ARKIT, expressions=expressions)
    weights = {
        "aa": np.array([0, 0.5, 1, 1, 0.4, 0.0]),
        "blink": np.array([0, 0.4, 0.6, 1, 1, 1.0]),
        "mySmirk": np.array([0, 0.2, 0.2, 0.2, 0, 0]),
        "happy": np.array([0, 0, 0, 0.25, 1, 0]),
        "angry": np.ones(6),
    }
    drive, _, _ = vrma(tmp_path / "a.vrma", bone_positions(rig), expressions=weights)
    track = mimesh.animate(path, drive, motion=mimesh.MotionOptions(ground=False)).own.tracks[node, "weights"]
    assert np.allclose(track[:, 0], [0, 0.25, 0.5, 0.375, 0, 0], atol=1e-6)
    assert np.allclose(track[:, 1], [0, 0, 0.5, 0, 0, 0.5], atol=1e-6)
    assert np.allclose(track[:, 2], [0, 0.1, 0.1, 0.225, 0.5, 0], atol=1e-6)


def test_an_animation_that_lacks_bones_is_refused(tmp_path):
    sample = Sample()
    times, turns = sample.accessor([0.0, 1.0]), sample.accessor([[0, 0, 0, 1], [0, 0, 0.6, 0.8]])
    sample.gltf |= {
        "nodes": [{"name": "hips"}],
        "animations": [
            {
                "samplers": [{"input": times, "output": turns}],
                "channels": [{"sampler": 0, "target": {"node": 0, "path": "rotation"}}],
            }
        ],
        "extensions": {"VRMC_vrm_animation": {"humanoid": {"humanBones": {"hips": {"node": 0}}}}},
    }
    with pytest.raises(InputError, match="expected hips and, left and right, thigh"):
        load_clip(sample.glb(tmp_path / "a.vrma"))


def test_a_rig_without_hands_is_no_vrm(tmp_path):
    """The T-pose, which needs hands, too, is not looked for before."""
    whole = figure()
    hands = [name for name in whole.names if any(part in name for part in ("Hand", "Finger", "Thumb"))]
    path = character(tmp_path / "stumps.glb", person=whole.without(*hands[::-1]))
    with pytest.raises(InputError, match=r"expected the bones that VRM requires, found none for .*LeftHand"):
        mimesh.rig(path).save(tmp_path / "out.vrm", author="someone", license="https://example.com/licence")
