# SPDX-License-Identifier: GPL-3.0-or-later
"""From mimesh's result to a copy of the identity with shape keys, or with an armature that moves it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np

from . import animating
from .reading import Identity, rest

if TYPE_CHECKING:
    from mimesh import ClipResult
    from mimesh.core.rig import AnimatedRig

SHORTEST = 0.01
"""Length of a bone over the size of the mesh, at least."""


@dataclass(frozen=True, eq=False)
class Moved:
    """What came out, and what it is for."""

    source: bpy.types.Object
    identity: Identity
    result: ClipResult
    frames: range
    still: bool
    """A pose: nothing is keyed."""

    @property
    def name(self) -> str:
        return f"{self.source.name} {'posed' if self.still else 'animated'}"


def build_shape_keys(context: bpy.types.Context, moved: Moved) -> bpy.types.Object:
    """A copy with a shape key for each frame after the first, which is the basis; each is reached on its frame.

    Between two frames both have a share, so points go straight. The basis of a pose is the identity at rest.
    """
    copy = _copy(context, moved)
    world = moved.result.clip.vertices
    if not moved.still:
        _set_points(copy.data.vertices, _local(copy, world[0]))
    copy.shape_key_add(name="Basis", from_mix=False)
    shown = [0] if moved.still else range(1, len(world))
    for t in shown:
        key = copy.shape_key_add(name=f"frame {moved.frames[t]}", from_mix=False)
        _set_points(key.data, _local(copy, world[t]))
        key.value = float(moved.still)
    if len(world) > 1:
        animating.key_shapes(copy.data.shape_keys, moved.name, moved.frames)
    return copy


def build_armature(context: bpy.types.Context, moved: Moved) -> bpy.types.Object:
    """A copy under an armature of the joints that moved it, with four weights a vertex, and an action of its bones."""
    skeleton = moved.result.skeleton
    assert skeleton is not None, "mimesh was asked for joints"
    copy = _copy(context, moved)
    place = np.array(copy.matrix_world.translation)
    rig = bpy.data.objects.new(f"{moved.name} rig", bpy.data.armatures.new(moved.name))
    rig.location = copy.matrix_world.translation
    _add_beside(context, moved.source, rig)
    _choose(context, rig)
    _add_bones(rig, skeleton, place)
    _add_weights(copy, skeleton)
    copy.parent = rig
    copy.matrix_parent_inverse = rig.matrix_world.inverted()
    modifier = copy.modifiers.new("Armature", "ARMATURE")
    modifier.object = rig
    modifier.use_deform_preserve_volume = False
    copy.modifiers.move(len(copy.modifiers) - 1, 0)
    animating.pose_bones(rig, skeleton, place, moved.name, None if moved.still else moved.frames)
    return rig


def _copy(context: bpy.types.Context, moved: Moved) -> bpy.types.Object:
    """The identity again, at rest, chosen, where it stands; modifiers that are in its vertices are gone."""
    copy = rest(moved.source)
    copy.name = copy.data.name = moved.name
    _add_beside(context, moved.source, copy)
    if moved.identity.baked:
        copy.modifiers.clear()
    _choose(context, copy)
    _set_points(copy.data.vertices, _local(copy, moved.identity.mesh.vertices))
    return copy


def _add_beside(context: bpy.types.Context, source: bpy.types.Object, added: bpy.types.Object) -> None:
    """Into the collections of the source, if they are seen; else into that of the scene."""
    for collection in source.users_collection if source.visible_get() else [context.scene.collection]:
        collection.objects.link(added)


def _choose(context: bpy.types.Context, chosen: bpy.types.Object) -> None:
    """Select it alone, and bring its matrix up to date."""
    context.view_layer.update()
    for one in context.view_layer.objects:
        one.select_set(one == chosen)
    context.view_layer.objects.active = chosen


def _local(copy: bpy.types.Object, world: np.ndarray) -> np.ndarray:
    """World coordinates (V, 3) in those of the object."""
    back = np.linalg.inv(np.array(copy.matrix_world, dtype=np.float64))
    return world.astype(np.float64) @ back[:3, :3].T + back[:3, 3]


def _set_points(points: bpy.types.bpy_prop_collection, values: np.ndarray) -> None:
    points.foreach_set("co", np.ascontiguousarray(values, np.float32).ravel())


def _add_bones(rig: bpy.types.Object, skeleton: AnimatedRig, place: np.ndarray) -> None:
    """Bones from each joint towards the next; where a bone points does not change what it does to the mesh."""
    heads = skeleton.rig.joints - place
    tails = _tails(skeleton, heads)
    bpy.ops.object.mode_set(mode="EDIT")
    bones = [rig.data.edit_bones.new(name) for name in skeleton.names]
    for bone, parent, head, tail, turn in zip(
        bones, skeleton.parents, heads, tails, skeleton.rig.rotation, strict=True
    ):
        bone.head, bone.tail = head, tail
        bone.align_roll(turn[:, 2])
        bone.parent = None if parent < 0 else bones[parent]
    bpy.ops.object.mode_set(mode="OBJECT")
    rig.show_in_front = True


def _tails(skeleton: AnimatedRig, heads: np.ndarray) -> np.ndarray:
    """Ends of the bones (J, 3): at the one joint below, or the most upward of several; ends go on as their parents."""
    shortest = SHORTEST * np.ptp(skeleton.mesh.vertices, axis=0).max()
    ways = np.zeros_like(heads)
    for j, (parent, turn) in enumerate(zip(skeleton.parents, skeleton.rig.rotation, strict=True)):
        below = [heads[c] - heads[j] for c, above in enumerate(skeleton.parents) if above == j]
        ways[j] = max(below, key=lambda way: way @ turn[:, 1], default=ways[parent] / 2)
        length = np.linalg.norm(ways[j])
        if length < shortest:
            ways[j] = shortest * (ways[j] / length if length > 0 else turn[:, 1])
    return heads + ways


def _add_weights(copy: bpy.types.Object, skeleton: AnimatedRig) -> None:
    """A vertex group for each bone; groups of another rig with such a name give way."""
    joints, weights = skeleton.strongest()
    for j, name in enumerate(skeleton.names):
        if name in copy.vertex_groups:
            copy.vertex_groups.remove(copy.vertex_groups[name])
        group = copy.vertex_groups.new(name=name)
        for vertex, slot in np.argwhere((joints == j) & (weights > 0)).tolist():
            group.add([vertex], float(weights[vertex, slot]), "REPLACE")
