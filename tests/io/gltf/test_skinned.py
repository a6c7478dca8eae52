"""Skinned results: at rest as in the source file, and in every frame of the animation as in the clip."""

import numpy as np
import pytest
import zoo
from people import person, walk
from scipy.spatial.transform import Rotation

from mimesh.core.animated_rig import AnimatedRig, RigAnimation
from mimesh.core.errors import InputError
from mimesh.core.frame_buffer import LazyFrames
from mimesh.core.mesh import Mesh, Part
from mimesh.core.rig import Rig
from mimesh.io import load_clip, load_mesh, save_mesh
from mimesh.io.gltf.document import open_document, read_accessor
from mimesh.io.gltf.skinned import write_gltf_skinned
from mimesh.pipeline import animate


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_skinned_frames_equal_the_frames_of_the_result(model, tmp_path, suffix):
    """The file keeps the materials of its source; weights sum to 1, and quaternions are continuous."""
    mesh = person(0)
    save_mesh(mesh, tmp_path / "hero.glb")
    result = animate(tmp_path / "hero.glb" if suffix == ".glb" else mesh, walk(faces=600), model)
    saved = result.save_skinned(tmp_path / f"moved{suffix}")
    path = saved
    assert saved.deviations[0]["skinned_deviation"] < 1e-5  # three joints are fewer than four
    assert np.allclose(load_mesh(path).vertices, mesh.vertices, atol=1e-5)
    assert np.allclose(load_clip(path).vertices, result.clip.vertices, atol=1e-4)
    document = open_document(path)
    assert len(document.gltf["skins"]) == 1
    assert document.gltf["materials"] == open_document(tmp_path / "hero.glb").gltf["materials"]
    attributes = document.gltf["meshes"][0]["primitives"][0]["attributes"]
    joints, weights = (read_accessor(document, attributes[name]) for name in ("JOINTS_0", "WEIGHTS_0"))
    assert np.allclose(weights.sum(axis=1), 1, atol=1e-6)
    assert (joints[weights == 0] == 0).all()
    animation = document.gltf["animations"][0]
    for sampler in animation["samplers"][:-1]:
        quaternions = read_accessor(document, sampler["output"])
        assert np.allclose(np.linalg.norm(quaternions, axis=1), 1, atol=1e-6)
        assert ((quaternions[1:] * quaternions[:-1]).sum(axis=1) > 0).all()
    with pytest.raises(InputError, match=r"expected \.glb, \.gltf or \.fbx for joints, found '\.obj'"):
        result.save_skinned(tmp_path / "hero.obj")


def test_a_mesh_in_other_axes_leaves_no_empty_node(model, tmp_path):
    mesh = person(0)
    turned = mesh.with_vertices(mesh.vertices @ Rotation.from_euler("x", 90, degrees=True).as_matrix().T)
    save_mesh(turned, tmp_path / "zup.stl")
    result = animate(tmp_path / "zup.stl", walk(faces=600), model)
    document = open_document(result.save_skinned(tmp_path / "moved.glb"))
    nodes, joints = document.gltf["nodes"], document.gltf["skins"][0]["joints"]
    assert [node["name"] for node in nodes if "mesh" in node] == ["zup"]
    assert all("mesh" in node or k in joints or node["name"] == "axes" for k, node in enumerate(nodes))
    assert np.ptp(load_mesh(tmp_path / "moved.glb").vertices, axis=0).argmax() == 1  # stands


@pytest.mark.parametrize("shared", [False, True])
def test_objects_of_an_obj_keep_their_names(model, tmp_path, shared):
    """One skin serves all; parts that share vertices are groups of one surface."""
    mesh, hat = person(0), zoo.cube()
    top = mesh.vertices[:, 1].max()
    vertices = np.concatenate([mesh.vertices, 0.1 * hat.vertices + [0, top, 0]])
    faces = np.concatenate([mesh.faces, hat.faces + len(mesh.vertices)])
    end = 300 if shared else len(mesh.faces)
    parts = Part("body", 0, end), Part("hat", end, len(faces))
    save_mesh(Mesh(vertices, faces, "hero", parts=parts), tmp_path / "hero.obj")
    path = animate(tmp_path / "hero.obj", walk(faces=600), model).save_skinned(tmp_path / "moved.glb")
    gltf = open_document(path).gltf
    shown = [(node["name"], node["skin"]) for node in gltf["nodes"] if "mesh" in node]
    assert shown == ([("hero", 0)] if shared else [("body", 0), ("hat", 0)])
    assert [part.name for part in load_mesh(path).parts][-1] == ("hero" if shared else "hat")
    if not shared:
        np.testing.assert_allclose(load_mesh(path).vertices, vertices, atol=1e-5)


def swinging(frames, fps, joints=6):
    """A chain of joints of which some hold still, some turn evenly, and one swings for a while."""
    mesh = person(0)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    positions = low + np.linspace(0, 1, joints)[:, None] * (high - low)
    weights = np.exp(-((mesh.vertices[:, None] - positions) ** 2).sum(axis=-1) / 0.05)
    rest = Rotation.random(joints, 4)
    rig = Rig(rest.as_matrix(), positions, weights / weights.sum(axis=1, keepdims=True))
    seconds = np.arange(frames) / fps
    angle = np.zeros((frames, joints))
    angle[:, 1], angle[:, 3] = 0.02 * seconds, np.where(seconds > 0.5, np.sin(3 * (seconds - 0.5)), 0)
    local = Rotation.from_rotvec((angle[..., None] * [0.0, 0.0, 1.0]).reshape(-1, 3)).as_matrix()
    world = local.reshape(frames, joints, 3, 3)
    for j in range(1, joints):
        world[:, j] = world[:, j - 1] @ world[:, j]
    names, parents = tuple(f"j{j}" for j in range(joints)), tuple(range(-1, joints - 1))
    root = np.tile(positions[0], (frames, 1))
    return AnimatedRig(mesh, names, parents, rig, world @ rig.rotation, root)


@pytest.mark.parametrize(("frames", "fps"), [(1, 30.0), (2, 30.0), (20, 2.5), (120, 60.0), (61, 24000 / 1001)])
def test_a_file_has_the_frames_and_the_rate_of_the_clip(frames, fps, tmp_path):
    moving = swinging(frames, fps)
    write_gltf_skinned([RigAnimation("swing", moving, fps)], tmp_path / "a.glb")
    clip = load_clip(tmp_path / "a.glb")
    assert len(clip) == frames
    assert clip.fps == fps
    assert moving.deviation(LazyFrames.stored(clip.vertices)) < 1e-6
    document = open_document(tmp_path / "a.glb")
    animation = document.gltf["animations"][0]
    counts = [document.gltf["accessors"][sampler["input"]]["count"] for sampler in animation["samplers"]]
    assert counts[-1] == frames, "the root has all keys"
    assert sum(count == 1 for count in counts[:-1]) >= 4
    assert frames < 3 or counts[1] == frames
    assert len({sampler["input"] for sampler in animation["samplers"]}) == len(set(counts)), "times are shared"


def test_a_file_has_several_animations_at_their_own_rates(tmp_path):
    slow, fast = swinging(40, 24.0), swinging(50, 60.0)
    write_gltf_skinned([RigAnimation("slow", slow, 24.0), RigAnimation("fast", fast, 60.0)], tmp_path / "a.glb")
    assert load_mesh(tmp_path / "a.glb").source.animations == ("slow", "fast")
    for name, moving, fps in (("slow", slow, 24.0), ("fast", fast, 60.0)):
        clip = load_clip(tmp_path / "a.glb", animation=name)
        assert (len(clip), clip.fps) == (len(moving.root), fps)
        assert moving.deviation(LazyFrames.stored(clip.vertices)) < 1e-4
    targets = [
        {(channel["target"]["node"], channel["target"]["path"]) for channel in animation["channels"]}
        for animation in open_document(tmp_path / "a.glb").gltf["animations"]
    ]
    assert targets[0] == targets[1]
