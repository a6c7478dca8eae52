"""Script for Blender's Python: rigged characters and skeletons through the extension; records what happens.

    python blender_rigs.py EXTENSION.zip FOLDER

The folder has the files of `test_blender_rigs.py`; `facts.json` and an `.npz` for each case are written into it.
"""

import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
from mathutils import Matrix

ARCHIVE, FOLDER = Path(sys.argv[1]), Path(sys.argv[2])
FPS, FRAMES = 20, range(0, 6)
MODES = ("XYZ", "ZYX", "AXIS_ANGLE", "QUATERNION")
COMPARED = ("LeftFoot", "RightFoot", "LeftHand", "RightHand")
"""Joints of captured motions that are compared with the bones of the driving."""
FACTS = {}


def imported(path):
    """Import a file; return its armature, and the mesh that it deforms, if any."""
    before = set(bpy.data.objects)
    if path.suffix == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(path))
    elif path.suffix == ".fbx":
        bpy.ops.import_scene.fbx(filepath=str(path), anim_offset=0.0)
    else:
        bpy.ops.import_anim.bvh(filepath=str(path), update_scene_fps=False)
    added = set(bpy.data.objects) - before
    (armature,) = (one for one in added if one.type == "ARMATURE")
    meshes = [one for one in added if any(modifier.type == "ARMATURE" for modifier in one.modifiers)]
    return armature, meshes[0] if meshes else None


def shown(mesh):
    bpy.context.view_layer.update()
    evaluated = mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([evaluated.matrix_world @ vertex.co for vertex in evaluated.to_mesh().vertices], np.float64)


def played(mesh, frames=FRAMES):
    kept = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        kept.append(shown(mesh))
    bpy.context.scene.frame_set(0)
    return np.stack(kept)


def choose(identity, driving, frames=FRAMES, **settings):
    chosen = bpy.context.scene.mimesh
    chosen.identity, chosen.driving = identity, driving
    chosen.use_scene_range, chosen.frame_start, chosen.frame_end = False, frames[0], frames[-1]
    chosen.frame_step, chosen.root, chosen.ground, chosen.model = frames.step, "scale", True, "mime"
    chosen.contacts = False  # nearest points of a surface differ where its vertices are rounded
    for key, value in settings.items():
        setattr(chosen, key, value)
    return chosen


def notes(single_pose=False):
    """Run what the buttons run, and return the notes that they would show."""
    from bl_ext.user_default.mimesh import operator

    chosen = bpy.context.scene.mimesh
    work = operator.transfer(bpy.context, chosen.frames(bpy.context.scene), single_pose)
    while True:
        try:
            next(work)
        except StopIteration as end:
            return list(end.value)


def refusal(**settings):
    chosen = bpy.context.scene.mimesh
    old = {key: getattr(chosen, key) for key in settings}
    for key, value in settings.items():
        setattr(chosen, key, value)
    try:
        bpy.ops.mimesh.animate()
    except RuntimeError as error:
        return str(error)
    finally:
        for key, value in old.items():
            setattr(chosen, key, value)
    return ""


def curves(action):
    """Return all keys of an action."""
    bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    return {
        f"{curve.data_path} {curve.array_index}": [list(point.co) for point in curve.keyframe_points]
        for bag in bags
        for curve in bag.fcurves
    }


def stashed(armature):
    tracks = armature.animation_data.nla_tracks
    return [strip.action.name for track in tracks if track.mute for strip in track.strips]


def identities(driving):
    """Animate characters of several makers; compare their actions before and after."""
    for path in sorted(FOLDER.glob("own_*.glb")):
        armature, mesh = imported(path)
        name, old = path.stem, armature.animation_data.action if armature.animation_data else None
        before = None if old is None else curves(old)
        chosen = choose(mesh, driving)
        FACTS[name] = {"result": chosen.result, "outcome": list(bpy.ops.mimesh.animate())}
        np.savez(FOLDER / f"{name}.npz", result=played(mesh))
        new = armature.animation_data.action
        FACTS[name] |= {"new": new.name, "same action": new == old, "keys": sorted(curves(new))}
        if old is not None:
            FACTS[name] |= {"kept": curves(old) == before, "fake": old.use_fake_user}
            FACTS[name]["stashed"] = old.name in stashed(armature)


def written_and_read_as_fbx(driving):
    armature, mesh = imported(FOLDER / "own_mixamo.glb")
    for one in bpy.context.view_layer.objects:
        one.select_set(one in (armature, mesh))
    armature.animation_data_clear()
    bpy.ops.export_scene.fbx(
        filepath=str(FOLDER / "mixamo.fbx"), use_selection=True, bake_anim=False, add_leaf_bones=False
    )
    armature, mesh = imported(FOLDER / "mixamo.fbx")
    choose(mesh, driving, contacts=True)
    bpy.ops.mimesh.animate()
    np.savez(FOLDER / "fbx.npz", result=played(mesh))


def captures():
    """Capture the joints of an armature that is turned, scaled and moved, and of one of motion capture."""
    for name in ("driving.glb", "walk.bvh"):
        armature, mesh = imported(FOLDER / name)
        if mesh is not None:
            turned = Matrix.LocRotScale((1, 2, 0.5), Matrix.Rotation(2.2, 3, "Z"), (1.5,) * 3)
            armature.matrix_world = turned @ armature.matrix_world
        chosen = choose(None, armature)
        FACTS[f"capture {name}"] = {"outcome": list(bpy.ops.mimesh.capture())}
        made = bpy.context.view_layer.objects.active
        pairs = (armature, bones_of(armature)), (made, COMPARED)
        places = []
        for frame in chosen.frames(bpy.context.scene):
            bpy.context.scene.frame_set(frame)
            places.append([heads(one, names) for one, names in pairs])
        bpy.context.scene.frame_set(0)
        np.savez(FOLDER / f"capture {name}.npz", joints=places)


def bones_of(armature):
    """Return the names of the bones that are COMPARED."""
    from bl_ext.user_default.mimesh import bones

    from mimesh.bodies.joint_names import person_joints

    names, parents = bones.bone_tree(armature)
    joints = person_joints(names, parents)
    return [names[joints[joint]] for joint in COMPARED]


def heads(armature, names):
    """Evaluate the world positions of the heads of bones in the current frame."""
    bpy.context.view_layer.update()
    evaluated = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([evaluated.matrix_world @ evaluated.pose.bones[name].head for name in names])


def variants(driving):
    """Other rotation modes, values left by hand, an armature that stands elsewhere, other options, a single pose."""
    armature, mesh = imported(FOLDER / "own_mixamo.glb")
    for k, bone in enumerate(armature.pose.bones):
        bone.rotation_mode = MODES[k % len(MODES)]
    bpy.context.scene.frame_set(2)
    armature.pose.bones[3].scale, armature.pose.bones[4].location = (1.2, 1, 1), (0.001, 0, 0)
    choose(mesh, driving)
    bpy.ops.mimesh.animate()
    np.savez(FOLDER / "modes.npz", result=played(mesh))
    FACTS["modes"] = sorted({path.split(".")[-1].split()[0] for path in curves(armature.animation_data.action)})
    choose(mesh, driving, range(1, 6, 2), root="keep", ground=False)
    bpy.ops.mimesh.animate()
    np.savez(FOLDER / "step.npz", result=played(mesh, range(1, 6, 2)))
    place = Matrix.LocRotScale((3, 1, 0.2), Matrix.Rotation(math.radians(37), 3, "Z").to_quaternion(), (2, 2, 2))
    armature.matrix_world = place @ armature.matrix_world
    bpy.context.view_layer.update()
    choose(armature, driving)
    bpy.ops.mimesh.animate()
    np.savez(FOLDER / "placed.npz", result=played(mesh), place=np.array(place))
    bpy.context.scene.frame_set(3)
    armature.animation_data_clear()
    actions = len(bpy.data.actions)
    bpy.ops.mimesh.pose()
    np.savez(FOLDER / "posed.npz", result=shown(mesh)[None], place=np.array(place))
    FACTS["posed"] = {"animated": armature.animation_data is not None, "actions": len(bpy.data.actions) - actions}


def constraints(driving):
    armature, mesh = imported(FOLDER / "own_mixamo.glb")
    target = bpy.data.objects.new("target", None)
    target.location = (1, 1, 1)
    bpy.context.scene.collection.objects.link(target)
    kinematics = armature.pose.bones["mixamorig:LeftLeg"].constraints.new("IK")
    kinematics.target, kinematics.chain_count = target, 2
    other = armature.pose.bones["mixamorig:LeftToeBase"].constraints.new("IK")
    other.target, other.mute = target, True
    choose(mesh, driving)
    FACTS["constraints"] = notes()
    np.savez(FOLDER / "constraints.npz", result=played(mesh))
    FACTS["influence"] = [kinematics.influence, other.influence]
    driven = armature.pose.bones["mixamorig:Head"].driver_add("rotation_quaternion", 1)
    driven.driver.expression = "0.5"
    FACTS["driven"] = notes()


def control_rig(driving):
    """Give a character the structure of a generated Rigify rig: deforming bones copy others that have the hierarchy."""
    armature, mesh = imported(FOLDER / "own_rigify.glb")
    armature.animation_data_clear()
    for bone in armature.pose.bones:
        bone.matrix_basis = Matrix()
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    bones = armature.data.edit_bones
    parents = {bone.name: bone.parent.name if bone.parent else None for bone in bones}
    for name in parents:
        original = bones.new(f"ORG-{name}")
        original.head, original.tail, original.roll = bones[name].head, bones[name].tail, bones[name].roll
        original.use_deform = False
        bones[name].use_connect = False
    for name, parent in parents.items():
        bones[f"ORG-{name}"].parent = None if parent is None else bones[f"ORG-{parent}"]
        bones[name].parent = bones[f"ORG-{name}"]
        bones[name].name = f"DEF-{name}"
    bpy.ops.object.mode_set(mode="OBJECT")
    for name in parents:
        copying = armature.pose.bones[f"DEF-{name}"].constraints.new("COPY_TRANSFORMS")
        copying.target, copying.subtarget = armature, f"ORG-{name}"
    choose(mesh, driving)
    FACTS["control rig"] = {"drawn": drawn(), "notes": notes()}
    np.savez(FOLDER / "control_rig.npz", result=played(mesh))


def undone(driving):
    armature, mesh = imported(FOLDER / "own_mixamo.glb")
    choose(mesh, driving)
    counts = {kind: len(getattr(bpy.data, kind)) for kind in ("actions", "objects", "meshes", "armatures")}
    old, name = armature.animation_data.action.name, armature.name
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.mimesh.animate("EXEC_DEFAULT", True)
    between = bpy.data.objects[name].animation_data.action.name
    bpy.ops.ed.undo()
    armature = bpy.data.objects[name]
    FACTS["undone"] = {
        "counts": counts == {kind: len(getattr(bpy.data, kind)) for kind in counts},
        "actions": [old, between, armature.animation_data.action.name],
        "fake": armature.animation_data.action.use_fake_user,
    }


class Layout:
    """Stand-in for a panel's layout that records labels and what is greyed out."""

    def __init__(self, shown=None, enabled=True):
        self.shown, self.enabled = [] if shown is None else shown, enabled

    def prop(self, owner, name):
        self.shown.append((owner.bl_rna.properties[name].name, self))

    def operator(self, name, icon):
        self.shown.append((name, self))

    def label(self, text, icon="NONE"):
        self.shown.append((text, self))

    def row(self, **options):
        return Layout(self.shown, self.enabled)

    column = row


def drawn():
    """Return the texts of the panel, those in grey in brackets."""
    from bl_ext.user_default.mimesh import panel

    texts = []
    for one in (
        panel.MIMESH_PT_main,
        panel.MIMESH_PT_joints,
        panel.MIMESH_PT_motion,
        panel.MIMESH_PT_rig,
        panel.MIMESH_PT_axes,
    ):
        layout = Layout()
        one.draw(SimpleNamespace(layout=layout), bpy.context)
        texts += [text if layout.enabled and part.enabled else f"({text})" for text, part in layout.shown]
    return texts


def drivings(own):
    """Drive by an imported BVH file, by an armature whose mesh is gone, and by unknown bones; shape keys as well."""
    capture, _ = imported(FOLDER / "walk.bvh")
    choose(own, capture, range(1, 10))
    bpy.context.scene.render.fps = 30
    bpy.ops.mimesh.animate()
    np.savez(FOLDER / "capture.npz", result=played(own, range(1, 10)))
    bpy.context.scene.render.fps = FPS
    FACTS["drawn"] = drawn()
    FACTS["joints of a skeleton"] = joints_refusal()
    choose(own, capture, result="SHAPE_KEYS")
    FACTS["no mesh"] = refusal(model="npt")
    FACTS["other model"] = refusal(result="OWN", model="npt")
    FACTS["drawn of another model"] = drawn() if setattr(bpy.context.scene.mimesh, "model", "npt") is None else []
    armature, mesh = imported(FOLDER / "driving.glb")
    choose(own, mesh, result="SHAPE_KEYS")
    bpy.ops.mimesh.animate()
    (made,) = (one for one in bpy.data.objects if one.name.endswith("animated"))
    np.savez(FOLDER / "keys.npz", result=played(made))
    bpy.data.objects.remove(made)
    bpy.data.objects.remove(mesh)
    choose(own, armature)
    bpy.ops.mimesh.animate()
    np.savez(FOLDER / "bare.npz", result=played(own))
    armature.data.pose_position = "REST"
    FACTS["rest position"] = refusal()
    armature.data.pose_position = "POSE"
    armature.scale.x *= 2
    bpy.context.view_layer.update()
    FACTS["unequal scale"] = refusal()
    armature.scale.x /= 2
    FACTS["armature as a mesh"] = refusal(identity=own.find_armature(), result="ARMATURE")
    for bone in armature.data.bones:
        bone.name = "unknown"
    bpy.context.view_layer.update()
    FACTS["unknown driving"] = refusal()


def joints_refusal():
    try:
        bpy.ops.mimesh.show_joints()
    except RuntimeError as error:
        return str(error)
    return ""


def unknown_identity(driving):
    armature, mesh = imported(FOLDER / "own_rigify.glb")
    for bone in armature.data.bones:
        bone.name = "unknown"
    chosen = choose(mesh, driving)
    FACTS["unknown"] = {"result": chosen.result, "drawn": drawn(), "refusal": refusal(result="OWN")}
    chosen.result = "OWN"
    FACTS["unknown"]["grey"] = drawn()


def animals():
    """Animate an animal by another one, as keys of its own armature, as shape keys, and by what must not be."""
    bpy.context.scene.render.fps = 30  # the rate of their files
    armature, mesh = imported(FOLDER / "animal_own.glb")
    driving, _ = imported(FOLDER / "animal_driving.glb")
    chosen = choose(mesh, driving)
    FACTS["animals"] = {"result": chosen.result, "drawn": drawn(), "outcome": list(bpy.ops.mimesh.animate())}
    np.savez(FOLDER / "animals.npz", result=played(mesh))
    FACTS["animals"]["keys"] = sorted(curves(armature.animation_data.action))
    FACTS["joints of animals"] = joints_refusal()
    choose(mesh, driving, result="SHAPE_KEYS")
    FACTS["animals"]["notes"] = notes()
    (made,) = (one for one in bpy.data.objects if one.name.endswith("animated"))
    np.savez(FOLDER / "animal_keys.npz", result=played(made))
    bpy.data.objects.remove(made)
    choose(mesh, driving, result="OWN")
    FACTS["animal as a person"] = refusal(body="human")
    choose(mesh, imported(FOLDER / "driving.glb")[1])
    FACTS["animal by a person"] = refusal()
    bpy.context.scene.render.fps = FPS


def main():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=str(ARCHIVE), repo="user_default", enable_on_install=True)
    bpy.context.scene.render.fps = FPS
    driving, _ = imported(FOLDER / "driving.glb")
    identities(driving)
    written_and_read_as_fbx(driving)
    variants(driving)
    constraints(driving)
    unknown_identity(driving)
    animals()
    captures()
    control_rig(driving)
    drivings(imported(FOLDER / "own_mixamo.glb")[1])
    undone(bpy.data.objects[driving.name])
    (FOLDER / "facts.json").write_text(json.dumps(FACTS))


main()
