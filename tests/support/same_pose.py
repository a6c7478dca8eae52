"""Compare the poses of two people of the shipped body by their surfaces, whatever their shapes."""

from __future__ import annotations

from functools import cache

import numpy as np

from mimesh.core.geometry import angles_between, nearest_rotation
from mimesh.evaluate.pairs import human

RIGID, LEAST = 0.999, 10
"""Skinning weight above which a vertex moves rigidly with its joint, and number of such vertices that a region has."""
TOLERANCE = 0.1
"""Degrees. Weights just below 1 bend a region by 0.006; poses of two pairs differ by 50 and more."""


@cache
def rigid_regions() -> tuple[np.ndarray, ...]:
    """Vertices that each joint moves alone, of joints with enough of them to define a rotation."""
    regions = [np.flatnonzero(weights > RIGID) for weights in human().weights.T]
    return tuple(region for region in regions if len(region) >= LEAST)


def region_rotations(rest: np.ndarray, posed: np.ndarray) -> np.ndarray:
    """World rotation of each region from one pose of a person to another, by least squares."""
    before, after = (
        [vertices[region] - vertices[region].mean(axis=0) for region in rigid_regions()] for vertices in (rest, posed)
    )
    return nearest_rotation(np.stack([b.T @ a for a, b in zip(before, after, strict=True)]))


def pose_difference(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> float:
    """Largest angle (degrees) between the rotations of two people from a common pose to their poses.

    Each person is (vertices in the common pose, vertices in their pose), the body's own vertices first.
    """
    return float(angles_between(region_rotations(*first), region_rotations(*second)).max())


def assert_same_pose(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]) -> None:
    """Assert that two people, given as in `pose_difference`, end in the same pose."""
    assert len(rigid_regions()) >= 16, "the head and all limbs, to the fingers"
    assert pose_difference(first, second) < TOLERANCE
