"""Script for Blender's Python: record what Blender evaluates of files of mimesh, or write files with Blender.

    python blender_formats.py read FOLDER     FOLDER/jobs.json -> FOLDER/<name>.npz
    python blender_formats.py write FOLDER    files of a scene, and truth.npz with what Blender shows of it

Vertices are in Blender's world, z up, every frame of every mesh object in the order of `bpy.data.objects`.
"""

import json
import math
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler, Matrix

MODE, FOLDER = sys.argv[1], Path(sys.argv[2])
FPS, FRAMES = 24, range(12)


def main():
    if MODE == "write":
        write_all()
        return
    for job in json.loads((FOLDER / "jobs.json").read_text()):
        empty_scene(job["fps"])
        open_file(job)
        np.savez(FOLDER / f"{job['name']}.npz", **shown(range(job["frames"])))


def empty_scene(fps):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = fps


def open_file(job):
    path, suffix = job["path"], Path(job["path"]).suffix
    if suffix in (".glb", ".gltf"):
        bpy.ops.import_scene.gltf(filepath=path, disable_bone_shape=True)
    elif suffix.startswith(".usd"):
        bpy.ops.wm.usd_import(filepath=path)
    elif suffix == ".obj":
        bpy.ops.wm.obj_import(filepath=path)
    elif suffix == ".ply":
        bpy.ops.wm.ply_import(filepath=path, forward_axis="NEGATIVE_Z", up_axis="Y")
    elif suffix == ".stl":
        bpy.ops.wm.stl_import(filepath=path, forward_axis="NEGATIVE_Z", up_axis="Y")
    if "cache" in job:
        (hero,) = meshes()
        cache = hero.modifiers.new("cache", "MESH_CACHE")
        cache.cache_format, cache.filepath, cache.frame_start = job["cache"][-3:].upper(), job["cache"], 0.0


def meshes():
    return [thing for thing in bpy.data.objects if thing.type == "MESH" and thing.users_scene]


def shown(frames):
    """Evaluate the world positions of all meshes in every frame; return them with the meshes' other data."""
    points = np.stack([np.concatenate([world_points(thing, frame) for thing in meshes()]) for frame in frames])
    data = [thing.data for thing in meshes()]
    materials = [slot.material for thing in meshes() for slot in thing.material_slots if slot.material]
    images = [
        node.image for one in materials if one.node_tree for node in one.node_tree.nodes if node.type == "TEX_IMAGE"
    ]
    return {
        "vertices": points,
        "sizes": np.concatenate([numbers(mesh.polygons, "loop_total", np.int32) for mesh in data]),
        "uv": np.concatenate([uv_of(mesh) for mesh in data]),
        "colors": len([one for mesh in data for one in mesh.color_attributes]),
        "materials": sorted({one.name for one in materials}),
        "images": len([image for image in images if image and image.size[0]]),
        "names": [thing.name for thing in meshes()],
    }


def world_points(thing, frame):
    scene = bpy.context.scene
    if scene.frame_current != frame:
        scene.frame_set(frame)
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    points = numbers(mesh.vertices, "co", np.float32, 3).astype(np.float64)
    evaluated.to_mesh_clear()
    place = np.array(evaluated.matrix_world)
    return points @ place[:3, :3].T + place[:3, 3]


def numbers(items, name, dtype, width=1):
    values = np.empty(len(items) * width, dtype)
    items.foreach_get(name, values)
    return values.reshape(-1, width) if width > 1 else values


def uv_of(mesh):
    return numbers(mesh.uv_layers.active.data, "uv", np.float32, 2) if mesh.uv_layers.active else np.zeros((0, 2))


def write_all():
    empty_scene(FPS)
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = FRAMES[0], FRAMES[-1]
    build_scene()
    np.savez(FOLDER / "truth.npz", **shown(FRAMES))
    bpy.context.scene.frame_set(0)
    path = lambda name: str(FOLDER / name)  # noqa: E731
    for name, form in (("scene.glb", "GLB"), ("separate.gltf", "GLTF_SEPARATE")):
        bpy.ops.export_scene.gltf(filepath=path(name), export_format=form, export_force_sampling=True)
    for suffix in ("usda", "usdc", "usdz"):
        bpy.ops.wm.usd_export(filepath=path(f"scene.{suffix}"), export_animation=True)
    (FOLDER / "obj").mkdir()
    bpy.ops.wm.obj_export(filepath=path("obj/scene.obj"), export_animation=True, start_frame=0, end_frame=FRAMES[-1])
    (FOLDER / "ply").mkdir()
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        bpy.ops.wm.ply_export(filepath=path(f"ply/{frame:04d}.ply"))
    bpy.context.scene.frame_set(0)
    bpy.ops.export_scene.fbx(filepath=path("scene.fbx"), bake_anim_simplify_factor=0.0)
    empty_scene(FPS)
    bpy.ops.wm.fbx_import(filepath=path("scene.fbx"), anim_offset=0.0)
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = FRAMES[0], FRAMES[-1]
    np.savez(FOLDER / "truth_fbx.npz", **shown(FRAMES))
    bpy.context.scene.frame_set(0)
    bpy.ops.export_scene.gltf(filepath=path("fbx.glb"), export_format="GLB", export_force_sampling=True)


def build_scene():
    """Add a skinned tube below a rotated and scaled armature below a moving empty, and a mirrored block with keys."""
    above = bpy.data.objects.new("way", None)
    bpy.context.scene.collection.objects.link(above)
    for frame in FRAMES:
        above.location, above.rotation_euler = (0.1 * frame, 0.3, 0), Euler((0, 0, 0.05 * frame))
        above.keyframe_insert("location", frame=frame)
        above.keyframe_insert("rotation_euler", frame=frame)
    tube = grid_object("tube of quads", *tube_of_quads())
    rig = armature_with(tube)
    rig.parent, rig.scale, rig.rotation_euler = above, (0.5, 0.5, 0.5), Euler((0.2, 0, 0.4))
    block = grid_object("block é", *block_of_quads())
    block.matrix_world = Matrix.LocRotScale((2, 0, 0), Euler((0, 0.3, 0)), (-1, 1, 1))
    block.shape_key_add(name="Basis")
    tall = block.shape_key_add(name="tall")
    for point in tall.data:
        point.co.z *= 2
    for frame in FRAMES:
        tall.value = 0.5 + 0.5 * math.sin(frame)
        tall.keyframe_insert("value", frame=frame)


def grid_object(name, vertices, faces, uv):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices, [], faces)
    layer = mesh.uv_layers.new(name="UVMap")
    for corner, place in zip(layer.data, uv, strict=True):
        corner.uv = place
    for number, color in enumerate(((0.8, 0.1, 0.1, 1), (0.1, 0.1, 0.8, 1))):
        material = bpy.data.materials.new(f"{name} {number}")
        material.use_nodes = True
        material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = color
        mesh.materials.append(material)
    for polygon in mesh.polygons:
        polygon.material_index = polygon.index % 2
    made = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(made)
    return made


def tube_of_quads(around=16, along=24):
    vertices = [
        (0.2 * math.cos(2 * math.pi * a / around), 0.2 * math.sin(2 * math.pi * a / around), 3 * row / along)
        for row in range(along + 1)
        for a in range(around)
    ]
    faces, uv = [], []
    for row in range(along):
        for a in range(around):
            b = (a + 1) % around
            faces.append((row * around + a, row * around + b, (row + 1) * around + b, (row + 1) * around + a))
            uv += [(x / around, y / along) for x, y in ((a, row), (a + 1, row), (a + 1, row + 1), (a, row + 1))]
    return vertices, faces, uv


def block_of_quads():
    vertices = [(x, y, z) for x in (-0.3, 0.4) for y in (-0.5, 0.5) for z in (0, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, faces, [place for _ in faces for place in ((0, 0), (1, 0), (1, 1), (0, 1))]


def armature_with(tube):
    data = bpy.data.armatures.new("rig")
    rig = bpy.data.objects.new("rig", data)
    bpy.context.scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    for number in range(3):
        bone = data.edit_bones.new(f"bone {number}")
        bone.head, bone.tail, bone.roll = (0, 0, number), (0, 0.1, number + 1), 0.3
        bone.parent = data.edit_bones[number - 1] if number else None
    bpy.ops.object.mode_set(mode="OBJECT")
    for number in range(3):
        group = tube.vertex_groups.new(name=f"bone {number}")
        for vertex in tube.data.vertices:
            group.add([vertex.index], max(0.0, 1 - abs(vertex.co.z - number - 0.5)) + 1e-3, "REPLACE")
    tube.parent = rig
    tube.modifiers.new("rig", "ARMATURE").object = rig
    for bone in rig.pose.bones:
        bone.rotation_mode = "QUATERNION"
        for frame in FRAMES:
            bone.rotation_quaternion = Euler((0.1 * frame, 0.05 * frame, 0)).to_quaternion()
            bone.keyframe_insert("rotation_quaternion", frame=frame)
    return rig


main()
