"""FBX files that Blender writes for mimesh, read again with ufbx: bones, names, axes, frames, takes and units.

Blender is the module `bpy` in an environment of its own: `make clients` makes one, or MIMESH_BPY names its Python.
"""

import numpy as np
import pytest
from client_programs import blender
from engine_rigs import moving_rig
from people import person, walk
from rigs import character
from scipy.spatial import cKDTree

import mimesh
from mimesh.bodies.engine_rig import engine_rig
from mimesh.core.animated_rig import RigAnimation
from mimesh.io import load_clip, load_mesh, save_as_fbx, save_rig_animations
from mimesh.io.gltf.animation import animation_names, read_channels
from mimesh.io.gltf.bake import frame_times, sample_nodes
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.scene import node_parents
from mimesh.pipeline.skinned import save_skinned

pytestmark = pytest.mark.client
pytest.importorskip("ufbx")
FPS = 30.0
CLOSE = 1e-4
"""Largest distance of a vertex or a bone, over the size of the mesh."""
SAME_AXES = 2e-3
"""Largest difference of an axis of a bone; Blender stores bones as head, tail and roll in single precision."""


@pytest.fixture(autouse=True)
def use_blender(monkeypatch):
    monkeypatch.setenv("BLENDER", str(blender()))


def distance(found, expected):
    """Return the largest distance between two sets of points, in both directions, over their size."""
    pairs = ((found, expected), (expected, found))
    return max(cKDTree(a).query(b)[0].max() for a, b in pairs) / np.ptp(expected, axis=0).max()


def bones(path, animation):
    """Return the world transforms of all nodes by name in every frame, and the parent of each."""
    document = open_document(path)
    channels = read_channels(document, animation_names(document).index(animation))
    times = frame_times(document, channels, FPS)
    world = np.concatenate([matrices for _, matrices in sample_nodes(document, channels, times)])
    names = [node.get("name") for node in document.gltf["nodes"]]
    above = [None if parent < 0 else names[parent] for parent in node_parents(document)]
    return {name: world[:, k] for k, name in enumerate(names)}, dict(zip(names, above, strict=True))


def compare(glb, fbx, joints):
    """Compare all animations of two files; `joints` are the names of the bones."""
    names = animation_names(open_document(glb))
    assert animation_names(open_document(fbx)) == names
    assert distance(load_mesh(fbx).vertices, load_mesh(glb).vertices) < CLOSE
    for name in names:
        expected, found = (load_clip(path, animation=name) for path in (glb, fbx))
        assert found.fps == expected.fps
        assert len(found) == len(expected)
        for before, after in zip(expected.vertices, found.vertices, strict=True):
            assert distance(after, before) < CLOSE
        (before, parents), (after, parents_after) = bones(glb, name), bones(fbx, name)
        size = np.ptp(expected.mesh.vertices, axis=0).max()
        for joint in joints:
            assert np.abs(after[joint][:, :3, 3] - before[joint][:, :3, 3]).max() < CLOSE * size
            axes = [m[joint][:, :3, :3] / np.linalg.norm(m[joint][:, :3, :3], axis=1, keepdims=True)
                    for m in (before, after)]  # fmt: skip
            assert np.abs(axes[0] - axes[1]).max() < SAME_AXES
            if parents[joint] in joints:
                assert parents_after[joint] == parents[joint]


@pytest.mark.parametrize(("names", "root_bone"), [("mixamo", False), ("unreal", True), ("own", True)])
def test_rig_of_ours_in_the_layout_of_an_engine(names, root_bone, tmp_path):
    rig = engine_rig(moving_rig(7, fingers=True, arms=10.0), names, root_bone, "file")
    for suffix in ("glb", "fbx"):
        save_rig_animations([RigAnimation("dance", rig, FPS)], tmp_path / f"a.{suffix}")
    compare(tmp_path / "a.glb", tmp_path / "a.fbx", rig.names)
    found, parents = bones(tmp_path / "a.fbx", "dance")
    # Nothing but the armature, of the name that Unreal Engine leaves out, is above the first bone; no leaves are added.
    assert parents[rig.names[0]] == "Armature"
    assert set(found) - set(rig.names) == {"Armature", rig.mesh.name, "RootNode"} & set(found)
    np.testing.assert_allclose(np.linalg.norm(found["Armature"][:, :3, :3], axis=1), 1.0, atol=1e-5)


@pytest.mark.parametrize("frames", [0, 3])
def test_own_rig_with_several_animations(frames, tmp_path):
    hero = load_mesh(character(tmp_path / "hero.glb", faces=600, frames=frames))
    results = [mimesh.animate(hero, walk(shape, frames=5, faces=900)) for shape in (1, 2)]
    assert all(result.own is not None for result in results)
    for suffix in ("glb", "fbx"):
        save_skinned(results, tmp_path / f"a.{suffix}", ["walk", "walk again"])
    compare(tmp_path / "a.glb", tmp_path / "a.fbx", results[0].skeleton.names)


def test_root_bone_and_new_names_on_an_own_rig(tmp_path):
    hero = load_mesh(character(tmp_path / "hero.glb", faces=600, frames=1))
    result = mimesh.animate(hero, walk(1, frames=5, faces=900))
    for suffix in ("glb", "fbx"):
        result.save_skinned(tmp_path / f"a.{suffix}", names="unreal", root_bone=True)
    compare(tmp_path / "a.glb", tmp_path / "a.fbx", ("root", "pelvis", "thigh_l", "hand_r", "head"))


def test_pose_of_an_own_rig(tmp_path):
    hero = load_mesh(character(tmp_path / "hero.glb", faces=600, frames=1))
    posed = mimesh.transfer(hero, person(1, pose=3, faces=900))
    posed.save(tmp_path / "posed.fbx")
    assert distance(load_mesh(tmp_path / "posed.fbx").vertices, posed.vertices) < CLOSE


def test_frames_become_blend_shapes(tmp_path):
    clip = walk(1, frames=4, faces=900)
    mimesh.io.save_clip(clip, tmp_path / "walk.fbx")
    found = load_clip(tmp_path / "walk.fbx", fps=clip.fps)
    assert len(found) == len(clip)
    for before, after in zip(clip.vertices, found.vertices, strict=True):
        assert distance(after, before.astype(np.float64)) < CLOSE


def test_fbx_is_written_again_as_fbx(tmp_path):
    rig = moving_rig(7)
    save_rig_animations([RigAnimation("dance", rig, FPS)], tmp_path / "a.fbx")
    save_as_fbx(tmp_path / "a.fbx", tmp_path / "b.fbx")
    compare(tmp_path / "a.fbx", tmp_path / "b.fbx", rig.names)
