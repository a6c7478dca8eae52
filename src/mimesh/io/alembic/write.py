"""Alembic out: a new archive of one transform, one mesh and its samples, as every program reads it."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.frame_buffer import Progress, each_frame
from ...core.geometry import normal_turner
from ...core.mesh import Clip, Material, Mesh
from ..atomic import whole_file
from ..polygons import backwards, polygon_corners, polygon_sizes
from ..usd import stage_axes
from .archive import library

ROOM = 2**20
"""Bytes that must be free on the disk before a sample, besides what the sample may take."""


@dataclass(frozen=True, eq=False)
class AlembicSource:
    """What a new archive takes over from the one a mesh was read from, which itself cannot be copied.

    Satisfies `mesh.Source`: the suffix is its own, and `notes` say what is not taken over.
    """

    sizes: Int[np.ndarray, " P"]
    """Corners of each polygon."""
    notes: tuple[str, ...]
    name: str
    """Of the mesh within the archive."""
    suffix = ".abc"

    def write(self, mesh: Mesh, path: Path) -> None:
        """Write a new archive of the mesh."""
        write_alembic(mesh, path)


def write_alembic(mesh: Mesh, path: Path) -> None:
    """Write a mesh as a new Alembic archive: a clip of one frame (see `write_alembic_clip`)."""
    write_alembic_clip(Clip.still(mesh), path)


def write_alembic_clip(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write a clip as a new Alembic archive (Ogawa): a transform, below it a mesh with a sample at each k / fps.

    Positions in single precision, polygons whole, texture coordinates and normals (where the mesh has them, turned with
    the surface) for each corner, a face set for each material, or part without one. Bounds are written, colours and
    images are not: Alembic has no common way to say them. Memory does not grow with the number of frames.

    Raises:
        InputError: alembic3d is not installed.
    """
    abc, geometry, core, imath = library(path, "write")
    mesh = clip.mesh
    name = _object_name(mesh.source.name if isinstance(mesh.source, AlembicSource) else mesh.name)
    with whole_file(path) as temporary:
        archive = abc.CreateArchiveWithInfo(str(temporary), clip.fps, "mimesh", "")
        sampling = abc.Argument(archive.addTimeSampling(core.TimeSampling(1.0 / clip.fps, 0.0)))
        transform = geometry.OXform(archive.getTop(), name)
        transform.getSchema().set(_stands(mesh, geometry, imath))
        shape = geometry.OPolyMesh(transform, f"{name}Shape", sampling)
        schema = shape.getSchema()
        sample_of = _sampler(mesh, path)
        for vertices in each_frame(clip.vertices, progress):
            _need_room(path, ROOM + 8 * mesh.faces.nbytes)
            schema.set(sample_of(vertices))
        _add_face_sets(schema, mesh, path)
        # The library finishes the file when the last of these is gone.
        del schema, shape, transform, archive


def _need_room(path: Path, size: int) -> None:
    """Stop while the library can still finish its file: on a full disk it ends the process.

    Raises:
        OSError: fewer bytes are free.
    """
    if shutil.disk_usage(path.parent).free < size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _stands(mesh: Mesh, geometry, imath):
    """What stands a mesh up as Alembic's clients want it, y up in metres; vertices stay as they are below it."""
    z_up, unit = stage_axes(mesh)
    sample = geometry.XformSample()
    if z_up:
        sample.setXRotation(-90.0)
    if unit != 1:
        sample.setScale(imath.V3d(unit, unit, unit))
    return sample


def _sampler(mesh: Mesh, path: Path) -> Callable[[Float[np.ndarray, "V 3"]], Any]:
    """A function from the vertices of a frame to its sample; what does not change is stored once by the library."""
    _, geometry, _, imath = library(path, "write")
    sizes = polygon_sizes(mesh)
    corners = polygon_corners(sizes)[backwards(sizes)]
    counts = imath.IntArrayFromBuffer(sizes.astype(np.int32))
    indices = imath.IntArrayFromBuffer(mesh.faces.reshape(-1)[corners].astype(np.int32))
    scope = geometry.GeometryScope.kFacevaryingScope
    uv = geometry.OV2fGeomParamSample()
    if mesh.corner_uv is not None:
        values, index = np.unique(mesh.corner_uv.reshape(-1, 2)[corners], axis=0, return_inverse=True)
        buffer = imath.V2fArrayFromBuffer(values.astype(np.float32))
        uv = geometry.OV2fGeomParamSample(buffer, _unsigned(index.reshape(-1), imath), scope)
    turned, chosen, index_of_corner = None, None, None
    if mesh.corner_normals is not None:
        turned = normal_turner(mesh.corner_normals, mesh.faces, mesh.vertices)
        # Corners of one vertex with one normal turn together: one value serves them all.
        rows = np.column_stack([mesh.faces.reshape(-1), mesh.corner_normals.reshape(-1, 3)])[corners]
        _, first, index = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        chosen, index_of_corner = corners[first], _unsigned(index.reshape(-1), imath)

    def sample_of(vertices: Float[np.ndarray, "V 3"]) -> Any:
        points = imath.V3fArrayFromBuffer(np.ascontiguousarray(vertices, np.float32))
        if turned is None:
            return geometry.OPolyMeshSchemaSample(points, indices, counts, uv)
        values = imath.V3fArrayFromBuffer(turned(vertices).reshape(-1, 3)[chosen].astype(np.float32))
        normals = geometry.ON3fGeomParamSample(values, index_of_corner, scope)
        return geometry.OPolyMeshSchemaSample(points, indices, counts, uv, normals)

    return sample_of


def _unsigned(index: Int[np.ndarray, " N"], imath: Any) -> Any:
    return imath.UnsignedIntArray(imath.DoubleArrayFromBuffer(index.astype(np.float64)))  # it takes no other buffer


def _add_face_sets(schema: Any, mesh: Mesh, path: Path) -> None:
    _, geometry, _, imath = library(path, "write")
    triangles = polygon_sizes(mesh) - 2
    first = np.cumsum(triangles) - triangles
    members: dict[Material | str, list[Int[np.ndarray, " N"]]] = {}
    for part in mesh.parts:
        start, stop = np.searchsorted(first, [part.start, part.stop]).tolist()
        if (part.material.name if part.material else part.name) and start < stop:
            members.setdefault(part.material or part.name, []).append(np.arange(start, stop))
    taken: set[str] = set()
    for look, polygons in members.items():
        name = _free_name(_object_name(look.name if isinstance(look, Material) else look), taken)
        taken.add(name)
        faces = imath.IntArrayFromBuffer(np.concatenate(polygons).astype(np.int32))
        schema.createFaceSet(name).getSchema().set(geometry.OFaceSetSchemaSample(faces))


def _free_name(name: str, taken: set[str]) -> str:
    """The name, or with the next free number."""
    wanted, number = name, 2
    while name in taken:
        name, number = f"{wanted}_{number}", number + 1
    return name


def _object_name(name: str) -> str:
    """A name an object may have: not empty, and without the stroke that separates the names of a path."""
    return name.replace("/", "_") or "mesh"
