# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads armatures: bones at rest and in the current frame, and the weights of the meshes that they deform."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np

if TYPE_CHECKING:
    from mimesh import Mesh
    from mimesh.motions.humanoid_rig import HumanoidRig
    from mimesh.pipeline.bone_rigs import Binding, Bones

SHEAR = 1e-3
"""Largest difference of an armature's scales along its axes, relative to the largest."""


@dataclass(frozen=True, eq=False)
class OwnArmature:
    """The armature of an identity, whose bones are those of a person or of a four-legged animal."""

    armature: bpy.types.Object
    mesh: Mesh
    """The meshes that it deforms, at rest."""
    rig: HumanoidRig
    level: np.ndarray
    """Transform (4, 4) from the world to the axes of the rig (see `level_axes`)."""


def armature_of(source: bpy.types.Object | None) -> bpy.types.Object | None:
    """Find the armature that an object is, that moves it, or that is the only one below it; None without one."""
    if source is None or source.type == "ARMATURE":
        return source
    for modifier in source.modifiers:
        if modifier.type == "ARMATURE" and modifier.object is not None and modifier.show_viewport:
            return modifier.object
    if source.parent is not None and source.parent.type == "ARMATURE":
        return source.parent
    below = [child for child in source.children_recursive if child.type == "ARMATURE"]
    return below[0] if len(below) == 1 and source.type == "EMPTY" else None


def is_bound(candidate: bpy.types.Object, armature: bpy.types.Object) -> bool:
    """Tell whether an armature deforms a mesh, by a modifier or as its parent, or moves it with one bone."""
    if candidate.type != "MESH":
        return False
    by_parent = candidate.parent == armature and candidate.parent_type in {"ARMATURE", "BONE"}
    return by_parent or any(
        modifier.type == "ARMATURE" and modifier.object == armature for modifier in candidate.modifiers
    )


def known_bones(armature: bpy.types.Object) -> tuple[int, int]:
    """Count the bones of an armature that are read, and those of them that are a person's by name."""
    names, parents = bone_tree(armature)
    return len(names), len(_person(names, parents))


def bone_tree(armature: bpy.types.Object) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """List the deforming bones with the nearest deforming one above each.

    All bones, if only these are a person's by name, or if none deforms.
    """
    bones = armature.data.bones
    return _chosen_tree(tuple((one.name, one.parent and one.parent.name, one.use_deform) for one in bones))


@functools.lru_cache(maxsize=8)
def _chosen_tree(bones: tuple[tuple[str, str | None, bool], ...]) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Choose the bones for `bone_tree`, from their names, parents and use; kept, because panels are drawn often."""
    parents = {name: parent for name, parent, _ in bones}
    deforming = _tree({name for name, _, deforms in bones if deforms}, parents)
    if _person(*deforming):
        return deforming
    whole = _tree(set(parents), parents)
    return whole if _person(*whole) or not deforming[0] else deforming


def _tree(names: set[str], parents: dict[str, str | None]) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """List bones, parents first, with the index of the nearest of them above each.

    The deforming bones of a generated Rigify rig are children of bones that mirror the whole skeleton: above
    DEF-thigh.L is ORG-thigh.L, then ORG-spine, which stands for DEF-spine.
    """
    above: dict[str, str | None] = {}
    for name in parents:
        if name in names:
            chain = (_deforming_name(one, names) for one in _chain(parents, parents[name]))
            above[name] = next((one for one in chain if one in names and one != name), None)
    # Strange names could make a loop: a bone whose chain returns to it becomes a root.
    for name in above:
        if name in _chain(above, above[name]):
            above[name] = None
    depth = {name: len(_chain(above, name)) for name in above}
    ordered = sorted(above, key=depth.__getitem__)
    place = {name: k for k, name in enumerate(ordered)}
    return tuple(ordered), tuple(-1 if (parent := above[name]) is None else place[parent] for name in ordered)


def _deforming_name(name: str, names: set[str]) -> str:
    """Return the deforming bone that an original bone of a Rigify rig stands for, if there is one."""
    twin = "DEF-" + name.removeprefix("ORG-")
    return twin if name.startswith("ORG-") and twin in names else name


def _chain(above: dict[str, str | None], name: str | None) -> list[str]:
    """List a bone and those above it, each once."""
    chain: list[str] = []
    while name is not None and name not in chain:
        chain.append(name)
        name = above[name]
    return chain


@functools.lru_cache(maxsize=8)
def _person(names: tuple[str, ...], parents: tuple[int, ...]) -> dict[str, int]:
    """Find the joints of a person by name; kept, because panels are drawn often."""
    from mimesh.bodies.joint_names import person_joints

    return person_joints(names, parents)


def level_axes(armature: bpy.types.Object, up: str, front: str | None) -> np.ndarray:
    """Return the rotation (4, 4) about the vertical after which the armature's axes are nearest to those of the world.

    An armature may stand at any angle; what it faces is one of the world's axes afterwards. With a given front, the
    user has named it in the axes of the world, which then stay.
    """
    from scipy.spatial.transform import Rotation

    from mimesh.core.geometry import nearest_rotation
    from mimesh.core.normalization import ROTATIONS, parse_axis

    level = np.eye(4)
    if front is not None:
        return level
    vertical = np.zeros(3)
    axis = parse_axis(up, "up")
    vertical["xyz".index(axis[1])] = 1.0
    turned = nearest_rotation(np.array(armature.matrix_world, np.float64)[:3, :3])
    squared = ROTATIONS[np.einsum("rkl,kl->r", ROTATIONS, turned).argmax()]
    x, y, z, w = Rotation.from_matrix(turned @ squared.T).as_quat()
    # The part of the rotation about the vertical (swing-twist decomposition).
    angle = 2 * np.arctan2(np.dot([x, y, z], vertical), w)
    level[:3, :3] = Rotation.from_rotvec(-angle * vertical).as_matrix()
    return level


def check_usable(armature: bpy.types.Object) -> None:
    """Check that bones show a pose and that their transforms are rigid in the world.

    Raises:
        InputError: the armature shows its rest position, or is scaled unequally.
    """
    from mimesh import InputError

    if armature.data.pose_position == "REST":
        raise InputError(
            f"{armature.name}: expected the pose position, found the rest position; switch to Pose Position in the "
            "properties of the armature"
        )
    scale = np.linalg.norm(np.array(armature.matrix_world, np.float64)[:3, :3], axis=0)
    if not scale.min() > 0 or np.ptp(scale) > SHEAR * scale.max():
        raise InputError(f"{armature.name}: expected one scale for all axes, found {scale.round(3)}; apply the scale")


def bones_at_rest(armature: bpy.types.Object, level: np.ndarray) -> Bones:
    """Return the bones that are read at rest, in the world after `level`."""
    from mimesh.pipeline.bone_rigs import Bones

    names, parents = bone_tree(armature)
    local = np.array([armature.data.bones[name].matrix_local for name in names], np.float64)
    return Bones(armature.name, names, parents, level @ np.array(armature.matrix_world, np.float64) @ local)


def posed_bones(armature: bpy.types.Object, names: Sequence[str]) -> np.ndarray:
    """Return the transforms (J, 4, 4) of bones of an evaluated armature in the world."""
    bones = armature.pose.bones
    return np.array(armature.matrix_world, np.float64) @ np.array([bones[name].matrix for name in names], np.float64)


def influences(
    source: bpy.types.Object, mesh: bpy.types.Mesh, armature: bpy.types.Object
) -> list[list[tuple[int, float]]]:
    """List the joints and weights of each vertex of an object's mesh.

    A vertex without any belongs to the world, the joint after the last.
    """
    names, _ = bone_tree(armature)
    place = {name: joint for joint, name in enumerate(names)}
    if source.parent == armature and source.parent_type == "BONE":
        bone = armature.data.bones[source.parent_bone]
        nearest = next((place[one.name] for one in (bone, *bone.parent_recursive) if one.name in place), len(names))
        return [[(nearest, 1.0)]] * len(mesh.vertices)
    joint_of = {group.index: place[group.name] for group in source.vertex_groups if group.name in place}
    world = [(len(names), 1.0)]
    return [
        [(joint_of[one.group], one.weight) for one in vertex.groups if one.group in joint_of and one.weight > 0]
        or world
        for vertex in mesh.vertices
    ]


def bind(rows: Sequence[list[tuple[int, float]]], armature: bpy.types.Object) -> Binding:
    """Make arrays of the joints and weights of vertices, as `influences` lists them."""
    from mimesh.pipeline.bone_rigs import Binding

    widest = max((len(row) for row in rows), default=1)
    joint_of, weights = np.full((len(rows), widest), len(bone_tree(armature)[0])), np.zeros((len(rows), widest))
    for v, row in enumerate(rows):
        for k, (joint, weight) in enumerate(row):
            joint_of[v, k], weights[v, k] = joint, weight
    return Binding(joint_of, weights / weights.sum(axis=1, keepdims=True))


@contextlib.contextmanager
def rest_position(context: bpy.types.Context, armature: bpy.types.Object) -> Iterator[None]:
    """Show an armature in its rest position, and afterwards as before."""
    shown = armature.data.pose_position
    armature.data.pose_position = "REST"
    context.view_layer.update()
    try:
        yield
    finally:
        armature.data.pose_position = shown
        context.view_layer.update()
