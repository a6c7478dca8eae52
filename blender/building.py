# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds what mimesh has made: a copy of the identity with shape keys or an armature, or an armature alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np

from . import animating
from .reading import Driving, Identity, rest_copy

if TYPE_CHECKING:
    from mimesh.core.animated_rig import AnimatedRig
    from mimesh.pipeline.capturing import CapturedClip

MIN_BONE = 0.01
"""Smallest length of a bone, as a share of the size of the mesh; Blender deletes bones without length."""


@dataclass(frozen=True, eq=False)
class Copy:
    """A copy of the identity that is to be made."""

    source: bpy.types.Object
    identity: Identity
    name: str
    frames: range
    """Frames of the scene that its frames belong to."""
    single_pose: bool
    """Whether it has one pose, without keys."""


def build_shape_keys(context: bpy.types.Context, made: Copy, world: np.ndarray) -> bpy.types.Object:
    """Build a copy with a shape key for each frame (T, V, 3) after the first, which is the basis.

    Between two frames their keys are mixed, so that vertices move linearly. The basis of a pose is the identity at
    rest.
    """
    copy = _copy(context, made)
    if not made.single_pose:
        _set_points(copy.data.vertices, _local(copy, world[0]))
    copy.shape_key_add(name="Basis", from_mix=False)
    keyed_frames = [0] if made.single_pose else range(1, len(world))
    for t in keyed_frames:
        key = copy.shape_key_add(name=f"frame {made.frames[t]}", from_mix=False)
        _set_points(key.data, _local(copy, world[t]))
        key.value = float(made.single_pose)
    if len(world) > 1:
        animating.key_shapes(copy.data.shape_keys, made.name, made.frames)
    return copy


def build_armature(context: bpy.types.Context, made: Copy, skeleton: AnimatedRig) -> bpy.types.Object:
    """Build a copy with an armature of joints, four weights per vertex, and an action of the bones."""
    copy = _copy(context, made)
    origin = np.array(copy.matrix_world.translation)
    rig = _new_armature(context, made.source, f"{made.name} rig", skeleton, origin)
    _add_weights(copy, skeleton)
    copy.parent = rig
    copy.matrix_parent_inverse = rig.matrix_world.inverted()
    modifier = copy.modifiers.new("Armature", "ARMATURE")
    modifier.object = rig
    modifier.use_deform_preserve_volume = False
    # The armature comes first: other modifiers (subdivision, mirror) apply to the posed mesh.
    copy.modifiers.move(len(copy.modifiers) - 1, 0)
    animating.pose_bones(rig, skeleton, origin, made.name, None if made.single_pose else made.frames)
    return rig


def build_motion(
    context: bpy.types.Context, source: bpy.types.Object, driving: Driving, captured: CapturedClip, frames: range
) -> bpy.types.Object:
    """Build an armature of captured joints, which moves where the driving does; at rest it is at the origin."""
    skeleton, origin, name = _in_world(driving, captured), np.zeros(3), f"{source.name} captured"
    rig = _new_armature(context, source, name, skeleton, origin)
    animating.pose_bones(rig, skeleton, origin, name, frames)
    return rig


def _in_world(driving: Driving, captured: CapturedClip) -> AnimatedRig:
    """Bring captured joints, y up on the ground, to where they are in the world; their mesh is the joints."""
    from mimesh import Mesh
    from mimesh.core.animated_rig import AnimatedRig
    from mimesh.core.rig import Rig

    found = captured.found
    turn = driving.to_world @ found.norm.axes.T
    hips = found.track.smoothed(found.smooth).positions[:1, found.motion.joints.index(captured.names[0])]
    place = driving.to_world @ found.norm.undo(hips)[0] - turn @ captured.root[0]
    joints, count = captured.rest @ turn.T, len(captured.names)
    mesh = Mesh(joints, np.empty((0, 3), np.int64), name=captured.name)
    rest = Rig(np.tile(turn, (count, 1, 1)), joints, np.eye(count))
    root = captured.root @ turn.T + place
    return AnimatedRig(mesh, captured.names, captured.parents, rest, turn @ captured.rotation, root)


def _new_armature(
    context: bpy.types.Context, source: bpy.types.Object, name: str, skeleton: AnimatedRig, origin: np.ndarray
) -> bpy.types.Object:
    """Add an armature with a bone for each joint beside an object, and select it; `origin` is its place."""
    rig = bpy.data.objects.new(name, bpy.data.armatures.new(name))
    rig.location = origin
    _add_beside(context, source, rig)
    select(context, rig)
    _add_bones(rig, skeleton, origin)
    return rig


def _copy(context: bpy.types.Context, made: Copy) -> bpy.types.Object:
    """Copy the identity at rest and in place, and select the copy; modifiers applied to the vertices are removed."""
    copy = rest_copy(made.source)
    copy.name = copy.data.name = made.name
    _add_beside(context, made.source, copy)
    if made.identity.baked:
        copy.modifiers.clear()
    select(context, copy)
    _set_points(copy.data.vertices, _local(copy, made.identity.mesh.vertices))
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
