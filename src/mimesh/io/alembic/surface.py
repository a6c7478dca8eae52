"""What an Alembic mesh has besides its points, at its first sample: polygons, texture coordinates, normals, face sets.

Alembic's polygons run clockwise seen from outside; here they run counter-clockwise, also where a transform mirrors.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError
from ...core.geometry import unit_vectors
from ..polygons import backwards
from .scene import Shape, at_time, whole_numbers


@dataclass(frozen=True, eq=False)
class Surface:
    """The polygons of a mesh and what their corners carry, corner after corner."""

    sizes: Int[np.ndarray, " P"]
    corners: Int[np.ndarray, " C"]
    uv: Float[np.ndarray, "C 2"] | None
    normals: Float[np.ndarray, "C 3"] | None
    """In the world, at length one or zero."""
    face_set: Int[np.ndarray, " P"]
    """Number of the first face set that has a polygon, -1 where none has."""
    face_sets: tuple[str, ...]
    notes: tuple[str, ...]


def read_surface(shape: Shape, count: int, T_world_local: Float[np.ndarray, "4 4"], path: Path) -> Surface:
    """The surface of a mesh of `count` vertices. Values at its corners that do not fit them are left out with a note.

    Raises:
        InputError: polygons or face sets that name what is not there.
    """
    sizes, corners = _polygons(shape, shape.points.times[0])
    if (sizes < 0).any() or sizes.sum() != len(corners) or (len(corners) and not _within(corners, count)):
        raise InputError(
            f"{path}: expected polygons with corners in 0..{count - 1} in {shape.name!r}, found {len(sizes)} polygons "
            f"with {len(corners)} corners that do not fit; the file is damaged, export it again"
        )
    determinant = np.linalg.det(T_world_local[:3, :3])
    order = np.arange(len(corners)) if determinant < 0 else backwards(sizes)
    notes: list[str] = []
    values: list[Float[np.ndarray, "C K"] | None] = []
    for found, width in ((shape.schema.getUVsParam(), 2), (_normals_of(shape), 3)):
        rows = None
        if found is not None and found.valid() and found.getNumSamples() > 0:
            rows = _corner_values(found, width, sizes, corners, count)
            if rows is None:
                notes.append(f"dropped '{found.getName()}' of {shape.name}: not one for each corner or vertex")
        values.append(rows[order] if rows is not None else None)
    normals = values[1]
    if normals is not None:
        normals = unit_vectors(normals @ _cofactors(T_world_local[:3, :3]).T) * (-1.0 if determinant < 0 else 1.0)
    face_set, names = _face_sets(shape, len(sizes), path)
    return Surface(sizes, corners[order], values[0], normals, face_set, names, tuple(notes))


def keeps_topology(shape: Shape, time: float) -> bool:
    """Whether the polygons of a sample are those of the first; an archive may say so without a look at them."""
    schema = shape.schema
    if schema.getFaceCountsProperty().isConstant() and schema.getFaceIndicesProperty().isConstant():
        return True
    both = zip(_polygons(shape, time), _polygons(shape, shape.points.times[0]), strict=True)
    return all(np.array_equal(now, first) for now, first in both)


def _polygons(shape: Shape, time: float) -> tuple[Int[np.ndarray, " P"], Int[np.ndarray, " C"]]:
    """Corner counts and corners as the file has them."""
    found = (shape.schema.getFaceCountsProperty(), shape.schema.getFaceIndicesProperty())
    sizes, corners = (np.asarray(values.getValue(at_time(time)), np.int32).astype(np.int64) for values in found)
    return sizes, corners


def _normals_of(shape: Shape) -> Any:
    # The library has no such function for subdivision surfaces, which have no normals of their own.
    return shape.schema.getNormalsParam() if hasattr(shape.schema, "getNormalsParam") else None


def _within(index: Int[np.ndarray, " N"], count: int) -> bool:
    return not len(index) or bool(index.min() >= 0 and index.max() < count)


def _corner_values(
    found: Any, width: int, sizes: Int[np.ndarray, " P"], corners: Int[np.ndarray, " C"], count: int
) -> Float[np.ndarray, "C K"] | None:
    """The values of a geometry parameter at the corners in the file's order; None where they do not fit."""
    sample = found.getIndexedValue()
    rows = np.asarray(sample.getVals(), np.float32).astype(np.float64).reshape(-1, width)
    if found.isIndexed():
        index = whole_numbers(sample.getIndices())
        if not _within(index, len(rows)):
            return None
        rows = rows[index]
    at_vertices = str(found.getScope()) in ("kVertexScope", "kVaryingScope")
    # Programs name the scope wrongly at times; the number of values tells.
    if len(rows) == len(corners) and not (at_vertices and len(rows) == count):
        return rows
    if len(rows) == count:
        return rows[corners]
    if len(rows) == len(sizes):
        return np.repeat(rows, sizes, axis=0)
    return np.repeat(rows, len(corners), axis=0) if len(rows) == 1 else None


def _cofactors(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The inverse transposed, times the determinant; also of a matrix that has no inverse."""
    return np.cross(np.roll(matrix, -1, axis=0), np.roll(matrix, -2, axis=0))


def _face_sets(shape: Shape, polygons: int, path: Path) -> tuple[Int[np.ndarray, " P"], tuple[str, ...]]:
    names = tuple(shape.schema.getFaceSetNames())
    face_set = np.full(polygons, -1)
    for number, name in enumerate(names):
        chosen = shape.schema.getFaceSet(name).getSchema()
        faces = np.asarray(chosen.getValue().getFaces(), np.int32) if chosen.getNumSamples() else np.zeros(0, np.int32)
        if not _within(faces, polygons):
            raise InputError(
                f"{path}: expected polygons in 0..{polygons - 1} in face set {name!r}, found {faces.max()}; "
                "the file is damaged, export it again"
            )
        face_set[faces[face_set[faces] < 0]] = number
    return face_set, names
