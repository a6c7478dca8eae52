"""Convert polygons to triangles and back, and move values between polygon corners and triangle corners.

Polygons are given by `sizes`, their corner counts, with the corners of all polygons one after another in a flat list.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core.geometry import face_normals
from ..core.mesh import Mesh


@dataclass(frozen=True, eq=False)
class PolygonSource:
    """The polygons of the file that a Mesh was read from, which new files of it have, too. Satisfies `mesh.Source`."""

    suffix: str
    sizes: Int[np.ndarray, " P"]
    """Corners of each polygon; the faces are triangle fans of them."""


def fan_corners(sizes: Int[np.ndarray, " P"]) -> tuple[Int[np.ndarray, "F 3"], Int[np.ndarray, " F"]]:
    """Triangulate polygons, each as a fan around its first corner.

    Returns the index in the flat list of each triangle's corners, and the polygon of each triangle. Polygons of one or
    two corners give no triangle. Concave polygons get the same fan, whose triangles may lie outside of them.
    """
    # Polygon p becomes triangles (0, 1, 2), (0, 2, 3), ...; `step` counts them from 0 within each polygon.
    triangles = np.maximum(sizes - 2, 0)
    polygon = np.repeat(np.arange(len(sizes)), triangles)
    first = (np.cumsum(sizes) - sizes)[polygon]
    step = np.arange(len(polygon)) - (np.cumsum(triangles) - triangles)[polygon]
    return np.stack([first, first + step + 1, first + step + 2], axis=1).astype(np.int64), polygon


def polygon_sizes(mesh: Mesh) -> Int[np.ndarray, " P"]:
    """Return the corner count of each polygon of a mesh, in face order; triangles where its source has no polygons."""
    sizes = getattr(mesh.source, "sizes", None)  # only sources of formats with polygons have it
    if sizes is None:
        return np.full(len(mesh.faces), 3)
    sizes = sizes[sizes > 2]
    assert (sizes - 2).sum() == len(mesh.faces), "a mesh with other faces must not keep its source"
    return sizes


def polygon_corners(sizes: Int[np.ndarray, " P"]) -> Int[np.ndarray, " C"]:
    """Return the index of each polygon corner among the flattened triangle corners (F, 3) of `fan_corners`.

    `mesh.faces.reshape(-1)[polygon_corners(sizes)]` are the vertices of the polygons; the same index takes texture
    coordinates and normals back. Polygons must have three corners or more.
    """
    first = np.repeat(3 * (np.cumsum(sizes - 2) - (sizes - 2)), sizes)
    step = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    # Corners 0, 1, 2 are those of the first triangle; corner k > 2 is the last of triangle k - 2: 3 (k - 2) + 2.
    return first + np.where(step < 2, step, 3 * step - 4)


def polygons_of(mesh: Mesh, values: np.ndarray) -> list[list]:
    """Collect values at the triangle corners (F, 3) as one list per polygon."""
    sizes = polygon_sizes(mesh)
    if (sizes == 3).all():
        return values.reshape(-1, 3).tolist()
    flat = values.reshape(-1)[polygon_corners(sizes)].tolist()
    stops = np.cumsum(sizes).tolist()
    return [flat[stop - size : stop] for size, stop in zip(sizes.tolist(), stops, strict=True)]


def joined_corners(values_of_mesh: Sequence[np.ndarray | None], counts: Sequence[int]) -> np.ndarray | None:
    """Concatenate corner values of several meshes: zeros for a mesh without values, None where no mesh has any.

    `counts` are the rows of each mesh.
    """
    shape = next((values.shape[1:] for values in values_of_mesh if values is not None), None)
    if shape is None:
        return None
    pairs = zip(values_of_mesh, counts, strict=True)
    return np.concatenate([np.zeros((count, *shape)) if values is None else values for values, count in pairs])


def with_face_normals(
    normals: Float[np.ndarray, "F 3 3"], vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "F 3 3"]:
    """Replace zero corner normals by the normals of their faces."""
    return np.where(normals.any(axis=2, keepdims=True), normals, face_normals(vertices, faces)[:, None])


def smooth_normals(mesh: Mesh) -> Float[np.ndarray, "V 3"] | None:
    """Return the normal of each vertex, +y for one without faces; None where corners of a vertex have several."""
    if mesh.corner_normals is None:
        return None
    normals = np.tile([0.0, 1.0, 0.0], (len(mesh.vertices), 1))
    normals[mesh.faces] = mesh.corner_normals
    return normals if (normals[mesh.faces] == mesh.corner_normals).all() else None
