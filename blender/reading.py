# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads Blender's objects into mimesh's arrays: evaluated meshes in world space, z up."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np

if TYPE_CHECKING:
    from mimesh import Clip, Mesh

POSE_MODIFIERS = {"ARMATURE", "MESH_CACHE", "MESH_SEQUENCE_CACHE"}
"""Types of modifiers that pose a mesh: the identity is read without them."""


@dataclass(frozen=True, eq=False)
class Identity:
    """The mesh to move, at rest."""

    mesh: Mesh
    """In world space."""
    baked: bool
    """Whether its modifiers are applied to the vertices, because they keep their number; else they stay modifiers."""


def read_identity(context: bpy.types.Context, source: bpy.types.Object) -> Identity:
    """Read an object at rest: without shape keys and POSE_MODIFIERS, with its other modifiers applied if possible."""
    from mimesh import Mesh

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
        copy.shape_key_clear()
        bpy.data.batch_remove([keys])
        copy.data.vertices.foreach_set("co", points)
    for modifier in [modifier for modifier in copy.modifiers if modifier.type in POSE_MODIFIERS]:
        copy.modifiers.remove(modifier)
    # Constraints and the parent could move the copy: its world matrix is set instead.
    copy.constraints.clear()
    copy.hide_viewport = False  # hidden objects are not evaluated
    copy.parent = None
    copy.matrix_world = matrix
    return copy


def driving_meshes(context: bpy.types.Context, source: bpy.types.Object) -> list[bpy.types.Object]:
    """List the driving meshes: the object itself, or visible meshes that are its children or deformed by it.

    Raises:
        InputError: there is no visible mesh.
    """
    from mimesh import InputError

    if source.type == "MESH":
        found = [source]
    else:
        context.view_layer.update()
        children = set(source.children_recursive)
        found = [
            candidate
            for candidate in context.view_layer.objects
            if candidate.type == "MESH" and (candidate in children or _is_deformed_by(candidate, source))
        ]
    found = [candidate for candidate in found if candidate.visible_get()]
    if not found:
        raise InputError(f"{source.name}: expected a visible mesh, found none in it; show it or choose another driving")
    return found


def read_clip(context: bpy.types.Context, source: bpy.types.Object, frames: range) -> Generator[int, None, Clip]:
    """Read the frames of the scene; yields the number of frames read, returns the clip in world space.

    The scene is set back to its current frame afterwards, also when the caller stops half-way. The current frame alone
    is read without setting it, so that a pose without keys is not lost.

    Raises:
        InputError: no frames, no visible mesh, or a number of vertices that changes.
    """
    from mimesh import Clip, InputError, Mesh
    from mimesh.core.frame_buffer import PAGED, allocate_frames, release_pages

    if not frames:
        raise InputError("frames: expected a first frame before the last, found none between them; change the range")
    objects = driving_meshes(context, source)
    vertices, faces = _read_objects(context, objects)
    positions = allocate_frames(len(frames), len(vertices), np.float32)
    with _set_frames(context.scene, frames) as frame_numbers:
        for done, frame in enumerate(frame_numbers):
            vertices = _read_objects(context, objects)[0]
            if vertices.shape != positions.shape[1:]:
                raise InputError(
                    f"{source.name}: expected {positions.shape[1]} vertices in every frame, found {len(vertices)} in "
                    f"frame {frame}; switch off modifiers that change the topology, or take other frames"
                )
            positions[done] = vertices
            if done % PAGED == 0:
                release_pages(positions)
            yield done + 1
    fps = context.scene.render.fps / context.scene.render.fps_base / frames.step
    return Clip(Mesh(positions[0].astype(np.float64), faces, name=source.name), positions, fps)


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
    vertices, faces, count = [], [], 0
    for source in objects:
        points, corners = _read_evaluated(source.evaluated_get(graph))
        vertices.append(points)
        faces.append(corners + count)
        count += len(points)
    return np.concatenate(vertices), np.concatenate(faces)


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


def _is_deformed_by(candidate: bpy.types.Object, armature: bpy.types.Object) -> bool:
    return any(modifier.type == "ARMATURE" and modifier.object == armature for modifier in candidate.modifiers)
