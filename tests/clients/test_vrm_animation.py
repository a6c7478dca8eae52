"""three-vrm and three-vrm-animation on VRM animations and on VRM characters that we write."""

import json
import subprocess

import numpy as np
import pytest
import rigs
from client_programs import three, three_vrm_animation, validator
from people import person
from scipy.spatial.transform import Rotation
from vrm_files import bone_positions, vrm, vrma

import mimesh
from mimesh.io.gltf.document import open_document

pytestmark = pytest.mark.client
FRAMES = (0, 3, 7, 11)
TARGETS = ("jawOpen", "Blink_L", "Blink_R", "smirk", "cheek")


def play(avatar, animation):
    times = [str(t / 30) for t in FRAMES]
    answer = subprocess.run([*three_vrm_animation(), avatar, animation, *times], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    return json.loads(answer.stdout)


def expressions(version, node):
    """Expressions of VRM 0.x or 1.0 that move common targets, one without intermediate values."""
    if version == 0:
        rows = {"A": ("a", [(0, 50)]), "B": ("blink", [(1, 100), (2, 100)]), "J": ("joy", [(0, 25), (3, 100)])}
        bound = {
            name: {"presetName": preset, "binds": [{"mesh": 0, "index": k, "weight": w} for k, w in binds]}
            for name, (preset, binds) in rows.items()
        }
        bound["B"]["isBinary"] = True
        return bound
    rows = {"aa": [(0, 0.5)], "blink": [(1, 1), (2, 1)], "happy": [(0, 0.25), (3, 1)], "mySmirk": [(3, 0.5)]}
    bound = {
        name: {"morphTargetBinds": [{"node": node, "index": k, "weight": w} for k, w in binds]}
        for name, binds in rows.items()
    }
    bound["blink"]["isBinary"] = True
    bound["happy"] |= {"overrideMouth": "blend", "overrideBlink": "none"}
    return bound


@pytest.fixture(params=[0, 1])
def moved(request, tmp_path):
    """A VRM with morph targets that a VRM animation moves, body and face: its path, animation, result and bones."""
    version = request.param
    path, rig, _ = vrm(tmp_path / "a.vrm", version, TARGETS)
    node = next(number for number, entry in enumerate(open_document(path).gltf["nodes"]) if "mesh" in entry)
    path, rig, nodes = vrm(tmp_path / "a.vrm", version, TARGETS, expressions(version, node))
    rng = np.random.default_rng(0)
    weights = {name: rng.random(12) for name in ("aa", "blink", "happy", "mySmirk")}
    rest = bone_positions(rig, "+z" if version else "-z")
    drive, _, _ = vrma(tmp_path / "drive.vrma", rest, frames=12, expressions=weights)
    as_it_is = mimesh.MotionOptions(ground=False, contacts=False)
    return path, drive, mimesh.animate(path, drive, motion=as_it_is), nodes, node


def check_bones(played, result, nodes):
    """Compare the bones that a client shows with ours; rotations to 1e-3."""
    assert played["warnings"] == []
    size = np.ptp(result.clip.mesh.vertices, axis=0).max()
    world = {bone: result.own.node_matrices([node])[:, 0] for bone, node in nodes.items()}
    start = np.array(played["frames"][0]["hips"]) - world["hips"][0, :3, 3]
    for t, frame in zip(FRAMES, played["frames"], strict=True):
        assert frame["bones"].keys() == nodes.keys()
        for bone, quaternion in frame["bones"].items():
            ours = Rotation.from_matrix(world[bone][t, :3, :3])
            assert (ours.inv() * Rotation.from_quat(quaternion)).magnitude() < 1e-3, bone
        assert np.abs(frame["hips"] - start - world["hips"][t, :3, 3]).max() < 1e-4 * size
    return start


def test_an_animation_of_others_is_played_as_we_read_it(moved):
    """The first frame of our result stands where the identity stood; the client leaves the hips where they are."""
    path, drive, result, nodes, node = moved
    played = play(path, drive)
    check_bones(played, result, nodes)
    for t, frame in zip(FRAMES, played["frames"], strict=True):
        assert np.abs(np.array(frame["weights"][0]) - result.own.tracks[node, "weights"][t]).max() < 1e-3


def test_a_written_animation_moves_the_bones_as_the_result(moved, tmp_path):
    path, _, result, nodes, _ = moved
    start = check_bones(play(path, result.save(tmp_path / "b.vrma")), result, nodes)
    assert np.abs(start).max() < 1e-5


def test_a_written_vrm_is_a_vrm_that_moves(moved, tmp_path):
    """A .glb with the extensions of VRM and an animation: three-vrm finds the humanoid, three.js plays it."""
    _, _, result, nodes, node = moved
    result.save_skinned(tmp_path / "b.glb")
    played = play(tmp_path / "b.glb", "-")
    assert np.abs(check_bones(played, result, nodes)).max() < 1e-5
    for t, frame in zip(FRAMES, played["frames"], strict=True):
        assert np.abs(np.array(frame["weights"][0]) - result.own.tracks[node, "weights"][t]).max() < 1e-4


def test_an_animation_of_another_character_plays_on_a_vrm(tmp_path):
    """Of a character with other names, an A-pose and random axes: limbs of the VRM point where the character's do."""
    from rigs import character

    avatar, rig, nodes = vrm(tmp_path / "a.vrm")
    hero = character(tmp_path / "hero.glb", faces=600)
    drive, _, _ = vrma(tmp_path / "drive.vrma", bone_positions(rig), frames=12)
    result = mimesh.animate(hero, drive, motion=mimesh.MotionOptions(ground=False))
    played = play(avatar, result.save(tmp_path / "hero.vrma"))
    assert played["warnings"] == []
    joints = dict(zip(rig.names, rig.rig.joints, strict=True))
    rest = {bone: Rotation.from_matrix(open_rotation(avatar, node)) for bone, node in nodes.items()}
    pairs = {
        (f"{side}{a}", f"{side}{b}"): (f"{side.capitalize()}{c}", f"{side.capitalize()}{d}")
        for side in ("left", "right")
        for a, b, c, d in (
            ("UpperArm", "LowerArm", "Arm", "ForeArm"),
            ("LowerArm", "Hand", "ForeArm", "Hand"),
            ("UpperLeg", "LowerLeg", "UpLeg", "Leg"),
            ("LowerLeg", "Foot", "Leg", "Foot"),
        )
    }
    for (bone, end), (joint, tail) in pairs.items():
        world = result.own.node_matrices([result.own.joints[name] for name in (joint, tail)])[..., :3, 3]
        for t, frame in zip(FRAMES, played["frames"], strict=True):
            turn = Rotation.from_quat(frame["bones"][bone]) * rest[bone].inv()
            found, wanted = turn.apply(joints[end] - joints[bone]), world[t, 1] - world[t, 0]
            cosine = found @ wanted / np.linalg.norm(found) / np.linalg.norm(wanted)
            # The legs of the avatar are up to 5 degrees off the T-pose, and the client copies rotations.
            assert np.degrees(np.arccos(min(cosine, 1))) < (1 if "Arm" in bone else 6), bone


def open_rotation(path, node):
    from mimesh.io.gltf.scene import local_matrices, world_matrices

    document = open_document(path)
    return world_matrices(document, local_matrices(document))[node, :3, :3]


def test_bones_that_hang_elsewhere_in_the_file_are_turned_right_in_the_vrm(tmp_path):
    """Of a Biped, whose thighs hang on the spine and arms on the neck: the client turns bones by VRM's hierarchy."""
    hold = dict.fromkeys(("LeftUpLeg", "RightUpLeg"), "LowerBack")
    hold |= dict.fromkeys(("LeftShoulder", "RightShoulder"), "Neck")
    own, _, _ = rigs.of_kind(tmp_path / "own.glb", "A-pose", moving=False, hold=hold)
    path = mimesh.rig(own).save(tmp_path / "own.vrm", author="A", license="https://example.org/licence")
    drive, _, _ = vrma(tmp_path / "drive.vrma", bone_positions(vrm(tmp_path / "a.vrm")[1]), frames=12)
    result = mimesh.animate(path, drive, motion=mimesh.MotionOptions(ground=False))
    bones = open_document(path).gltf["extensions"]["VRMC_vrm"]["humanoid"]["humanBones"]
    nodes = {bone: entry["node"] for bone, entry in bones.items()}
    check_bones(play(path, result.save(tmp_path / "b.vrma")), result, nodes)
    issues = json.loads(subprocess.run([*validator(), path], capture_output=True, text=True, check=True).stdout)
    assert issues["issues"]["numErrors"] == 0


def test_written_animations_are_valid(moved, tmp_path):
    _, _, result, _, _ = moved
    result.save(tmp_path / "b.vrma")
    (tmp_path / "b.vrma").rename(tmp_path / "b.glb")
    answer = subprocess.run([*validator(), str(tmp_path / "b.glb")], capture_output=True, text=True, check=True)
    issues = json.loads(answer.stdout)["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"][:5]


def test_a_rigged_character_is_a_vrm_in_three_vrm(tmp_path):
    """Both meshes without joints and files with bones of their own: the bones are found, and a raised arm is raised."""
    own, _, _ = rigs.of_kind(tmp_path / "own.glb", "A-pose", faces=2000)
    for name, mesh in (("bare", person(0)), ("own", own)):
        path = mimesh.rig(mesh).save(tmp_path / f"{name}.vrm", author="A", license="https://example.org/licence")
        answer = subprocess.run([*three(), path], capture_output=True, text=True, check=True)
        played = json.loads(answer.stdout)
        assert played["warnings"] == []
        assert {"hips", "spine", "head", "leftHand", "rightFoot"} <= set(played["vrm"]["bones"])
        before, after = played["vrm"]["before"], played["vrm"]["after"]
        assert after[1] > before[1] + 0.3
        issues = json.loads(subprocess.run([*validator(), path], capture_output=True, text=True, check=True).stdout)
        assert issues["issues"]["numErrors"] == 0
