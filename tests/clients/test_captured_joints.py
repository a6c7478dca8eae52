"""Captured joints in other programs: Blender and three.js show a skeleton, and play it as the library has it."""

import json
import subprocess

import numpy as np
import pytest
from client_programs import blender, three_joints, validator
from people import walk

import mimesh
from mimesh.core.skinning import place_joints
from mimesh.io import load_clip

pytestmark = pytest.mark.client
PLAY_IN_BLENDER = """
import json, sys, bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
scene, path = bpy.context.scene, sys.argv[1]
scene.render.fps = int(sys.argv[2])
bpy.ops.import_scene.gltf(filepath=path, disable_bone_shape=True)
(armature,) = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
frames = []
for frame in range(int(sys.argv[3])):
    scene.frame_set(frame)
    frames.append({bone.name: list(armature.matrix_world @ bone.head) for bone in armature.pose.bones})
print("FOUND" + json.dumps({"frames": frames, "clip": armature.animation_data.action.name}))
"""
"""Script that prints where the bones of a file are in each frame."""


@pytest.fixture(scope="module")
def captured():
    return mimesh.capture(walk(frames=8))


@pytest.fixture(scope="module")
def positions(captured):
    """Return the position of each joint in each frame."""
    above = list(captured.parents[1:])
    placed = place_joints(captured.root, captured.rest[1:] - captured.rest[above], captured.rotation, captured.parents)
    return dict(zip(captured.names, placed.swapaxes(0, 1), strict=True))


def compare(frames, positions, turn):
    size = np.ptp(np.concatenate(list(positions.values())), axis=0).max()
    assert len(frames) == len(positions["Hips"])
    for t, frame in enumerate(frames):
        assert frame.keys() == positions.keys()
        for name, place in frame.items():
            assert np.abs(np.array(place) - turn @ positions[name][t]).max() < 1e-3 * size, name


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_blender_shows_an_armature_and_plays_it(captured, positions, suffix, tmp_path):
    path = captured.save(tmp_path / f"walk{suffix}")
    command = [blender(), "-I", "-c", PLAY_IN_BLENDER, path, f"{captured.fps:g}", str(len(captured.root))]
    answer = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    found = json.loads(answer.split("FOUND")[1].splitlines()[0])
    compare(found["frames"], positions, np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]))


def test_three_shows_bones_and_plays_them(captured, positions, tmp_path):
    path = captured.save(tmp_path / "walk.glb")
    times = [str(t / captured.fps) for t in range(len(captured.root))]
    answer = subprocess.run([*three_joints(), path, *times], capture_output=True, text=True, check=True)
    found = json.loads(answer.stdout)
    compare(found["frames"], positions, np.eye(3))
    assert found["clip"] == captured.name


def test_the_validator_finds_nothing_wrong(captured, tmp_path):
    path = captured.save(tmp_path / "walk.glb")
    answer = subprocess.run([*validator(), str(path)], capture_output=True, text=True, check=True)
    issues = json.loads(answer.stdout)["issues"]
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues["messages"]


def test_an_fbx_plays_as_the_glb(captured, monkeypatch, tmp_path):
    pytest.importorskip("ufbx")
    monkeypatch.setenv("BLENDER", str(blender()))
    clips = [load_clip(captured.save(tmp_path / f"walk{suffix}")) for suffix in (".fbx", ".glb")]
    assert clips[0].fps == clips[1].fps == captured.fps
    found, expected = (np.asarray(clip.vertices, float) for clip in clips)
    assert np.abs(found - expected).max() < 1e-3 * np.ptp(expected[0], axis=0).max()
