"""Script for Blender's Python: install the extension, make a scene, press the buttons, record the results.

    python blender_scene.py EXTENSION.zip FOLDER

The folder has `meshes.npz` (see `test_blender_extension.py`) and `driving.glb`; `facts.json` and an `.npz` for each
case are written into it. The scene is read vertex by vertex here, independently of the extension's code.
"""

import json
import socket
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
from mathutils import Matrix

ARCHIVE, FOLDER = Path(sys.argv[1]), Path(sys.argv[2])
FRAMES = range(3, 9)
ROLES = ("identity", "driving")


def refuse(*arguments):
    raise AssertionError(f"the net was asked for {arguments[1:]}")


def new_object(name, vertices, faces, place):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], faces.tolist())
    made = bpy.data.objects.new(name, mesh)
    made.matrix_world = place
    bpy.context.scene.collection.objects.link(made)
    return made


def new_identity(data):
    """Add the identity, rotated, scaled and moved, with an active shape key that the extension must ignore."""
    made = new_object(
        "hero", data["identity"], data["identity_faces"], Matrix.LocRotScale((3, 1, 0.5), turn(2), (2,) * 3)
    )
    made.shape_key_add(name="Basis")
    fat = made.shape_key_add(name="fat")
    for point in fat.data:
        point.co.x *= 1.5
    fat.value = 1.0
    return made


def new_driving(data):
    """Add the driving mesh, animated by shape keys, its object's location, and a rotated parent empty."""
    frames = data["driving"]
    made = new_object("dancer", frames[0], data["driving_faces"], Matrix.Identity(4))
    made.shape_key_add(name="Basis")
    for t, frame in enumerate(FRAMES):
        key = made.shape_key_add(name=f"f{t}")
        for point, place in zip(key.data, frames[t], strict=True):
            point.co = place
        for other in FRAMES:
            key.value = float(other == frame)
            key.keyframe_insert("value", frame=other)
    for frame in (FRAMES[0], FRAMES[-1]):
        made.location.y = 0.1 * frame
        made.keyframe_insert("location", frame=frame)
    above = bpy.data.objects.new("above", None)
    bpy.context.scene.collection.objects.link(above)
    above.rotation_euler.z = 0.4
    made.parent = above
    return made


def turn(quarters):
    return Matrix.Rotation(quarters * np.pi / 2, 3, "Z").to_euler()


def shown(made):
    """Evaluate the world positions of an object in the current frame."""
    bpy.context.view_layer.update()
    evaluated = made.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    return np.array([evaluated.matrix_world @ vertex.co for vertex in mesh.vertices], np.float64)


def triangles(made):
    made.data.calc_loop_triangles()
    return np.array([list(triangle.vertices) for triangle in made.data.loop_triangles])


def played(made, frames=FRAMES):
    kept = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        kept.append(shown(made))
    bpy.context.scene.frame_set(1)
    return np.stack(kept)


def counts():
    kinds = ("objects", "meshes", "actions", "armatures", "shape_keys")
    return {kind: len(getattr(bpy.data, kind)) for kind in kinds} | {"frame": bpy.context.scene.frame_current}


def state(made):
    return [shown(made).sum(), len(made.data.shape_keys.key_blocks), made.name, *np.array(made.matrix_world).ravel()]


def results():
    """Return the objects that the extension made."""
    return [one for one in bpy.data.objects if one.name.startswith("hero ")]


def tidy():
    for one in results():
        bpy.data.objects.remove(one)
    bpy.data.orphans_purge(do_recursive=True)


def case(name, driving, meshes, operator=None, frames=FRAMES, **settings):
    """Press a button; save the driving frames and the result's frames, and return facts about the result."""
    chosen = bpy.context.scene.mimesh
    chosen.driving = driving
    for key, value in settings.items():
        setattr(chosen, key, value)
    before = state(chosen.identity)
    outcome = (operator or bpy.ops.mimesh.animate)()
    (made,) = (one for one in results() if one.type == "MESH")
    kept = {"result": played(made, frames), "driving": np.concatenate([played(one, frames) for one in meshes], axis=1)}
    np.savez(FOLDER / f"{name}.npz", **kept)
    keys = made.data.shape_keys
    facts = {
        "outcome": list(outcome),
        "unchanged": before == state(chosen.identity),
        "keys": [key.name for key in keys.key_blocks] if keys else [],
        "active": bpy.context.view_layer.objects.active.name,
        "bones": [bone.name for one in results() if one.type == "ARMATURE" for bone in one.data.bones],
    }
    tidy()
    return facts


def stopped(until):
    """Cancel the work at the first message with this text; return the numbers of data blocks before and after."""
    from bl_ext.user_default.mimesh import operator

    before = counts()
    work = operator.transfer(bpy.context, FRAMES, False)
    for _, text in work:
        if until in text:
            break
    work.close()
    return {"before": before, "after": counts()}


class Window:
    """A context with a window, for the steps that a user's clicks would run: background Blender has none."""

    def __init__(self):
        self.window_manager, self.workspace, self.window, self.screen = self, self, self, self
        self.mimesh, self.areas = SimpleNamespace(text="", fraction=0.0), [SimpleNamespace(type="CONSOLE")]
        self.timers, self.texts = 0, []

    def __getattr__(self, name):
        return getattr(bpy.context, name)

    def event_timer_add(self, seconds, window):
        self.timers += 1

    def event_timer_remove(self, timer):
        self.timers -= 1

    def status_text_set(self, text):
        self.texts.append(text)

    def nothing(self, *arguments):
        pass

    progress_begin = progress_update = progress_end = modal_handler_add = nothing


def clicked(escape_at):
    """Click on Animate, press Esc at the first message that contains `escape_at`, and return what happened."""
    from bl_ext.user_default.mimesh import operator

    methods = {name: value for name, value in vars(operator._TransferOperator).items() if callable(value)}
    button = type("Button", (), methods | {"single_pose": False, "report": print})()
    button.frames = lambda context: FRAMES
    before, window, timer = counts(), Window(), SimpleNamespace(type="TIMER")
    operator.bpy = SimpleNamespace(app=SimpleNamespace(background=False))
    outcome = button.invoke(window, timer)
    assert button.modal(window, SimpleNamespace(type="MOUSEMOVE")) == outcome
    while outcome == {"RUNNING_MODAL"}:
        escape = any(escape_at in text for text in window.texts)
        outcome = button.modal(window, SimpleNamespace(type="ESC") if escape else timer)
    operator.bpy = bpy
    facts = {"outcome": list(outcome), "timers": window.timers, "text": window.mimesh.text, "last": window.texts[-1]}
    facts |= {"steps": len(window.texts), "left": before == counts()}
    tidy()
    return facts


class Layout:
    """Stand-in for a panel's layout that records labels; an unknown property or operator is an error."""

    def __init__(self):
        self.shown = []

    def prop(self, owner, name):
        self.shown.append(owner.bl_rna.properties[name].name)

    def operator(self, name, icon):
        self.shown.append(getattr(bpy.ops.mimesh, name.split(".")[1]).get_rna_type().name)

    def row(self, **options):
        return self

    column = row

    def label(self, text, icon="NONE"):
        self.shown.append(text)


def drawn():
    """Return the labels that the panels draw."""
    from bl_ext.user_default.mimesh import panel

    layout = Layout()
    for one in (
        panel.MIMESH_PT_main,
        panel.MIMESH_PT_joints,
        panel.MIMESH_PT_motion,
        panel.MIMESH_PT_rig,
        panel.MIMESH_PT_axes,
    ):
        one.draw(SimpleNamespace(layout=layout), bpy.context)
    return layout.shown


def modified(kind):
    """Pose a hidden identity with a modifier; return the result's modifiers and the change of its points."""
    chosen = bpy.context.scene.mimesh
    chosen.identity.modifiers.new("its own", kind)
    chosen.identity.hide_viewport = True
    bpy.ops.mimesh.pose()
    (made,) = (one for one in results() if one.type == "MESH")
    facts = {"modifiers": [one.type for one in made.modifiers], "vertices": len(made.data.vertices)}
    bare = np.array([vertex.co for vertex in chosen.identity.data.vertices])
    facts["apart"] = float(np.abs(bare - np.array([vertex.co for vertex in made.data.vertices])).max())
    chosen.identity.modifiers.clear()
    chosen.identity.hide_viewport = False
    tidy()
    return facts


def rigged(name, names="own", rest="file"):
    """Press Rig; save the bones and weights of the copy, and return facts about it."""
    settings = bpy.context.scene.mimesh
    identity, settings.names, settings.rest = settings.identity, names, rest
    before = state(identity)
    outcome = bpy.ops.mimesh.rig()
    (made,) = (one for one in results() if one.type == "MESH")
    (armature,) = (one for one in results() if one.type == "ARMATURE")
    names = [bone.name for bone in armature.data.bones]
    weights = np.zeros((len(made.data.vertices), len(names)))
    for vertex in made.data.vertices:
        for entry in vertex.groups:
            weights[vertex.index, names.index(made.vertex_groups[entry.group].name)] = entry.weight
    np.savez(FOLDER / f"{name}.npz", shown=shown(made), weights=weights, heads=heads(armature, names))
    facts = {"outcome": list(outcome), "unchanged": before == state(identity), "bones": names}
    facts["modifiers"] = [(one.type, one.object == armature) for one in made.modifiers]
    facts |= {"keys": bool(made.data.shape_keys), "animated": bool(armature.animation_data), "made": made.name}
    tidy()
    return facts


def captured(driving):
    """Press Capture; save the bones' heads in every frame, and return facts about the armature."""
    bpy.context.scene.mimesh.driving = driving
    outcome = bpy.ops.mimesh.capture()
    made = bpy.context.view_layer.objects.active
    names, places = [bone.name for bone in made.data.bones], []
    for frame in FRAMES:
        bpy.context.scene.frame_set(frame)
        places.append(heads(made, names))
    bpy.context.scene.frame_set(1)
    np.savez(FOLDER / "captured.npz", heads=places, result=places, driving=played(driving))
    facts = {"outcome": list(outcome), "bones": names, "made": made.name, "action": made.animation_data.action.name}
    bpy.data.objects.remove(made)
    bpy.data.orphans_purge(do_recursive=True)
    return facts


def heads(armature, names):
    """Evaluate the world positions of the heads of bones in the current frame."""
    bpy.context.view_layer.update()
    evaluated = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return np.array([evaluated.matrix_world @ evaluated.pose.bones[name].head for name in names])


def refusal(operator=None, **settings):
    chosen = bpy.context.scene.mimesh
    old = {key: getattr(chosen, key) for key in settings}
    for key, value in settings.items():
        setattr(chosen, key, value)
    try:
        (operator or bpy.ops.mimesh.animate)()
    except RuntimeError as error:
        return str(error)
    finally:
        for key, value in old.items():
            setattr(chosen, key, value)
    return ""


def empties(role):
    """Return the empties of joints: joint -> object."""
    return {one["mimesh_joint"]: one for one in bpy.data.objects if one.get("mimesh_role") == role}


def corrected(driving):
    """Show the joints, move two of them, pose, show them again, and clear; return what happened."""
    scene = bpy.context.scene
    scene.mimesh.driving, scene.mimesh.model, scene.mimesh.result = driving, "mime", "SHAPE_KEYS"
    before = counts()
    bpy.ops.mimesh.show_joints()
    bpy.context.view_layer.update()
    found = {role: {n: list(one.matrix_world.translation) for n, one in empties(role).items()} for role in ROLES}
    facts = {"joints": sorted(found["identity"]), "same": sorted(found["driving"]) == sorted(found["identity"])}
    (parent,) = {one.parent for one in empties("identity").values()}
    facts["parent"] = parent.name
    # Half of the size of the identity's object: its children move twice as far in the world.
    empties("identity")["LeftLeg"].location.x += 0.05
    empties("driving")["RightForeArm"].location.z += 0.03
    bpy.context.view_layer.update()
    moved = {"identity": ["LeftLeg"], "driving": ["RightForeArm"]}
    picked = {role: {n: list(empties(role)[n].matrix_world.translation) for n in moved[role]} for role in ROLES}
    facts["drawn"] = drawn()
    facts["posed"] = case("corrected", driving, [driving], bpy.ops.mimesh.pose, [scene.frame_current])
    np.savez(FOLDER / "picked.npz", **{role: np.array(list(picked[role].values())) for role in ROLES})
    bpy.ops.mimesh.show_joints()
    bpy.context.view_layer.update()
    facts["kept"] = [
        float(np.abs(np.subtract(empties(role)[n].matrix_world.translation, picked[role][n])).max())
        for role in ROLES
        for n in moved[role]
    ]
    facts["other frames"] = refusal(use_scene_range=False, frame_start=5, frame_end=6)
    bpy.ops.mimesh.clear_joints()
    facts["cleared"] = before == counts()
    return facts


def main():
    socket.socket.connect = refuse
    socket.getaddrinfo = refuse
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=str(ARCHIVE), repo="user_default", enable_on_install=True)
    assert "mimesh" not in sys.modules, "mimesh must not be imported before it is used"
    data = np.load(FOLDER / "meshes.npz")
    identity, driving = new_identity(data), new_driving(data)
    rest = np.array([identity.matrix_world @ vertex.co for vertex in identity.data.vertices])
    bpy.ops.import_scene.gltf(filepath=str(FOLDER / "driving.glb"))
    (armature,) = (one for one in bpy.data.objects if one.type == "ARMATURE")
    (skin,) = (one for one in armature.children_recursive if one.type == "MESH")
    for bone in armature.data.bones:
        bone.name = "unknown"  # known bones would be used in place of the surface
    scene = bpy.context.scene
    scene.render.fps = 24
    scene.frame_start, scene.frame_end = FRAMES[0], FRAMES[-1]
    scene.frame_set(1)
    scene.mimesh.identity, scene.mimesh.driving = identity, driving
    still = [scene.frame_current]
    facts = {"stopped": [stopped("reading frame 3"), stopped("moving the identity")]}
    facts["clicked"] = [clicked("reading frame 2"), clicked("moving"), clicked("nothing")]
    facts["drawn"] = drawn()
    facts["no frames"] = refusal(use_scene_range=False, frame_start=5, frame_end=4)
    facts["no joints"] = refusal(model="npt-maxpool", result="ARMATURE")
    facts["no rig"] = refusal(bpy.ops.mimesh.rig, model="npt")
    facts["no capture"] = refusal(bpy.ops.mimesh.capture, model="npt")
    facts["rigged"], facts["captured"] = rigged("rigged"), captured(driving)
    facts["rigged for mixamo"] = rigged("rigged for mixamo", "mixamo", "T")
    facts["keys"] = case("keys", driving, [driving])
    facts["other"] = case("other", driving, [driving], model="npt-maxpool")
    facts["bones"] = case("bones", driving, [driving], model="mime", result="ARMATURE", root="keep", ground=True)
    facts["skinned"] = case("skinned", armature, [skin], root="scale", ground=False)
    facts["posed"] = case("posed", armature, [skin], bpy.ops.mimesh.pose, still)
    facts["modified"] = {kind: modified(kind) for kind in ("SUBSURF", "SMOOTH")}
    facts["pose key"] = case("pose key", driving, [driving], bpy.ops.mimesh.pose, still, result="SHAPE_KEYS")
    facts["corrected"] = corrected(driving)
    np.savez(
        FOLDER / "scene.npz", identity=rest, faces=triangles(identity), driving=triangles(driving), skin=triangles(skin)
    )
    (FOLDER / "facts.json").write_text(json.dumps(facts))


main()
