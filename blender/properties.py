# SPDX-License-Identifier: GPL-3.0-or-later
"""What the user chooses, kept with the scene, and how far the work is, kept with the window."""

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty
from bpy.types import Object, PropertyGroup

MODELS = (
    ("mime", "mime", "Reads the joints of both meshes and turns the one's as the other's; the best, made for people"),
    ("skeleton", "skeleton", "Fits a person to both meshes, frame by frame; takes seconds a frame"),
    ("npt", "NPT", "Neural Pose Transfer (2020), frame by frame"),
    ("npt-maxpool", "NPT, max-pooled", "Its variant with one pose code"),
    ("aniformer", "AniFormer", "AniFormer (2021), three frames at once"),
)
RESULTS = (
    ("SHAPE_KEYS", "Shape keys", "One shape key a frame, on a copy of the mesh"),
    ("ARMATURE", "Armature", "Bones, weights and an action, on a copy of the mesh (mime only)"),
)
ROOTS = (
    ("scale", "As far as its legs go", "The way over the ground is as much longer or shorter as the legs are"),
    ("keep", "As far as the driving", "The way over the ground is that of the driving"),
    ("drop", "In place", "No way over the ground"),
)
AXES = tuple((axis, axis.upper(), f"{axis} of world space") for axis in ("+x", "-x", "+y", "-y", "+z", "-z"))
FRONTS = (("auto", "Found", "Found from the shape"), *AXES)


def _shows_a_mesh(settings: PropertyGroup, candidate: Object) -> bool:
    return candidate.type == "MESH"


def _may_drive(settings: PropertyGroup, candidate: Object) -> bool:
    return candidate.type in {"MESH", "ARMATURE", "EMPTY"}


class MimeshSettings(PropertyGroup):
    """One transfer."""

    identity: PointerProperty(
        name="Identity", type=Object, poll=_shows_a_mesh, description="Mesh to be moved; it stays, a copy of it moves"
    )
    driving: PointerProperty(
        name="Driving",
        type=Object,
        poll=_may_drive,
        description="What it imitates, however that is moved: a mesh, or an armature or empty and the meshes below it",
    )
    model: EnumProperty(name="Model", items=MODELS, default="mime")
    result: EnumProperty(name="Result", items=RESULTS, default="SHAPE_KEYS")
    use_scene_range: BoolProperty(name="Scene range", default=True, description="Take the frames that the scene plays")
    frame_start: IntProperty(name="Start", default=1)
    frame_end: IntProperty(name="End", default=250)
    frame_step: IntProperty(name="Step", default=1, min=1, description="Take every so many frames")
    root: EnumProperty(name="Way", items=ROOTS, default="scale", description="How far it goes (mime only)")
    ground: BoolProperty(
        name="Keep feet on the ground", default=False, description="Feet stay where they stand (mime only)"
    )
    smooth: FloatProperty(
        name="Smooth",
        default=0.0,
        min=0.0,
        soft_max=0.5,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
        precision=3,
        description="Average turns and ways over so many seconds (mime only)",
    )
    identity_up: EnumProperty(name="Up", items=AXES, default="+z", description="Up of the identity in world space")
    identity_front: EnumProperty(
        name="Front", items=FRONTS, default="auto", description="Where the identity faces in world space"
    )
    driving_up: EnumProperty(name="Up", items=AXES, default="+z", description="Up of the driving in world space")
    driving_front: EnumProperty(
        name="Front", items=FRONTS, default="auto", description="Where the driving faces in world space"
    )

    def frames(self, scene) -> range:
        """Frames of the scene that are taken."""
        if self.use_scene_range:
            return range(scene.frame_start, scene.frame_end + 1, self.frame_step)
        return range(self.frame_start, self.frame_end + 1, self.frame_step)

    def options(self) -> dict:
        """What `mimesh.animate` is given besides the meshes; options that only mime has go to no other model."""
        fronts = [None if front == "auto" else front for front in (self.identity_front, self.driving_front)]
        options = {
            "model": self.model,
            "up": self.identity_up,
            "front": fronts[0],
            "driving_up": self.driving_up,
            "driving_front": fronts[1],
            "skinned": self.result == "ARMATURE",
        }
        if self.model == "mime":
            options |= {"root": self.root, "ground": self.ground, "smooth": self.smooth}
        return options


class MimeshProgress(PropertyGroup):
    """How far the work is, for the panel."""

    text: StringProperty(options={"SKIP_SAVE"})
    fraction: FloatProperty(min=0.0, max=1.0, options={"SKIP_SAVE"})
