# SPDX-License-Identifier: GPL-3.0-or-later
"""The user's settings, stored with the scene, and the progress, stored with the window manager."""

from typing import TYPE_CHECKING

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty
from bpy.types import Context, Object, PropertyGroup

from . import bones, reading

if TYPE_CHECKING:
    from mimesh import Layout, MotionOptions

MODELS = (
    (
        "mime",
        "mime",
        "Predicts joints and skinning weights of both meshes; fast, made for people and four-legged animals",
    ),
    ("npt", "NPT", "Neural Pose Transfer (2020), frame by frame"),
    ("npt-maxpool", "NPT, max-pooled", "Its variant with one pose code"),
    ("aniformer", "AniFormer", "AniFormer (2021), three frames at once"),
)
RESULTS = (
    ("OWN", "Own armature", "A new action on the identity's own armature, whose action before is kept (mime only)"),
    ("SHAPE_KEYS", "Shape keys", "One shape key per frame, on a copy of the mesh"),
    ("ARMATURE", "New armature", "Bones, weights and an action, on a copy of the mesh (mime only)"),
)
ROOTS = (
    ("scale", "Scaled by leg length", "Distances on the ground are scaled by the ratio of leg lengths"),
    ("keep", "As far as the driving", "Distances on the ground are those of the driving"),
    ("drop", "In place", "No motion along the ground"),
)
BODIES = (
    ("auto", "Detected", "By their bones or their shapes"),
    ("human", "People", "Two people"),
    ("quadruped", "Four-legged animals", "Two four-legged animals"),
)
NAMES = (
    ("own", "mimesh", "The joints' own names"),
    ("mixamo", "Mixamo", "Names and hierarchy of Mixamo"),
    ("unreal", "Unreal", "Names and hierarchy of Unreal Engine 5"),
    ("vrm", "VRM", "Names of VRM's humanoid bones"),
    ("godot", "Godot", "Names and hierarchy of Godot 4"),
    ("rigify", "Rigify", "Names of the deform bones of Rigify"),
)
RESTS = (
    ("file", "As it is", "The pose that the identity is in"),
    ("T", "T-pose", "Arms to the sides"),
    ("A", "A-pose", "Arms obliquely down"),
)
AXES = tuple((axis, axis.upper(), f"{axis} of world space") for axis in ("+x", "-x", "+y", "-y", "+z", "-z"))
FRONTS = (("auto", "Detected", "Detected from the shape"), *AXES)


def _can_move(settings: PropertyGroup, candidate: Object) -> bool:
    return candidate.type in {"MESH", "ARMATURE"}


def _can_drive(settings: PropertyGroup, candidate: Object) -> bool:
    return candidate.type in {"MESH", "ARMATURE", "EMPTY"}


def _choose_result(settings: PropertyGroup, context: Context) -> None:
    """Choose the identity's own armature as the result where it is a person's or an animal's, another where not."""
    armature, axes = bones.armature_of(settings.identity), (settings.identity_up, settings.front("identity"))
    person = armature is not None and bones.known_bones(armature)[1] > 0
    unknown = armature is not None and not person
    settings.animal_bones = reading.count_animal_bones(context, settings.identity, *axes) if unknown else 0
    if person or settings.animal_bones:
        settings.result = "OWN"
    elif settings.result == "OWN":
        settings.result = "SHAPE_KEYS"


class MimeshSettings(PropertyGroup):
    """Settings of a transfer."""

    identity: PointerProperty(
        name="Identity",
        type=Object,
        poll=_can_move,
        update=_choose_result,
        description="Mesh to move, or its armature; a copy of the mesh moves, or its own armature gets a new action",
    )
    driving: PointerProperty(
        name="Driving",
        type=Object,
        poll=_can_drive,
        description="Object with the motion: an animated mesh, an armature, or an empty with its child meshes",
    )
    model: EnumProperty(name="Model", items=MODELS, default="mime")
    body: EnumProperty(
        name="Both are",
        items=BODIES,
        default="auto",
        description="What identity and driving are: two people, or two four-legged animals (mime only)",
    )
    animal_bones: IntProperty(options={"HIDDEN"})
    result: EnumProperty(name="Result", items=RESULTS, default="SHAPE_KEYS")
    use_scene_range: BoolProperty(name="Scene range", default=True, description="Use the frame range of the scene")
    frame_start: IntProperty(name="Start", default=1)
    frame_end: IntProperty(name="End", default=250)
    frame_step: IntProperty(name="Step", default=1, min=1, description="Use every n-th frame")
    root: EnumProperty(
        name="Root motion", items=ROOTS, default="scale", description="Motion along the ground (mime only)"
    )
    ground: BoolProperty(
        name="Keep feet on the ground",
        default=True,
        description="Soles slide no more than those of the driving while they stand on the ground (mime only)",
    )
    contacts: BoolProperty(
        name="Keep hands in contact",
        default=True,
        description="Hands touch the body where those of the driving do, and arms stay out of it (mime only)",
    )
    smooth: FloatProperty(
        name="Smooth",
        default=0.0,
        min=0.0,
        soft_max=0.5,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
        precision=3,
        description="Average rotations and positions over so many seconds (mime only)",
    )
    names: EnumProperty(
        name="Bone names", items=NAMES, default="own", description="Bones of what Rig makes of a person, for an engine"
    )
    rest: EnumProperty(
        name="Rest pose", items=RESTS, default="file", description="Pose that Rig binds the copy of a person in"
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
        """Return the frames of the scene to be used."""
        if self.use_scene_range:
            return range(scene.frame_start, scene.frame_end + 1, self.frame_step)
        return range(self.frame_start, self.frame_end + 1, self.frame_step)

    def front(self, which: str) -> str | None:
        """Return the front of identity or driving; None: it is to be detected."""
        front = getattr(self, f"{which}_front")
        return None if front == "auto" else front

    def layout(self) -> "Layout":
        """Return how the bones that Rig makes are arranged."""
        from mimesh import Layout

        return Layout(self.names, rest=self.rest)

    def hints(self) -> dict:
        """Return what is known of both meshes, as `mimesh.Hints` has it."""
        return {
            "up": self.identity_up,
            "front": self.front("identity"),
            "driving_up": self.driving_up,
            "driving_front": self.front("driving"),
            "body": self.body if self.model == "mime" else "auto",
        }

    def motion(self) -> "MotionOptions":
        """Return how joints move; options of mime are left out for other models."""
        from mimesh import MotionOptions

        names = ("root", "ground", "contacts", "smooth") if self.model == "mime" else ()
        of_joints = {name: getattr(self, name) for name in names}
        return MotionOptions(skinned=self.result == "ARMATURE", **of_joints)


class MimeshProgress(PropertyGroup):
    """Progress of the running operator, for the panel; the text is empty without one."""

    text: StringProperty(options={"SKIP_SAVE"})
    fraction: FloatProperty(min=0.0, max=1.0, options={"SKIP_SAVE"})
