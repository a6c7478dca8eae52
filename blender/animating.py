# SPDX-License-Identifier: GPL-3.0-or-later
"""Creates actions of shape keys and of bones. Curves have a key per frame and are linear between keys."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import bpy
import numpy as np

if TYPE_CHECKING:
    from mimesh.core.animated_rig import AnimatedRig


def key_shapes(keys: bpy.types.Key, name: str, frames: range) -> None:
    """Animate every shape key but the basis: 1 on its frame, 0 on the frames before and after; the last one stays 1."""
    channels = new_channels(keys, name)
    for t, key in enumerate(keys.key_blocks[1:], start=1):
        # The first frame is the basis, so key t belongs to frames[t].
        times, values = frames[t - 1 : t + 2], [0.0, 1.0, 0.0]
        add_curve(channels, key.path_from_id("value"), 0, times, values[: len(times)])


def pose_bones(
    rig: bpy.types.Object, skeleton: AnimatedRig, origin: np.ndarray, name: str, frames: range | None
) -> None:
    """Rotate the bones as the joints, and move the root; without frames, set the first pose and create no keys.

    `origin` is the armature's position in the world.
    """
    rotations, locations = _bone_channels(rig, skeleton, origin)
    bones = [rig.pose.bones[joint] for joint in skeleton.names]
    for bone, rotation in zip(bones, rotations[0], strict=True):
        bone.rotation_mode = "QUATERNION"
        bone.rotation_quaternion = rotation
    bones[0].location = locations[0]
    if frames is None:
        return
    channels = new_channels(rig, name)
    for j, bone in enumerate(bones):
        for axis in range(4):
            add_curve(channels, bone.path_from_id("rotation_quaternion"), axis, frames, rotations[:, j, axis])
    for axis in range(3):
        add_curve(channels, bones[0].path_from_id("location"), axis, frames, locations[:, axis])


def _bone_channels(rig: bpy.types.Object, skeleton: AnimatedRig, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the values of bone channels: quaternions (T, J, 4) with w first, and locations of the root (T, 3).

    Bones may have any orientation at rest: the transform of a joint from rest to a pose is applied to its bone. A
    channel is relative to the bone at rest and to its parent: inv(rest to parent) @ (posed to posed parent).
    """
    to_armature = np.eye(4)
    to_armature[:3, 3] = -origin
    bones = np.array([rig.data.bones[name].matrix_local for name in skeleton.names], np.float64)
    posed_bones = to_armature @ skeleton.transforms() @ np.linalg.inv(to_armature) @ bones
    parents = list(skeleton.parents[1:])
    channels = np.linalg.inv(bones) @ posed_bones
    channels[:, 1:] = np.linalg.inv(np.linalg.inv(bones[parents]) @ bones[1:]) @ (
        np.linalg.inv(posed_bones[:, parents]) @ posed_bones[:, 1:]
    )
    return _quaternions(channels[..., :3, :3]), channels[:, 0, :3, 3]


def _quaternions(rotation: np.ndarray) -> np.ndarray:
    """Convert rotations (T, J, 3, 3) to quaternions (T, J, 4), w first.

    q and -q are the same rotation; each frame has the sign nearer to the frame before, or curves would jump.
    """
    from scipy.spatial.transform import Rotation

    quaternions = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat().reshape(*rotation.shape[:2], 4)
    flipped = (quaternions[1:] * quaternions[:-1]).sum(axis=-1) < 0
    quaternions[1:] *= np.cumprod(np.where(flipped, -1.0, 1.0), axis=0)[..., None]
    return quaternions[..., [3, 0, 1, 2]]


def new_channels(owner: bpy.types.ID, name: str) -> bpy.types.ActionChannelbag:
    """Create an action for an owner and return its container of curves."""
    action = bpy.data.actions.new(name)
    slot = action.slots.new(id_type=owner.id_type, name=owner.name)
    strip = action.layers.new("Layer").strips.new(type="KEYFRAME")
    animation = owner.animation_data_create()
    animation.action, animation.action_slot = action, slot
    return strip.channelbag(slot, ensure=True)


def add_curve(
    channels: bpy.types.ActionChannelbag, path: str, index: int, frames: Sequence[int], values: Sequence[float]
) -> None:
    """Add a curve with linear keys at the frames."""
    # foreach_set fills all keys in one call; adding them one by one takes much longer.
    keys = np.stack([np.asarray(frames, np.float32), np.asarray(values, np.float32)], axis=1)
    linear = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value
    curve = channels.fcurves.new(path, index=index)
    curve.keyframe_points.add(len(keys))
    curve.keyframe_points.foreach_set("co", keys.ravel())
    curve.keyframe_points.foreach_set("interpolation", np.full(len(keys), linear, np.int32))
    curve.update()
