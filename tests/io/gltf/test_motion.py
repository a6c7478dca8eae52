"""glTF files of joints without a mesh: the body's limbs point as the joints that were written, frame by frame."""

import base64
import json
import struct

import numpy as np
import pytest
from foreign_names import renamed
from gltf_samples import QUARTER, pack_glb
from people import person
from rigs import kept
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.core import frame_buffer as paging
from mimesh.core.animated_rig import AnimatedRig
from mimesh.core.errors import InputError
from mimesh.core.rig import Rig
from mimesh.io import load_clip, load_mesh, save_skinned
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.motion import gltf_joints, read_skeleton
from mimesh.io.gltf.skin import read_skin
from mimesh.motions import load_motion, window
from mimesh.motions.motion import joint_tracks
from mimesh.motions.on_body import on_body
from mimesh.motions.retarget import BONES
from mimesh.tools.inspect import inspect_file

ARMATURES = {
    "none": {},
    "z-up, centimetres": {"rotation": QUARTER, "scale": [0.01] * 3},
    "turned by a quarter": {"rotation": [0, 0.5**0.5, 0, 0.5**0.5], "translation": [3, 4, 5]},
}
TURN = [0, np.sin(np.pi / 12), 0, np.cos(np.pi / 12)]
"""By 30 degrees about y."""


@pytest.fixture(scope="module")
def body():
    return load_body()


@pytest.fixture(scope="module")
def motion():
    return window(load_motion("jump"), 0.0, 0.7)


@pytest.fixture(scope="module")
def rigged(body, motion, tmp_path_factory):
    """A mesh on the body's skeleton, whose joints lie anyhow at rest, and its motion."""
    path = tmp_path_factory.mktemp("rigged") / "leap.glb"
    anyhow = Rotation.random(len(body.parents), 5).as_matrix()
    rotation, place = joint_tracks(body, motion)
    rig = Rig(anyhow, body.joints, body.weights[kept(1000)])
    skeleton = AnimatedRig(person(0), body.joint_names, body.parents, rig, rotation @ anyhow, place[:, 0])
    save_skinned(skeleton, motion.fps, path)
    return path


def stripped(rigged, path, change=lambda gltf: None, skin=False):
    """The file without its mesh, and without its skin unless that is wanted; `change` alters the rest."""
    content = rigged.read_bytes()
    size = struct.unpack_from("<I", content, 12)[0]
    gltf = json.loads(content[20 : 20 + size])
    for node in gltf["nodes"]:
        node.pop("mesh", None)
        node.pop("skin", None)
    del gltf["meshes"]
    if not skin:
        del gltf["skins"]
    change(gltf)
    path.write_bytes(pack_glb(gltf, content[28 + size :]))
    return path


def hang(gltf, **armature):
    """Put the joints below another node."""
    gltf["nodes"].append({"name": "Armature", **armature, "children": [joint_node(gltf, "Hips")]})
    gltf["scenes"][0]["nodes"] = [len(gltf["nodes"]) - 1]


def joint_node(gltf, name):
    return next(k for k, node in enumerate(gltf["nodes"]) if node.get("name") == name)


def key(gltf, name, path, values):
    """Another track of one joint, at the times of the others; its values lie in a buffer of their own."""
    content, animation = np.asarray(values, "<f4").tobytes(), gltf["animations"][0]
    uri = "data:application/octet-stream;base64," + base64.b64encode(content).decode()
    gltf["buffers"].append({"byteLength": len(content), "uri": uri})
    gltf["bufferViews"].append({"buffer": len(gltf["buffers"]) - 1, "byteLength": len(content)})
    view = {"bufferView": len(gltf["bufferViews"]) - 1, "componentType": 5126}
    gltf["accessors"].append({**view, "count": len(values), "type": "VEC3"})
    times, output = animation["samplers"][0]["input"], len(gltf["accessors"]) - 1
    animation["samplers"].append({"input": times, "output": output})
    target = {"node": joint_node(gltf, name), "path": path}
    animation["channels"] = [channel for channel in animation["channels"] if channel["target"] != target]
    animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})


def on_ours(path):
    return on_body(read_skeleton(open_document(path)), path)


def limbs(body, motion):
    """Unit vectors along all limb bones, (T, L, 3)."""
    _, place = joint_tracks(body, motion)
    bones = np.stack([place[:, body.joint(b)] - place[:, body.joint(a)] for a, b in BONES.items()], axis=1)
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def angle(one, two):
    """Largest angle between unit vectors, radians."""
    return 2 * np.arcsin(np.linalg.norm(one - two, axis=-1) / 2).max()


def way(body, motion):
    """The path of the hips from where it begins."""
    place = joint_tracks(body, motion)[1][:, 0]
    return place - place[0]


@pytest.mark.parametrize("skin", [False, True], ids=["nodes", "skin"])
@pytest.mark.parametrize("armature", ARMATURES)
def test_limbs_point_as_the_joints_that_were_written(armature, skin, rigged, body, motion, tmp_path):
    path = stripped(rigged, tmp_path / "a.glb", lambda gltf: hang(gltf, **ARMATURES[armature]), skin)
    got = on_ours(path)
    assert (got.fps, len(got)) == (motion.fps, len(motion))
    assert angle(limbs(body, got), limbs(body, motion)) < 1e-5
    np.testing.assert_allclose(way(body, got), way(body, motion), atol=1e-5)


@pytest.mark.parametrize("heading", [0, 170])
def test_a_skin_knows_the_rest_pose_whatever_the_nodes_say(heading, rigged, body, motion, tmp_path):
    """Nodes that stand in some frame of another motion, below an armature that is turned by no right angle."""

    def change(gltf):
        for channel in gltf["animations"][0]["channels"]:
            node = gltf["nodes"][channel["target"]["node"]]
            if channel["target"]["path"] == "rotation":
                turn, own = (
                    Rotation.from_euler("xyz", [20, -15, 10], degrees=True),
                    Rotation.from_quat(node["rotation"]),
                )
                turned = Rotation.from_euler("y", heading, degrees=True) * own if node["name"] == "Hips" else own * turn
                node["rotation"] = turned.as_quat().tolist()
        hang(gltf, rotation=TURN)

    got = on_ours(stripped(rigged, tmp_path / "a.glb", change, skin=True))
    turn = Rotation.from_quat(TURN).as_matrix()
    assert angle(limbs(body, got), limbs(body, motion) @ turn.T) < 1e-5
    np.testing.assert_allclose(way(body, got), way(body, motion) @ turn.T, atol=1e-5)


def test_joints_come_back_under_other_names_and_beside_other_nodes(rigged, body, motion, tmp_path):
    """Several roots (a camera that moves), and a node between two joints that neither moves nor is listed."""

    def change(gltf):
        gltf["nodes"].append({"name": "Eye"})
        gltf["scenes"][0]["nodes"].append(len(gltf["nodes"]) - 1)
        key(gltf, "Eye", "translation", np.random.default_rng(1).normal(size=(len(motion), 3)))
        elbow = joint_node(gltf, "LeftForeArm")
        holder = gltf["nodes"][joint_node(gltf, "LeftArm")]
        gltf["nodes"].append({"name": "Twist", "children": [elbow]})
        holder["children"] = [len(gltf["nodes"]) - 1 if child == elbow else child for child in holder["children"]]
        for node in gltf["nodes"]:
            node["name"] = renamed("mixamo")(node["name"]) if node["name"] in body.joint_names else node["name"]

    path = stripped(rigged, tmp_path / "a.glb", change)
    assert angle(limbs(body, on_ours(path)), limbs(body, motion)) < 1e-5
    assert gltf_joints(open_document(path)) == len(body.parents) + 2
    source = read_skeleton(open_document(path))
    assert (source.joint_names[0], source.parents.count(-1)) == ("world", 1)


def test_scales_are_not_played_and_mirrored_joints_are_no_matter(rigged, body, motion, tmp_path):
    def change(gltf):
        key(gltf, "Hips", "scale", np.linspace(0, 2, len(motion))[:, None] * np.ones(3))
        hang(gltf, scale=[-2, -2, -2], rotation=[1, 0, 0, 0])

    got = on_ours(stripped(rigged, tmp_path / "a.glb", change))
    assert np.isfinite(got.rotmat).all()
    np.testing.assert_allclose(np.linalg.det(got.rotmat), 1)
    lengths = np.linalg.norm(way(body, got), axis=1)
    np.testing.assert_allclose(lengths, np.linalg.norm(way(body, motion), axis=1), atol=1e-5)


def test_a_file_is_the_clip_of_its_motion(rigged, body, motion, tmp_path):
    path = stripped(rigged, tmp_path / "leap.glb")
    told: list[tuple[int, int]] = []
    clip = load_clip(path, progress=lambda done, count: told.append((done, count)))
    assert (clip.mesh.name, clip.fps, len(clip)) == ("leap", 30.0, len(motion))
    assert told == [(k + 1, len(motion)) for k in range(len(motion))]
    assert clip.vertices.shape[1] == len(body.vertices)
    np.testing.assert_array_equal(load_mesh(path).vertices.astype(np.float32), clip.vertices[0])
    np.testing.assert_array_equal(clip.mesh.vertices.astype(np.float32), clip.vertices[0])
    twice = load_clip(path, fps=60.0)
    assert (twice.fps, len(twice)) == (60.0, 2 * len(motion) - 1)
    np.testing.assert_allclose(np.ptp(twice.vertices[::2] - clip.vertices, axis=(0, 1)), 0.0, atol=1e-5)


def test_long_animations_lie_on_disk(rigged, tmp_path, monkeypatch):
    monkeypatch.setattr(paging, "LARGE", 2**20)
    clip = load_clip(stripped(rigged, tmp_path / "a.glb"))
    assert isinstance(clip.vertices, np.memmap)
    assert clip.vertices.dtype == np.float32


def test_one_of_several_animations_is_chosen_by_name(rigged, tmp_path):
    def change(gltf):
        first = gltf["animations"][0]
        still = {"name": "Rig|Lean", "samplers": first["samplers"], "channels": first["channels"][:3]}
        gltf["animations"] = [{**first, "name": "Rig|Leap"}, still]

    path = stripped(rigged, tmp_path / "a.glb", change)
    leap, lean = load_clip(path, animation="Leap"), load_clip(path, animation="Lean")
    np.testing.assert_array_equal(leap.vertices, load_clip(path).vertices)
    assert np.abs(leap.vertices - lean.vertices).max() > 0.1
    with pytest.raises(InputError, match=r"one of its animations \(Rig\|Leap, Rig\|Lean\), found 'Nap'"):
        load_clip(path, animation="Nap")
    facts = inspect_file(path)
    assert facts.animations == ("Rig|Leap", "Rig|Lean")
    assert facts.details[0] == ("motion", "31 joints, played on the shipped body, which these facts describe")
    assert ("animation", "Rig|Lean, 0.67 s") in facts.details


def test_what_is_no_motion_of_a_person_is_refused(rigged, tmp_path):
    def rename(gltf):
        for node in gltf["nodes"]:
            node["name"] = node["name"].replace("Left", "Port")

    fox = stripped(rigged, tmp_path / "fox.glb", rename)
    with pytest.raises(InputError, match=r"fox\.glb: expected hips .* found none for LeftUpLeg, .* among Hips, "):
        load_clip(fox)
    still = stripped(rigged, tmp_path / "still.glb", lambda gltf: gltf.pop("animations"))
    with pytest.raises(InputError, match="expected a scene with triangles"):
        load_mesh(still)
    with pytest.raises(InputError, match="expected a rigged mesh"):
        read_skin(stripped(rigged, tmp_path / "leap.glb"))
    stripped(rigged, tmp_path / "a1.glb")
    with pytest.raises(InputError, match=r"a1\.glb: expected a mesh as a frame of a clip, found joints that move"):
        load_clip(tmp_path)


def test_limbs_without_a_length_are_refused(rigged, tmp_path):
    def change(gltf):
        for node in gltf["nodes"]:
            node["translation"] = [0, 0, 0]

    with pytest.raises(InputError, match=r"a\.glb: expected limbs with a length at rest, found none for LeftUpLeg, "):
        load_clip(stripped(rigged, tmp_path / "a.glb", change))


def test_numbers_that_are_none_are_refused(rigged, motion, tmp_path):
    def change(gltf):
        values = np.zeros((len(motion), 3))
        values[4, 1] = np.nan
        key(gltf, "LeftLeg", "translation", values)

    path = stripped(rigged, tmp_path / "a.glb", change)
    with pytest.raises(InputError, match=r"found NaN or infinity in frame [34]"):
        load_clip(path)
