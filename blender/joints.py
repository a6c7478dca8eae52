# SPDX-License-Identifier: GPL-3.0-or-later
"""Empties for the joints that mimesh finds: the user moves those that are wrong, and moved ones become corrections.

Empties of the identity are its children. Those of the driving stay in world space: they belong to the frame in which
they were shown.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import numpy as np

if TYPE_CHECKING:
    from mimesh import ClipResult
    from mimesh.core.joint_corrections import JointCorrections

COLLECTION = "mimesh joints"
JOINT, ROLE, FOUND, FRAME = "mimesh_joint", "mimesh_role", "mimesh_found", "mimesh_frame"
"""Custom properties of an empty: its joint, identity or driving, where it was found (its location), and the frame."""
SIZE = 0.012
"""Radius of an empty, as a share of the height of the mesh."""
MOVED = 1e-4
"""Distance from which on an empty counts as moved, in its radius."""


def show(context: bpy.types.Context, result: ClipResult, frame: int) -> None:
    """Make an empty for each joint of identity and driving; empties that were moved stay where they are."""
    from mimesh.pipeline.known import shown_bones

    settings = context.scene.mimesh
    kept = {role: moved(context, role) for role in ("identity", "driving")}
    clear(context)
    collection = bpy.data.collections.new(COLLECTION)
    context.scene.collection.children.link(collection)
    for role, joints, mesh in (
        ("identity", result.joints, result.identity),
        ("driving", result.driving_joints, result.driving.mesh),
    ):
        radius = SIZE * float(np.ptp(mesh.vertices, axis=0).max())
        parent = settings.identity if role == "identity" else None
        for name in shown_bones(result.report["body"]):
            empty = bpy.data.objects.new(f"{name} ({settings.identity.name if parent else role})", None)
            collection.objects.link(empty)
            empty.empty_display_type, empty.empty_display_size = "SPHERE", radius
            empty.show_in_front = empty.show_name = True
            empty.parent = parent
            if parent is not None:
                empty.matrix_parent_inverse = parent.matrix_world.inverted()
            empty.location = joints[name]
            empty[JOINT], empty[ROLE], empty[FRAME] = name, role, frame
            # A kept empty has another place than the one that it was found at: it still counts as moved.
            empty[FOUND] = [np.inf] * 3 if name in kept[role] else list(empty.location)
    context.view_layer.update()


def clear(context: bpy.types.Context) -> None:
    """Remove all empties of joints from the scene, and with them the corrections."""
    for empty in _empties(context):
        bpy.data.objects.remove(empty)
    for collection in [c for c in context.scene.collection.children if c.name.split(".")[0] == COLLECTION]:
        if not collection.all_objects:
            bpy.data.collections.remove(collection)


def moved(context: bpy.types.Context, role: str) -> dict[str, np.ndarray]:
    """Return the world positions of the empties of a role that were moved: joint -> (3,)."""
    context.view_layer.update()
    return {
        empty[JOINT]: np.array(empty.matrix_world.translation, np.float64) for empty in moved_empties(context, role)
    }


def moved_empties(context: bpy.types.Context, role: str) -> list[bpy.types.Object]:
    """Return the empties of a role that were moved, without evaluating the scene: panels may not."""
    return [
        empty
        for empty in _empties(context)
        if empty[ROLE] == role
        and np.linalg.norm(np.subtract(empty.location, empty[FOUND])) > MOVED * empty.empty_display_size
    ]


def of_identity(context: bpy.types.Context) -> JointCorrections | None:
    """Return the corrections of the empties of the identity that were moved; None without any."""
    from mimesh.core.joint_corrections import JointCorrections

    positions = moved(context, "identity")
    return JointCorrections.of(positions, "joints of the identity") if positions else None


def of_driving(context: bpy.types.Context, frames: range) -> JointCorrections | None:
    """As `of_identity`, of the driving; `frames` are those taken.

    Raises:
        InputError: joints were moved in a frame that is not taken.
    """
    from mimesh import InputError
    from mimesh.core.joint_corrections import JointCorrections

    positions = moved(context, "driving")
    if not positions:
        return None
    (frame,) = {empty[FRAME] for empty in _empties(context) if empty[ROLE] == "driving"}
    if frame not in frames:
        raise InputError(
            f"joints of the driving: expected frame {frame}, in which they were shown, among those taken, found "
            f"{frames[0]} to {frames[-1]} in steps of {frames.step}; change the range, or show the joints again"
        )
    return JointCorrections.of(positions, "joints of the driving", frame=frames.index(frame))


def refuse_moved(context: bpy.types.Context, role: str) -> None:
    """Raise InputError if joints of a role were moved, where bones say where they are."""
    from mimesh import InputError

    if count := len(moved_empties(context, role)):
        raise InputError(
            f"joints of the {role}: expected none that were moved, because its armature has them, found {count}; clear "
            "them, or choose another Result"
        )


def _empties(context: bpy.types.Context) -> list[bpy.types.Object]:
    return [one for one in context.scene.objects if one.type == "EMPTY" and JOINT in one]
