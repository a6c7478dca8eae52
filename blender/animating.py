# SPDX-License-Identifier: GPL-3.0-or-later
"""Actions: values of shape keys, turns of bones. Curves are filled whole, and run straight from key to key."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import bpy
import numpy as np

if TYPE_CHECKING:
    from mimesh.core.rig import AnimatedRig


def key_shapes(keys: bpy.types.Key, name: str, frames: range) -> None:
    """Let every shape key but the basis be 1 on its frame and 0 on those beside it; the last one stays."""
    channels = _new_channels(keys, name)
    for t, key in enumerate(keys.key_blocks[1:], start=1):
        times, values = frames[t - 1 : t + 2], [0.0, 1.0, 0.0]
        _add_curve(channels, key.path_from_id("value"), 0, times, values[: len(times)])


def pose_bones(
    rig: bpy.types.Object, skeleton: AnimatedRig, place: np.ndarray, name: str, frames: range | None
) -> None:
    """Turn the bones as the joints turn, and move the root; without frames the first pose is set and nothing keyed."""
    turns, ways = _in_bones(rig, skeleton, place)
    bones = [rig.pose.bones[joint] for joint in skeleton.names]
    for bone, turn in zip(bones, turns[0], strict=True):
        bone.rotation_mode = "QUATERNION"
        bone.rotation_quaternion = turn
    bones[0].location = ways[0]
    if frames is None:
        return
    channels = _new_channels(rig, name)
    for j, bone in enumerate(bones):
        for axis in range(4):
            _add_curve(channels, bone.path_from_id("rotation_quaternion"), axis, frames, turns[:, j, axis])
    for axis in range(3):
        _add_curve(channels, bones[0].path_from_id("location"), axis, frames, ways[:, axis])


def _in_bones(rig: bpy.types.Object, skeleton: AnimatedRig, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What bones are given: quaternions (T, J, 4) with w first, and the way of the root (T, 3).

    Bones may point anywhere at rest: what carries a joint from rest to a pose carries its bone too.
    """
    still = _transforms(skeleton.rig.rotation, skeleton.rig.joints - place)
    posed = _transforms(skeleton.rotation, _places(skeleton) - place)
    bones = np.array([rig.data.bones[name].matrix_local for name in skeleton.names], np.float64)
    carried = posed @ np.linalg.inv(still) @ bones
    above = list(skeleton.parents[1:])
    own = np.linalg.inv(bones) @ carried
    own[:, 1:] = np.linalg.inv(np.linalg.inv(bones[above]) @ bones[1:]) @ (
        np.linalg.inv(carried[:, above]) @ carried[:, 1:]
    )
    return _quaternions(own[..., :3, :3]), own[:, 0, :3, 3]


def _places(skeleton: AnimatedRig) -> np.ndarray:
    """Where the joints are in every frame (T, J, 3)."""
    places = [skeleton.root]
    for j, bone in enumerate(skeleton.rig.bones(skeleton.parents), start=1):
        parent = skeleton.parents[j]
        places.append(places[parent] + skeleton.rotation[:, parent] @ bone)
    return np.stack(places, axis=1)


def _transforms(rotation: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Matrices (..., 4, 4) of rotations (..., 3, 3) and places (..., 3)."""
    matrices = np.zeros((*place.shape[:-1], 4, 4))
    matrices[..., :3, :3], matrices[..., :3, 3], matrices[..., 3, 3] = rotation, place, 1.0
    return matrices


def _quaternions(rotation: np.ndarray) -> np.ndarray:
    """Quaternions (T, J, 4), w first, of rotations (T, J, 3, 3); each near that of the frame before."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat().reshape(*rotation.shape[:2], 4)
    flipped = (turns[1:] * turns[:-1]).sum(axis=-1) < 0
    turns[1:] *= np.cumprod(np.where(flipped, -1.0, 1.0), axis=0)[..., None]
    return turns[..., [3, 0, 1, 2]]


def _new_channels(owner: bpy.types.ID, name: str) -> bpy.types.ActionChannelbag:
    """The curves of a new action that is the owner's."""
    action = bpy.data.actions.new(name)
    slot = action.slots.new(id_type=owner.id_type, name=owner.name)
    strip = action.layers.new("Layer").strips.new(type="KEYFRAME")
    animation = owner.animation_data_create()
    animation.action, animation.action_slot = action, slot
    return strip.channelbag(slot, ensure=True)


def _add_curve(
    channels: bpy.types.ActionChannelbag, path: str, index: int, frames: Sequence[int], values: Sequence[float]
) -> None:
    keyed = np.stack([np.asarray(frames, np.float32), np.asarray(values, np.float32)], axis=1)
    linear = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value
    curve = channels.fcurves.new(path, index=index)
    curve.keyframe_points.add(len(keyed))
    curve.keyframe_points.foreach_set("co", keyed.ravel())
    curve.keyframe_points.foreach_set("interpolation", np.full(len(keyed), linear, np.int32))
    curve.update()
