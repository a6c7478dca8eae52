"""Vertices for graphics hardware: split only where normals or texture coordinates of faces at a vertex differ."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core.geometry import weld
from ..core.mesh import Mesh
from ..render.textures import creased_normals

SMOOTH_COSINE = 0.98
"""Cosine between the corner normals of two faces at one end of an edge, above which the edge is smooth there."""


@dataclass(frozen=True, eq=False)
class SplitMesh:
    """A mesh with split vertices: R render vertices, in the order of the mesh's vertices."""

    corners: Int[np.ndarray, "F 3"]
    """Render vertex of each face corner."""
    origin: Int[np.ndarray, " R"]
    """Vertex of the mesh of each render vertex."""
    smooth: Int[np.ndarray, " R"]
    """Smoothing group: render vertices of one group share a normal, the sum of the normals of their faces."""
    uv: Float[np.ndarray, "R 2"] | None
    """Texture coordinates; None without a texture."""


def split_vertices(mesh: Mesh) -> SplitMesh:
    """Split the vertices of a mesh; a point cloud is not changed.

    Edges are hard where the file's corner normals differ, or, without any, where `textures.creased_normals` differ.
    Custom normals of a file are not kept: the player computes normals from the geometry of every frame.
    """
    count = len(mesh.vertices)
    if len(mesh.faces) == 0:
        return SplitMesh(np.zeros((0, 3), np.int64), np.arange(count), np.arange(count), None)
    normals = creased_normals(mesh.vertices, mesh.faces) if mesh.corner_normals is None else mesh.corner_normals
    group = smoothing_groups(mesh, normals).ravel()
    textured = mesh.corner_uv is not None and any(part.material and part.material.texture for part in mesh.parts)
    uv = np.ascontiguousarray(mesh.corner_uv, np.float32).reshape(-1, 2) if textured else None
    # A render vertex is a distinct combination of vertex, smoothing group and texture coordinates.
    key = _number_pairs(mesh.faces.ravel(), group)
    if uv is not None:
        # Two float32 are compared as one uint64, much faster than rows.
        key = _number_pairs(key, np.unique(uv.view(np.uint64).ravel(), return_inverse=True)[1])
    first, corners = np.unique(key, return_index=True, return_inverse=True)[1:]
    return SplitMesh(
        corners.reshape(-1, 3),
        mesh.faces.ravel()[first].astype(np.int64),
        np.unique(group[first], return_inverse=True)[1],
        None if uv is None else uv[first],
    )


def smoothing_groups(mesh: Mesh, normals: Float[np.ndarray, "F 3 3"]) -> Int[np.ndarray, "F 3"]:
    """Number the smoothing groups of corners: corners at one position that smooth edges connect, directly or not.

    An edge is smooth at an end if the normals of its two faces there have a cosine above SMOOTH_COSINE. Positions, not
    vertex indices, are compared, so that files with split vertices are smooth, too. Groups are the connected components
    of a graph of corners: half-edges are sorted by their end positions, which puts the two of an edge side by side.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    position = weld(mesh.vertices)[1][mesh.faces]
    corner = np.arange(position.size).reshape(-1, 3)
    start, stop = position.ravel(), np.roll(position, -1, axis=1).ravel()
    start_corner, stop_corner = corner.ravel(), np.roll(corner, -1, axis=1).ravel()
    swapped = start > stop
    # Corners at the end with the smaller and with the larger position index, whichever way the half-edge runs.
    low, high = np.where(swapped, stop_corner, start_corner), np.where(swapped, start_corner, stop_corner)
    order = np.lexsort((np.maximum(start, stop), np.minimum(start, stop)))
    low, high = low[order], high[order]
    flat = position.ravel()
    # Successive half-edges of the same positions share the edge; an edge of three faces gives two pairs.
    same = (flat[low[1:]] == flat[low[:-1]]) & (flat[high[1:]] == flat[high[:-1]])
    a = np.concatenate([low[:-1][same], high[:-1][same]])
    b = np.concatenate([low[1:][same], high[1:][same]])
    flat_normals = normals.reshape(-1, 3)
    similar = np.einsum("nk,nk->n", flat_normals[a], flat_normals[b]) > SMOOTH_COSINE
    a, b = a[similar], b[similar]
    size = position.size
    groups = connected_components(coo_array((np.ones(len(a), bool), (a, b)), shape=(size, size)), directed=False)[1]
    return groups.reshape(-1, 3)


def _number_pairs(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Number the distinct pairs (first, second) in lexicographic order; return the number of each pair."""
    return np.unique(first.astype(np.int64) * (int(second.max()) + 1) + second, return_inverse=True)[1]
