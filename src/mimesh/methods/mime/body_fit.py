"""A person of the shipped body laid onto a surface, from where a network has read its joints to be.

A network sees a few hundred points once. What it reads is good enough to say which of a body's points is near which of
the surface's, and from there least squares know better: Gauss-Newton over pose, shape and proportions, what was read
being the prior. Matches are the nearest points of both sides, in planes halfway between both normals (symmetric ICP,
Rusinkiewicz 2019), with the robust weights of Geman and McClure (1985).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from ...bodies import load_body
from ...bodies.sampled_body import BodyState, PosedBody, SampledBody
from ...core.rig import descendants
from ..confidence import LIMBS

if TYPE_CHECKING:
    from scipy.spatial import KDTree

POINTS = 1000
"""Of the body; for twice as many of the surface the nearest of them is looked for."""
ROUNDS, ROUGH, FEW = 6, 3, 400
"""How often points are matched, how many of the first times are for FEW points of the body."""
FAR, NEAR = 0.03, 0.003
"""Distance (metres of the body) that matched points are thought to have, in the first round and in the last."""
OUTLIER_SCALE = 3.0
"""So many times that, and a match counts a quarter."""
CERTAIN = 0.3
"""Of all matches: neighbours are wrong together."""
READ_TURN, READ_JOINT = 0.2, 0.1
"""How far a network's rotations (radians) and joints (metres) may well be off."""
SHAPE, BONES = 3.0, 0.1
"""How far shape coefficients and the logarithms of bones' lengths and girths are from zero."""
UNMATCHED_BODY, UNMATCHED_SURFACE = 0.05, 0.08
"""Metres of the body: so far from the surface a point of the body has missed it, and the other way round."""


@dataclass(frozen=True, eq=False)
class SurfaceSample:
    """A surface as points in random order, spread evenly: the first few stand for all."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    """Of unit length, or zero where they are not known."""

    def outward(self, posed: PosedBody) -> SurfaceSample:
        """The same with normals that look as the body's near them do, should most of them be turned over."""
        from scipy.spatial import KDTree

        near = KDTree(posed.points).query(self.points)[1]
        over = np.median((posed.normals[near] * self.normals).sum(axis=1)) < 0
        return replace(self, normals=-self.normals) if over else self


@dataclass(frozen=True, eq=False)
class BodyFit:
    """What was found of a surface."""

    rotation: Float[np.ndarray, "J 3 3"]
    joints: Float[np.ndarray, "J 3"]
    unmatched_body: dict[str, float]
    """Share of each limb of the body that is UNMATCHED_BODY from the surface."""
    unmatched_surface: float
    """Share of the surface that is UNMATCHED_SURFACE from the body."""


@cache
def sampled_body() -> SampledBody:
    """The shipped body in few points."""
    return SampledBody.of(load_body(), POINTS)


def fit_body(cloud: SurfaceSample, rotation: Float[np.ndarray, "J 3 3"], joints: Float[np.ndarray, "J 3"]) -> BodyFit:
    """Rotation and place of every joint of a surface, from what was read of them.

    Any unit, place and heading will do. Joints are those of the shipped body, in its order.
    """
    from scipy.spatial import KDTree

    body, tree = sampled_body(), KDTree(cloud.points)
    stance = body.mean_person(_size(body, joints), joints[0].copy(), rotation)
    cloud = cloud.outward(PosedBody(body, stance))
    stance = _descended(body, stance, Prior(body, stance.size, rotation, joints), cloud, tree)
    posed = PosedBody(body, stance)
    away = tree.query(posed.points)[0] > UNMATCHED_BODY * stance.size
    unmatched_body = {limb: float(away[which].mean()) for limb, which in _limbs().items()}
    unmatched_surface = KDTree(posed.points).query(cloud.points[: 2 * POINTS])[0] > UNMATCHED_SURFACE * stance.size
    return BodyFit(stance.rotation, posed.joints, unmatched_body, float(unmatched_surface.mean()))


@cache
def _limbs() -> dict[str, Bool[np.ndarray, " N"]]:
    """Which points of the body each limb holds."""
    body = sampled_body()
    held = {limb: descendants([body.names.index(top)], body.parents) for limb, top in LIMBS.items()}
    return {limb: body.weights[:, joints].sum(axis=1) > 0.5 for limb, joints in held.items()}


def _descended(body: SampledBody, stance: BodyState, prior: Prior, cloud: SurfaceSample, tree: KDTree) -> BodyState:
    """Match, take a step of Gauss-Newton, and again; from rough to fine."""
    few, spread = body.first(FEW), 0.0
    for k in range(ROUNDS):
        expected = max(stance.size * FAR * (NEAR / FAR) ** (k / (ROUNDS - 1)), spread)
        posed = PosedBody(few if k < ROUGH else body, stance)
        rows, residual, weight = _matches(posed, cloud, tree, OUTLIER_SCALE * expected)
        spread = 1.48 * float(np.median(np.abs(residual)))  # the deviation of a normal distribution of that median
        weight *= CERTAIN / expected**2
        normal, slope = (rows * weight[:, None]).T @ rows, rows.T @ (weight * residual)
        held, pull = prior(posed)
        stance = body.stepped(stance, -np.linalg.solve(normal + held, slope + pull))
    return stance


def _matches(posed: PosedBody, cloud: SurfaceSample, tree: KDTree, wild: float):
    """Rows, residuals and weights: the body's points to the nearest of the surface, and the other way round."""
    from scipy.spatial import KDTree

    count = len(posed.points)
    points, normals = cloud.points[: 2 * count], cloud.normals[: 2 * count]
    there, back = tree.query(posed.points), KDTree(posed.points).query(points)
    index = np.concatenate([np.arange(count), back[1]])
    target = np.concatenate([cloud.points[there[1]], points])
    theirs, own = np.concatenate([cloud.normals[there[1]], normals]), posed.normals[index]
    between = theirs + own
    between /= np.maximum(np.linalg.norm(between, axis=1, keepdims=True), 1e-9)
    alike = np.where(theirs.any(axis=1), (theirs * own).sum(axis=1).clip(0, 1), 1.0)
    off = np.concatenate([there[0], back[0]]) / wild
    residual = ((posed.points[index] - target) * between).sum(axis=1)
    return posed.along(index, between), residual, alike / np.square(1 + np.square(off))


class Prior:
    """What was read, and what people are like, as terms of least squares."""

    def __init__(self, body: SampledBody, size: float, rotation: np.ndarray, joints: np.ndarray) -> None:
        self.rotation, self.joints = rotation, joints
        self.joint = 1 / (READ_JOINT * size) ** 2
        self.turns = body.unknowns["turns"]
        self.carried = np.kron(body.below.T, np.eye(3))
        shape, bones = body.unknowns["shape"], body.unknowns["bones"]
        self.person = slice(shape.start, bones.stop)
        self.plain = np.zeros(self.turns.stop)
        self.plain[shape], self.plain[bones] = SHAPE**-2, BONES**-2

    def __call__(self, posed: PosedBody) -> tuple[Float[np.ndarray, "U U"], Float[np.ndarray, " U"]]:
        """Left and right side of the normal equations."""
        stance, rows = posed.state, posed.of_joints()
        held = self.joint * rows.T @ rows + np.diag(self.plain)
        pull = self.joint * rows.T @ (posed.joints - self.joints).reshape(-1)
        pull[self.person] += self.plain[self.person] * np.concatenate([stance.shape, stance.bones])
        off = stance.rotation @ self.rotation.swapaxes(-1, -2)
        turned = (off - off.swapaxes(-1, -2))[:, [2, 0, 1], [1, 2, 0]] / 2
        held[self.turns, self.turns] += self.carried.T @ self.carried / READ_TURN**2
        pull[self.turns] += self.carried.T @ turned.reshape(-1) / READ_TURN**2
        return held, pull


def _size(body: SampledBody, joints: Float[np.ndarray, "J 3"]) -> float:
    """How much longer bones are than the body's, where those are long enough to tell."""
    above = list(body.parents[1:])
    bones, own = (np.linalg.norm(places[1:] - places[above], axis=1) for places in (joints, body.joints))
    long = own > 0.05
    return float(np.exp(np.median(np.log(np.maximum(bones[long], 1e-9) / own[long]))))
