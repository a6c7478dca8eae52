"""Reduce very dense surfaces quickly: vertices in one cell of a grid become one of them."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from .geometry import distinct_rows, face_areas
from .mesh import Mesh

MOST_CELLS = 2**20
"""Along an axis, so that the number of a cell is one of 64 bits."""


def clusters(
    points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int
) -> tuple[Int[np.ndarray, " C"], Int[np.ndarray, "G 3"], Int[np.ndarray, " G"]]:
    """Keep one vertex of each cell of a grid whose cells have the area of the surface over `count` on a side.

    Time and memory grow with the number of vertices, where decimation by quadrics takes seven times as long for three
    times as many; it is rougher, too, so `count` should be far above what is needed.

    Returns:
        The vertices that are kept, sorted; the triangles between them, by their places among these; and which of the
        triangles these are. Triangles within a cell, or with two corners in one, are left out.
    """
    side = max(np.sqrt(face_areas(points, faces).sum() / count), np.ptp(points, axis=0).max() / MOST_CELLS)
    cell = ((points - points.min(axis=0)) / side).astype(np.int64)
    width = cell.max(axis=0) + 1
    first, index = distinct_rows([(cell[:, 0] * width[1] + cell[:, 1]) * width[2] + cell[:, 2]])
    place = np.empty(len(first), np.int64)
    place[np.argsort(first)] = np.arange(len(first))
    corners = place[index][faces]
    kept = np.flatnonzero((corners != np.roll(corners, 1, axis=1)).all(axis=1))
    return np.sort(first), corners[kept], kept


def clustered_mesh(mesh: Mesh, count: int) -> Mesh:
    """Reduce a mesh to roughly `count` vertices by `clusters`; normals, texture coordinates and materials stay."""
    vertices, faces, kept = clusters(mesh.vertices, mesh.faces, count)
    parts = [
        dataclasses.replace(part, start=int(start), stop=int(stop))
        for part in mesh.parts
        for start, stop in [np.searchsorted(kept, (part.start, part.stop))]
    ]
    return Mesh(
        mesh.vertices[vertices],
        faces,
        mesh.name,
        corner_uv=None if mesh.corner_uv is None else mesh.corner_uv[kept],
        corner_normals=None if mesh.corner_normals is None else mesh.corner_normals[kept],
        vertex_colors=None if mesh.vertex_colors is None else mesh.vertex_colors[vertices],
        parts=tuple(part for part in parts if part.stop > part.start),
        up=mesh.up,
    )
