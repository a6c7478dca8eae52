"""Fit the shipped body to a surface, starting from the joints that a network predicts for it.

A prediction is good enough to say which point of the body is near which point of the surface. From such matches, least
squares find pose, shape and bone lengths more precisely than the network, which gets a few hundred points once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...bodies import load_body
from ...bodies.character_limbs import SIDES
from ...bodies.hands import hand_joints
from ...bodies.joint_ranges import JointRanges, joint_ranges
from ...bodies.sampled_body import BodyState, PosedBody, SampledBody
from ...core.geometry import nearest_rotation
from ...core.rig import Rig
from ..confidence import limb_joints, mean_angle
from .fit_prior import Prior
from .joint_targets import JointTargets
from .limb_search import limb_gaps, search_limbs
from .surface_sample import SurfaceSample

# docs/log/mime.md ("a person laid onto the surface") says which of these values matter, with figures on val.
BODY_POINTS = 1000
"""Points of the body that are matched. Twice as many points of the surface are matched to them in turn."""
ROUNDS, COARSE_ROUNDS, COARSE_POINTS = 6, 3, 400
"""Gauss-Newton steps; the first COARSE_ROUNDS of them use only COARSE_POINTS points of the body."""
FIRST_DISTANCE, LAST_DISTANCE = 0.03, 0.003
"""Expected distance (metres of the body) of matched points, in the first round and in the last."""
OUTLIER_SCALE = 3.0
"""Scale of the robust weights, in expected distances: a match that far apart has a quarter of the weight."""
MATCH_WEIGHT = 0.3
"""Weight of a match beside the prior. Below 1, because the errors of neighbouring matches are not independent."""
RELIABLE_MISMATCH, MISMATCH_EXPONENT, MISMATCH_POINTS = 0.0022, 6, 16
"""Mismatch of the shapes (see `_mismatch`, metres of the body) at which fit and prediction count alike, how fast that
changes, and the neighbours that are averaged. People of the shipped body have 0.1 mm, dressed ones 0.5, those with
noise of up to 5 % 1.9, realistic and stylised characters of others 1.6, figures of blocks 3 (docs/log/mime.md)."""
REFINED = ("quadruped",)
"""Bodies whose fits go on where they have the shape of the surface. Of people, poses at the joint limits gain by it,
and dressed ones lose (docs/log/animals.md)."""
SHIPPED_SHAPE, FURTHER_ROUNDS = 0.0012, 10
"""Mismatch (metres of the body) up to which a fit goes on, and by how many rounds at most. Before that, animals of the
shipped body have 0.2 to 0.5 mm, those of other makers 2 to 8: these would drift away from what was predicted."""
STEADY = 0.98
"""Ratio of a round's mismatch to that of the round before from which on a fit goes no further."""
STILL_OFF = 0.015
"""Gap of a limb (see `limb_gaps`, metres of the body) after the search from which on single predictions are tried."""
CHUNK = 65_536
"""Points of a surface whose nearest points of the fitted body are found at once; bounds the memory."""
NEAREST = 3
"""Vertices of the fitted body from which its weights at a point of the surface are interpolated."""
SAME_SHAPE, SHAPE_EXPONENT = 0.0004, 4
"""Mismatch (metres of the body) at which predicted weights and those of the fitted body count alike, and how fast that
changes: the body's are better only where it has the shape of the surface (docs/log/mime.md, "Weights of the body")."""
UNMATCHED_BODY, UNMATCHED_SURFACE = 0.05, 0.08
"""Distance (metres of the body) from which on a point of the body is unmatched by the surface, and the reverse."""


@dataclass(frozen=True, eq=False)
class NearestBody:
    """For each point of a surface the nearest point of the body that was fitted to it."""

    distance: Float[np.ndarray, " V"]
    """Distance to it (metres of the body)."""
    weights: Float[np.ndarray, "V J"]
    """Its skinning weights."""
    body: str = "human"
    """Name of the body."""


@dataclass(frozen=True, eq=False)
class BodyFit:
    """Joints of a surface from the body that was fitted to it, and how well the body covers the surface."""

    rotation: Float[np.ndarray, "J 3 3"]
    """World rotation of each joint from the body at rest."""
    joints: Float[np.ndarray, "J 3"]
    """World position of each joint, in the unit of the surface."""
    unmatched_body: dict[str, float]
    """Share of each limb of the body that is farther than UNMATCHED_BODY from the surface."""
    unmatched_surface: float
    """Share of the surface that is farther than UNMATCHED_SURFACE from the body."""
    distance: float
    """Mismatch of the shapes of body and surface (metres of the body); see `_mismatch`."""
    angle: float
    """Mean angle (degrees) between the rotations of the fitted body and the predicted ones."""
    posed: PosedBody
    """The fitted body."""
    gaps: Mapping[str, float]
    """How far each limb of the body and the surface next to it are apart; see `limb_gaps`."""

    @property
    def cost(self) -> float:
        """Mismatch of the shapes, larger where limbs of the body are away from the surface."""
        return self.distance * (1 + sum(self.unmatched_body.values()))

    @property
    def gap(self) -> float:
        """Sum of the gaps of all limbs."""
        return sum(self.gaps.values())

    def nearest(self, points: Float[np.ndarray, "V 3"]) -> NearestBody:
        """Find the nearest point of the fitted body to each of some points of the surface."""
        from scipy.spatial import KDTree

        body = whole_body(self.posed.body.name)
        tree = KDTree(PosedBody(body, self.posed.state).points)
        nearest, weights = np.empty(len(points)), np.empty((len(points), body.weights.shape[1]))
        # CHUNK points at a time: the weights of all their neighbours take several times the memory of the result.
        for start in range(0, len(points), CHUNK):
            chunk = slice(start, start + CHUNK)
            distance, index = tree.query(points[chunk], k=NEAREST)
            share = 1 / np.maximum(distance, 1e-9 * self.posed.state.size) ** 2
            share /= share.sum(axis=1, keepdims=True)
            nearest[chunk] = distance[:, 0] / self.posed.state.size
            weights[chunk] = np.einsum("vn,vnj->vj", share, body.weights[index])
        return NearestBody(nearest, weights, body.name)

    def blended_weights(self, predicted: Float[np.ndarray, "V J"], nearest: NearestBody) -> Float[np.ndarray, "V J"]:
        """Mix predicted weights with those of the fitted body as far as it has the shape of the surface.

        Weights of a person's hands stay predicted: the fitted body has stubs instead of fingers.
        """
        body = self.posed.body
        hands = [j for side in SIDES for j in hand_joints(body.names, side)] if body.name == "human" else []
        of_body = 1 / (1 + (self.distance / SAME_SHAPE) ** SHAPE_EXPONENT)
        share = of_body * (1 - nearest.weights[:, hands].sum(axis=1, keepdims=True))
        return (1 - share) * predicted + share * nearest.weights


@cache
def sampled_body(name: str = "human") -> SampledBody:
    """Return a shipped body as BODY_POINTS points."""
    return SampledBody.of(load_body(name), BODY_POINTS)


@cache
def whole_body(name: str = "human") -> SampledBody:
    """Return a shipped body as all of its vertices."""
    return SampledBody.of_vertices(load_body(name))


def fit_body(
    surface: SurfaceSample,
    rotation: Float[np.ndarray, "J 3 3"],
    joints: Float[np.ndarray, "J 3"],
    targets: JointTargets | None = None,
    name: str = "human",
    others: Sequence[Float[np.ndarray, "J 3 3"]] = (),
) -> BodyFit:
    """Fit a shipped body to a surface, from predicted rotations and positions of its joints.

    The unknowns are size, root position, shape coefficients, bone lengths and girths, and the joint rotations (see
    `SampledBody`). Joints are those of the fitted body where it covers the surface closely, the predicted ones where it
    does not, and between the two a blend. The surface may have any unit, position and heading. Joints are the shipped
    body's, in its order; those with `targets` keep these positions. `others` are more predicted rotations, from which
    limbs that do not lie on the surface are searched.
    """
    from scipy.spatial import KDTree

    body = sampled_body(name)
    ranges = joint_ranges(name) if name in REFINED and targets is None else None
    start = rotation if ranges is None else ranges.world(rotation[0], ranges.clipped(rotation))
    state = body.mean_person(_initial_size(body, joints), joints[0].copy(), start)
    surface = surface.outward(PosedBody(body, state))
    state, mismatch = _optimise(body, state, Prior(body, state.size, start, joints, targets, ranges), surface)
    if ranges is not None and mismatch < SHIPPED_SHAPE * state.size:
        state, mismatch = _optimise_further(body, state, surface, ranges)
        if others:
            state, mismatch = _with_searched_limbs(body, state, surface, ranges, others)
    posed = PosedBody(body, state)
    # Where the body does not have the shape of the surface, its joints are less right than the predicted ones.
    distance = mismatch / state.size
    share = 1 / (1 + (distance / RELIABLE_MISMATCH) ** MISMATCH_EXPONENT)
    blended = nearest_rotation(share * state.rotation + (1 - share) * rotation)
    unmatched = surface.tree.query(posed.points)[0] > UNMATCHED_BODY * state.size
    unmatched_body = {limb: float(unmatched[points].mean()) for limb, points in _limb_points(name).items()}
    to_body = KDTree(posed.points).query(surface.points[: 2 * BODY_POINTS])[0]
    unmatched_surface = float((to_body > UNMATCHED_SURFACE * state.size).mean())
    positions = share * posed.joints + (1 - share) * joints
    return BodyFit(
        rotation=blended,
        joints=targets.apply(positions) if targets else positions,
        unmatched_body=unmatched_body,
        unmatched_surface=unmatched_surface,
        distance=distance,
        angle=mean_angle(state.rotation, rotation),
        posed=posed,
        gaps=limb_gaps(posed, surface) if ranges is not None else {},
    )


def fit_predictions(surface: SurfaceSample, consensus: Rig, predictions: Sequence[Rig], name: str) -> BodyFit:
    """Fit a shipped body to a surface from the consensus of some predictions.

    If a body of REFINED has the shape of the surface, but a limb does not lie on it even after a search, the body is
    also fitted from each of the predictions, and limbs are searched from the best. The fit with the smaller gaps is
    returned.
    """
    rotations = [consensus.rotation, *(rig.rotation for rig in predictions)]
    best = fit_body(surface, consensus.rotation, consensus.joints, name=name, others=rotations)
    if not predictions or best.distance > SHIPPED_SHAPE or max(best.gaps.values(), default=0.0) < STILL_OFF:
        return best
    fits = [fit_body(surface, rig.rotation, rig.joints, name=name).gap for rig in predictions]
    start = predictions[int(np.argmin(fits))]
    other = fit_body(surface, start.rotation, start.joints, name=name, others=rotations)
    return min(best, other, key=lambda fit: fit.gap)


@cache
def _limb_points(name: str) -> dict[str, Bool[np.ndarray, " N"]]:
    """Limb -> mask of a body's points that are weighted mostly to its joints."""
    body = sampled_body(name)
    joints = limb_joints(body.names, body.parents)
    return {limb: body.weighted_to(indices) for limb, indices in joints.items()}


def _initial_size(body: SampledBody, joints: Float[np.ndarray, "J 3"]) -> float:
    """Median ratio of predicted bone lengths to the body's, over the bones that are longer than 5 cm."""
    parents = list(body.parents[1:])
    predicted, rest = (np.linalg.norm(ends[1:] - ends[parents], axis=1) for ends in (joints, body.joints))
    long = rest > 0.05
    return float(np.exp(np.median(np.log(np.maximum(predicted[long], 1e-9) / rest[long]))))


def _optimise(body: SampledBody, state: BodyState, prior: Prior, surface: SurfaceSample) -> tuple[BodyState, float]:
    """Alternate between matching nearest points and one Gauss-Newton step, from coarse to fine.

    Returns the state, and the mismatch of the shapes (see `_mismatch`).

    The energy is the sum of w r^2 over the matches, r being the distance of a match along its normal, plus the prior.
    To first order r(x + step) = r(x) + J step, J being the derivative of r by the unknowns. The energy is then
    quadratic in the step, and least where (J^T W J + P) step = -(J^T W r + g): the normal equations, with P and g from
    the prior. The next round matches and linearises again at the new state.
    """
    coarse, distance, mismatch = body.first(COARSE_POINTS), 0.0, 0.0
    for k in range(ROUNDS):
        # Matches are expected to come nearer in every round, but not nearer than those of the last round were.
        fraction = (LAST_DISTANCE / FIRST_DISTANCE) ** (k / (ROUNDS - 1))
        # 1.48 medians are the standard deviation of a normal distribution, and outliers move them little.
        expected = max(state.size * FIRST_DISTANCE * fraction, 1.48 * distance)
        posed = PosedBody(coarse if k < COARSE_ROUNDS else body, state)
        matches = _matches(posed, surface, OUTLIER_SCALE * expected)
        distance = float(np.median(np.abs(matches.residual)))
        if k == ROUNDS - 1:
            mismatch = _mismatch(posed, matches)
        state = body.stepped(state, _step(posed, matches, prior, expected))
    return state, mismatch


def _optimise_further(
    body: SampledBody, state: BodyState, surface: SurfaceSample, ranges: JointRanges
) -> tuple[BodyState, float]:
    """Go on from a fit whose body has the shape of the surface, as long as the mismatch falls.

    The prior of each step is the pose before it: it keeps steps short, but no longer pulls to the prediction, which in
    poses within the joint limits is 20 degrees off.
    """
    mismatch = np.inf
    for _ in range(FURTHER_ROUNDS):
        posed, expected = PosedBody(body, state), LAST_DISTANCE * state.size
        matches = _matches(posed, surface, OUTLIER_SCALE * expected)
        prior = Prior(body, state.size, state.rotation, posed.joints, ranges=ranges)
        state = body.stepped(state, _step(posed, matches, prior, expected))
        before, mismatch = mismatch, _mismatch(posed, matches)
        if mismatch > STEADY * before:
            break
    return state, mismatch


def _with_searched_limbs(
    body: SampledBody,
    state: BodyState,
    surface: SurfaceSample,
    ranges: JointRanges,
    others: Sequence[Float[np.ndarray, "J 3 3"]],
) -> tuple[BodyState, float]:
    """Search other poses of the limbs that do not lie on the surface; a fit goes on from what is found."""

    def refined(other: BodyState) -> BodyState:
        return _optimise_further(body, other, surface, ranges)[0]

    state = search_limbs(PosedBody(body, state), surface, others, ranges, refined)
    posed = PosedBody(body, state)
    matches = _matches(posed, surface, OUTLIER_SCALE * LAST_DISTANCE * state.size)
    return state, _mismatch(posed, matches)


def _step(posed: PosedBody, matches: Matches, prior: Prior, expected: float) -> Float[np.ndarray, " U"]:
    """Solve the normal equations of one Gauss-Newton step, for matches at an expected distance."""
    jacobian, weight = matches.jacobian, matches.weight * MATCH_WEIGHT / expected**2
    hessian, gradient = (jacobian * weight[:, None]).T @ jacobian, jacobian.T @ (weight * matches.residual)
    prior_hessian, prior_gradient = prior.normal_equations(posed)
    return -np.linalg.solve(hessian + prior_hessian, gradient + prior_gradient)


def _mismatch(posed: PosedBody, matches: Matches) -> float:
    """Measure how much the shapes of body and surface differ, in the unit of the surface.

    It is the median over the body's points of the absolute mean of the signed residuals around each: where the shapes
    differ, neighbouring residuals have one sign, and noise of the surface averages out.
    """
    from scipy.spatial import KDTree

    near = np.asarray(KDTree(posed.points).query(posed.points, k=MISMATCH_POINTS)[1])
    signed, weights = matches.residual[near], matches.weight[near]  # matches of the body's points come first
    return float(np.median(np.abs((signed * weights).sum(axis=1) / np.maximum(weights.sum(axis=1), 1e-9))))


class Matches(NamedTuple):
    """M pairs of a point of a posed body and one of a surface."""

    jacobian: Float[np.ndarray, "M U"]
    """Derivatives of the residuals by the body's unknowns."""
    residual: Float[np.ndarray, " M"]
    """Signed distances along the normals."""
    weight: Float[np.ndarray, " M"]


def _matches(posed: PosedBody, surface: SurfaceSample, scale: float) -> Matches:
    """Match nearest points in both directions.

    Only body to surface would leave parts of the surface uncovered, only surface to body would let limbs of the body
    go where there is no surface.
    """
    from scipy.spatial import KDTree

    count = len(posed.points)
    points, normals = surface.points[: 2 * count], surface.normals[: 2 * count]
    to_surface, to_body = surface.tree.query(posed.points), KDTree(posed.points).query(points)
    index = np.concatenate([np.arange(count), to_body[1]])
    target = np.concatenate([surface.points[to_surface[1]], points])
    target_normal, body_normal = np.concatenate([surface.normals[to_surface[1]], normals]), posed.normals[index]
    # Symmetric ICP (Rusinkiewicz 2019): distances count along the sum of both normals, so that points may slide along
    # the surface. The normals of one side alone gave the same figures on val.
    direction = target_normal + body_normal
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)
    residual = ((posed.points[index] - target) * direction).sum(axis=1)
    # A match of opposite normals (the other side of a hand) has no weight; unknown normals (zeros) agree with all.
    agreement = np.where(target_normal.any(axis=1), (target_normal * body_normal).sum(axis=1).clip(0, 1), 1.0)
    # Geman and McClure (1985): minimising the sum of d^2 / (1 + d^2), which no outlier raises by more than 1, is least
    # squares with the weight 1 / (1 + d^2)^2, here of the distance d in units of `scale`.
    distance = np.concatenate([to_surface[0], to_body[0]]) / scale
    return Matches(posed.along(index, direction), residual, agreement / np.square(1 + np.square(distance)))
