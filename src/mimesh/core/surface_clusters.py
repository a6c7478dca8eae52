"""Reduce very dense surfaces quickly: vertices in one cell of a grid become one of them."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .geometry import distinct_rows, face_areas
from .mesh import Mesh, chosen_faces

MOST_CELLS = 2**19
"""Along an axis, so that the number of a cell and a kind is one of 64 bits."""


@dataclass(frozen=True, eq=False)
class Clusters:
    """Vertices that stand for those around them."""

    vertices: Int[np.ndarray, " C"]
    """The vertices that are kept, sorted: of each cell the first one."""
    cluster: Int[np.ndarray, " V"]
    """For each vertex the place, among these, of the one that stands for it."""
    faces: Int[np.ndarray, "G 3"]
    """Triangles between kept vertices, by their places; those with two corners in one cell are left out."""
    kept: Int[np.ndarray, " G"]
    """Which of the triangles these are."""
    side: float
    """Length of a cell."""


def clusters(
    points: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    count: int,
    kind: Int[np.ndarray, " V"] | None = None,
) -> Clusters:
    """Keep one vertex of each cell of a grid whose cells have the area of the surface over `count` on a side.

    Time and memory grow with the number of vertices, where decimation by quadrics takes seven times as long for three
    times as many; it is rougher, too, so `count` should be far above what is needed.

    Args:
        kind: from 0 to 7, of each vertex; vertices of a cell that differ in it stay apart.
    """
    side = max(np.sqrt(face_areas(points, faces).sum() / count), np.ptp(points, axis=0).max() / MOST_CELLS)
    cell = ((points - points.min(axis=0)) / side).astype(np.int64)
    width = cell.max(axis=0) + 1
    number = (cell[:, 0] * width[1] + cell[:, 1]) * width[2] + cell[:, 2]
    first, index = distinct_rows([number if kind is None else 8 * number + kind])
    place = np.empty(len(first), np.int64)
    place[np.argsort(first)] = np.arange(len(first))
    cluster = place[index]
    corners = cluster[faces]
    kept = np.flatnonzero((corners != np.roll(corners, 1, axis=1)).all(axis=1))
    return Clusters(np.sort(first), cluster, corners[kept], kept, float(side))


def clustered_mesh(mesh: Mesh, count: int) -> Mesh:
    """Reduce a mesh to roughly `count` vertices by `clusters`; normals, texture coordinates and materials stay."""
    found = clusters(mesh.vertices, mesh.faces, count)
    return dataclasses.replace(chosen_faces(mesh, found.kept, found.vertices), faces=found.faces)
