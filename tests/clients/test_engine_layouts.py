"""three.js, three-vrm and the Khronos validator on skinned files in the layout of each engine."""

import json
import subprocess

import numpy as np
import pytest
from client_programs import three, validator
from engine_rigs import moving_rig, posed

from mimesh.bodies.engine_names import SCHEMES
from mimesh.bodies.engine_rig import engine_rig
from mimesh.core.animated_rig import RigAnimation
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.draft import Draft
from mimesh.io.gltf.skinned import write_gltf_skinned

pytestmark = pytest.mark.client
FPS = 30.0
FRAMES = (0, 2, 4)


def write(path, names, root_bone=True, rest="file"):
    rig = engine_rig(moving_rig(7, fingers=True, arms=10.0), names, root_bone, rest)
    write_gltf_skinned([RigAnimation("a", rig, FPS)], path)
    return rig


def play(path):
    times = [str(t / FPS) for t in FRAMES]
    answer = subprocess.run([*three(), str(path), *times], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    return json.loads(answer.stdout)


def as_vrm(path):
    """Add the extension of VRM 1.0 to a .glb whose bones have its names."""
    document = open_document(path)
    gltf = dict(document.gltf)
    bones = {node["name"]: {"node": number} for number, node in enumerate(gltf["nodes"])}
    named = {bone: bones[bone] for bone in SCHEMES["vrm"].bones.values() if bone in bones}
    meta = {"name": "mover", "version": "1", "authors": ["nobody"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
    gltf["extensions"] = {"VRMC_vrm": {"specVersion": "1.0", "meta": meta, "humanoid": {"humanBones": named}}}
    gltf["extensionsUsed"] = ["VRMC_vrm"]
    draft = Draft(gltf)
    draft.gltf |= {key: gltf[key] for key in ("accessors", "bufferViews")}
    draft.chunks, draft.size = [memoryview(document.binary)], len(document.binary)
    draft.save(path.with_suffix(".vrm"))
    return path.with_suffix(".vrm"), named


@pytest.mark.parametrize("names", SCHEMES)
@pytest.mark.parametrize("rest", ["file", "T", "A"])
def test_three_plays_the_frames_of_the_rig(names, rest, tmp_path):
    rig = write(tmp_path / "a.glb", names, rest=rest)
    played, size = play(tmp_path / "a.glb"), np.ptp(rig.mesh.vertices, axis=0).max()
    assert played["warnings"] == []
    assert np.abs(np.array(played["rest"]) - rig.mesh.vertices).max() < 1e-5 * size
    for t, vertices in zip(FRAMES, played["frames"], strict=True):
        assert np.abs(np.array(vertices) - posed(rig, t)).max() < 1e-4 * size
    # three.js leaves out the characters that its paths of properties use.
    plain = [name.translate(str.maketrans("", "", "[].:/")) for name in rig.names]
    assert played["bones"] == plain


@pytest.mark.parametrize("names", SCHEMES)
@pytest.mark.parametrize("root_bone", [False, True])
def test_files_are_valid(names, root_bone, tmp_path):
    write(tmp_path / "a.glb", names, root_bone, "A")
    answer = subprocess.run([*validator(), str(tmp_path / "a.glb")], capture_output=True, text=True, check=True)
    issues = json.loads(answer.stdout)["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"][:5]


def test_three_vrm_finds_the_humanoid_and_turns_its_bones(tmp_path):
    rig = write(tmp_path / "a.glb", "vrm", rest="T")
    path, named = as_vrm(tmp_path / "a.glb")
    played = play(path)
    assert set(played["vrm"]["bones"]) == set(named)
    assert len(named) == 52
    assert played["vrm"]["meta"] == "1"
    # The left arm points to +x in the T-pose; a turn of 90 degrees about z raises it.
    joints = dict(zip(rig.names, rig.rig.joints, strict=True))
    raised = joints["leftUpperArm"] + [0, joints["leftHand"][0] - joints["leftUpperArm"][0], 0]
    assert np.allclose(played["vrm"]["before"], joints["leftHand"], atol=1e-5)
    assert np.allclose(played["vrm"]["after"], raised, atol=1e-5)
