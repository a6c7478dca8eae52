"""Script that Blender runs: import a .glb and export it as .fbx. It is never imported by mimesh.

    blender --background --factory-startup --python blender_export.py -- JOB.json
    python blender_export.py -- JOB.json      where Python has `bpy`

The job has the paths `glb`, `fbx` and `errors`, the frame rate `fps`, `clips`, the parts of the one animation, and
`materials` and `images` (see `write.py`). Frame 0 is the file at rest.
"""

# pyright: reportMissingImports=false, reportMissingModuleSource=false

import json
import sys
from pathlib import Path

import bpy

CENTIMETRE = 0.01
"""Metres of Blender's unit during the export: FBX is in centimetres, and objects then need no scale of 100."""
IMPORT = {
    # Bones keep the local axes that the joints have in the file.
    "bone_heuristic": "BLENDER",
    "disable_bone_shape": True,
}
EXPORT = {
    "object_types": {"ARMATURE", "MESH", "EMPTY"},
    "axis_forward": "-Z",
    "axis_up": "Y",
    "apply_unit_scale": True,
    "apply_scale_options": "FBX_SCALE_NONE",
    "add_leaf_bones": False,
    "use_armature_deform_only": False,
    "primary_bone_axis": "Y",
    "secondary_bone_axis": "X",
    "armature_nodetype": "NULL",
    "use_mesh_modifiers": False,
    "mesh_smooth_type": "OFF",
    "bake_anim_use_all_bones": True,
    "bake_anim_use_nla_strips": True,
    "bake_anim_use_all_actions": False,
    "bake_anim_force_startend_keying": True,
    "bake_anim_step": 1.0,
    "bake_anim_simplify_factor": 0.0,
    "path_mode": "COPY",
    "embed_textures": True,
}
"""Options of Blender's FBX exporter: every frame is a key, no bones are added, shape keys are kept."""
APART = 1e-5
"""Distance of a bone from the y axis of that above it, over the length of that, from which on Blender's FBX importer
does not connect them (1e-6), and single precision keeps it."""
ARMATURE = "Armature"
"""Name of the armature's node in the file: Unreal Engine leaves a root node of this name out of the skeleton."""


def export(job):
    """Import the .glb, arrange its animation, and write the .fbx."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.scale_length = CENTIMETRE
    scene.render.fps = max(1, round(job["fps"]))
    scene.render.fps_base = scene.render.fps / job["fps"]
    call(bpy.ops.import_scene.gltf, IMPORT, filepath=job["glb"])
    for entry in job["materials"]:
        make_plain(entry)
    name_images(job["images"])
    armatures = [thing for thing in bpy.data.objects if thing.type == "ARMATURE"]
    if len(armatures) == 1:
        for other in [thing for thing in bpy.data.objects if thing.name == ARMATURE and thing != armatures[0]]:
            other.name = f"{ARMATURE} (of the file)"
        armatures[0].name = ARMATURE
    for armature in armatures:
        keep_apart(armature)
    if job["clips"]:
        add_strips(job["clips"], armatures)
    call(bpy.ops.export_scene.fbx, EXPORT, filepath=job["fbx"], bake_anim=bool(job["clips"]))


def keep_apart(armature):
    """Move bones with a path off the y axis of the bone above them, by APART.

    Where the only bone below another is on that axis, Blender's FBX importer connects it, and connected bones have no
    path: hips above a root would stay where they are at rest.
    """
    action = armature.animation_data and armature.animation_data.action
    curves = [curve for curve in curves_of(action) if curve.data_path.endswith(".location")] if action else []
    paths = {curve.data_path for curve in curves if any(abs(key.co[1]) > 0 for key in curve.keyframe_points)}
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in armature.data.edit_bones:
        if bone.parent and f'pose.bones["{bpy.utils.escape_identifier(bone.name)}"].location' in paths:
            way = bone.head - bone.parent.head
            if (way - way.dot(bone.parent.y_axis) * bone.parent.y_axis).length < APART * way.length:
                step = APART * way.length * bone.parent.x_axis
                bone.use_connect = False
                bone.head, bone.tail = bone.head + step, bone.tail + step
    bpy.ops.object.mode_set(mode="OBJECT")


def curves_of(action):
    """Return the curves of an action; from Blender 5 on they are those of its layers."""
    if hasattr(action, "fcurves"):
        return list(action.fcurves)
    return [c for layer in action.layers for strip in layer.strips for bag in strip.channelbags for c in bag.fcurves]


def make_plain(entry):
    """Replace the base colour's network of nodes by a colour and an image, in one material for all of its variants."""
    # The importer makes a variant, with a number at the end of its name, for meshes with vertex colours.
    variants = [material for material in bpy.data.materials if material.name.rpartition(".")[0] == entry["key"]]
    exact = bpy.data.materials.get(entry["key"])
    found = ([exact] if exact else []) + variants
    if not found:
        return
    material = found[0]
    for variant in found[1:]:
        variant.user_remap(material)
        bpy.data.materials.remove(variant)
    material.name = entry["name"]
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next((node for node in nodes if node.type == "BSDF_PRINCIPLED"), None)
    if shader is None:  # unlit
        shader = nodes.new("ShaderNodeBsdfPrincipled")
        shader.inputs["Roughness"].default_value = 1.0
        output = next(node for node in nodes if node.type == "OUTPUT_MATERIAL")
        links.new(shader.outputs[0], output.inputs["Surface"])
    color, alpha = shader.inputs["Base Color"], shader.inputs["Alpha"]
    for link in list(color.links):
        links.remove(link)
    color.default_value = (*entry["color"], 1.0)
    alpha.default_value = entry["alpha"]
    images = [node for node in nodes if node.type == "TEX_IMAGE" and node.image is not None]
    picture = next((node for node in images if entry["image"] and node.image.name == entry["image"]), None)
    if picture is not None:
        links.new(picture.outputs["Color"], color)


def name_images(images):
    """Give each image its file name, relative to the file that is written: images of a .glb have none."""
    for entry in images:
        image = bpy.data.images.get(entry["key"])
        if image is not None:
            image.filepath = "//" + entry["name"]
            image.name = entry["name"]


def add_strips(clips, armatures):
    """Add a strip of time for each clip to the armature, or to any object where only shape keys move."""
    moving = [thing for thing in armatures if thing.animation_data and thing.animation_data.action]
    owner = (moving or armatures or list(bpy.data.objects))[0]
    data = owner.animation_data or owner.animation_data_create()
    action = data.action or bpy.data.actions.new("time")
    slot = getattr(data, "action_slot", None)
    for thing in bpy.data.objects:
        for track in list(thing.animation_data.nla_tracks) if thing.animation_data else []:
            thing.animation_data.nla_tracks.remove(track)
    track = data.nla_tracks.new()
    for clip in clips:
        strip = track.strips.new(clip["name"], clip["first"], action)
        strip.name = clip["name"]
        if slot is not None:
            strip.action_slot = slot
        strip.action_frame_start, strip.action_frame_end = clip["first"], clip["last"]
        strip.frame_start, strip.frame_end = clip["first"], clip["last"]
        strip.extrapolation = "NOTHING"
    # The exporter writes the nodes as they are in the current frame, with the active action.
    bpy.context.scene.frame_set(0)


def call(operator, options, **more):
    """Call an operator with those options that this version of Blender has."""
    known = operator.get_rna_type().properties.keys()
    return operator(**{key: value for key, value in options.items() if key in known}, **more)


def main():
    """Run the job that the command line names; the reason of an error becomes the one line of its file `errors`."""
    job = json.loads(Path(sys.argv[sys.argv.index("--") + 1]).read_text(encoding="utf-8"))
    try:
        export(job)
    except Exception as error:
        Path(job["errors"]).write_text(reason(error), encoding="utf-8")
        raise


def reason(error):
    """Return the type and message of an error; those of an operator have a traceback, and say where it was called."""
    lines = [line for line in str(error).splitlines() if line.strip() and not line.startswith(("Location:", " "))]
    return lines[-1].strip() if lines else type(error).__name__


if __name__ == "__main__":
    main()
