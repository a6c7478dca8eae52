# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds a copy of the identity from mimesh's result: with shape keys, or with an armature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np

from . import animating
from .reading import Identity, rest_copy

if TYPE_CHECKING:
    from mimesh import ClipResult
    from mimesh.core.animated_rig import AnimatedRig

MIN_BONE = 0.01
"""Smallest length of a bone, as a share of the size of the mesh; Blender deletes bones without length."""


@dataclass(frozen=True, eq=False)
class Transfer:
    """A result of mimesh with its inputs in the scene."""

    source: bpy.types.Object
    identity: Identity
    result: ClipResult
    frames: range
    """Frames of the scene that the result's frames belong to."""
    single_pose: bool
    """Whether it is one pose, without keys."""

    @property
    def name(self) -> str:
        return f"{self.source.name} {'posed' if self.single_pose else 'animated'}"


def build_shape_keys(context: bpy.types.Context, transfer: Transfer) -> bpy.types.Object:
    """Build a copy with a shape key for each frame after the first, which is the basis.

    Between two frames their keys are mixed, so that vertices move linearly. The basis of a pose is the identity at
    rest.
    """
    copy = _copy(context, transfer)
    world = transfer.result.clip.vertices
    if not transfer.single_pose:
        _set_points(copy.data.vertices, _local(copy, world[0]))
    copy.shape_key_add(name="Basis", from_mix=False)
    keyed_frames = [0] if transfer.single_pose else range(1, len(world))
    for t in keyed_frames:
        key = copy.shape_key_add(name=f"frame {transfer.frames[t]}", from_mix=False)
        _set_points(key.data, _local(copy, world[t]))
        key.value = float(transfer.single_pose)
    if len(world) > 1:
        animating.key_shapes(copy.data.shape_keys, transfer.name, transfer.frames)
    return copy


def build_armature(context: bpy.types.Context, transfer: Transfer) -> bpy.types.Object:
    """Build a copy with an armature of the result's joints, four weights per vertex, and an action of the bones."""
    skeleton = transfer.result.skeleton
    assert skeleton is not None, "mimesh was called with skinned=True"
    copy = _copy(context, transfer)
    origin = np.array(copy.matrix_world.translation)
    rig = bpy.data.objects.new(f"{transfer.name} rig", bpy.data.armatures.new(transfer.name))
    rig.location = copy.matrix_world.translation
    _add_beside(context, transfer.source, rig)
    select(context, rig)
    _add_bones(rig, skeleton, origin)
    _add_weights(copy, skeleton)
    copy.parent = rig
    copy.matrix_parent_inverse = rig.matrix_world.inverted()
    modifier = copy.modifiers.new("Armature", "ARMATURE")
    modifier.object = rig
    modifier.use_deform_preserve_volume = False
    # The armature comes first: other modifiers (subdivision, mirror) apply to the posed mesh.
    copy.modifiers.move(len(copy.modifiers) - 1, 0)
    animating.pose_bones(rig, skeleton, origin, transfer.name, None if transfer.single_pose else transfer.frames)
    return rig


def _copy(context: bpy.types.Context, transfer: Transfer) -> bpy.types.Object:
    """Copy the identity at rest and in place, and select the copy; modifiers applied to the vertices are removed."""
    copy = rest_copy(transfer.source)
    copy.name = copy.data.name = transfer.name
    _add_beside(context, transfer.source, copy)
    if transfer.identity.baked:
        copy.modifiers.clear()
    select(context, copy)
    _set_points(copy.data.vertices, _local(copy, transfer.identity.mesh.vertices))
    return copy


def _add_beside(context: bpy.types.Context, source: bpy.types.Object, added: bpy.types.Object) -> None:
    """Link an object to the collections of the source if it is visible, else to that of the scene."""
    for collection in source.users_collection if source.visible_get() else [context.scene.collection]:
        collection.objects.link(added)


def select(context: bpy.types.Context, selected: bpy.types.Object) -> None:
    """Make an object active and the only selected one; updates its world matrix first."""
    context.view_layer.update()
    for other in context.view_layer.objects:
        other.select_set(other == selected)
    context.view_layer.objects.active = selected


def _local(copy: bpy.types.Object, world: np.ndarray) -> np.ndarray:
    """Transform world coordinates (V, 3) to those of the object."""
    world_to_object = np.linalg.inv(np.array(copy.matrix_world, dtype=np.float64))
    return world.astype(np.float64) @ world_to_object[:3, :3].T + world_to_object[:3, 3]


def _set_points(points: bpy.types.bpy_prop_collection, values: np.ndarray) -> None:
    points.foreach_set("co", np.ascontiguousarray(values, np.float32).ravel())


def _add_bones(rig: bpy.types.Object, skeleton: AnimatedRig, origin: np.ndarray) -> None:
    """Add a bone for each joint, towards the next one; the direction of a bone has no effect on the mesh."""
    heads = skeleton.rig.joints - origin
    tails = _tails(skeleton, heads)
    # Bones can be added in edit mode only, which needs the armature to be active.
    bpy.ops.object.mode_set(mode="EDIT")
    bones = [rig.data.edit_bones.new(name) for name in skeleton.names]
    for bone, parent, head, tail, rotation in zip(
        bones, skeleton.parents, heads, tails, skeleton.rig.rotation, strict=True
    ):
        bone.head, bone.tail = head, tail
        bone.align_roll(rotation[:, 2])
        bone.parent = None if parent < 0 else bones[parent]
    bpy.ops.object.mode_set(mode="OBJECT")
    rig.show_in_front = True


def _tails(skeleton: AnimatedRig, heads: np.ndarray) -> np.ndarray:
    """Compute the tails of the bones (J, 3).

    A bone ends at its child, or at the one of several that is farthest along the joint's y axis. Without a child, it
    continues its parent at half the length.
    """
    shortest = MIN_BONE * np.ptp(skeleton.mesh.vertices, axis=0).max()
    offsets = np.zeros_like(heads)
    for j, (parent, rotation) in enumerate(zip(skeleton.parents, skeleton.rig.rotation, strict=True)):
        children = [heads[c] - heads[j] for c, parent_of_c in enumerate(skeleton.parents) if parent_of_c == j]
        offsets[j] = max(children, key=lambda offset: offset @ rotation[:, 1], default=offsets[parent] / 2)
        length = np.linalg.norm(offsets[j])
        if length < shortest:
            offsets[j] = shortest * (offsets[j] / length if length > 0 else rotation[:, 1])
    return heads + offsets


def _add_weights(copy: bpy.types.Object, skeleton: AnimatedRig) -> None:
    """Add a vertex group for each bone; existing groups of the same name are replaced."""
    joints, weights = skeleton.strongest()
    for j, name in enumerate(skeleton.names):
        if name in copy.vertex_groups:
            copy.vertex_groups.remove(copy.vertex_groups[name])
        group = copy.vertex_groups.new(name=name)
        for vertex, slot in np.argwhere((joints == j) & (weights > 0)).tolist():
            group.add([vertex], float(weights[vertex, slot]), "REPLACE")
