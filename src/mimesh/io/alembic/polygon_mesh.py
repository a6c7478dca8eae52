"""Read the first sample of an Alembic mesh besides its points: polygons, texture coordinates, normals, face sets.

Alembic winds polygons clockwise seen from outside. They are returned counter-clockwise, also under a mirroring
transform.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ...core.geometry import unit_vectors
from ..polygons import reversed_corners
from .scene import MeshObject, at_time, integers_of


@dataclass(frozen=True, eq=False)
class PolygonMesh:
    """The polygons of a mesh object with the values at their corners."""

    sizes: Int[np.ndarray, " P"]
    """Corners of each polygon."""
    corners: Int[np.ndarray, " C"]
    """Vertex index of each corner, polygon after polygon."""
    uv: Float[np.ndarray, "C 2"] | None
    normals: Float[np.ndarray, "C 3"] | None
    """World coordinates, of length one or zero."""
    face_set: Int[np.ndarray, " P"]
    """Index in `face_sets` of the first one that contains the polygon, -1 where none does."""
    face_sets: tuple[str, ...]
    """Names of the face sets."""
    notes: tuple[str, ...]
    """One line for each geometry parameter that was left out."""


def read_polygons(abc_mesh: MeshObject, count: int, T_world_local: Float[np.ndarray, "4 4"], path: Path) -> PolygonMesh:
    """Read the polygons of a mesh object of `count` vertices, with normals in world coordinates.

    UVs or normals whose number fits neither corners, vertices nor polygons are left out with a note.

    Raises:
        InputError: vertex indices of polygons, or polygon indices of face sets, are out of range.
    """
    sizes, corners = _polygons(abc_mesh, abc_mesh.points.times[0])
    if (sizes < 0).any() or sizes.sum() != len(corners) or (len(corners) and not _within(corners, count)):
        raise InputError(
            f"{path}: expected polygons with corners in 0..{count - 1} in {abc_mesh.name!r}, found {len(sizes)} "
            f"polygons with {len(corners)} corners that do not fit; the file is damaged, export it again"
        )
    # Reversing each polygon makes it counter-clockwise; a mirroring transform (negative determinant) already does so.
    determinant = np.linalg.det(T_world_local[:3, :3])
    order = np.arange(len(corners)) if determinant < 0 else reversed_corners(sizes)
    notes: list[str] = []
    values: list[Float[np.ndarray, "C K"] | None] = []
    for found, width in ((abc_mesh.schema.getUVsParam(), 2), (_normals_of(abc_mesh), 3)):
        rows = None
        if found is not None and found.valid() and found.getNumSamples() > 0:
            rows = _corner_values(found, width, sizes, corners, count)
            if rows is None:
                notes.append(f"dropped '{found.getName()}' of {abc_mesh.name}: not one for each corner or vertex")
        values.append(rows[order] if rows is not None else None)
    normals = values[1]
    if normals is not None:
        # Normals transform by the cofactor matrix; its sign flips with the determinant.
        normals = unit_vectors(normals @ _cofactors(T_world_local[:3, :3]).T) * (-1.0 if determinant < 0 else 1.0)
    face_set, names = _face_sets(abc_mesh, len(sizes), path)
    return PolygonMesh(sizes, corners[order], values[0], normals, face_set, names, tuple(notes))


def keeps_topology(abc_mesh: MeshObject, time: float) -> bool:
    """Return whether the polygons of the sample at a time equal those of the first; constant ones are not compared."""
    schema = abc_mesh.schema
    if schema.getFaceCountsProperty().isConstant() and schema.getFaceIndicesProperty().isConstant():
        return True
    both = zip(_polygons(abc_mesh, time), _polygons(abc_mesh, abc_mesh.points.times[0]), strict=True)
    return all(np.array_equal(now, first) for now, first in both)


def _polygons(abc_mesh: MeshObject, time: float) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " C"]]:
    """Read the corner count of each polygon and the vertex of each corner, in the file's winding."""
    found = (abc_mesh.schema.getFaceCountsProperty(), abc_mesh.schema.getFaceIndicesProperty())
    sizes, corners = (np.asarray(values.getValue(at_time(time)), np.int32).astype(np.int64) for values in found)
    return sizes, corners


def _normals_of(abc_mesh: MeshObject) -> Any:
    """Return the normals parameter of a mesh; None for a subdivision surface, whose schema has none."""
    return abc_mesh.schema.getNormalsParam() if hasattr(abc_mesh.schema, "getNormalsParam") else None


def _within(index: Int[np.ndarray, " N"], count: int) -> bool:
    """Return whether all indices are in 0..count - 1."""
    return not len(index) or bool(index.min() >= 0 and index.max() < count)


def _corner_values(
    found: Any, width: int, sizes: Int[np.ndarray, " P"], corners: Int[np.ndarray, " C"], count: int
) -> Float[np.ndarray, "C K"] | None:
    """Read a geometry parameter and expand it to one value per corner, in the file's order; None where it does not fit.

    The scope follows from the number of values: per corner, vertex, polygon, or one for all. Some exporters declare a
    wrong scope, so the declared one only decides where the number of corners equals the number of vertices.
    """
    sample = found.getIndexedValue()
    rows = np.asarray(sample.getVals(), np.float32).astype(np.float64).reshape(-1, width)
    if found.isIndexed():
        index = integers_of(sample.getIndices())
        if not _within(index, len(rows)):
            return None
        rows = rows[index]
    # Values at varying scope are per vertex for polygons.
    at_vertices = str(found.getScope()) in ("kVertexScope", "kVaryingScope")
    if len(rows) == len(corners) and not (at_vertices and len(rows) == count):
        return rows
    if len(rows) == count:
        return rows[corners]
    if len(rows) == len(sizes):
        return np.repeat(rows, sizes, axis=0)
    return np.repeat(rows, len(corners), axis=0) if len(rows) == 1 else None


def _cofactors(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Compute the cofactor matrix: determinant times inverse transpose, and defined for singular matrices too."""
    return np.cross(np.roll(matrix, -1, axis=0), np.roll(matrix, -2, axis=0))


def _face_sets(abc_mesh: MeshObject, polygons: int, path: Path) -> tuple[Int[np.ndarray, " P"], tuple[str, ...]]:
    """Read for each polygon the index of the first face set that contains it (-1: none), and the face sets' names."""
    names = tuple(abc_mesh.schema.getFaceSetNames())
    face_set = np.full(polygons, -1)
    for number, name in enumerate(names):
        schema = abc_mesh.schema.getFaceSet(name).getSchema()
        faces = np.asarray(schema.getValue().getFaces(), np.int32) if schema.getNumSamples() else np.zeros(0, np.int32)
        if not _within(faces, polygons):
            raise InputError(
                f"{path}: expected polygons in 0..{polygons - 1} in face set {name!r}, found {faces.max()}; "
                "the file is damaged, export it again"
            )
        face_set[faces[face_set[faces] < 0]] = number
    return face_set, names
