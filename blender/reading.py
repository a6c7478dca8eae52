# SPDX-License-Identifier: GPL-3.0-or-later
"""From Blender's objects to mimesh's arrays: meshes in world space, z up, as the dependency graph shows them."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import bpy
import numpy as np

if TYPE_CHECKING:
    from mimesh import Clip, Mesh

MOVERS = {"ARMATURE", "MESH_CACHE", "MESH_SEQUENCE_CACHE"}
"""Modifiers that pose a mesh: the identity is read without them."""


@dataclass(frozen=True, eq=False)
class Identity:
    """The mesh to be moved, as it stands."""

    mesh: Mesh
    """In world space."""
    baked: bool
    """Whether its modifiers are in its vertices: they keep the vertex count; else they come after the motion."""


def read_identity(context: bpy.types.Context, source: bpy.types.Object) -> Identity:
    """The object at rest: its shape keys and what poses it are left out, its other modifiers keep their say."""
    from mimesh import Mesh

    rested = rest(source)
    context.scene.collection.objects.link(rested)
    try:
        vertices, faces = _shown(rested.evaluated_get(context.evaluated_depsgraph_get()))
        baked = len(vertices) == len(rested.data.vertices)
        if not baked:
            vertices, faces = _vertices(rested.data, rested.matrix_world), _faces(rested.data, rested.matrix_world)
    finally:
        data = rested.data
        bpy.data.objects.remove(rested)
        bpy.data.meshes.remove(data)
    return Identity(Mesh(vertices, faces, name=source.name), baked)


def rest(source: bpy.types.Object) -> bpy.types.Object:
    """A copy of the object with a mesh of its own, unlinked: at rest, held by nothing, where the object is now."""
    place = source.matrix_world.copy()
    copy = source.copy()
    copy.data = source.data.copy()
    copy.animation_data_clear()
    copy.data.animation_data_clear()
    keys = copy.data.shape_keys
    if keys is not None:
        points = np.empty(3 * len(copy.data.vertices), np.float32)
        keys.reference_key.data.foreach_get("co", points)
        copy.shape_key_clear()
        bpy.data.batch_remove([keys])
        copy.data.vertices.foreach_set("co", points)
    for modifier in [one for one in copy.modifiers if one.type in MOVERS]:
        copy.modifiers.remove(modifier)
    copy.constraints.clear()
    copy.hide_viewport = False  # what is hidden is not evaluated
    copy.parent = None
    copy.matrix_world = place
    return copy


def driving_meshes(context: bpy.types.Context, source: bpy.types.Object) -> list[bpy.types.Object]:
    """The mesh itself; or the visible meshes under an armature or empty, or deformed by that armature.

    Raises:
        InputError: there is none to be seen.
    """
    from mimesh import InputError

    if source.type == "MESH":
        found = [source]
    else:
        context.view_layer.update()
        under = set(source.children_recursive)
        found = [
            one for one in context.view_layer.objects if one.type == "MESH" and (one in under or _held(one, source))
        ]
    found = [one for one in found if one.visible_get()]
    if not found:
        raise InputError(f"{source.name}: expected a visible mesh, found none in it; show it or choose another driving")
    return found


def sample(context: bpy.types.Context, source: bpy.types.Object, frames: range) -> Generator[int, None, Clip]:
    """Play the scene over the frames; yields how many are read, returns the clip of them in world space.

    The scene is back at its own frame afterwards, also when the caller stops half-way. The one frame that is shown is
    read without playing, so that a pose without keys counts.

    Raises:
        InputError: no frames, nothing visible, or vertices that come and go.
    """
    from mimesh import Clip, InputError, Mesh
    from mimesh.core.frame_buffer import PAGED, allocate_frames, release_pages

    if not frames:
        raise InputError("frames: expected a first frame before the last, found none between them; change the range")
    objects = driving_meshes(context, source)
    vertices, faces = _joined(context, objects)
    kept = allocate_frames(len(frames), len(vertices), np.float32)
    with _played(context.scene, frames) as shown:
        for done, frame in enumerate(shown):
            vertices = _joined(context, objects)[0]
            if vertices.shape != kept.shape[1:]:
                raise InputError(
                    f"{source.name}: expected {kept.shape[1]} vertices in every frame, found {len(vertices)} in frame "
                    f"{frame}; switch off modifiers that change the topology, or take other frames"
                )
            kept[done] = vertices
            if done % PAGED == 0:
                release_pages(kept)
            yield done + 1
    fps = context.scene.render.fps / context.scene.render.fps_base / frames.step
    return Clip(Mesh(kept[0].astype(np.float64), faces, name=source.name), kept, fps)


@contextlib.contextmanager
def _played(scene: bpy.types.Scene, frames: range) -> Iterator[Iterator[int]]:
    """The frames, each shown as it comes; afterwards the scene shows what it showed."""
    frame, subframe = scene.frame_current, scene.frame_subframe
    if list(frames) == [frame]:
        yield iter(frames)
        return
    try:
        yield (scene.frame_set(one) or one for one in frames)
    finally:
        scene.frame_set(frame, subframe=subframe)


def _joined(context: bpy.types.Context, objects: list[bpy.types.Object]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and triangles (F, 3) of all objects together, as they are shown now."""
    graph = context.evaluated_depsgraph_get()
    vertices, faces, count = [], [], 0
    for one in objects:
        points, corners = _shown(one.evaluated_get(graph))
        vertices.append(points)
        faces.append(corners + count)
        count += len(points)
    return np.concatenate(vertices), np.concatenate(faces)


def _shown(evaluated: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of an evaluated object in world space."""
    mesh = evaluated.to_mesh()
    arrays = _vertices(mesh, evaluated.matrix_world), _faces(mesh, evaluated.matrix_world)
    evaluated.to_mesh_clear()
    return arrays


def _vertices(mesh: bpy.types.Mesh, matrix_world) -> np.ndarray:
    """Vertices (V, 3) of a mesh in world space, in double precision."""
    points = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", points)
    place = np.array(matrix_world)
    return points.reshape(-1, 3).astype(np.float64) @ place[:3, :3].T + place[:3, 3]


def _faces(mesh: bpy.types.Mesh, matrix_world) -> np.ndarray:
    """Triangles (F, 3), counter-clockwise in world space, also where the object is mirrored."""
    mesh.calc_loop_triangles()
    corners = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", corners)
    faces = corners.reshape(-1, 3).astype(np.int64)
    return faces[:, ::-1] if np.linalg.det(np.array(matrix_world)[:3, :3]) < 0 else faces


def _held(one: bpy.types.Object, armature: bpy.types.Object) -> bool:
    return any(modifier.type == "ARMATURE" and modifier.object == armature for modifier in one.modifiers)
