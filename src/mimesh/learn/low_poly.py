"""Low-poly versions of surfaces: points on flat triangles of a decimated mesh, with the triangles' normals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ..core import geometry, surface_points

LEVELS = (200, 500, 1200)
"""Numbers of triangles of a whole character. Chosen by hand: game characters of phones have about 500 to 1,500."""
SAMPLES = 2
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
    counts: Sequence[int] = LEVELS,
) -> Float[np.ndarray, "L 2 N 3"]:
    """Move points of a mesh to the mesh decimated to some numbers of triangles: points and normals on each.

    Each point goes to the nearest, in place and normal, of random points of the decimated mesh. So it keeps its weights
    and joints, and no triangle gets more than its share. A mesh that is coarser already keeps its points.
    """
    import fast_simplification
    from scipy.spatial import KDTree

    coarse, index = geometry.weld(vertices)
    triangles = index[faces]
    triangles = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    weight = NORMAL_WEIGHT * np.ptp(vertices, axis=0).max() / 2
    result = np.tile(np.stack([points, normals]), (len(counts), 1, 1, 1))
    for level in np.argsort(counts)[::-1]:  # from fine to coarse, each from the one before: that is fast
        if len(triangles) > counts[level]:
            found = fast_simplification.simplify(coarse, triangles.astype(np.int32), target_count=counts[level])
            coarse, triangles = found[0].astype(np.float64), found[1].astype(np.int64)
            triangles = triangles[geometry.face_areas(coarse, triangles) > 0]
            if len(triangles) < SMALLEST:
                break
            rng = np.random.default_rng(0)
            face, share = surface_points.sample_surface(coarse, triangles, SAMPLES * len(points), rng)
            places = surface_points.at_barycentric(coarse, triangles, face, share)
            flat = geometry.face_normals(coarse, triangles)[face]
            tree = KDTree(np.hstack([places, weight * flat]), balanced_tree=False)
            nearest = tree.query(np.hstack([points, weight * normals]))[1]
            result[level] = places[nearest], flat[nearest]
    return result
