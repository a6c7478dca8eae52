"""Find limbs that were predicted elsewhere than they are: shins on the other leg, arms of blocks, joints outside.

Of people who sit with an ankle on the other knee, a network often puts both shins on the leg that stands. The fitted
body then leaves the shin that lies across uncovered, and has a part of a leg where there is no surface. The foot of
that leg is put where the uncovered surface is farthest from its knee, and the body is fitted again. It keeps that pose
if it covers more of the surface, and both legs lie nearer to it (docs/log/mime.md, "A shin on the other knee").

In the arm of a figure of cubes the network finds a wrist, an elbow and a shoulder nearer to the trunk than makers put
them, or a slant where there is none. The surface says more: such an arm is short, and as thick at its end as at its
start. It has its shoulder where it starts, its wrist near its end and its elbow between them, all on its axis
(docs/log/mime.md, "Arms of blocks").

Joints of a person lie inside of the surface, and what was read as one may lie outside. A joint is enclosed if nearly
every direction from it meets the surface. That needs no closed surface, no winding and no normals: inner shells, faces
drawn twice and garments do no harm, as they do to winding numbers.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from ..bodies.character_limbs import SIDES
from ..core.geometry import nearest_points, unit_vectors
from ..core.rig import Rig, descendants
from ..rigs.confidence import MAX_UNMATCHED_SURFACE
from .body_fit import BODY_POINTS, BodyFit, SurfaceSample, fit_body, is_uncovered, limb_gaps
from .joint_targets import JointTargets

LOST_LEG = 0.05
"""Share of a leg of the fitted body away from the surface from which on its shin is looked for."""
LESS_UNCOVERED, NEARER = 0.7, 0.9
"""Ratios of the uncovered surface, and of the gaps of both legs, after a fit to before, up to which it is kept."""
REACH, SOLE = 1.5, 0.15
"""How far from its knee a leg's surface ends at most: lengths of its shin, and metres of the body more. Lengths of
bones of other people differ, and a foot adds to them."""
TIP = 0.1
"""Share of the uncovered surface that is the tip of the leg."""


def lost_shin(surface: SurfaceSample, fit: BodyFit) -> JointTargets | None:
    """Return knees and feet of a person with a shin elsewhere than where the fitted body has it; None: there is none.

    Args:
        surface: normalised, as the positions that are returned.
        fit: of a person to it.
    """
    names, size = fit.posed.body.names, fit.posed.state.size
    legs = {side: [names.index(f"{side}{bone}") for bone in ("Leg", "Foot")] for side in SIDES}
    lost = [side for side in SIDES if fit.unmatched_body[f"{side.lower()} leg"] > LOST_LEG]
    if not lost or fit.unmatched_surface <= MAX_UNMATCHED_SURFACE:
        return None
    points = surface.points[: 2 * BODY_POINTS]
    uncovered = points[is_uncovered(fit.posed, points)]
    fits = []
    for side in lost:
        foot = _foot(uncovered, fit.joints[legs[side]], size)
        if foot is not None:
            moved = JointTargets(legs[side][1:], foot[None]).move(fit.rotation, fit.joints)
            fits.append(fit_body(surface, *moved))
    gap, before = (lambda of: _gap(of, surface)), _gap(fit, surface)
    best = min(fits, key=gap, default=fit)
    if best.unmatched_surface > LESS_UNCOVERED * fit.unmatched_surface or gap(best) > NEARER * before:
        return None
    found = [joint for side in SIDES for joint in legs[side]]
    return JointTargets(found, best.joints[found])


def _foot(
    uncovered: Float[np.ndarray, "N 3"], shin: Float[np.ndarray, "2 3"], size: float
) -> Float[np.ndarray, " 3"] | None:
    """Place the foot of a shin, from knee to foot, towards the farthest points that it reaches; None: it reaches none.

    Args:
        size: of the body, in the unit of the points.
    """
    knee, length = shin[0], np.linalg.norm(shin[1] - shin[0])
    away = np.linalg.norm(uncovered - knee, axis=1)
    reached = uncovered[np.argsort(away)][: int((away < REACH * length + SOLE * size).sum())]
    if len(reached) == 0:
        return None
    along = reached[-max(1, int(TIP * len(reached))) :].mean(axis=0) - knee
    return knee + along * length / np.linalg.norm(along)


def _gap(fit: BodyFit, surface: SurfaceSample) -> float:
    """Measure how far both legs of a fitted body and the surface next to them are apart (metres of the body)."""
    gaps = limb_gaps(fit.posed, surface)
    return sum(gaps[f"{side.lower()} leg"] for side in SIDES)


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
