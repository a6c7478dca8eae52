"""Motions, glTF files of joints without a mesh: the body's limb directions equal those of the file in every frame."""

import base64
import json

import numpy as np
import pytest
from foreign_names import renamed
from gltf_reference import binary_of, json_of
from gltf_samples import QUARTER, pack_glb
from people import person
from rigs import kept
from scipy.spatial.transform import Rotation

from mimesh.bodies import load_body
from mimesh.core import frame_buffer as paging
from mimesh.core.animated_rig import AnimatedRig, RigAnimation
from mimesh.core.errors import InputError
from mimesh.core.rig import Rig
from mimesh.io import load_clip, load_mesh
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.motion import bind_poses, gltf_joints, read_skeleton
from mimesh.io.gltf.scene import world_matrices
from mimesh.io.gltf.skinned import write_gltf_skinned
from mimesh.motions import load_motion, window
from mimesh.motions.motion import BONES, joint_tracks
from mimesh.motions.on_body import on_body
from mimesh.tools.inspect import inspect_file

ARMATURES = {
    "none": {},
    "z-up, centimetres": {"rotation": QUARTER, "scale": [0.01] * 3},
    "turned by a quarter": {"rotation": [0, 0.5**0.5, 0, 0.5**0.5], "translation": [3, 4, 5]},
}
QUATERNION_30_DEGREES = [0, np.sin(np.pi / 12), 0, np.cos(np.pi / 12)]
"""Rotation (xyzw) by 30 degrees about y."""

KNOWN = "25 of a person and 2 of fingers known"
"""Joints of the shipped body that are found by name."""


@pytest.fixture(scope="module")
def body():
    return load_body()


@pytest.fixture(scope="module")
def motion():
    return window(load_motion("jump"), 0.0, 0.4)


@pytest.fixture(scope="module")
def rigged(body, motion, tmp_path_factory):
    """Write a mesh on the body's skeleton, with random joint axes at rest, and its motion."""
    path = tmp_path_factory.mktemp("rigged") / "leap.glb"
    rest_rotation = Rotation.random(len(body.parents), 5).as_matrix()
    rotation, position = joint_tracks(body, motion)
    rig = Rig(rest_rotation, body.joints, body.weights[kept(1000)])
    skeleton = AnimatedRig(person(0), body.joint_names, body.parents, rig, rotation @ rest_rotation, position[:, 0])
    write_gltf_skinned([RigAnimation("leap", skeleton, motion.fps)], path)
    return path


def joints_only(rigged, path, modify=lambda gltf: None, skin=False):
    """Write the file without its mesh, and without its skin unless `skin`; `modify` changes the JSON."""
    gltf = json_of(rigged)
    for node in gltf["nodes"]:
        node.pop("mesh", None)
        node.pop("skin", None)
    del gltf["meshes"]
    if not skin:
        del gltf["skins"]
    modify(gltf)
    path.write_bytes(pack_glb(gltf, binary_of(rigged)))
    return path


def add_armature(gltf, **armature):
    """Add a node above the joints."""
    gltf["nodes"].append({"name": "Armature", **armature, "children": [joint_node(gltf, "Hips")]})
    gltf["scenes"][0]["nodes"] = [len(gltf["nodes"]) - 1]


def joint_node(gltf, name):
    return next(k for k, node in enumerate(gltf["nodes"]) if node.get("name") == name)


def add_channel(gltf, name, path, values):
    """Add a channel for one joint, with the key times of the others; its values get a buffer of their own."""
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


def play_on_body(path):
    return on_body(read_skeleton(open_document(path)), path).motion


def limbs(body, motion):
    """Unit vectors along all limb bones, (T, L, 3)."""
    _, position = joint_tracks(body, motion)
    bones = np.stack([position[:, body.joint(b)] - position[:, body.joint(a)] for a, b in BONES.items()], axis=1)
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def angle(a, b):
    """Largest angle between unit vectors, radians."""
    return 2 * np.arcsin(np.linalg.norm(a - b, axis=-1) / 2).max()


def hip_path(body, motion):
    """Positions of the hips relative to the first frame, (T, 3)."""
    position = joint_tracks(body, motion)[1][:, 0]
    return position - position[0]


@pytest.mark.parametrize(
    ("armature", "skin"), [("none", False), ("z-up, centimetres", True), ("turned by a quarter", False)]
)
def test_motion_gives_the_body_the_limb_directions_of_the_file(armature, skin, rigged, body, motion, tmp_path):
    path = joints_only(rigged, tmp_path / "a.glb", lambda gltf: add_armature(gltf, **ARMATURES[armature]), skin)
    played = play_on_body(path)
    assert (played.fps, len(played)) == (motion.fps, len(motion))
    assert angle(limbs(body, played), limbs(body, motion)) < 1e-5
    np.testing.assert_allclose(hip_path(body, played), hip_path(body, motion), atol=1e-5)


@pytest.mark.parametrize("heading", [0, 170])
def test_rest_pose_comes_from_inverse_bind_matrices_not_from_nodes(heading, rigged, body, motion, tmp_path):
    """Node transforms are those of another pose, below an armature that is not rotated by a right angle."""

    def modify(gltf):
        turned, bent = Rotation.from_euler("y", heading, True), Rotation.from_euler("xyz", [20, -15, 10], True)
        for channel in gltf["animations"][0]["channels"]:
            node = gltf["nodes"][channel["target"]["node"]]
            if channel["target"]["path"] == "rotation":
                rest = Rotation.from_quat(node["rotation"])
                rotated = turned * rest if node["name"] == "Hips" else rest * bent
                node["rotation"] = rotated.as_quat().tolist()
        add_armature(gltf, rotation=QUATERNION_30_DEGREES)

    played = play_on_body(joints_only(rigged, tmp_path / "a.glb", modify, skin=True))
    rotation = Rotation.from_quat(QUATERNION_30_DEGREES).as_matrix()
    assert angle(limbs(body, played), limbs(body, motion) @ rotation.T) < 1e-5
    np.testing.assert_allclose(hip_path(body, played), hip_path(body, motion) @ rotation.T, atol=1e-5)


def test_rest_pose_is_that_of_the_file_where_it_is_the_bind_pose(tmp_path):
    """Bound z up, below a node that is turned about the vertical, as the roots of 3ds Max's bipeds are."""
    upright = Rotation.from_quat(QUARTER)
    above = (upright * Rotation.from_euler("z", 90, True)).as_quat().tolist()
    nodes = [
        {"rotation": above, "children": [1]},
        {"translation": [0, 0, 1], "children": [2]},
        {"translation": [0, 1, 0]},
    ]
    T_world_bind = np.eye(4)
    T_world_bind[:3, :3] = upright.as_matrix()
    gltf = {"asset": {"version": "2.0"}, "nodes": nodes, "skins": [{"joints": [1, 2], "inverseBindMatrices": 0}]}
    path = tmp_path / "biped.gltf"
    path.write_text(json.dumps(gltf | {"scenes": [{"nodes": [0]}]} | _matrices(np.eye(4)[None].repeat(2, axis=0))))
    world = world_matrices(open_document(path))
    path.write_text(
        json.dumps(gltf | {"scenes": [{"nodes": [0]}]} | _matrices(np.linalg.inv(world[1:]) @ T_world_bind))
    )
    np.testing.assert_allclose(next(bind_poses(open_document(path))), world, atol=1e-6)


def _matrices(matrices):
    """The accessor 0 of a glTF file with matrices (N, 4, 4)."""
    content = matrices.transpose(0, 2, 1).astype("<f4").tobytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(content).decode()
    return {
        "buffers": [{"uri": uri, "byteLength": len(content)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(content)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": len(matrices), "type": "MAT4"}],
    }


def test_motion_joints_are_found_under_other_names_and_among_other_nodes(rigged, body, motion, tmp_path):
    """There are several roots (an animated camera), and between two joints a node that is not a joint."""

    def modify(gltf):
        gltf["nodes"].append({"name": "Eye"})
        gltf["scenes"][0]["nodes"].append(len(gltf["nodes"]) - 1)
        add_channel(gltf, "Eye", "translation", np.random.default_rng(1).normal(size=(len(motion), 3)))
        elbow = joint_node(gltf, "LeftForeArm")
        holder = gltf["nodes"][joint_node(gltf, "LeftArm")]
        gltf["nodes"].append({"name": "Twist", "children": [elbow]})
        holder["children"] = [len(gltf["nodes"]) - 1 if child == elbow else child for child in holder["children"]]
        for node in gltf["nodes"]:
            node["name"] = renamed("mixamo")(node["name"]) if node["name"] in body.joint_names else node["name"]

    path = joints_only(rigged, tmp_path / "a.glb", modify)
    assert angle(limbs(body, play_on_body(path)), limbs(body, motion)) < 1e-5
    assert gltf_joints(open_document(path)) == len(body.parents) + 2
    source = read_skeleton(open_document(path))
    assert (source.joint_names[0], source.parents.count(-1)) == ("world", 1)


def test_nodes_that_assimp_writes_above_joints_are_no_joints(rigged, tmp_path):
    """Each joint's translation and rotation are in a node of their own, and its keys are theirs."""

    def split(gltf):
        skeleton = {joint for channel in gltf["animations"][0]["channels"] for joint in [channel["target"]["node"]]}
        lists = [*gltf["scenes"], *gltf["nodes"]]
        for joint in sorted(skeleton):
            node, start = gltf["nodes"][joint], len(gltf["nodes"])
            holder = next(h for h in lists if joint in h.get("children" if "nodes" not in h else "nodes", ()))
            below = holder["nodes" if "nodes" in holder else "children"]
            below[below.index(joint)] = start
            for k, (kind, path, child) in enumerate(
                [("Translation", "translation", start + 1), ("PreRotation", "rotation", joint)]
            ):
                value = {path: node.pop(path)} if path in node else {}
                pivot = {"name": f"{node['name']}_$AssimpFbx$_{kind}", "children": [child]}
                gltf["nodes"].append(pivot | value)
                for channel in gltf["animations"][0]["channels"]:
                    if channel["target"] == {"node": joint, "path": path}:
                        channel["target"]["node"] = start + k
            lists += gltf["nodes"][start:]

    right = read_skeleton(open_document(joints_only(rigged, tmp_path / "a.glb")))
    found = read_skeleton(open_document(joints_only(rigged, tmp_path / "b.glb", split)))
    assert sorted(found.joint_names) == sorted(right.joint_names)
    order = [found.joint_names.index(name) for name in right.joint_names]
    for a, b in zip(found.world(), right.world(), strict=True):
        np.testing.assert_allclose(a[:, order], b, atol=1e-6)
    played = play_on_body(tmp_path / "b.glb")
    np.testing.assert_allclose(played.rotmat, play_on_body(tmp_path / "a.glb").rotmat, atol=1e-6)


def test_motion_ignores_animated_scales_and_mirrored_joints(rigged, body, motion, tmp_path):
    def modify(gltf):
        add_channel(gltf, "Hips", "scale", np.linspace(0, 2, len(motion))[:, None] * np.ones(3))
        add_armature(gltf, scale=[-2, -2, -2], rotation=[1, 0, 0, 0])

    played = play_on_body(joints_only(rigged, tmp_path / "a.glb", modify))
    assert np.isfinite(played.rotmat).all()
    np.testing.assert_allclose(np.linalg.det(played.rotmat), 1)
    lengths = np.linalg.norm(hip_path(body, played), axis=1)
    np.testing.assert_allclose(lengths, np.linalg.norm(hip_path(body, motion), axis=1), atol=1e-5)


def test_motion_file_loads_as_a_clip_of_the_shipped_body(rigged, body, motion, tmp_path, monkeypatch):
    path = joints_only(rigged, tmp_path / "leap.glb")
    progress_calls: list[tuple[int, int]] = []
    clip = load_clip(path, progress=lambda done, count: progress_calls.append((done, count)))
    assert (clip.mesh.name, clip.fps, len(clip)) == ("leap", 30.0, len(motion))
    assert progress_calls == [(k + 1, len(motion)) for k in range(len(motion))]
    assert clip.vertices.shape[1] == len(body.vertices)
    np.testing.assert_array_equal(load_mesh(path).vertices.astype(np.float32), clip.vertices[0])
    np.testing.assert_array_equal(clip.mesh.vertices.astype(np.float32), clip.vertices[0])
    monkeypatch.setattr(paging, "LARGE", 2**20)
    twice = load_clip(path, fps=60.0)
    assert isinstance(twice.vertices, np.memmap), "long motions are stored on disk"
    assert twice.vertices.dtype == np.float32
    assert (twice.fps, len(twice)) == (60.0, 2 * len(motion) - 1)
    np.testing.assert_allclose(np.ptp(twice.vertices[::2] - clip.vertices, axis=(0, 1)), 0.0, atol=1e-5)


@pytest.mark.slow
def test_motion_is_selected_by_animation_name(rigged, tmp_path):
    def modify(gltf):
        first = gltf["animations"][0]
        still = {"name": "Rig|Lean", "samplers": first["samplers"], "channels": first["channels"][:3]}
        gltf["animations"] = [{**first, "name": "Rig|Leap"}, still]

    path = joints_only(rigged, tmp_path / "a.glb", modify)
    leap, lean = load_clip(path, animation="Leap"), load_clip(path, animation="Lean")
    np.testing.assert_array_equal(leap.vertices, load_clip(path).vertices)
    assert np.abs(leap.vertices - lean.vertices).max() > 0.1
    with pytest.raises(InputError, match=r"one of its animations \(Rig\|Leap, Rig\|Lean\), found 'Nap'"):
        load_clip(path, animation="Nap")
    facts = inspect_file(path)
    assert facts.animations == ("Rig|Leap", "Rig|Lean")
    assert facts.details[0] == ("motion", f"31 joints, {KNOWN}, played on the shipped body, which these facts describe")
    assert ("animation 1", f"Rig|Lean, {(len(leap) - 1) / 30:.2f} s") in facts.details


def test_motion_of_other_joints_than_a_persons_is_refused(rigged, tmp_path):
    def rename(gltf):
        for node in gltf["nodes"]:
            node["name"] = node["name"].replace("Left", "Port")

    fox = joints_only(rigged, tmp_path / "fox.glb", rename)
    with pytest.raises(InputError, match=r"fox\.glb: expected hips .* found none for LeftUpLeg, .* among Hips, "):
        load_clip(fox)
    still = joints_only(rigged, tmp_path / "still.glb", lambda gltf: gltf.pop("animations"))
    with pytest.raises(InputError, match="expected a scene with triangles"):
        load_mesh(still)
    joints_only(rigged, tmp_path / "a1.glb")
    with pytest.raises(InputError, match=r"a1\.glb: expected a mesh as a frame of a clip, found joints that move"):
        load_clip(tmp_path)

    def shrink(gltf):
        for node in gltf["nodes"]:
            node["translation"] = [0, 0, 0]

    with pytest.raises(InputError, match=r"b\.glb: expected limbs with a length at rest, found none for LeftUpLeg, "):
        load_clip(joints_only(rigged, tmp_path / "b.glb", shrink))


def test_motion_with_nan_is_refused(rigged, motion, tmp_path):
    def modify(gltf):
        values = np.zeros((len(motion), 3))
        values[4, 1] = np.nan
        add_channel(gltf, "LeftLeg", "translation", values)

    path = joints_only(rigged, tmp_path / "a.glb", modify)
    with pytest.raises(InputError, match=r"found NaN or infinity in frame [34]"):
        load_clip(path)
