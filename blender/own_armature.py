# SPDX-License-Identifier: GPL-3.0-or-later
"""Gives the identity's own armature a new action, or a pose. Nothing that it had is lost: see `build`."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from mathutils import Matrix

from . import animating
from .bones import OwnArmature, armature_of
from .building import select

if TYPE_CHECKING:
    from bpy.types import Constraint, Context, Object, PoseBone

    from mimesh import ClipResult

STILL = 1e-5
"""Difference, relative to the size of the mesh, below which a location counts as zero; 1 minus a scale likewise."""
MISSED, MISSED_ANGLE = 0.01, 0.02
"""Distance, relative to the size, and difference of the axes (radians) at which a bone is reported as elsewhere."""
QUOTED = 3
"""Largest number of names that a note quotes."""


@dataclass(frozen=True, eq=False)
class _Motion:
    """Transforms of bones in the space of the armature."""

    armature: Object
    target: dict[str, np.ndarray]
    """Of each bone that moves (T, 4, 4), parents first."""
    keyed: list[str]
    """Bones that are keyed: those of a person, and others that would not move with these; all those of an animal."""
    size: float
    """Largest extent of the mesh, in the space of the armature."""


def build(context: Context, own: OwnArmature, result: ClipResult, frames: range, single_pose: bool) -> tuple[str, ...]:
    """Animate the armature with a new action, or pose it without keys; returns notes for the user.

    The action before stays in the file: it gets a fake user and is kept as a muted NLA strip. Bones that are not keyed
    keep the values they have. Constraints of keyed bones, and inverse kinematics through them, get the influence 0 by
    a key of the new action (of a pose: by their property), because they would move the bones elsewhere.

    Raises:
        InputError: the armature's animation cannot be changed.
    """
    armature = own.armature
    _check_editable(armature)
    motion = _motion(own, result)
    channels = {bone: _channels(motion, armature.pose.bones[bone], local) for bone, local in _locals(motion).items()}
    released = _acting_constraints(armature, motion.keyed)
    if single_pose:
        for bone, values in channels.items():
            for path, rows in values.items():
                setattr(armature.pose.bones[bone], path, rows[0])
        for _, constraint in released:
            constraint.influence = 0.0
    else:
        _stash_action(armature)
        bag = animating.new_channels(armature, _action_name(context, armature))
        for bone, values in channels.items():
            for path, rows in values.items():
                data_path = armature.pose.bones[bone].path_from_id(path)
                for axis in range(rows.shape[1]):
                    animating.add_curve(bag, data_path, axis, frames, rows[:, axis])
        for _, constraint in released:
            animating.add_curve(bag, constraint.path_from_id("influence"), 0, frames[:1], [0.0])
    select(context, armature)
    return _constraint_notes(armature, released, single_pose) + _missed_notes(context, motion, frames, single_pose)


def _motion(own: OwnArmature, result: ClipResult) -> _Motion:
    """Bring the result from the axes of the rig to the space of the armature."""
    skeleton, armature = result.skeleton, own.armature
    assert skeleton is not None, "mime moves joints"
    to_armature = np.linalg.inv(own.level @ np.array(armature.matrix_world, np.float64))
    transforms = to_armature @ skeleton.transforms() @ np.linalg.inv(to_armature)
    bones = armature.data.bones
    of_name = {name: transforms[:, k] @ np.array(bones[name].matrix_local) for k, name in enumerate(skeleton.names)}
    ordered = sorted(of_name, key=lambda name: len(bones[name].parent_recursive))
    person = {own.rig.character.joint_names[joint] for joint in own.rig.joints.values()}
    loose = {name for name in ordered if not any(above.name in of_name for above in bones[name].parent_recursive)}
    controlled = {
        name for name in ordered if any(_follows_control(armature, c, of_name) for c in _acting(armature, name))
    }
    # Legs of animals have helpers beside the known bones, which the action before left in its pose.
    all_bones = own.rig.body_name == "quadruped"
    keyed = [name for name in ordered if all_bones or name in person | loose | controlled]
    size = float(np.ptp(own.mesh.vertices, axis=0).max() * np.cbrt(abs(np.linalg.det(to_armature[:3, :3]))))
    return _Motion(armature, {name: of_name[name] for name in ordered}, keyed, size)


def _locals(motion: _Motion) -> dict[str, list[Matrix]]:
    """Compute the transform that each keyed bone needs in every frame relative to its parent and its rest.

    Blender's own function is used, which knows whether a bone inherits rotation and scale.
    """
    bones = motion.armature.data.bones
    keyed = set(motion.keyed)
    needed = {above.name for name in keyed for above in bones[name].parent_recursive} | keyed
    ordered = sorted(needed, key=lambda name: len(bones[name].parent_recursive))
    found: dict[str, list[Matrix]] = {name: [] for name in motion.keyed}
    for t in range(len(next(iter(motion.target.values())))):
        posed: dict[str, Matrix] = {}
        for name in ordered:
            bone, own = bones[name], motion.armature.pose.bones[name]
            above = bone.parent
            options = {} if above is None else {
                "parent_matrix": posed[above.name], "parent_matrix_local": above.matrix_local
            }  # fmt: skip
            if name in keyed:
                posed[name] = Matrix(motion.target[name][t])
                found[name].append(bone.convert_local_to_pose(posed[name], bone.matrix_local, invert=True, **options))
            elif keyed.isdisjoint(one.name for one in bone.parent_recursive):
                posed[name] = own.matrix.copy()  # where it is, constraints included
            else:
                posed[name] = bone.convert_local_to_pose(own.matrix_basis, bone.matrix_local, **options)
    return found


def _channels(motion: _Motion, bone: PoseBone, local: list[Matrix]) -> dict[str, np.ndarray]:
    """Return the values of a bone's properties in every frame: its rotation, and location and scale where needed."""
    path, rotations = _rotations(bone, local)
    channels = {path: rotations}
    locations = np.array([matrix.translation for matrix in local])
    if max(np.abs(locations).max(), np.abs(bone.location).max()) > STILL * motion.size:
        channels["location"] = locations
    if np.abs(np.array(bone.scale) - 1).max() > STILL:
        channels["scale"] = np.ones((len(local), 3))
    return channels


def _rotations(bone: PoseBone, local: list[Matrix]) -> tuple[str, np.ndarray]:
    """Return the property for a bone's rotation mode and its values (T, C), without jumps from frame to frame."""
    if bone.rotation_mode not in {"QUATERNION", "AXIS_ANGLE"}:
        angles = [local[0].to_euler(bone.rotation_mode)]
        for matrix in local[1:]:
            angles.append(matrix.to_euler(bone.rotation_mode, angles[-1]))
        return "rotation_euler", np.array(angles)
    quaternions = np.array([matrix.to_quaternion() for matrix in local])
    flipped = (quaternions[1:] * quaternions[:-1]).sum(axis=-1) < 0
    quaternions[1:] *= np.cumprod(np.where(flipped, -1.0, 1.0))[:, None]
    if bone.rotation_mode == "QUATERNION":
        return "rotation_quaternion", quaternions
    # With signs that do not jump, the half angle may leave the range of arccos, and the axis stays on its side.
    sine = np.linalg.norm(quaternions[:, 1:], axis=1)
    side = np.ones(len(sine))
    axes = np.tile([0.0, 1.0, 0.0], (len(sine), 1))
    for t, (length, quaternion) in enumerate(zip(sine, quaternions, strict=True)):
        before = axes[max(t - 1, 0)]
        axes[t] = quaternion[1:] / length if length > 0 else before
        if t and axes[t] @ before < 0:
            axes[t], side[t] = -axes[t], -1.0
    angles = np.unwrap(2 * np.arctan2(side * sine, quaternions[:, 0]))
    return "rotation_axis_angle", np.concatenate([angles[:, None], axes], axis=1)


def _check_editable(armature: Object) -> None:
    from mimesh import InputError

    if armature.library is not None:
        raise InputError(f"{armature.name}: expected an armature of this file, found a linked one; make it local")
    if armature.animation_data is not None and armature.animation_data.use_tweak_mode:
        raise InputError(f"{armature.name}: expected no NLA strip in tweak mode, found one; leave it (Tab) first")


def _action_name(context: Context, armature: Object) -> str:
    """Name the new action after the driving's action, or its object without one, and the armature."""
    driving = context.scene.mimesh.driving
    animation = (armature_of(driving) or driving).animation_data
    action = None if animation is None else animation.action
    return f"{(action or driving).name} on {armature.name}"


def _stash_action(armature: Object) -> None:
    """Keep the armature's action in the file, as Blender's Stash does: with a fake user, and in a muted NLA strip."""
    animation = armature.animation_data
    action = None if animation is None else animation.action
    if action is None:
        return
    slot = animation.action_slot
    action.use_fake_user = True
    animation.action = None
    if any(strip.action == action for track in animation.nla_tracks for strip in track.strips):
        return
    track = animation.nla_tracks.new()
    track.name = "[Action Stash]"
    strip = track.strips.new(action.name, int(action.frame_range[0]), action)
    if slot is not None:
        strip.action_slot = slot
    track.mute, track.lock = True, True


def _acting_constraints(armature: Object, keyed: Sequence[str]) -> list[tuple[str, Constraint]]:
    """List the constraints with an influence that move keyed bones, with the bone that each is on."""
    moved = set(keyed)
    found = []
    for bone in armature.pose.bones:
        for constraint in _acting(armature, bone.name):
            chain = {bone.name}
            if constraint.type in {"IK", "SPLINE_IK"}:
                above = [one.name for one in bone.parent_recursive]
                count = constraint.chain_count
                chain |= set(above[: count - 1] if count else above)
            if chain & moved:
                found.append((bone.name, constraint))
    return found


def _acting(armature: Object, bone: str) -> list[Constraint]:
    """List the constraints of a bone that have an influence."""
    return [one for one in armature.pose.bones[bone].constraints if one.enabled and one.influence > 0]


def _follows_control(armature: Object, constraint: Constraint, moved: Container[str]) -> bool:
    """Tell whether a constraint follows a bone of the same armature that does not move with some bones."""
    single = [constraint] if hasattr(constraint, "subtarget") else []
    targets = [one.subtarget for one in (*single, *getattr(constraint, "targets", ())) if one.target == armature]
    bones = [armature.data.bones[name] for name in targets if name in armature.data.bones]
    return any(not any(one.name in moved for one in (bone, *bone.parent_recursive)) for bone in bones)


def _constraint_notes(
    armature: Object, released: Sequence[tuple[str, Constraint]], single_pose: bool
) -> tuple[str, ...]:
    if not released:
        return ()
    where = "now" if single_pose else "in the new action"
    listed = _quoted(f"{constraint.name} on {bone}" for bone, constraint in released)
    return (
        f"{armature.name}: constraints of its bones are not followed, their influence is 0 {where} ({listed}); "
        "set it back before you use other actions or the controls",
    )


def _missed_notes(context: Context, motion: _Motion, frames: range, single_pose: bool) -> tuple[str, ...]:
    """Compare bones with their targets in the first, a middle and the last frame, and name those that are elsewhere."""
    scene, missed = context.scene, {}
    current, subframe = scene.frame_current, scene.frame_subframe
    for t in sorted({0, (len(frames) - 1) // 2, len(frames) - 1}):
        if single_pose:
            context.view_layer.update()
        else:
            scene.frame_set(frames[t])
        evaluated = motion.armature.evaluated_get(context.evaluated_depsgraph_get())
        for name in motion.keyed:
            apart = np.array(evaluated.pose.bones[name].matrix) - motion.target[name][t]
            if np.abs(apart[:3, 3]).max() > MISSED * motion.size or np.abs(apart[:3, :3]).max() > MISSED_ANGLE:
                missed[name] = None
    if not single_pose:
        scene.frame_set(current, subframe=subframe)
    if not missed:
        return ()
    return (
        f"{motion.armature.name}: {len(missed)} bones are not where the motion takes them ({_quoted(missed)}): "
        "drivers, NLA strips or constraints move them; mute these",
    )


def _quoted(names: Iterable[str]) -> str:
    names = list(names)
    more = len(names) - QUOTED
    return ", ".join(names[:QUOTED]) + (f" and {more} more" if more > 0 else "")
