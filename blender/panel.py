# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab "mimesh" in the sidebar of the 3D view: two object fields, options, buttons."""

from bpy.types import Context, Object, Panel, UILayout

from . import bones, joints
from .properties import MimeshSettings


class _Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "mimesh"


class MIMESH_PT_main(_Sidebar, Panel):
    bl_label = "mimesh"

    def draw(self, context: Context) -> None:
        layout, settings = _form(self.layout, context)
        for which in ("identity", "driving"):
            layout.prop(settings, which)
            if (text := _bones_text(settings, which)) is not None:
                layout.label(text=text, icon="ARMATURE_DATA")
        layout.prop(settings, "model")
        row = layout.row()
        row.enabled = settings.model == "mime"
        row.prop(settings, "body")
        layout.prop(settings, "result")
        problem = _problem(settings)
        if problem is not None:
            layout.label(text=problem, icon="ERROR")
        _draw_range(layout, settings)
        _draw_buttons(self.layout, context, usable=problem is None)


class MIMESH_PT_joints(_Sidebar, Panel):
    bl_label = "Joints"
    bl_parent_id = "MIMESH_PT_main"
    bl_options = frozenset({"DEFAULT_CLOSED"})

    def draw(self, context: Context) -> None:
        layout, settings = _form(self.layout, context)
        # Joints of an armature need not be found.
        known = settings.result == "OWN" and bool(_known(settings.driving))
        layout.enabled = settings.model == "mime" and not known
        row = layout.row(align=True)
        row.operator("mimesh.show_joints", icon="EMPTY_DATA")
        row.operator("mimesh.clear_joints", icon="X")
        counts = [len(joints.moved_empties(context, role)) for role in ("identity", "driving")]
        if any(counts):
            layout.label(text=f"Moved: {counts[0]} of the identity, {counts[1]} of the driving")


class MIMESH_PT_motion(_Sidebar, Panel):
    bl_label = "Motion"
    bl_parent_id = "MIMESH_PT_main"
    bl_options = frozenset({"DEFAULT_CLOSED"})

    def draw(self, context: Context) -> None:
        layout, settings = _form(self.layout, context)
        layout.enabled = settings.model == "mime"
        layout.prop(settings, "root")
        layout.prop(settings, "ground")
        layout.prop(settings, "contacts")
        layout.prop(settings, "smooth")


class MIMESH_PT_rig(_Sidebar, Panel):
    bl_label = "Rig"
    bl_parent_id = "MIMESH_PT_main"
    bl_options = frozenset({"DEFAULT_CLOSED"})

    def draw(self, context: Context) -> None:
        layout, settings = _form(self.layout, context)
        layout.enabled = settings.model == "mime"
        layout.prop(settings, "names")
        layout.prop(settings, "rest")


class MIMESH_PT_axes(_Sidebar, Panel):
    bl_label = "Facing"
    bl_parent_id = "MIMESH_PT_main"
    bl_options = frozenset({"DEFAULT_CLOSED"})

    def draw(self, context: Context) -> None:
        layout, settings = _form(self.layout, context)
        for which in ("identity", "driving"):
            column = layout.column(align=True, heading=which.capitalize())
            column.prop(settings, f"{which}_up")
            column.prop(settings, f"{which}_front")


def _form(layout: UILayout, context: Context) -> tuple[UILayout, MimeshSettings]:
    """Set up a layout with names on the left and without keyframe buttons; returns it and the settings."""
    layout.use_property_split = True
    layout.use_property_decorate = False
    return layout, context.scene.mimesh


def _draw_range(layout: UILayout, settings: MimeshSettings) -> None:
    layout.prop(settings, "use_scene_range")
    column = layout.column(align=True)
    if not settings.use_scene_range:
        column.prop(settings, "frame_start")
        column.prop(settings, "frame_end")
    column.prop(settings, "frame_step")


def _known(source: Object | None) -> int:
    """Count the bones of a person in the armature of an object."""
    armature = bones.armature_of(source)
    return 0 if armature is None else bones.known_bones(armature)[1]


def _own_bones(settings: MimeshSettings) -> int:
    """Count the known bones in the identity's armature."""
    return _known(settings.identity) or settings.animal_bones


def _bones_text(settings: MimeshSettings, which: str) -> str | None:
    """Tell in a line what is known of the armature of identity or driving; None without one."""
    armature = bones.armature_of(getattr(settings, which))
    if armature is None:
        return None
    count, known = bones.known_bones(armature)
    if which == "identity" and settings.animal_bones:
        return f"{count} bones, {settings.animal_bones} of an animal"
    return f"{count} bones, {known} of a person" if known else f"{count} bones, not known as a person's"


def _problem(settings: MimeshSettings) -> str | None:
    """Tell why the result that is chosen cannot be made; None: it can."""
    if settings.result != "SHAPE_KEYS" and settings.model != "mime":
        return "Only mime has joints"
    if settings.result == "OWN" and settings.identity is not None and not _own_bones(settings):
        return "No known armature: choose another result"
    if settings.result != "OWN" and settings.identity is not None and settings.identity.type == "ARMATURE":
        return "Choose the mesh, or Own armature"
    return None


def _draw_buttons(layout: UILayout, context: Context, usable: bool) -> None:
    """Draw the buttons, or the progress while one of them is running."""
    progress = context.window_manager.mimesh
    if progress.text:
        layout.progress(factor=progress.fraction, text=progress.text)
        layout.label(text="Esc cancels")
        return
    row = layout.row(align=True)
    row.scale_y, row.enabled = 1.4, usable
    row.operator("mimesh.animate", icon="PLAY")
    row.operator("mimesh.pose", icon="ARMATURE_DATA")
    row = layout.row(align=True)
    row.enabled = context.scene.mimesh.model == "mime"
    row.operator("mimesh.rig", icon="OUTLINER_OB_ARMATURE")
    row.operator("mimesh.capture", icon="ACTION")
