# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads Blender's objects into mimesh's arrays: evaluated meshes and bones in world space, z up."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np

from . import bones

if TYPE_CHECKING:
    from mimesh import Clip, Mesh
    from mimesh.pipeline.bone_rigs import Binding

Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from y up, +z front to z up, -y front, as Blender imports motion capture."""
POSE_MODIFIERS = {"ARMATURE", "MESH_CACHE", "MESH_SEQUENCE_CACHE"}
"""Types of modifiers that pose a mesh: the identity is read without them."""


@dataclass(frozen=True, eq=False)
class Identity:
    """The mesh to move, at rest."""

    mesh: Mesh
    """In world space."""
    baked: bool
    """Whether its modifiers are applied to the vertices, because they keep their number; else they stay modifiers."""


@dataclass(frozen=True, eq=False)
class Driving:
    """The frames of the driving."""

    clip: Clip
    to_world: np.ndarray
    """Rotation (3, 3) from the axes of the clip to those of the world."""


def read_identity(context: bpy.types.Context, source: bpy.types.Object) -> Identity:
    """Read an object at rest: without shape keys and POSE_MODIFIERS, with its other modifiers applied if possible.

    Raises:
        InputError: the object is an armature.
    """
    from mimesh import InputError, Mesh

    if source.type != "MESH":
        raise InputError(
            f"{source.name}: expected a mesh as the identity, found an armature; choose its mesh, or Own armature as "
            "the result"
        )
    copy = rest_copy(source)
    context.scene.collection.objects.link(copy)
    try:
        vertices, faces = _read_evaluated(copy.evaluated_get(context.evaluated_depsgraph_get()))
        baked = len(vertices) == len(copy.data.vertices)
        if not baked:
            vertices, faces = _vertices(copy.data, copy.matrix_world), _faces(copy.data, copy.matrix_world)
    finally:
        data = copy.data
        bpy.data.objects.remove(copy)
        bpy.data.meshes.remove(data)
    return Identity(Mesh(vertices, faces, name=source.name), baked)


def rest_copy(source: bpy.types.Object) -> bpy.types.Object:
    """Copy an object and its mesh, unlinked: at rest, without animation, constraints and parent, at its position."""
    matrix = source.matrix_world.copy()
    copy = source.copy()
    copy.data = source.data.copy()
    copy.animation_data_clear()
    copy.data.animation_data_clear()
    keys = copy.data.shape_keys
    if keys is not None:
        # Removing shape keys would apply their current mix: the basis is read before and written back.
        points = np.empty(3 * len(copy.data.vertices), np.float32)
        keys.reference_key.data.foreach_get("co", points)
        name = keys.name
        copy.shape_key_clear()
        # Blender 4.5 and 5.0 keep the unused data block, 5.3 frees it: `keys` may be invalid from here on.
        if (unused := bpy.data.shape_keys.get((name, None))) is not None:
            bpy.data.batch_remove([unused])
        copy.data.vertices.foreach_set("co", points)
    for modifier in [modifier for modifier in copy.modifiers if modifier.type in POSE_MODIFIERS]:
        copy.modifiers.remove(modifier)
    # Constraints and the parent could move the copy: its world matrix is set instead.
    copy.constraints.clear()
    copy.hide_viewport = False  # hidden objects are not evaluated
    copy.parent = None
    copy.matrix_world = matrix
    return copy


def read_own_armature(
    context: bpy.types.Context, source: bpy.types.Object, up: str, front: str | None, body: str = "auto"
) -> bones.OwnArmature:
    """Read the armature of an identity, with the visible meshes that it deforms.

    Args:
        body: as `mimesh.animate` takes it.

    Raises:
        InputError: no armature, none of a person or an animal, no visible mesh, or an armature that cannot be used.
    """
    from mimesh import InputError, Mesh
    from mimesh.pipeline.bone_rigs import rig_of_bones

    armature = bones.armature_of(source)
    if armature is None:
        raise InputError(f"{source.name}: expected an armature that moves it, found none; choose another Result")
    bones.check_usable(armature)
    bound = _visible(one for one in context.view_layer.objects if bones.is_bound(one, armature))
    if not bound:
        raise InputError(f"{armature.name}: expected a visible mesh that it deforms, found none; show or bind one")
    level = bones.level_axes(armature, up, front)
    vertices, faces, binding = _read_bound(context, armature, bound)
    mesh = Mesh(vertices @ level[:3, :3].T, faces, name=source.name)
    rig = rig_of_bones(mesh, bones.bones_at_rest(armature, level), binding, up, front, body)
    return bones.OwnArmature(armature, mesh, rig, level)


def count_animal_bones(context: bpy.types.Context, source: bpy.types.Object, up: str, front: str | None) -> int:
    """Count the bones of an identity's armature that are known as a four-legged animal's; 0 if it is none's.

    They are found by where they are and what they deform, which takes too long for a panel that is drawn.
    """
    from mimesh import InputError

    try:
        return len(read_own_armature(context, source, up, front, "quadruped").rig.joints)
    except InputError:
        return 0


def driving_meshes(context: bpy.types.Context, source: bpy.types.Object) -> list[bpy.types.Object]:
    """List the driving meshes: the object itself, or visible meshes that are its children or deformed by it."""
    if source.type == "MESH":
        return _visible([source])
    context.view_layer.update()
    children = set(source.children_recursive)
    found = (one for one in context.view_layer.objects if one.type == "MESH")
    return _visible(one for one in found if one in children or bones.is_bound(one, source))


def driving_armature(source: bpy.types.Object, objects: list[bpy.types.Object], body: str) -> bpy.types.Object | None:
    """Return the armature that moves the driving, if its bones are a person's by name, or may be an animal's.

    An animal's are known only by the surface that they deform; what is no animal is then read on its surface.
    """
    from mimesh import InputError

    armature = bones.armature_of(source)
    if armature is None or bones.known_bones(armature)[1]:
        return armature
    if body == "human" or not any(bones.is_bound(one, armature) for one in objects):
        return None
    try:
        bones.check_usable(armature)
    except InputError:
        return None
    return armature


def read_clip(
    context: bpy.types.Context, source: bpy.types.Object, frames: range, with_bones: bool = True
) -> Generator[int, None, Driving]:
    """Read the frames of the scene; yields the number of frames read, returns the clip.

    The clip has the meshes in world space, turned about the vertical as `bones.level_axes` says, and the bones of a
    person's or an animal's armature; without a mesh, a person's bones move mimesh's own body. The scene is set back to
    its current frame afterwards, also when the caller stops half-way. The current frame alone is read without setting
    it, so that a pose without keys is not lost.

    Args:
        with_bones: read the bones of an armature; without, meshes alone.

    Raises:
        InputError: no frames, neither a visible mesh nor bones of a person, or a number of vertices that changes.
    """
    from mimesh import InputError

    if not frames:
        raise InputError("frames: expected a first frame before the last, found none between them; change the range")
    objects, body = driving_meshes(context, source), context.scene.mimesh.body
    armature = driving_armature(source, objects, body) if with_bones else None
    if not objects and armature is None:
        wanted = "a visible mesh, or an armature with the bones of a person by name" if with_bones else "a visible mesh"
        reason = "" if with_bones else " (bones alone need the model mime, and no joints that were moved)"
        raise InputError(f"{source.name}: expected {wanted}, found none{reason}; show a mesh or choose another driving")
    if armature is not None:
        bones.check_usable(armature)
    reader = DrivingReader(context, source, objects, armature)
    with _set_frames(context.scene, frames) as frame_numbers:
        yield from reader.read(frame_numbers, len(frames))
    fps = context.scene.render.fps / context.scene.render.fps_base / frames.step
    return Driving(reader.clip(fps), reader.to_world)


class DrivingReader:
    """Reads the meshes and the bones of a driving in frames of the scene."""

    def __init__(
        self,
        context: bpy.types.Context,
        source: bpy.types.Object,
        objects: list[bpy.types.Object],
        armature: bpy.types.Object | None,
    ) -> None:
        """Meshes or armature may be missing, but not both."""
        self._context, self._source, self._objects, self._armature = context, source, objects, armature
        self._names = () if armature is None else bones.bone_tree(armature)[0]
        self._bones: list[np.ndarray] = []

    def read(self, frame_numbers: Iterator[int], count: int) -> Generator[int, None, None]:
        """Read frames while the scene is set to them; yields the number of frames read."""
        from mimesh.core.frame_buffer import PAGED, allocate_frames, release_pages

        settings = self._context.scene.mimesh
        for done, frame in enumerate(frame_numbers):
            vertices, faces = _read_objects(self._context, self._objects)
            if done == 0:
                self._faces = faces
                self._vertices = allocate_frames(count, len(vertices), np.float32) if self._objects else None
                self._level = np.eye(4)
                self._axes = settings.driving_up, settings.front("driving")
            if self._armature is not None:
                evaluated = self._armature.evaluated_get(self._context.evaluated_depsgraph_get())
                if done == 0:
                    self._level = bones.level_axes(evaluated, *self._axes)
                    self._rest = bones.bones_at_rest(evaluated, self._level)
                self._bones.append(self._level @ bones.posed_bones(evaluated, self._names))
            if self._vertices is not None:
                self._check_count(len(vertices), frame)
                self._vertices[done] = vertices @ self._level[:3, :3].T
                if done % PAGED == 0:
                    release_pages(self._vertices)
            yield done + 1

    def clip(self, fps: float) -> Clip:
        """Return the clip of the frames that have been read."""
        from mimesh import Clip, Mesh
        from mimesh.pipeline.bone_rigs import BoneJoints, clip_of_bones

        if self._vertices is None:
            return clip_of_bones(self._rest, np.stack(self._bones), fps, self._axes[1])
        mesh = Mesh(self._vertices[0].astype(np.float64), self._faces, name=self._source.name)
        if self._armature is None:
            return Clip(mesh, self._vertices, fps)
        vertices, faces, binding = _read_bound(self._context, self._armature, self._objects)
        rest = Mesh(vertices @ self._level[:3, :3].T, faces, name=self._source.name)
        joints = BoneJoints(rest, self._rest, binding, np.stack(self._bones), *self._axes)
        return Clip(mesh, self._vertices, fps, skeleton=joints)

    @property
    def to_world(self) -> np.ndarray:
        """See `Driving`."""
        return Z_UP if self._vertices is None else self._level[:3, :3].T

    def _check_count(self, found: int, frame: int) -> None:
        from mimesh import InputError

        assert self._vertices is not None
        if found != self._vertices.shape[1]:
            raise InputError(
                f"{self._source.name}: expected {self._vertices.shape[1]} vertices in every frame, found {found} in "
                f"frame {frame}; switch off modifiers that change the topology, or take other frames"
            )


@contextlib.contextmanager
def _set_frames(scene: bpy.types.Scene, frames: range) -> Iterator[Iterator[int]]:
    """Yield an iterator that sets the scene to each frame; afterwards the scene is set back to its current one."""
    frame, subframe = scene.frame_current, scene.frame_subframe
    # Setting a frame evaluates the animation again, which would discard a pose without keys.
    if list(frames) == [frame]:
        yield iter(frames)
        return
    try:
        yield (scene.frame_set(number) or number for number in frames)
    finally:
        scene.frame_set(frame, subframe=subframe)


def _read_objects(context: bpy.types.Context, objects: list[bpy.types.Object]) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (V, 3) and triangles (F, 3) of all objects together, in the current frame."""
    graph = context.evaluated_depsgraph_get()
    return _joined([_read_evaluated(source.evaluated_get(graph)) for source in objects])


def _read_bound(
    context: bpy.types.Context, armature: bpy.types.Object, objects: list[bpy.types.Object]
) -> tuple[np.ndarray, np.ndarray, Binding]:
    """Return vertices and triangles of objects while an armature is at rest, and the weights of its bones."""
    parts, rows = [], []
    with bones.rest_position(context, armature):
        graph = context.evaluated_depsgraph_get()
        for source in objects:
            evaluated = source.evaluated_get(graph)
            mesh = evaluated.to_mesh()
            parts.append((_vertices(mesh, evaluated.matrix_world), _faces(mesh, evaluated.matrix_world)))
            rows += bones.influences(source, mesh, armature)
            evaluated.to_mesh_clear()
    return *_joined(parts), bones.bind(rows, armature)


def _joined(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Join vertices and triangles of several meshes to those of one."""
    vertices, faces, count = [np.empty((0, 3))], [np.empty((0, 3), np.int64)], 0
    for points, corners in parts:
        vertices.append(points)
        faces.append(corners + count)
        count += len(points)
    return np.concatenate(vertices), np.concatenate(faces)


def _visible(objects: Iterable[bpy.types.Object]) -> list[bpy.types.Object]:
    return [one for one in objects if one.visible_get()]


def _read_evaluated(evaluated: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles of an evaluated object in world space."""
    mesh = evaluated.to_mesh()
    arrays = _vertices(mesh, evaluated.matrix_world), _faces(mesh, evaluated.matrix_world)
    evaluated.to_mesh_clear()
    return arrays


def _vertices(mesh: bpy.types.Mesh, matrix_world) -> np.ndarray:
    """Return the vertices (V, 3) of a mesh in world space, in double precision."""
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    matrix = np.array(matrix_world)
    return points.reshape(-1, 3).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def _faces(mesh: bpy.types.Mesh, matrix_world) -> np.ndarray:
    """Return triangles (F, 3), counter-clockwise in world space, also if the object is mirrored."""
    mesh.calc_loop_triangles()
    corners = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", corners)
    faces = corners.reshape(-1, 3).astype(np.int64)
    # A mirrored object (negative determinant) has clockwise faces in world space.
    return faces[:, ::-1] if np.linalg.det(np.array(matrix_world)[:3, :3]) < 0 else faces
