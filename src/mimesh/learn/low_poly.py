"""Low-poly versions of surfaces: points on flat triangles of a decimated mesh, with the triangles' normals."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from ..core import geometry, surface_points

LEVELS = (200, 500, 1200)
"""Numbers of triangles of a whole character. Chosen by hand: game characters of phones have about 500 to 1,500."""
SAMPLES = 4
"""Points drawn on the decimated mesh for each point that is moved to the nearest of them."""
NORMAL_WEIGHT = 0.1
"""Distance, in heights of the mesh, that counts as much as opposite normals: points stay on their side of limbs."""
SMALLEST = 12
"""Triangles below which a decimated piece is not used: the piece keeps its points."""


def flattened(
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    count: int,
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """Move points of a mesh, with normals, to the mesh decimated to `count` triangles; a coarser one is left as it is.

    Each point goes to the nearest, in place and normal, of random points of the decimated mesh. So it keeps its weights
    and joints, and no triangle gets more than its share.
    """
    import fast_simplification
    from scipy.spatial import KDTree

    welded, index = geometry.weld(vertices)
    joined = index[faces]
    joined = joined[(joined != np.roll(joined, 1, axis=1)).all(axis=1)]
    if len(joined) <= count:
        return points, normals
    found = fast_simplification.simplify(welded, joined.astype(np.int32), target_count=count)
    coarse, triangles = found[0].astype(np.float64), found[1].astype(np.int64)
    triangles = triangles[geometry.face_areas(coarse, triangles) > 0]
    if len(triangles) < SMALLEST:
        return points, normals
    face, share = surface_points.sample_surface(coarse, triangles, SAMPLES * len(points), np.random.default_rng(0))
    places = surface_points.at_barycentric(coarse, triangles, face, share)
    flat = geometry.face_normals(coarse, triangles)[face]
    weight = NORMAL_WEIGHT * np.ptp(vertices, axis=0).max() / 2
    nearest = KDTree(np.hstack([places, weight * flat])).query(np.hstack([points, weight * normals]))[1]
    return places[nearest], flat[nearest]
