"""A mesh as a graphics card wants it: vertices split where normals or texture coordinates part, and nowhere else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core.geometry import weld
from ..core.mesh import Mesh
from ..render.textures import creased_normals

ALIKE = 0.98
"""Cosine between two corner normals at one end of an edge from which on the edge is smooth there."""


@dataclass(frozen=True, eq=False)
class SplitMesh:
    """The split surface; R render vertices, in the order of the mesh's."""

    corners: Int[np.ndarray, "F 3"]
    """Render vertex of each face corner."""
    origin: Int[np.ndarray, " R"]
    """The mesh's vertex that a render vertex is at."""
    smooth: Int[np.ndarray, " R"]
    """Render vertices with one number share a normal: the sum of their faces'."""
    uv: Float[np.ndarray, "R 2"] | None


def split_vertices(mesh: Mesh) -> SplitMesh:
    """Split the vertices of a mesh; a point cloud stays as it is.

    Hard edges are where the file's corner normals part, or where `paint.creased_normals` part if it gave none. Normals
    that the file has but that are no sum of its faces' are not kept: players shade by geometry, in every frame.
    """
    count = len(mesh.vertices)
    if len(mesh.faces) == 0:
        return SplitMesh(np.zeros((0, 3), np.int64), np.arange(count), np.arange(count), None)
    normals = creased_normals(mesh.vertices, mesh.faces) if mesh.corner_normals is None else mesh.corner_normals
    shared = smoothing(mesh, normals).ravel()
    textured = mesh.corner_uv is not None and any(part.material and part.material.texture for part in mesh.parts)
    uv = np.ascontiguousarray(mesh.corner_uv, np.float32).reshape(-1, 2) if textured else None
    key = _number(mesh.faces.ravel(), shared)
    if uv is not None:
        key = _number(key, np.unique(uv.view(np.uint64).ravel(), return_inverse=True)[1])
    first, corners = np.unique(key, return_index=True, return_inverse=True)[1:]
    return SplitMesh(
        corners.reshape(-1, 3),
        mesh.faces.ravel()[first].astype(np.int64),
        np.unique(shared[first], return_inverse=True)[1],
        None if uv is None else uv[first],
    )


def smoothing(mesh: Mesh, normals: Float[np.ndarray, "F 3 3"]) -> Int[np.ndarray, "F 3"]:
    """A number for each corner: corners at one position have the same where smooth edges lead from one to the other.

    Across split vertices too. An edge is smooth at an end where the normals of its two faces are alike there.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    position = weld(mesh.vertices)[1][mesh.faces]
    corner = np.arange(position.size).reshape(-1, 3)
    start, stop = position.ravel(), np.roll(position, -1, axis=1).ravel()
    here, there = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    swapped = start > stop
    low, high = np.where(swapped, there, here), np.where(swapped, here, there)
    order = np.lexsort((np.maximum(start, stop), np.minimum(start, stop)))
    low, high = low[order], high[order]
    flat = position.ravel()
    same = (flat[low[1:]] == flat[low[:-1]]) & (flat[high[1:]] == flat[high[:-1]])
    a = np.concatenate([low[:-1][same], high[:-1][same]])
    b = np.concatenate([low[1:][same], high[1:][same]])
    flat_normals = normals.reshape(-1, 3)
    alike = np.einsum("nk,nk->n", flat_normals[a], flat_normals[b]) > ALIKE
    a, b = a[alike], b[alike]
    size = position.size
    found = connected_components(coo_array((np.ones(len(a), bool), (a, b)), shape=(size, size)), directed=False)[1]
    return found.reshape(-1, 3)


def _number(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """One number for each pair, in the order of the pairs."""
    return np.unique(first.astype(np.int64) * (int(second.max()) + 1) + second, return_inverse=True)[1]
