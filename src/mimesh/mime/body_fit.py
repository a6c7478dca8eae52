"""Fit the shipped body to a surface, starting from the joints that a network predicts for it.

A prediction is good enough to say which point of the body is near which point of the surface. From such matches, least
squares find pose, shape and bone lengths more precisely than the network, which gets a few hundred points once.

A fit goes to the nearest minimum, so a folded leg or a twisted forefoot stays as wrong as it was predicted. A limb
alone has few joints: some hundred poses of it, as predicted and at random within the ranges of its joints, are tried
while the rest of the body is held, and the best are changed at random. The fit then goes on from what was found. A limb
keeps its new pose if it lies nearer to the surface than before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..bodies import load_body
from ..bodies.character_limbs import SIDES
from ..bodies.hands import hand_joints
from ..bodies.joint_ranges import JointRanges, joint_ranges
from ..bodies.sampled_body import BodyState, PosedBody, SampledBody
from ..bodies.sampling import rotvec_to_rotmat
from ..core.geometry import MIRROR, nearest_points, nearest_rotation
from ..core.rig import Rig
from ..core.surface_points import SurfacePoints
from ..rigs.confidence import limb_joints, mean_angle
from .joint_targets import JointTargets

if TYPE_CHECKING:
    from scipy.spatial import KDTree

NEAR, FAR = 0.03, 0.1
"""Up to NEAR (metres of the body) a distance counts along the normal, because samples of one surface lie some way
apart; beyond it as it is, FAR at most."""
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
RELIABLE_MISMATCH, MISMATCH_POINTS = 0.0022, 16
"""Mismatch of the shapes (see `_mismatch`, metres of the body) up to which a surface is taken for the shipped body's,
and the neighbours that are averaged. People of the shipped body have 0.1 mm, dressed ones 0.5, those with noise of up
to 5 % 1.9, realistic and stylised characters of others 1.6, figures of blocks 3 (docs/log/mime.md)."""


class Trust(NamedTuple):
    """How far a fit counts beside the prediction, by the mismatch of the shapes."""

    mismatch: float
    """Mismatch (metres of the body) at which it is halfway from all to the least."""
    exponent: int
    """How fast that changes."""
    least: float = 0.0
    """Share of the fit where the shapes differ and predictions are far apart."""

    def share(self, mismatch: float, spread: float = 0.0) -> float:
        """Return the share of the fit, up to 1; `spread` is that of predicted positions, over the surface's extent."""
        least = self.least * spread**2 / (spread**2 + UNSURE**2)
        return least + (1 - least) / (1 + (mismatch / self.mismatch) ** self.exponent)


UNSURE = 0.012
"""Spread of predicted positions, over the extent of the surface, at which the fit keeps half of its least share."""


PLACES = {"human": Trust(0.0008, 4, 0.45), "quadruped": Trust(RELIABLE_MISMATCH, 6)}
"""How far the positions of a fit's joints count. Where shapes differ and predictions do, the mean of fit and
prediction is nearer than either: 5.0 % of the height of cube people, against 5.9 and 6.2 (docs/log/mime.md)."""
TURNS = {"human": Trust(0.0014, 3), "quadruped": Trust(RELIABLE_MISMATCH, 6)}
"""The same of their rotations. Limbs of other makers' people point 2 to 7 degrees nearer to the truth as predicted, but
errors of the fit are alike in two poses, and cancel where both meshes are of one maker (docs/log/mime.md)."""
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
ROTATION_SIGMA, JOINT_SIGMA = 0.2, 0.1
"""Standard deviation of the predicted rotations (radians) and joint positions (metres of the body)."""
SHAPE_SIGMA, BONE_SIGMA = 3.0, 0.1
"""Standard deviation of the shape coefficients, and of the logarithms of bone lengths and girths; their mean is 0."""
RANGE_SIGMA = 0.1
"""Standard deviation (radians) of how far joints turn beyond their ranges."""
CORRECTED_SIGMA = 0.005
"""Standard deviation (metres of the body) of joint positions that the user has picked."""
SEARCHES = 3
"""How many times limbs are searched at most, each time from what the search before has found."""
LIES_ON = 0.005
"""Gap of a limb (see `limb_gaps`; metres of the body) up to which it is not searched. True poses have 3 to 9 mm, from
the distance between samples; wrong ones 5 to 100 (docs/log/animals.md)."""
LIES_OFF = 0.01
"""Gap from which on a limb is surely wrong. It is searched longer, and the other limbs that lie off do not count as
covering the surface: a tail that lies in a leg would hold the leg away."""
CHANGE = 0.15
"""Standard deviation of the changes, in the width of each joint's range."""
OTHER = 0.01
"""Distance of a limb's points (metres of the body, root of the mean square) from which on a pose is another one."""
WORTH = 1.15
"""Ratio of the distance of another pose to that of the present one up to which it is tried: it has not been fitted."""
GAIN = 0.97
"""Ratio of a limb's new gap to its old one from which on it keeps its old pose."""
UNCOVERED = 0.02
"""Distance (metres of the body) from the rest of the body beyond which a limb has to cover a point of the surface."""
FEWEST, MOST = 20, 150
"""Points of the surface that a mean is taken over: at least FEWEST, so that a single one that is far off does not
decide, and in the search MOST at most."""


def fit_predictions(surface: SurfaceSample, consensus: Rig, predictions: Sequence[Rig], name: str) -> BodyFit:
    """Fit a shipped body to a surface from the consensus of some predictions.

    If a body of REFINED has the shape of the surface, but a limb does not lie on it even after a search, the body is
    also fitted from each of the predictions, and limbs are searched from the best. The fit with the smaller gaps is
    returned.
    """
    rotations = [consensus.rotation, *(rig.rotation for rig in predictions)]
    spread = 0.0
    if predictions:
        places = np.stack([rig.joints for rig in predictions])
        apart = np.linalg.norm(places - np.median(places, axis=0), axis=-1)
        spread = float(np.median(apart) / np.ptp(surface.points, axis=0).max())
    best = fit_body(surface, consensus.rotation, consensus.joints, name=name, others=rotations, spread=spread)
    if not predictions or best.distance > SHIPPED_SHAPE or max(best.gaps.values(), default=0.0) < STILL_OFF:
        return best
    fits = [fit_body(surface, rig.rotation, rig.joints, name=name).gap for rig in predictions]
    start = predictions[int(np.argmin(fits))]
    other = fit_body(surface, start.rotation, start.joints, name=name, others=rotations)
    return min(best, other, key=lambda fit: fit.gap)


def fit_body(
    surface: SurfaceSample,
    rotation: Float[np.ndarray, "J 3 3"],
    joints: Float[np.ndarray, "J 3"],
    targets: JointTargets | None = None,
    name: str = "human",
    others: Sequence[Float[np.ndarray, "J 3 3"]] = (),
    spread: float = 0.0,
) -> BodyFit:
    """Fit a shipped body to a surface, from predicted rotations and positions of its joints.

    The unknowns are size, root position, shape coefficients, bone lengths and girths, and the joint rotations (see
    `SampledBody`). Joints are those of the fitted body where it covers the surface closely, and else a blend with the
    predicted ones (`PLACES`, `TURNS`). The surface may have any unit, position and heading. Joints are the shipped
    body's, in its order; those with `targets` keep these positions. `others` are more predicted rotations, from which
    limbs that do not lie on the surface are searched. `spread` is how far predicted positions lie apart, over the
    extent of the surface.
    """
    body = sampled_body(name)
    ranges = joint_ranges(name) if name in REFINED and targets is None else None
    start = rotation if ranges is None else ranges.world(rotation[0], ranges.clipped(rotation))
    parents = list(body.parents[1:])
    predicted, rest = (np.linalg.norm(ends[1:] - ends[parents], axis=1) for ends in (joints, body.joints))
    long = rest > 0.05  # the median ratio of bones of more than 5 cm is the size to begin with
    size = float(np.exp(np.median(np.log(np.maximum(predicted[long], 1e-9) / rest[long]))))
    state = body.mean_person(size, joints[0].copy(), start)
    surface = surface.outward(PosedBody(body, state))
    state, mismatch = _optimise(body, state, Prior(body, state.size, start, joints, targets, ranges), surface)
    if ranges is not None and mismatch < SHIPPED_SHAPE * state.size:
        state, mismatch = _optimise_further(body, state, surface, ranges)
        if others:
            state = search_limbs(
                PosedBody(body, state),
                surface,
                others,
                ranges,
                lambda other: _optimise_further(body, other, surface, ranges)[0],
            )
            posed = PosedBody(body, state)
            mismatch = _mismatch(posed, _matches(posed, surface, OUTLIER_SCALE * LAST_DISTANCE * state.size))
    posed = PosedBody(body, state)
    # Where the body does not have the shape of the surface, its joints are less right than the predicted ones.
    distance = mismatch / state.size
    place, turn = PLACES[name].share(distance, spread), TURNS[name].share(distance)
    blended = nearest_rotation(turn * state.rotation + (1 - turn) * rotation)
    unmatched = surface.tree.query(posed.points)[0] > UNMATCHED_BODY * state.size
    unmatched_body = {limb: float(unmatched[points].mean()) for limb, points in _limb_points(name).items()}
    unmatched_surface = float(is_uncovered(posed, surface.points[: 2 * BODY_POINTS]).mean())
    positions = place * posed.joints + (1 - place) * joints
    return BodyFit(
        rotation=blended,
        joints=targets.apply(positions) if targets else positions,
        unmatched_body=unmatched_body,
        unmatched_surface=unmatched_surface,
        surface_distance=float(surface.nearest_of(posed.points, state.size)[1].mean()),
        distance=distance,
        angle=mean_angle(state.rotation, rotation),
        posed=posed,
        gaps=limb_gaps(posed, surface) if ranges is not None else {},
    )


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
    surface_distance: float
    """Mean distance of the surface from the body (metres of the body, FAR at most)."""
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

    @property
    def share(self) -> float:
        """How far the body has the shape of the surface, from 0 to 1: so far its weights replace predicted ones."""
        return 1 / (1 + (self.distance / SAME_SHAPE) ** SHAPE_EXPONENT)

    def nearest(self, points: Float[np.ndarray, "V 3"]) -> NearestBody:
        """Find the nearest point of the fitted body to each of some points of the surface."""
        from scipy.spatial import KDTree

        body, size = whole_body(self.posed.body.name), self.posed.state.size
        tree = KDTree(PosedBody(body, self.posed.state).points)
        nearest, weights = np.empty(len(points)), np.empty((len(points), body.weights.shape[1]))
        # CHUNK points at a time: the weights of all their neighbours take several times the memory of the result.
        for start in range(0, len(points), CHUNK):
            chunk = slice(start, start + CHUNK)
            distance, index = map(np.asarray, tree.query(points[chunk], k=NEAREST))
            share = 1 / np.maximum(distance, 1e-9 * size) ** 2
            nearest[chunk] = distance[:, 0] / size
            weights[chunk] = np.einsum("vn,vnj->vj", share / share.sum(axis=1, keepdims=True), body.weights[index])
        return NearestBody(nearest, weights, body.name)

    def blended_weights(self, predicted: Float[np.ndarray, "V J"], nearest: NearestBody) -> Float[np.ndarray, "V J"]:
        """Mix predicted weights with those of the fitted body as far as it has the shape of the surface.

        Weights of a person's hands stay predicted: the fitted body has stubs instead of fingers.
        """
        body = self.posed.body
        hands = [j for side in SIDES for j in hand_joints(body.names, side)] if body.name == "human" else []
        share = self.share * (1 - nearest.weights[:, hands].sum(axis=1, keepdims=True))
        return (1 - share) * predicted + share * nearest.weights


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
class SurfaceSample:
    """Points of a surface; most are spread evenly and in random order, so that the first few represent all of it."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    """Unit normals, or zeros where they are unknown."""

    @cached_property
    def tree(self) -> KDTree:
        """Finds the nearest of the points."""
        from scipy.spatial import KDTree

        return KDTree(self.points)

    @classmethod
    def of(cls, samples: SurfacePoints, vertices: Float[np.ndarray, "V 3"]) -> SurfaceSample:
        """Compute samples of a mesh in a frame."""
        return cls(samples.points(vertices), samples.normals(vertices))

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, chosen: slice | Bool[np.ndarray, " N"]) -> SurfaceSample:
        return SurfaceSample(self.points[chosen], self.normals[chosen])

    def mirrored(self) -> SurfaceSample:
        """Reflect the points at the plane x = 0."""
        return SurfaceSample(self.points * MIRROR, self.normals * MIRROR)

    def turned(self, turn: Float[np.ndarray, "3 3"]) -> SurfaceSample:
        """Rotate the points about the origin."""
        return SurfaceSample(self.points @ turn.T, self.normals @ turn.T)

    def outward(self, posed: PosedBody) -> SurfaceSample:
        """Flip all normals if most of them point against those of the nearest points of a posed body."""
        nearest = nearest_points(posed.points, self.points)[1]
        inward = np.median((posed.normals[nearest] * self.normals).sum(axis=1)) < 0
        return replace(self, normals=-self.normals) if inward else self

    def distance_of(self, points: Float[np.ndarray, "M 3"], size: float) -> Float[np.ndarray, " M"]:
        """Measure how far points are from the surface, in metres of a body of that size."""
        nearest = np.asarray(self.tree.query(points)[1])
        return _distance(points - self.points[nearest], self.normals[nearest], size)

    def nearest_of(
        self, points: Float[np.ndarray, "M 3"], size: float
    ) -> tuple[Int[np.ndarray, " N"], Float[np.ndarray, " N"]]:
        """Find the nearest of some points to each of the surface, and the distance in metres of a body of that size."""
        nearest = nearest_points(points, self.points)[1]
        return nearest, _distance(self.points - points[nearest], self.normals, size)

    def distance_to_each(self, sets: Float[np.ndarray, "C M 3"], size: float) -> Float[np.ndarray, "C N"]:
        """Measure these distances for several small sets of points, ten times as fast as with a tree each."""
        rows = np.empty((len(sets), len(self.points)))
        for points, row in zip(sets, rows, strict=True):
            # |a - b|^2 without |a|^2, which does not change which is the nearest.
            nearest = (np.square(points).sum(axis=1) - 2 * self.points @ points.T).argmin(axis=1)
            row[:] = _distance(self.points - points[nearest], self.normals, size)
        return rows


def _distance(
    difference: Float[np.ndarray, "M 3"], normals: Float[np.ndarray, "M 3"], size: float
) -> Float[np.ndarray, " M"]:
    """Measure distances as NEAR and FAR say; unknown normals (zeros) count as they are."""
    distance = np.linalg.norm(difference, axis=1) / size
    along = np.where(normals.any(axis=1), np.abs((difference * normals).sum(axis=1)) / size, distance)
    return np.where(distance < NEAR, along, np.minimum(distance, FAR))


@cache
def sampled_body(name: str = "human") -> SampledBody:
    """Return a shipped body as BODY_POINTS points."""
    return SampledBody.of(load_body(name), BODY_POINTS)


@cache
def whole_body(name: str = "human") -> SampledBody:
    """Return a shipped body as all of its vertices."""
    return SampledBody.of_vertices(load_body(name))


@cache
def _limb_points(name: str) -> dict[str, Bool[np.ndarray, " N"]]:
    """Limb -> mask of a body's points that are weighted mostly to its joints."""
    body = sampled_body(name)
    joints = limb_joints(body.names, body.parents)
    return {limb: body.weighted_to(indices) for limb, indices in joints.items()}


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


def _step(posed: PosedBody, matches: Matches, prior: Prior, expected: float) -> Float[np.ndarray, " U"]:
    """Solve the normal equations of one Gauss-Newton step, for matches at an expected distance."""
    scale = np.sqrt(matches.weight * MATCH_WEIGHT) / expected
    jacobian = matches.jacobian * scale[:, None]  # of a matrix with its own transpose half of the product is computed
    hessian, gradient = jacobian.T @ jacobian, jacobian.T @ (scale * matches.residual)
    prior_hessian, prior_gradient = prior.normal_equations(posed)
    return -np.linalg.solve(hessian + prior_hessian, gradient + prior_gradient)


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
    count = len(posed.points)
    points, normals = surface.points[: 2 * count], surface.normals[: 2 * count]
    to_surface, to_body = surface.tree.query(posed.points), nearest_points(posed.points, points)
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


def _mismatch(posed: PosedBody, matches: Matches) -> float:
    """Measure how much the shapes of body and surface differ, in the unit of the surface.

    It is the median over the body's points of the absolute mean of the signed residuals around each: where the shapes
    differ, neighbouring residuals have one sign, and noise of the surface averages out.
    """
    near = nearest_points(posed.points, posed.points, MISMATCH_POINTS)[1]
    signed, weights = matches.residual[near], matches.weight[near]  # matches of the body's points come first
    return float(np.median(np.abs((signed * weights).sum(axis=1) / np.maximum(weights.sum(axis=1), 1e-9))))


class Prior:
    """Terms of the least squares that keep a body near the prediction and near the mean person.

    Each is a squared difference over a variance: joint positions (JOINT_SIGMA), joint rotations (ROTATION_SIGMA), shape
    coefficients (SHAPE_SIGMA), bone lengths and girths (BONE_SIGMA), and with ranges of the joints how far these turn
    beyond them (RANGE_SIGMA). They decide what no match determines. Positions that the user has picked have the small
    CORRECTED_SIGMA.
    """

    def __init__(
        self,
        body: SampledBody,
        size: float,
        rotation: Float[np.ndarray, "J 3 3"],
        joints: Float[np.ndarray, "J 3"],
        targets: JointTargets | None = None,
        ranges: JointRanges | None = None,
    ) -> None:
        self.rotation, self.joints, self.targets, self.ranges = rotation, joints, targets, ranges
        self.target_sigma = CORRECTED_SIGMA * size
        self.joint_weight = 1 / (JOINT_SIGMA * size) ** 2
        self.turns = body.unknowns["turns"]
        # Derivative of the world rotations: a turn of one joint turns all of its descendants too.
        self.turn_jacobian = np.kron(body.below.T, np.eye(3))
        self.turn_hessian = self.turn_jacobian.T @ self.turn_jacobian / ROTATION_SIGMA**2
        shape, bones = body.unknowns["shape"], body.unknowns["bones"]
        self.person = slice(shape.start, bones.stop)
        self.person_weight = np.zeros(self.turns.stop)
        self.person_weight[shape], self.person_weight[bones] = SHAPE_SIGMA**-2, BONE_SIGMA**-2

    def normal_equations(self, posed: PosedBody) -> tuple[Float[np.ndarray, "U U"], Float[np.ndarray, " U"]]:
        """Return the Hessian (Gauss-Newton) and the gradient of half the prior's energy at a posed body."""
        state, jacobian = posed.state, posed.of_joints()
        hessian = self.joint_weight * jacobian.T @ jacobian + np.diag(self.person_weight)
        gradient = self.joint_weight * jacobian.T @ (posed.joints - self.joints).reshape(-1)
        gradient[self.person] += self.person_weight[self.person] * np.concatenate([state.shape, state.bones])
        # The antisymmetric part of a small rotation is its rotation vector (of a large one: the axis times the sine).
        difference = state.rotation @ self.rotation.swapaxes(-1, -2)
        rotation_vector = (difference - difference.swapaxes(-1, -2))[:, [2, 0, 1], [1, 2, 0]] / 2
        hessian[self.turns, self.turns] += self.turn_hessian
        gradient[self.turns] += self.turn_jacobian.T @ rotation_vector.reshape(-1) / ROTATION_SIGMA**2
        if self.ranges:
            of_ranges, slope = self.ranges.normal_equations(state.rotation)
            hessian[self.turns, self.turns] += of_ranges / RANGE_SIGMA**2
            gradient[self.turns] += slope / RANGE_SIGMA**2
        if self.targets:
            corrected = jacobian.reshape(-1, 3, jacobian.shape[1])[self.targets.index].reshape(-1, jacobian.shape[1])
            difference = (posed.joints[self.targets.index] - self.targets.positions).reshape(-1)
            # Looser while they are far off: a step of Gauss-Newton is too large where it is far from linear.
            weight = 1 / (self.target_sigma**2 + np.square(0.3 * difference).mean())
            hessian += weight * corrected.T @ corrected
            gradient += weight * corrected.T @ difference
        return hessian, gradient


class Effort(NamedTuple):
    """How many poses of a limb are tried."""

    random: int
    """Random poses."""
    generations: int
    """How many times new poses are made of the best ones."""
    children: int
    """Poses that are made each time."""
    parents: int
    """Poses that they are made of."""


SHORT, LONG = Effort(128, 2, 64, 8), Effort(256, 3, 96, 16)


def search_limbs(
    posed: PosedBody,
    surface: SurfaceSample,
    predictions: Sequence[Float[np.ndarray, "J 3 3"]],
    ranges: JointRanges,
    refined: Callable[[BodyState], BodyState],
) -> BodyState:
    """Return the state of a fitted body in which its limbs lie on the surface, if the search finds one.

    Args:
        posed: the fitted body.
        surface: with normals that point outward.
        predictions: world rotations, the other poses that are tried first.
        ranges: of the body's joints.
        refined: fits a state more closely.
    """
    state, rng = posed.state, np.random.default_rng(0)
    starts = np.stack([ranges.clipped(world) for world in predictions])
    for _ in range(SEARCHES):
        better = _with_other_limbs(PosedBody(posed.body, state), surface, starts, ranges, refined, rng)
        if better is None:
            break
        state = better
    return state


def is_uncovered(posed: PosedBody, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, " N"]:
    """Tell which points of a surface are farther than UNMATCHED_SURFACE from a fitted body."""
    return nearest_points(posed.points, points)[0] > UNMATCHED_SURFACE * posed.state.size


def limb_gaps(posed: PosedBody, surface: SurfaceSample) -> dict[str, float]:
    """Measure how far each limb of a body is from the surface and the surface next to it from the limb.

    Returns:
        Limb -> sum of both means (metres of the body). The trunk is "trunk".
    """
    size, of_body = posed.state.size, surface.distance_of(posed.points, posed.state.size)
    nearest, of_surface = surface[: 2 * len(posed.points)].nearest_of(posed.points, size)
    masks = {limb: posed.body.weighted_to(joints) for limb, joints in limbs(posed.body.name).items()}
    masks["trunk"] = ~np.any(list(masks.values()), axis=0)
    return {limb: float(of_body[mask].mean() + _mean(of_surface[mask[nearest]])) for limb, mask in masks.items()}


@cache
def limbs(name: str) -> dict[str, list[int]]:
    """Return the joints of head, limbs and tail of a shipped body."""
    body = load_body(name)
    tail = [j for j, joint in enumerate(body.joint_names) if joint.startswith("Tail")]
    return limb_joints(body.joint_names, body.parents) | ({"tail": tail} if tail else {})


def _mean(values: Float[np.ndarray, "*C N"]) -> Float[np.ndarray, "*C"]:
    return np.asarray(values.sum(axis=-1) / max(values.shape[-1], FEWEST))


def _with_other_limbs(
    posed: PosedBody,
    surface: SurfaceSample,
    starts: Float[np.ndarray, "P B 3"],
    ranges: JointRanges,
    refined: Callable[[BodyState], BodyState],
    rng: np.random.Generator,
) -> BodyState | None:
    """Search all limbs that do not lie on the surface, fit again, and keep the poses that are better; None: none is."""
    state, before = posed.state, limb_gaps(posed, surface)
    rotation, found = state.rotation.copy(), []
    points, placed = posed.points.copy(), np.ones(len(posed.points), dtype=bool)
    joints_of = limbs(posed.body.name)
    worst_first = sorted(joints_of, key=before.__getitem__, reverse=True)
    searched = {limb: LimbPoses.of(posed, joints_of[limb]) for limb in worst_first if before[limb] > LIES_ON}
    for limb, poses in searched.items():
        placed[poses.mask] = before[limb] < LIES_OFF
    for limb, poses in searched.items():
        effort = SHORT if before[limb] < LIES_OFF else LONG
        distance = _distance_to_surface(poses, points[placed & ~poses.mask], surface)
        pose = _other_pose(poses, distance, starts, ranges, effort, rng)
        placed |= poses.mask
        if pose is not None:
            points[poses.mask], rotation[poses.joints] = poses.points(pose[None])[0], poses.world(pose[None])[0]
            found.append(limb)
    if not found:
        return None
    tried = refined(replace(state, rotation=rotation))
    after = limb_gaps(PosedBody(posed.body, tried), surface)
    kept = [limb for limb in found if after[limb] < GAIN * before[limb]]
    if kept and kept != found:
        back = [j for limb in found if limb not in kept for j in joints_of[limb]]
        rotation, before_it = tried.rotation.copy(), state.rotation
        for j in back:  # parents first: they get the rotation from their parents that they had before
            parent = posed.body.parents[j]
            rotation[j] = rotation[parent] @ before_it[parent].T @ before_it[j]
        tried = refined(replace(tried, rotation=rotation))
        after = limb_gaps(PosedBody(posed.body, tried), surface)
    return tried if kept and sum(after.values()) < sum(before.values()) else None


def _other_pose(
    limb: LimbPoses,
    distance: Callable[[Float[np.ndarray, "C K 3"]], Float[np.ndarray, " C"]],
    starts: Float[np.ndarray, "P B 3"],
    ranges: JointRanges,
    effort: Effort,
    rng: np.random.Generator,
) -> Float[np.ndarray, "K 3"] | None:
    """Find the best pose of a limb that is another than the present one; None if it is much farther from the surface.

    Args:
        limb: poses the limb.
        distance: of poses from the surface.
        starts: rotation vectors of all joints but the root, from their parents, of poses to begin with.
        ranges: of the joints.
        effort: how many poses are tried.
        rng: draws them.
    """
    index = np.array(limb.joints) - 1
    low, high = ranges.low[index], ranges.high[index]
    present = ranges.local(limb.posed.state.rotation)[None, index]
    poses = np.concatenate([present, starts[:, index], rng.uniform(low, high, (effort.random, *low.shape))])
    costs = distance(poses)
    now = costs[0]
    for _ in range(effort.generations):
        best = np.argsort(costs)[: effort.parents]
        parents = poses[best][rng.integers(len(best), size=effort.children)]
        children = np.clip(parents + CHANGE * (high - low) * rng.standard_normal(parents.shape), low, high)
        poses, costs = np.concatenate([poses[best], children]), np.concatenate([costs[best], distance(children)])
    moved = np.square(limb.points(poses) - limb.points(present)).sum(axis=-1).mean(axis=-1)
    costs = np.where(np.sqrt(moved) > OTHER * limb.posed.state.size, costs, np.inf)
    k = int(np.argmin(costs))
    return poses[k] if costs[k] < WORTH * now else None


def _distance_to_surface(
    limb: LimbPoses, rest: Float[np.ndarray, "R 3"], surface: SurfaceSample
) -> Callable[[Float[np.ndarray, "C K 3"]], Float[np.ndarray, " C"]]:
    """Return the function that measures how far poses of a limb are from the surface (metres of the body).

    It adds the mean over the limb's points, and the mean over the part of the surface that the points `rest` of the
    other body leave uncovered.
    """
    posed, size = limb.posed, limb.posed.state.size
    sample = surface[: 2 * len(posed.points)]
    part = sample[nearest_points(rest, sample.points)[0] > UNCOVERED * size][:MOST]
    _, from_rest = part.nearest_of(rest, size)

    def distance(poses: Float[np.ndarray, "C K 3"]) -> Float[np.ndarray, " C"]:
        points = limb.points(poses)
        of_limb = surface.distance_of(points.reshape(-1, 3), size).reshape(len(poses), -1).mean(axis=1)
        covered = np.minimum(part.distance_to_each(points, size), from_rest)
        return of_limb + _mean(covered)

    return distance


@dataclass(frozen=True, eq=False)
class LimbPoses:
    """Poses K joints of a limb in C ways at once, while the rest of the body is held."""

    posed: PosedBody
    joints: list[int]
    """The limb's joints, parents first."""
    mask: Bool[np.ndarray, " N"]
    """The body's points that are weighted mostly to them."""
    held: Float[np.ndarray, "M 3"]
    """What the other joints contribute to the limb's points."""

    @classmethod
    def of(cls, posed: PosedBody, joints: list[int]) -> LimbPoses:
        """Take the joints of a limb of a posed body."""
        mask = posed.body.weighted_to(joints)
        own = posed.contributions(mask)
        return cls(posed, joints, mask, own.sum(axis=1) - own[:, joints].sum(axis=1))

    def world(self, poses: Float[np.ndarray, "C K 3"]) -> Float[np.ndarray, "C K 3 3"]:
        """Turn rotation vectors from the parents into world rotations."""
        rotation = dict(enumerate(self.posed.state.rotation))
        for k, j in enumerate(self.joints):
            rotation[j] = rotation[self.posed.body.parents[j]] @ rotvec_to_rotmat(poses[:, k])
        return np.stack([rotation[j] for j in self.joints], axis=1)

    def points(self, poses: Float[np.ndarray, "C K 3"]) -> Float[np.ndarray, "C M 3"]:
        """Compute the limb's points; poses are rotation vectors from the parents."""
        posed, body, joints = self.posed, self.posed.body, self.joints
        # Size, lengths and girths of the bones stay: L = R R0^T L0, with R0 and L0 of the posed body.
        linear = self.world(poses) @ posed.state.rotation[joints].swapaxes(-1, -2) @ posed.linear[joints]
        maps, position = dict(enumerate(posed.linear)) | dict(zip(joints, linear.swapaxes(0, 1), strict=True)), {}
        for j in joints:
            parent = body.parents[j]
            bone = maps[parent] @ (posed.rest_joints[j] - posed.rest_joints[parent])
            position[j] = np.broadcast_to(position.get(parent, posed.joints[parent]) + bone, (len(poses), 3))
        weights, offset = body.weights[self.mask][:, joints], posed.offsets(self.mask)[:, joints]
        moved = np.einsum("ckab,mkb->cmka", linear, offset, optimize=True)
        placed = np.stack([position[j] for j in joints], axis=1)
        return self.held + np.einsum("mk,cmka->cma", weights, moved, optimize=True) + weights @ placed
