"""How near a skeleton is to the one that a maker gave a character, and its weights to theirs.

J2J, J2B, B2B and IoU are those of RigNet's evaluation (Xu et al., SIGGRAPH 2020, section 6): lengths are shares of the
longest side of the mesh's box, and each distance is the mean of both directions. Bones are segments from a joint to its
parent. All functions take joints as (N, 3), bones as (N, 2, 3), in one frame and unit.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

BONE_STEPS = 50
"""Points that a bone is sampled at. Their spacing is a fiftieth of the longest limb, a thousandth of a person."""
RAYS = 12
"""Rays about a bone that measure how thick a limb is."""
MOST_TESTS = 1 << 22
"""Pairs of a ray and a triangle that are tested at once; bounds the memory."""


def joints_to_joints(first: Float[np.ndarray, "N 3"], second: Float[np.ndarray, "M 3"]) -> float:
    """Return J2J: the mean distance of each joint to the nearest of the other skeleton."""
    distance = np.linalg.norm(first[:, None] - second[None], axis=-1)
    return float(distance.min(axis=1).mean() + distance.min(axis=0).mean()) / 2


def joints_to_bones(
    first: tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "A 2 3"]],
    second: tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "B 2 3"]],
) -> float:
    """Return J2B of two skeletons (joints, bones): the mean distance of each joint to the nearest bone of the other."""
    (joints, bones), (others, other_bones) = first, second
    return (_to_bones(joints, other_bones) + _to_bones(others, bones)) / 2


def bones_to_bones(first: Float[np.ndarray, "A 2 3"], second: Float[np.ndarray, "B 2 3"]) -> float:
    """Return B2B: the mean distance of points of each bone to the nearest bone of the other skeleton.

    Points lie evenly on all bones together, so that a long bone counts as much as it is long.
    """
    return (_to_bones(_points_on(first), second) + _to_bones(_points_on(second), first)) / 2


def matched_share(
    joints: Float[np.ndarray, "N 3"], truth: Float[np.ndarray, "M 3"], tolerance: Float[np.ndarray, " M"]
) -> float:
    """Return IoU: the share of the joints of both skeletons that have a partner within the tolerance.

    Partners are found by the Hungarian algorithm over the distances.

    Args:
        tolerance: of each joint of the truth; RigNet takes half of the local diameter (`limb_radius`).
    """
    from scipy.optimize import linear_sum_assignment

    distance = np.linalg.norm(joints[:, None] - truth[None], axis=-1)
    rows, columns = linear_sum_assignment(distance)
    matched = np.count_nonzero(distance[rows, columns] < tolerance[columns])
    return 2 * matched / (len(joints) + len(truth))


def limb_radius(
    joints: Float[np.ndarray, "N 3"],
    directions: Float[np.ndarray, "N 3"],
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
) -> Float[np.ndarray, " N"]:
    """Measure the distance from each joint to the surface, at right angles to its bone: the median of RAYS rays.

    A joint from which no ray meets the surface gets 0.

    Args:
        directions: of the bone of each joint, of any length; where it is 0, the bone counts as upright.
    """
    radius = np.zeros(len(joints))
    angles = np.arange(RAYS) * 2 * np.pi / RAYS
    for k, (joint, direction) in enumerate(zip(joints, directions, strict=True)):
        length = np.linalg.norm(direction)
        along = direction / length if length else np.array([0.0, 1.0, 0.0])
        side = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
        side /= np.linalg.norm(side)
        rays = np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * np.cross(along, side)
        hits = _first_hits(joint, rays, vertices[faces])
        hits = hits[np.isfinite(hits)]
        radius[k] = np.median(hits) if len(hits) else 0.0
    return radius


def weights_apart(first: Float[np.ndarray, "V J"], second: Float[np.ndarray, "V J"]) -> float:
    """Return the mean over the vertices of the L1 distance of their weights, from 0 to 2; columns correspond."""
    return float(np.abs(first - second).sum(axis=1).mean())


def _to_bones(points: Float[np.ndarray, "N 3"], bones: Float[np.ndarray, "B 2 3"]) -> float:
    start, along = bones[None, :, 0], (bones[:, 1] - bones[:, 0])[None]
    step = points[:, None] - start
    length = np.maximum((along**2).sum(-1), np.finfo(float).tiny)
    share = np.clip((step * along).sum(-1) / length, 0, 1)
    return float(np.linalg.norm(step - share[..., None] * along, axis=-1).min(axis=1).mean())


def _points_on(bones: Float[np.ndarray, "B 2 3"]) -> Float[np.ndarray, "P 3"]:
    length = np.linalg.norm(bones[:, 1] - bones[:, 0], axis=1)
    counts = np.maximum(np.ceil(BONE_STEPS * length / length.max()).astype(int), 1)
    shares = [(np.arange(count) + 0.5) / count for count in counts]
    return np.concatenate([a + share[:, None] * (b - a) for (a, b), share in zip(bones, shares, strict=True)])


def _first_hits(
    origin: Float[np.ndarray, " 3"], rays: Float[np.ndarray, "R 3"], triangles: Float[np.ndarray, "F 3 3"]
) -> Float[np.ndarray, " R"]:
    """Measure how far unit rays from one point go to the first triangle, from either side; infinite without one.

    Möller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
    """
    nearest = np.full(len(rays), np.inf)
    at_once = max(MOST_TESTS // len(rays), 1)
    for begin in range(0, len(triangles), at_once):
        corner = triangles[begin : begin + at_once, 0]
        one, two = (triangles[begin : begin + at_once, k] - corner for k in (1, 2))
        step = origin - corner
        across, around = np.cross(rays[:, None], two[None]), np.cross(step, one)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1 / (one * across).sum(-1)
            u, v = (step * across).sum(-1) * scale, (rays[:, None] * around).sum(-1) * scale
            far = (two * around).sum(-1) * scale
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (far > 0)
        nearest = np.minimum(nearest, np.where(hit, far, np.inf).min(axis=1))
    return nearest
