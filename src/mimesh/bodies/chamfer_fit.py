"""Fit a rigged body to a cloud of points by L-BFGS on the Chamfer distance: from the T-pose, coarse to fine.

Only positions are compared, each with the nearest one of the other set: no vertex index is ever taken for a
correspondence. Unknowns: size and place, the joints' rotations, the shape coefficients that the body comes with.
Lengths are about those of the unit sphere, which the weights of the priors are chosen for.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from .body_model import RiggedBody
from .body_parameters import BodyParameters, descendants, fit_of, posed_and_pullback, unknowns_of
from .sampling import JOINT_LIMITS, TABLE_6, limits_rotvec, rotvec_to_rotmat

if TYPE_CHECKING:
    from scipy.spatial import KDTree

POSE_PRIOR = 3e-6
"""Squared distance that a joint turned from rest by half of its range costs, by the square of the turn.

This and the next three were chosen on human-npt's `val`.
"""
SHAPE_PRIOR = 3e-7
"""Squared distance that a shape coefficient of one standard deviation costs."""
SLIDE = 0.1
"""What a squared distance along the surface counts, beside one across it: matched points are not the same point."""
GOOD = 1.2e-4
"""Error of a fit to 4,000 points that found its person: on `val` these are below 1.1e-4, and all others above 2e-4."""
PATIENCE = 2
"""Throws in a row that may fail to make a fit clearly better."""
# What is thrown together where a fit went wrong.
LEGS, ARMS = ("UpLeg", "Leg"), ("Shoulder", "Arm", "ForeArm")
LIMBS = tuple(tuple(side + bone for bone in bones) for side in ("Left", "Right") for bones in (LEGS, ARMS))
LOWER_HALF = ("Hips", "LowerBack", "Spine", *LIMBS[0], *LIMBS[2])
SLACK = np.radians(15)
"""How far a joint may go beyond the tables of limits: less of it makes fits of people within them worse."""
LOUD = 100.0
"""Lengths are multiplied by this for L-BFGS, whose test for convergence takes values below 1 for small."""


def fit_points(
    body: RiggedBody, points: Float[np.ndarray, "N 3"], start: BodyParameters | None = None, seed: int = 0
) -> BodyParameters:
    """The person of `body` (see `thin_body`) nearest to points of a normalised mesh, given in random order.

    With a start, the fit of a frame before of the same person, size and shape are kept. If that leaves an error of
    `start.lost`, which the first frame has set, the points are fitted as if there were no start; the better one counts.
    Nothing is rejected: points far off the body pull it towards them. Does not look for people on their heads.
    """
    cloud = cloud_of(points, SLIDE)
    coarse = [(_first_points(body, count), cloud_of(points[:count])) for count in (300, 800)]
    if start is None:
        return _fitted_anew(body, points, cloud, coarse, seed)
    turns = _free(body, size=False, shape=False)
    followed = _descend(body, cloud, _descend(*coarse[1], start, turns, 4, 15), turns, 8, 15)
    followed = replace(followed, lost=start.lost)
    if followed.error < start.lost:
        return followed
    return min(followed, _fitted_anew(body, points, cloud, coarse, seed), key=_error)


def _fitted_anew(
    body: RiggedBody,
    points: Float[np.ndarray, "N 3"],
    cloud: TargetCloud,
    coarse: list[tuple[RiggedBody, TargetCloud]],
    seed: int,
) -> BodyParameters:
    """From T-poses that face a little left or right, raise a knee or lower the arms, the few points choose the best.

    While the fit is not GOOD, limbs are thrown anew by the seed until that helps no more; the better fit is kept.
    """
    rough = _best_of([_starts(coarse[0][0], points)], 12, *coarse)
    fit, rng = _descend(body, cloud, rough, _free(body), 8, 30), np.random.default_rng(seed)
    failed = 0
    while fit.error > GOOD and failed < PATIENCE:
        again = _best_of(
            [_thrown(coarse[0][0], points, fit, limb, rng) for limb in (*LIMBS, LOWER_HALF, body.joint_names)],
            2,
            *coarse,
        )
        better = fit
        if again.error < rough.error:
            rough, better = again, min(fit, _descend(body, cloud, again, _free(body), 8, 30), key=_error)
        failed = 0 if better.error < 0.8 * fit.error else failed + 1
        fit = better
    return replace(fit, lost=max(3 * fit.error, GOOD))


def _best_of(
    groups: list[list[BodyParameters]],
    kept: int,
    few: tuple[RiggedBody, TargetCloud],
    more: tuple[RiggedBody, TargetCloud],
) -> BodyParameters:
    """The best of many poses after a short descent: some of each group to the few points, then two to more points."""
    limbs = _free(few[0], ("Hips", "Leg", "Arm"), shape=False)
    begun = [fit for group in groups for fit in sorted((_scored(*few, fit) for fit in group), key=_error)[:kept]]
    begun = sorted((_descend(*few, fit, limbs, 4, 5) for fit in begun), key=_error)[:2]
    return min((_descend(*more, fit, _free(few[0]), 4, 15) for fit in begun), key=_error)


def _thrown(
    body: RiggedBody,
    points: Float[np.ndarray, "N 3"],
    fit: BodyParameters,
    names: tuple[str, ...],
    rng: np.random.Generator,
) -> list[BodyParameters]:
    """The fit with joints of these names anywhere within their limits, many times."""
    low, high = limits_rotvec(body, JOINT_LIMITS)
    low[0, 1], high[0, 1] = -1.0, 1.0  # headings, which the table leaves out
    joints, fits = [body.joint(name) for name in names], []
    for anywhere in rng.uniform(low, high, (60, *low.shape)):
        rotvec = fit.rotvec.copy()
        rotvec[joints] = anywhere[joints]
        fits.append(_placed(body, points, fit.shape, rotvec))
    return fits


def _scored(body: RiggedBody, cloud: TargetCloud, fit: BodyParameters) -> BodyParameters:
    posed = posed_and_pullback(body, unknowns_of(fit))[0]
    return replace(fit, error=chamfer(cloud, posed, cloud.matches(posed))[0])


def _error(fit: BodyParameters) -> float:
    return fit.error


def _first_points(body: RiggedBody, count: int) -> RiggedBody:
    components = body.components[:, :count]
    return replace(body, vertices=body.vertices[:count], components=components, weights=body.weights[:count])


def _starts(body: RiggedBody, points: Float[np.ndarray, "N 3"]) -> list[BodyParameters]:
    """People of mean shape in simple poses."""
    fits = []
    legs = ((0, 0), (60, 60), (85, 0))  # hanging, knee raised, stretched to the front
    for heading, left, right, lowered in product((-40, 0, 40), legs, legs, (0, 70)):
        degrees = {"Hips": (0, heading, 0), "LeftArm": (0, 0, -lowered), "RightArm": (0, 0, lowered)}
        degrees |= {"LeftUpLeg": (-left[0], 0, 0), "LeftLeg": (left[1], 0, 0)}
        degrees |= {"RightUpLeg": (-right[0], 0, 0), "RightLeg": (right[1], 0, 0)}
        rotvec = np.zeros((len(body.parents), 3))
        for name, turn in degrees.items():
            rotvec[body.joint(name)] = np.radians(turn)
        fits.append(_placed(body, points, np.zeros(len(body.components)), rotvec))
    return fits


def _placed(
    body: RiggedBody,
    points: Float[np.ndarray, "N 3"],
    shape: Float[np.ndarray, " K"],
    rotvec: Float[np.ndarray, "J 3"],
) -> BodyParameters:
    """A person with the centroid and the root mean square radius of the points."""
    posed = body.posed(shape, rotvec_to_rotmat(rotvec))
    size, own = (np.sqrt(np.square(x - x.mean(axis=0)).sum(-1).mean()) for x in (points, posed))
    scale = max(float(size / own), 1e-6)  # a single point has no size
    return BodyParameters(scale, points.mean(axis=0) - scale * posed.mean(axis=0), shape, rotvec)


def _free(
    body: RiggedBody, joints: tuple[str, ...] = ("",), size: bool = True, shape: bool = True
) -> Bool[np.ndarray, " P"]:
    """Which unknowns move: place always, size, shape, and joints whose names end like these."""
    turns = np.repeat([name.endswith(joints) for name in body.joint_names], 3)
    return np.concatenate([[size], np.ones(3, bool), np.full(len(body.components), shape), turns])


def _descend(
    body: RiggedBody, cloud: TargetCloud, fit: BodyParameters, free: Bool[np.ndarray, " P"], rounds: int, steps: int
) -> BodyParameters:
    """Match nearest points, take up to `steps` iterations of L-BFGS over the free unknowns, `rounds` times."""
    from scipy.optimize import minimize

    unknowns, unit = unknowns_of(fit), LOUD * _reach(body)[free]
    low, high = _limits(body)
    weight = _prior_weight(body, low, high)

    def objective(moving: Float[np.ndarray, " M"]) -> tuple[float, Float[np.ndarray, " M"]]:
        trial = unknowns.copy()
        trial[free] = moving / unit
        posed, pullback = posed_and_pullback(body, trial)
        error, gradient = chamfer(cloud, posed, matches)
        slope = pullback(gradient) + 2 * weight * trial
        return LOUD**2 * (error + float(weight @ trial**2)), LOUD**2 * slope[free] / unit

    bounds = np.stack([low[free] * unit, high[free] * unit], axis=1)
    options = {"maxiter": steps, "maxcor": 20, "ftol": 1e-5, "gtol": 1e-7}
    for _ in range(rounds):
        matches = cloud.matches(posed_and_pullback(body, unknowns)[0])
        found = minimize(objective, unknowns[free] * unit, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        unknowns[free] = found.x / unit
    return _scored(body, cloud, fit_of(body, unknowns))


def _reach(body: RiggedBody) -> Float[np.ndarray, " P"]:
    """How far about a unit of each unknown moves the points: makes steps of all unknowns comparable."""
    carried = body.weights @ descendants(body.parents).T
    joints = np.sqrt((carried * np.square(body.vertices[:, None] - body.joints).sum(-1)).mean(axis=0))
    size = np.sqrt(np.square(body.vertices - body.vertices.mean(axis=0)).sum(-1).mean())
    shape = np.sqrt(np.square(body.components).sum(-1).mean(-1))
    return np.maximum(np.concatenate([[size], np.ones(3), shape, np.repeat(joints, 3)]), 3e-3)


def _limits(body: RiggedBody) -> tuple[Float[np.ndarray, " P"], Float[np.ndarray, " P"]]:
    """Lowest and highest unknowns: joints that never turn are held, the root is free."""
    tables = np.stack([limits_rotvec(body, table) for table in (TABLE_6, JOINT_LIMITS)])
    low, high = tables[:, 0].min(axis=0), tables[:, 1].max(axis=0)
    slack = SLACK * (high > low).any(axis=1, keepdims=True)
    low, high = low - slack, high + slack
    low[0], high[0] = -np.inf, np.inf
    place, shape = np.full(4, np.inf), np.full(len(body.components), 3.5)
    return np.concatenate([-place, -shape, low.ravel()]), np.concatenate([place, shape, high.ravel()])


def _prior_weight(
    body: RiggedBody, low: Float[np.ndarray, " P"], high: Float[np.ndarray, " P"]
) -> Float[np.ndarray, " P"]:
    """Cost of the square of each unknown: none for size, place and the root."""
    k = len(body.components)
    half = (high[4 + k :] - low[4 + k :]) / 2
    return np.concatenate([np.zeros(4), np.full(k, SHAPE_PRIOR), POSE_PRIOR / np.where(half > 0, half, np.inf) ** 2])


@dataclass(frozen=True, eq=False)
class TargetCloud:
    """Points to fit to, and the planes that they lie in."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    """Of the surface, either side; zero where distances count alike in all directions."""
    slide: float
    """Weight of the squared distance as such; its part along the normal has the rest of 1."""
    tree: KDTree

    def matches(self, others: Float[np.ndarray, "V 3"]) -> tuple[Int[np.ndarray, " V"], Int[np.ndarray, " N"]]:
        """The nearest point of each of the others, and the nearest other of each point."""
        from scipy.spatial import KDTree

        return np.asarray(self.tree.query(others)[1]), np.asarray(KDTree(others).query(self.points)[1])


def cloud_of(points: Float[np.ndarray, "N 3"], slide: float = 1.0, neighbours: int = 16) -> TargetCloud:
    """A cloud; where `slide` is below 1, with the normals of planes through each point's nearest neighbours."""
    from scipy.spatial import KDTree

    tree, normals = KDTree(points), np.zeros_like(points)
    if slide < 1:
        near = points[tree.query(points, k=min(neighbours, len(points)))[1].reshape(len(points), -1)]
        near = near - near.mean(axis=1, keepdims=True)
        normals = np.linalg.eigh(near.transpose(0, 2, 1) @ near)[1][:, :, 0]
    return TargetCloud(points, normals, slide, tree)


def chamfer(
    cloud: TargetCloud, others: Float[np.ndarray, "V 3"], matches: tuple[Int[np.ndarray, " V"], Int[np.ndarray, " N"]]
) -> tuple[float, Float[np.ndarray, "V 3"]]:
    """Mean squared distance of the others to their matches and of the cloud to its, and the gradient by the others."""
    near, back = matches
    error, gradient = 0.0, np.zeros_like(others)
    for mine, theirs in ((near, slice(None)), (slice(None), back)):
        normals, away = cloud.normals[mine], others[theirs] - cloud.points[mine]
        pull = cloud.slide * away + (1 - cloud.slide) * (away * normals).sum(-1, keepdims=True) * normals
        error += float((away * pull).sum()) / len(away)
        if isinstance(theirs, slice):
            gradient += 2 / len(away) * pull
        else:
            gradient += 2 / len(away) * np.stack([np.bincount(theirs, p, len(others)) for p in pull.T], axis=1)
    return error, gradient
