"""Tell which joints a surface encloses: those of a person lie inside of it, and what was read as one may lie outside.

A joint is enclosed if nearly every direction from it meets the surface. That needs no closed surface, no winding and no
normals: inner shells, faces drawn twice and garments do no harm, as they do to winding numbers.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from jaxtyping import Float

DIRECTIONS = 48
"""Directions from a joint, even over the sphere."""
MEETS = float(np.cos(np.radians(30)))
"""Cosine of the angle to the nearest point of the surface up to which a direction meets it. Of wrists and necks, 3 cm
from the surface, points of it are 20 degrees apart; with 25 degrees 0.75 of the joints of people are enclosed, with 30
0.94 (docs/log/mime.md, "Joints outside of the surface")."""
ENCLOSED = 0.9
"""Share of the directions that meet the surface, above which a joint is enclosed."""
OPEN = 0.1
"""Length of the mean normal of a surface from which on it is open: 0.06 at most of 160 whole meshes, half of a surface,
as one camera sees it, has 0.5."""


def share_enclosed(
    joints: Float[np.ndarray, "J 3"], points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]
) -> float:
    """Return the share of joints that a surface encloses; 1 without joints, and of an open surface.

    Args:
        points: spread evenly over the surface.
        normals: there, of unit length.
    """
    if len(joints) == 0 or np.linalg.norm(normals.mean(axis=0)) > OPEN:
        return 1.0
    meets = []
    for joint in joints:
        towards = (points - joint).astype(np.float32)
        towards /= np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
        meets.append((towards @ _directions().T).max(axis=0) > MEETS)
    return float((np.mean(meets, axis=1) > ENCLOSED).mean())


@cache
def _directions() -> Float[np.ndarray, "D 3"]:
    """Return directions along a spiral from pole to pole, the golden angle apart."""
    steps = np.arange(DIRECTIONS)
    height, angle = 1 - (2 * steps + 1) / DIRECTIONS, np.pi * (3 - np.sqrt(5)) * steps
    radius = np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], axis=1).astype(np.float32)
