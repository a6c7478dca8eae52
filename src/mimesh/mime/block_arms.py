"""Place the joints of arms that are plain blocks, as those of figures of cubes.

The network looks for a hand. In a block it finds a wrist, an elbow and a shoulder nearer to the trunk than makers put
them, or a slant where there is none. The surface says more: such an arm is short, and as thick at its end as at its
start. It has its shoulder where it starts, its wrist near its end and its elbow between them, all on its axis
(docs/log/mime.md, "Arms of blocks").
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..bodies.character_limbs import SIDES
from ..core.geometry import nearest_points, unit_vectors
from ..core.rig import Rig, descendants
from .joint_targets import JointTargets

LONGEST, UNEVEN = 4.5, 0.11
"""Length of an arm in its radii, and deviation of the radius along it, up to which it is a block. Blocks have 3.3 to
4.3 and 0.02 to 0.10; arms of a yeti of cubes, which end in fists, 4.8, those of people in wide coats 5.6."""
SLICES, LEAST, OUTER = 10, 5, 0.8
"""Slices of an arm whose radius is measured, the points that each has at least, and the share of its points that are
nearer to the axis than the radius. The first and the last slice do not count."""
FEWEST = 60
"""Points of an arm from which on it is measured."""
ROUNDS, APART = 3, 1.6
"""Rounds in which an axis is found, and distance from it, in medians of all, up to which a point counts in the next."""
BEYOND = 0.02
"""Share of an arm's points before its start, where the shoulder blends into it."""
HAND = 0.5
"""Length of the hand of a block, in radii: about where makers put its wrist."""
STRAIGHT = 30.0
"""Bend of an elbow (degrees) up to which an arm may be a block."""


@dataclass(frozen=True, eq=False)
class BlockArm:
    """An arm as a block along an axis. Lengths are in the unit of its points."""

    start: Float[np.ndarray, " 3"]
    axis: Float[np.ndarray, " 3"]
    """Of length 1, from the shoulder to the hand."""
    length: float
    radius: float
    uneven: float
    """Standard deviation of the radius along the arm, in radii; NaN if a slice has too few points."""

    @classmethod
    def of(cls, points: Float[np.ndarray, "N 3"], towards: Float[np.ndarray, " 3"]) -> BlockArm:
        """Measure an arm by points of its surface; those far from its axis belong to something else.

        Args:
            towards: roughly the direction of the hand.
        """
        centre, axis = points.mean(axis=0), unit_vectors(towards)
        for _ in range(ROUNDS):
            centre = points.mean(axis=0)
            axis = np.linalg.svd(points - centre, full_matrices=False)[2][0]
            away = np.linalg.norm(np.cross(points - centre, axis), axis=1)
            points = points[away <= APART * np.median(away)]
        axis = axis if axis @ towards > 0 else -axis
        along, away = (points - centre) @ axis, np.linalg.norm(np.cross(points - centre, axis), axis=1)
        start, end = np.quantile(along, BEYOND), along.max()
        slices = np.floor(SLICES * (along - start) / (end - start))
        inner = [away[slices == k] for k in range(1, SLICES - 1)]
        radii = [np.quantile(of, OUTER) if len(of) >= LEAST else np.nan for of in inner]
        radius = float(np.mean(radii))
        return cls(centre + start * axis, axis, float(end - start), radius, float(np.std(radii)) / radius)

    @property
    def wrist(self) -> float:
        """Distance of the wrist from the start."""
        return self.length - HAND * self.radius

    @property
    def joints(self) -> Float[np.ndarray, "3 3"]:
        """Shoulder, elbow and wrist."""
        return self.start + np.array([0.0, self.wrist / 2, self.wrist])[:, None] * self.axis

    def shares(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Share points among upper arm, lower arm and hand, blended over a radius about elbow and wrist."""
        along = ((points - self.start) @ self.axis)[:, None] - np.array([self.wrist / 2, self.wrist])
        lower, hand = (along / self.radius + 0.5).clip(0, 1).T
        return np.stack([1 - lower, lower * (1 - hand), lower * hand], axis=1)


def with_block_arms(
    rig: Rig,
    points: Float[np.ndarray, "N 3"],
    weighted: Float[np.ndarray, "M 3"],
    names: tuple[str, ...],
    parents: tuple[int, ...],
) -> Rig:
    """Place the arms of a rig anew if both are blocks; their weights follow. Else it is returned as it is.

    Args:
        rig: of a person, in any frame.
        points: spread evenly over the surface.
        weighted: the points of the surface that have the weights of the rig.
        names: of the joints.
        parents: of the joints.
    """
    nearest = nearest_points(weighted, points)[1]
    weights, chains, arms = rig.weights.copy(), [], []
    for side in SIDES:
        chain = [names.index(side + bone) for bone in ("Arm", "ForeArm", "Hand")]
        whole = descendants(chain[:1], parents)
        share = rig.weights[:, whole].sum(axis=1)
        own = points[share[nearest] > 0.5]
        upper, lower = unit_vectors(np.diff(rig.joints[chain], axis=0))
        if len(own) < FEWEST or upper @ lower < np.cos(np.radians(STRAIGHT)):
            return rig
        arm = BlockArm.of(own, upper + lower)
        if not (arm.length <= LONGEST * arm.radius and arm.uneven <= UNEVEN):
            return rig
        weights[:, whole] = 0.0
        weights[:, chain] = share[:, None] * arm.shares(weighted)
        chains, arms = chains + chain, [*arms, arm]
    targets = JointTargets(chains, np.concatenate([arm.joints for arm in arms]))
    rotation, joints = targets.move(rig.rotation, rig.joints)
    for arm, hand in zip(arms, chains[2::3], strict=True):  # fingers end in the block
        fingers = descendants([hand], parents)
        reach = (joints[fingers] - joints[hand]) @ arm.axis
        joints[fingers] = joints[hand] + (joints[fingers] - joints[hand]) * min(1, HAND * arm.radius / reach.max())
    return dataclasses.replace(rig, rotation=rotation, joints=joints, weights=weights)
