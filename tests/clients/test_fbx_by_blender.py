"""FBX files that Blender writes for mimesh, read again with ufbx: bones, names, axes, frames, takes and units.

Blender is the module `bpy` in an environment of its own: `make clients` makes one, or MIMESH_BPY names its Python.
"""

import io
import json
import subprocess

import numpy as np
import pytest
from client_programs import blender
from engine_rigs import moving_rig
from gltf_samples import Sample, box, png, props
from people import person, walk
from PIL import Image
from rigs import character, exercise, figure, quantized
from scipy.spatial import cKDTree

import mimesh
from mimesh.bodies.engine_rig import engine_rig
from mimesh.core.animated_rig import RigAnimation
from mimesh.io import joints_file, load_clip, load_mesh, save_whole
from mimesh.io.gltf.animation import animation_names, frame_times, read_channels, sample_nodes
from mimesh.io.gltf.document import open_document
from mimesh.io.gltf.scene import node_parents
from mimesh.io.gltf.skinned import write_gltf_skinned
from mimesh.pipeline.skinned import save_skinned

pytestmark = pytest.mark.client
pytest.importorskip("ufbx")
FPS = 30.0
CLOSE = 1e-4
"""Largest distance of a vertex or a bone, over the size of the mesh."""
SAME_AXES = 2e-3
"""Largest difference of an axis of a bone; Blender stores bones as head, tail and roll in single precision."""
READ_IN_BLENDER = """
import json, sys, bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.fbx(filepath=sys.argv[1])
found = {}
for material in bpy.data.materials:
    color = material.node_tree.nodes["Principled BSDF"].inputs["Base Color"]
    images = [link.from_node.image for link in color.links]
    files = [(image.filepath.replace("\\\\", "/").rpartition("/")[2], image.packed_file.size) for image in images]
    found[material.name] = [list(color.default_value)[:3], files]
print("FOUND" + json.dumps(found))
"""
"""Script that prints colour and image of each material of an FBX file."""

PATH_IN_BLENDER = """
import sys, bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.fbx(filepath=sys.argv[1])
(armature,) = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
for frame in (1, 2, 3):
    bpy.context.scene.frame_set(frame)
    print("FOUND", *(armature.matrix_world @ armature.pose.bones["hips"].matrix).translation)
"""
"""Script that prints where the bone "hips" is in frames of an FBX file."""


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
        with joints_file(tmp_path / f"a.{suffix}") as temporary:
            write_gltf_skinned([RigAnimation("dance", rig, FPS)], temporary)
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
        save_skinned(results, tmp_path / f"a.{suffix}", animations=["walk", "walk again"])
    compare(tmp_path / "a.glb", tmp_path / "a.fbx", results[0].skeleton.names)


def test_root_bone_and_new_names_on_an_own_rig(tmp_path):
    hero = load_mesh(character(tmp_path / "hero.glb", faces=600, frames=1))
    result = mimesh.animate(hero, walk(1, frames=5, faces=900))
    for suffix in ("glb", "fbx"):
        result.save_skinned(tmp_path / f"a.{suffix}", names="unreal", root_bone=True)
    compare(tmp_path / "a.glb", tmp_path / "a.fbx", ("root", "pelvis", "thigh_l", "hand_r", "head"))


def test_quantized_character_without_its_images(tmp_path):
    """Blender's importer removes bones that are far from the origin, and fails at images that are not there."""

    def gone(draft):
        gloss = {"specularGlossinessTexture": {"index": 0}}
        draft.gltf |= {"images": [{"uri": "gone.tga"}], "textures": [{"source": 0}]}
        draft.gltf["materials"] = [{"extensions": {"KHR_materials_pbrSpecularGlossiness": gloss}}]
        for primitive in draft.gltf["meshes"][0]["primitives"]:
            primitive["material"] = 0

    clips = {"move": exercise(figure(), 4)}
    plain = character(tmp_path / "plain.glb", faces=600, clips=clips, frames=2, change=gone)
    path = quantized(plain, tmp_path / "hero.glb", 1e-6)
    save_whole(path, tmp_path / "a.fbx")
    compare(path, tmp_path / "a.fbx", figure().names)


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
    with joints_file(tmp_path / "a.fbx") as temporary:
        write_gltf_skinned([RigAnimation("dance", rig, FPS)], temporary)
    save_whole(tmp_path / "a.fbx", tmp_path / "b.fbx")
    compare(tmp_path / "a.fbx", tmp_path / "b.fbx", rig.names)


def run(script, fbx):
    """Run a script in Blender; return what it prints after the word FOUND."""
    path = fbx.with_suffix(".py")
    path.write_text(script)
    answer = subprocess.run([blender(), path, fbx], capture_output=True, text=True, check=True)
    return [line.removeprefix("FOUND") for line in answer.stdout.splitlines() if line.startswith("FOUND")]


def test_hips_straight_above_their_root_keep_their_path_in_blender(tmp_path):
    sample, (positions, _, _, faces) = Sample(), box(0.2)
    weighted = {
        "POSITION": sample.accessor(positions + [0.0, 1.0, 0.0]),
        "JOINTS_0": sample.accessor(np.tile([1, 0, 0, 0], (24, 1)), "u1"),
        "WEIGHTS_0": sample.accessor(np.tile([1.0, 0.0, 0.0, 0.0], (24, 1))),
    }
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1, 3, 1] = -1.0  # columns first, as glTF has them
    path = np.array([[0.0, 1.0, 0.0], [0.2, 0.6, 0.0], [0.3, 0.9, 0.5]])
    key = {"input": sample.accessor(np.arange(3) / FPS), "output": sample.accessor(path)}
    sample.gltf |= {
        "scenes": [{"nodes": [0, 2]}],
        "nodes": [
            {"name": "root", "children": [1]},
            {"name": "hips", "translation": [0, 1, 0]},
            {"name": "box", "mesh": 0, "skin": 0},
        ],
        "meshes": [{"primitives": [{"attributes": weighted, "indices": sample.indices(faces, "u1")}]}],
        "skins": [{"joints": [0, 1], "inverseBindMatrices": sample.accessor(bind.reshape(2, 16))}],
        "animations": [
            {"name": "a", "samplers": [key], "channels": [{"sampler": 0, "target": {"node": 1, "path": "translation"}}]}
        ],
    }
    save_whole(sample.glb(tmp_path / "a.glb"), tmp_path / "a.fbx")
    found = np.array([line.split() for line in run(PATH_IN_BLENDER, tmp_path / "a.fbx")], float)
    np.testing.assert_allclose(found, path @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=2e-5)  # z is up


def test_colours_and_texture_names(tmp_path):
    """Blender has networks of nodes for vertex colours, unlit materials, and a texture with a factor."""
    (tmp_path / "colour map.png").write_bytes(png())
    other = io.BytesIO()
    Image.new("RGB", (2, 2), (0, 0, 255)).save(other, "JPEG")
    sample = props()
    flat = {"baseColorFactor": [0.1, 0.2, 0.3, 1.0]}
    sample.gltf["extensionsUsed"] = ["KHR_materials_unlit"]
    sample.gltf["materials"] = [
        {"name": "flat", "pbrMetallicRoughness": flat},
        {"name": "unlit", "pbrMetallicRoughness": flat, "extensions": {"KHR_materials_unlit": {}}},
        {"name": "beside", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}},
        {"name": "inside", "pbrMetallicRoughness": {**flat, "baseColorTexture": {"index": 1}}},
    ]
    inside = sample.view(other.getvalue())
    sample.gltf["images"] = [{"uri": "colour%20map.png"}, {"bufferView": inside, "mimeType": "image/jpeg"}]
    sample.gltf["textures"] = [{"source": 0}, {"source": 1}]
    box = sample.gltf["meshes"][0]["primitives"][0]
    colored = {**box["attributes"], "COLOR_0": sample.accessor(np.full((24, 4), 0.5))}
    box_meshes = [
        {"primitives": [{**box, "attributes": attributes, "material": number} for number in range(4)]}
        for attributes in (box["attributes"], colored)
    ]
    sample.gltf["meshes"] += box_meshes
    sample.gltf["nodes"][1]["mesh"], sample.gltf["nodes"][2]["mesh"] = (len(sample.gltf["meshes"]) - k for k in (1, 2))
    save_whole(sample.text(tmp_path / "a.gltf"), tmp_path / "a.fbx")
    color = [0.1, 0.2, 0.3]
    beside, inside = ["colour map.png", len(png())], ["image1.jpg", len(other.getvalue())]
    expected = {"flat": (color, []), "unlit": (color, []), "beside": ([1, 1, 1], [beside]), "inside": (color, [inside])}

    by_blender = json.loads(run(READ_IN_BLENDER, tmp_path / "a.fbx")[0])
    # Meshes with and without vertex colours share a material.
    assert set(by_blender) & {"DefaultMaterial"} == set(by_blender) - set(expected)
    for name, (color, images) in expected.items():
        np.testing.assert_allclose(by_blender[name][0], color, atol=1e-6)
        assert by_blender[name][1] == images

    document = open_document(tmp_path / "a.fbx")
    gltf = document.gltf
    for material in gltf["materials"]:
        color, images = expected.get(material["name"], (None, []))
        surface = material["pbrMetallicRoughness"]
        if "baseColorTexture" in surface:
            source = gltf["textures"][surface["baseColorTexture"]["index"]]["source"]
            assert [gltf["images"][source]["name"]] == [name.partition(".")[0] for name, _ in images]
            assert [len(document.images[source])] == [size for _, size in images]
        elif color is not None:
            assert not images
            np.testing.assert_allclose(surface["baseColorFactor"][:3], color, atol=1e-6)
