"""From the polygons of a file to the triangles of a Mesh, and from its corner normals back to the file's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ..core.geometry import face_normals
from ..core.mesh import Mesh


def fan_corners(sizes: Int[np.ndarray, " P"]) -> tuple[Int[np.ndarray, "F 3"], Int[np.ndarray, " F"]]:
    """Triangulate polygons, each as a fan around its first corner.

    `sizes` are the corner counts of polygons whose corners lie one after another in a flat list. Returns the place
    in that list of each triangle's corners, and the polygon each triangle came from. Polygons of one or two corners
    give no triangle; concave polygons are not treated apart.
    """
    triangles = np.maximum(sizes - 2, 0)
    polygon = np.repeat(np.arange(len(sizes)), triangles)
    first = (np.cumsum(sizes) - sizes)[polygon]
    step = np.arange(len(polygon)) - (np.cumsum(triangles) - triangles)[polygon]
    return np.stack([first, first + step + 1, first + step + 2], axis=1).astype(np.int64), polygon


def polygon_sizes(mesh: Mesh) -> Int[np.ndarray, " P"]:
    """Corners of each polygon that the faces of a mesh are fans of, in order; triangles unless its file says more."""
    sizes = getattr(mesh.source, "sizes", None)  # of sources whose format has polygons
    if sizes is None:
        return np.full(len(mesh.faces), 3)
    sizes = sizes[sizes > 2]
    assert (sizes - 2).sum() == len(mesh.faces), "a mesh with other faces must not keep its source"
    return sizes


def polygon_corners(sizes: Int[np.ndarray, " P"]) -> Int[np.ndarray, " C"]:
    """Where each polygon's corners are among the triangle corners that `fan_corners` made of them, (F, 3) flattened.

    `mesh.faces.reshape(-1)[polygon_corners(sizes)]` are the vertices of the polygons, one after another; the same takes
    texture coordinates and normals back. Polygons have three corners or more.
    """
    first = np.repeat(3 * (np.cumsum(sizes - 2) - (sizes - 2)), sizes)
    step = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    # Corners 0, 1, 2 are those of the first triangle, corner k the last of triangle k - 2.
    return first + np.where(step < 2, step, 3 * step - 4)


def reversed_corners(sizes: Int[np.ndarray, " P"]) -> Int[np.ndarray, " C"]:
    """Places of all corners in their flat list, those of each polygon from its last to its first."""
    first = np.repeat(np.cumsum(sizes) - sizes, sizes)
    return 2 * first + np.repeat(sizes, sizes) - 1 - np.arange(len(first))


def polygons_of(mesh: Mesh, values: np.ndarray) -> list[list]:
    """Of values at the triangle corners (F, 3), those at the corners of each polygon, as lists."""
    sizes = polygon_sizes(mesh)
    if (sizes == 3).all():
        return values.reshape(-1, 3).tolist()
    flat = values.reshape(-1)[polygon_corners(sizes)].tolist()
    stops = np.cumsum(sizes).tolist()
    return [flat[stop - size : stop] for size, stop in zip(sizes.tolist(), stops, strict=True)]


def joined_corners(given: Sequence[np.ndarray | None], counts: Sequence[int]) -> np.ndarray | None:
    """Values at the corners of several meshes as those of one mesh: zeros where a mesh has none, None where all lack.

    `counts` are the rows of each mesh.
    """
    width = next((values.shape[1:] for values in given if values is not None), None)
    if width is None:
        return None
    filled = [np.zeros((n, *width)) if values is None else values for values, n in zip(given, counts, strict=True)]
    return np.concatenate(filled)


def with_face_normals(
    normals: Float[np.ndarray, "F 3 3"], vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "F 3 3"]:
    """Corner normals, and those of the faces where they are zero."""
    return np.where(normals.any(axis=2, keepdims=True), normals, face_normals(vertices, faces)[:, None])


def scatter_corners(
    corner_values: Float[np.ndarray, "F 3 C"], index: Int[np.ndarray, "F 3"], before: Float[np.ndarray, "N C"]
) -> Float[np.ndarray, "N C"]:
    """Bring values at triangle corners back to the `index` they were taken from; rows no corner uses keep `before`."""
    after = before.copy()
    after[index.ravel()] = corner_values.reshape(-1, corner_values.shape[-1])
    return after
