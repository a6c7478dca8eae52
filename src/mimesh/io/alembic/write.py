"""Write a new Alembic archive of one transform (Xform) and one mesh (PolyMesh) with its samples."""

from __future__ import annotations

import errno
import importlib.util
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ...core.frame_buffer import Progress, each_frame
from ...core.geometry import normal_turner
from ...core.mesh import Clip, Material, Mesh
from ...core.printable import numbered
from ..atomic import whole_file
from ..polygons import polygon_corners, polygon_sizes, reversed_corners
from ..usd import stage_axes

RESERVED_SPACE = 2**20
"""Bytes that must stay free on the disk besides the size of a sample, so that the library can finish the file."""


@dataclass(frozen=True, eq=False)
class AlembicSource:
    """What a new archive takes over from the archive that a mesh was read from. Satisfies `mesh.Source`.

    The library cannot copy an archive with other points, so `notes` list what a new one lacks.
    """

    sizes: Int[np.ndarray, " P"]
    """Corners of each polygon; the faces are triangle fans of them."""
    notes: tuple[str, ...]
    """One line for each thing that a new archive lacks or stores differently."""
    name: str
    """Name of the mesh object."""
    suffix = ".abc"


def write_alembic(mesh: Mesh, path: Path) -> None:
    """Write a mesh as a new Alembic archive: a clip of one frame (see `write_alembic_clip`)."""
    write_alembic_clip(Clip.still(mesh), path)


def write_alembic_clip(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write a clip as a new Alembic archive (Ogawa): an Xform, below it a PolyMesh with sample k at k / fps seconds.

    Written are positions in single precision, polygons, bounds, texture coordinates and normals per corner (normals
    rotate with the surface), and a face set for each material, or for each part without one. Colours and images are
    not written: Alembic has no common convention for them. Memory does not grow with the number of frames.

    Raises:
        InputError: alembic3d is not installed.
        OSError: the disk is nearly full.
    """
    abc, geometry, core, imath = _library(path)
    mesh = clip.mesh
    name = _object_name(mesh.source.name if isinstance(mesh.source, AlembicSource) else mesh.name)
    with whole_file(path) as temporary:
        archive = abc.CreateArchiveWithInfo(str(temporary), clip.fps, "mimesh", "")
        sampling = abc.Argument(archive.addTimeSampling(core.TimeSampling(1.0 / clip.fps, 0.0)))
        # One static transform; the mesh has a sample per frame at the archive's time sampling.
        transform = geometry.OXform(archive.getTop(), name)
        transform.getSchema().set(_axis_transform(mesh, geometry, imath))
        shape = geometry.OPolyMesh(transform, f"{name}Shape", sampling)
        schema = shape.getSchema()
        sample_of = _sampler(mesh, path)
        for vertices in each_frame(clip.vertices, progress):
            _check_free_space(path, RESERVED_SPACE + 8 * mesh.faces.nbytes)
            schema.set(sample_of(vertices))
        _add_face_sets(schema, mesh, path)
        # The library writes the end of the file when the last of these objects is destroyed.
        del schema, shape, transform, archive


def need_library(path: Path, verb: str) -> None:
    """Raise InputError where alembic3d is not installed; `verb` is "read" or "write"."""
    if importlib.util.find_spec("alembic3d") is None:
        raise InputError(
            f"{path}: expected alembic3d to {verb} Alembic, found it not installed; pip install 'mimesh[alembic]'"
        )


def _library(path: Path) -> tuple[Any, Any, Any, Any]:
    """Import alembic3d and return its modules Abc, AbcGeom, AbcCoreAbstract and imath.

    Raises:
        InputError: it is not installed.
    """
    need_library(path, "write")
    import alembic3d
    import imath

    return alembic3d.Abc, alembic3d.AbcGeom, alembic3d.AbcCoreAbstract, imath


def _check_free_space(path: Path, size: int) -> None:
    """Check that the disk has room for `size` more bytes: on a full disk the library ends the process.

    Raises:
        OSError: fewer bytes are free.
    """
    if shutil.disk_usage(path.parent).free < size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _axis_transform(mesh: Mesh, geometry, imath):
    """Build the Xform sample from the mesh's axes and unit to y up and metres, as programs that read Alembic expect.

    The vertices below it keep their coordinates.
    """
    (axis, angle), unit = stage_axes(mesh)
    sample = geometry.XformSample()
    if angle:
        (sample.setXRotation if axis == "x" else sample.setZRotation)(angle)
    if unit != 1:
        sample.setScale(imath.V3d(unit, unit, unit))
    return sample


def _sampler(mesh: Mesh, path: Path) -> Callable[[Float[np.ndarray, "V 3"]], Any]:
    """Return a function from the vertices of a frame to its PolyMesh sample.

    Polygons and UVs are in every sample; the library stores equal arrays once.
    """
    _, geometry, _, imath = _library(path)
    sizes = polygon_sizes(mesh)
    corners = polygon_corners(sizes)[reversed_corners(sizes)]
    counts = imath.IntArrayFromBuffer(sizes.astype(np.int32))
    indices = imath.IntArrayFromBuffer(mesh.faces.reshape(-1)[corners].astype(np.int32))
    scope = geometry.GeometryScope.kFacevaryingScope
    uv = geometry.OV2fGeomParamSample()
    if mesh.corner_uv is not None:
        values, index = np.unique(mesh.corner_uv.reshape(-1, 2)[corners], axis=0, return_inverse=True)
        buffer = imath.V2fArrayFromBuffer(values.astype(np.float32))
        uv = geometry.OV2fGeomParamSample(buffer, _unsigned(index.reshape(-1), imath), scope)
    rotated_normals, unique_corners, normal_index = None, None, None
    if mesh.corner_normals is not None:
        rotated_normals = normal_turner(mesh.corner_normals, mesh.faces, mesh.vertices)
        # Corners of one vertex with one normal rotate together, so one value is stored for all of them.
        rows = np.column_stack([mesh.faces.reshape(-1), mesh.corner_normals.reshape(-1, 3)])[corners]
        _, first, index = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        unique_corners, normal_index = corners[first], _unsigned(index.reshape(-1), imath)

    def sample_of(vertices: Float[np.ndarray, "V 3"]) -> Any:
        points = imath.V3fArrayFromBuffer(np.ascontiguousarray(vertices, np.float32))
        if rotated_normals is None:
            return geometry.OPolyMeshSchemaSample(points, indices, counts, uv)
        values = rotated_normals(vertices).reshape(-1, 3)[unique_corners].astype(np.float32)
        normals = geometry.ON3fGeomParamSample(imath.V3fArrayFromBuffer(values), normal_index, scope)
        return geometry.OPolyMeshSchemaSample(points, indices, counts, uv, normals)

    return sample_of


def _unsigned(index: Int[np.ndarray, " N"], imath: Any) -> Any:
    """Convert indices to the library's unsigned array, which has no constructor from an integer buffer."""
    return imath.UnsignedIntArray(imath.DoubleArrayFromBuffer(index.astype(np.float64)))


def _add_face_sets(schema: Any, mesh: Mesh, path: Path) -> None:
    """Write a face set of polygons for each material, and for each named part without one."""
    _, geometry, _, imath = _library(path)
    triangles = polygon_sizes(mesh) - 2
    first = np.cumsum(triangles) - triangles  # each polygon's first triangle
    members: dict[Material | str, list[Int[np.ndarray, " N"]]] = {}
    for part in mesh.parts:
        start, stop = np.searchsorted(first, [part.start, part.stop]).tolist()
        if (part.material.name if part.material else part.name) and start < stop:
            members.setdefault(part.material or part.name, []).append(np.arange(start, stop))
    used_names: set[str] = set()
    for label, polygons in members.items():
        label = _object_name(label.name if isinstance(label, Material) else label)
        name = next(name for name in numbered(label, "_") if name not in used_names)
        used_names.add(name)
        faces = imath.IntArrayFromBuffer(np.concatenate(polygons).astype(np.int32))
        schema.createFaceSet(name).getSchema().set(geometry.OFaceSetSchemaSample(faces))


def _object_name(name: str) -> str:
    """Return a legal object name: not empty, and without the slash that separates the names of a path."""
    return name.replace("/", "_") or "mesh"
