"""Written files in the layouts of engines, read again: what docs/characters.md says of them holds in the file itself.

Unity, Unreal and Godot are not run here; the rules are those of their documentation.
"""

import copy
import dataclasses

import numpy as np
import pytest
from engine_rigs import ROOTS, expected_parents, moving_rig, posed
from matrix import matrix
from people import person, walk

from mimesh.bodies.engine_names import SCHEMES
from mimesh.bodies.engine_rig import engine_rig
from mimesh.core.animated_rig import RigAnimation
from mimesh.core.errors import InputError
from mimesh.core.options import MotionOptions
from mimesh.io import load_mesh
from mimesh.io.gltf.animation import read_channels
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.read import read_rest
from mimesh.io.gltf.skinned import write_gltf_skinned
from mimesh.pipeline import animate

FPS = 30.0
LAYOUTS = [(names, rest != "file", rest) for names in SCHEMES for rest in ("file", "T", "A")]


def written(path, names, root_bone, rest="file", fingers=True):
    rig = engine_rig(moving_rig(4, fingers, arms=10.0), names, root_bone, rest)
    write_gltf_skinned([RigAnimation("a", rig, FPS)], path)
    return rig, open_document(path)


def parents_of(gltf):
    """Node -> parent, by name."""
    nodes = gltf["nodes"]
    return {nodes[child]["name"]: node["name"] for node in nodes for child in node.get("children", [])}


def frame_of(document, t):
    """The file's vertices in frame t: read at rest after the values at its time were written into the joint nodes."""
    gltf = copy.deepcopy(document.gltf)
    for channel in read_channels(document, 0):
        gltf["nodes"][channel.node][channel.path] = channel.sample(np.array([t / FPS]))[0].tolist()
    return read_rest(dataclasses.replace(document, gltf=gltf))[0].vertices


@matrix(("names", "root_bone", "rest"), LAYOUTS, quick=[*LAYOUTS[::4], ("vrm", True, "T")])
def test_a_file_has_the_frames_names_and_parents_of_the_rig(names, root_bone, rest, tmp_path):
    rig, document = written(tmp_path / "a.glb", names, root_bone, rest)
    size = np.ptp(rig.mesh.vertices, axis=0).max()
    assert np.abs(load_mesh(tmp_path / "a.glb").vertices - rig.mesh.vertices).max() < 1e-5 * size
    for t in (0, 3):
        assert np.abs(frame_of(document, t) - posed(rig, t)).max() < 1e-5 * size
    nodes, joints = document.gltf["nodes"], document.gltf["skins"][0]["joints"]
    if names != "own":
        found, wanted = parents_of(document.gltf), expected_parents(names, fingers=True)
        wanted = {bone: above for bone, above in wanted.items() if root_bone or above != ROOTS[names]}
        assert {name: found.get(name) for name in wanted} == wanted
        for joint in joints if rest == "T" else ():
            # Godot's profile wants no transform on the node of the skeleton, VRM 0.x bones without rotations.
            assert np.allclose(nodes[joint].get("rotation", [0, 0, 0, 1]), [0, 0, 0, 1], atol=1e-6)
        if root_bone:
            assert found[SCHEMES[names].bones["Hips"]] == nodes[joints[0]]["name"] == ROOTS[names]
    everywhere = [node["name"] for node in nodes]
    assert all(everywhere.count(nodes[joint]["name"]) == 1 for joint in joints)
    # One root of the skeleton, which is at the top of the scene and not turned or scaled by any node above it.
    assert joints[0] in document.gltf["scenes"][0]["nodes"]
    assert not any("scale" in node or "matrix" in node for node in nodes)
    if names == "vrm":  # extra bones without weights are left out
        assert not {"LThumb", "LeftHandFinger1", "RThumb", "RightHandFinger1"} & set(rig.names)
        assert {"LeftFingerBase", "RightFingerBase"} <= set(rig.names)


def test_only_bones_that_need_a_path_have_one(tmp_path):
    """Godot and Unity drop positions of bones other than root and hips, so as few as possible are written.

    Thighs hang on joints that the scheme lacks, and toes lie elsewhere than ours.
    """
    _, document = written(tmp_path / "a.glb", "rigify", True, fingers=False)
    gltf = document.gltf
    moved = {
        gltf["nodes"][channel["target"]["node"]]["name"]
        for channel in gltf["animations"][0]["channels"]
        if channel["target"]["path"] == "translation"
    }
    assert moved == {"root", "DEF-spine", "DEF-thigh.L", "DEF-thigh.R", "DEF-toe.L", "DEF-toe.R"}


def test_sampled_rates_keep_the_duration_and_the_frames_they_share(tmp_path):
    plain = moving_rig(5)
    rig = engine_rig(plain, "unreal", True)
    for fps, (k, t) in {10.0: (1, 3), 30.0: (1, 1), 60.0: (2, 1)}.items():
        sampled = rig.resampled(FPS, fps)
        assert len(sampled.root) == int((len(rig.root) - 1) / FPS * fps + 1e-6) + 1
        assert np.allclose(posed(sampled, k), posed(rig, t), atol=1e-9)
    write_gltf_skinned([RigAnimation("a", sampled, fps)], tmp_path / "a.glb")
    times = open_document(tmp_path / "a.glb").gltf["accessors"]
    assert any(np.isclose(accessor.get("max", [0])[0], (len(sampled.root) - 1) / fps) for accessor in times)
    # Half way between two frames is what a player of glTF shows.
    sampled = plain.resampled(30.0, 60.0)
    assert sampled.positions is None
    half = plain.rotation[0, 0].T @ sampled.rotation[1, 0]
    assert np.allclose(half @ half, plain.rotation[0, 0].T @ plain.rotation[1, 0])
    assert np.allclose(sampled.root[1], (plain.root[0] + plain.root[1]) / 2)


@pytest.mark.slow
def test_a_result_is_saved_with_engine_names(tmp_path):
    identity, driving = person(0, faces=400), walk(frames=2, faces=400)
    limited = animate(identity, driving, motion=MotionOptions(skinned=True))
    assert limited.save_skinned(tmp_path / "posed.glb", rest="A").deviations[0]["deviation_cause"] == "rest"
    result = animate(identity, driving)
    (plain,) = result.save_skinned(tmp_path / "plain.glb").deviations
    assert plain["deviation_cause"] == "weights"
    (named,) = result.save_skinned(tmp_path / "a.glb", names="unreal", root_bone=True, fps=60.0).deviations
    assert np.isclose(named["skinned_deviation"], plain["skinned_deviation"], atol=1e-6)
    gltf = open_document(tmp_path / "a.glb").gltf
    assert gltf["nodes"][gltf["skins"][0]["joints"][0]]["name"] == "root"
    with pytest.raises(InputError, match=r"^names: expected one of"):
        result.save_skinned(tmp_path / "a.glb", names="maya")
