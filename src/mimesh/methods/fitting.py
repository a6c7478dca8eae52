"""A person of the shipped body laid onto a surface, from where a network has read its joints to be.

A network sees a few hundred points once. What it reads is good enough to say which of a body's points is near which of
the surface's, and from there least squares know better: Gauss-Newton over pose, shape and proportions, with the nearest
points of both sides (symmetric ICP, Rusinkiewicz 2019) and what was read as a prior.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float

from ..bodies import load_body
from ..bodies.figure import Figure, Posed

POINTS = 1000
"""Of the body; and twice as many of the surface look for the nearest of them."""
ROUNDS, ROUGH, FEW = 6, 3, 400
"""How often points are matched, how many of the first times are for FEW points of the body."""
FAR, NEAR = 0.03, 0.003
"""Distance (metres of the body) that matched points are thought to have, in the first round and in the last."""
WILD = 3.0
"""So many times that, and a match counts a quarter."""
CERTAIN = 0.3
"""Of all matches: neighbours are wrong together."""
READ_TURN, READ_JOINT = 0.2, 0.1
"""How far a network's rotations (radians) and joints (metres) may well be off."""
SHAPE, BONES = 3.0, 0.1
"""How far shape coefficients and the logarithms of bones' lengths and girths are from zero."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """A surface as points, spread evenly."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    """Of unit length, or zero where they are not known."""


@dataclass(frozen=True, eq=False)
class Fit:
    """What was found; the same fields as in `Rig`."""

    rotation: Float[np.ndarray, "J 3 3"]
    joints: Float[np.ndarray, "J 3"]


@cache
def figure() -> Figure:
    """The shipped body in few points."""
    return Figure.of(load_body(), POINTS)


def fitted(cloud: Cloud, rotation: Float[np.ndarray, "J 3 3"], joints: Float[np.ndarray, "J 3"]) -> Fit:
    """Rotation and place of every joint of a surface, from what was read of them; any unit and place."""
    from scipy.spatial import KDTree

    body, tree = figure(), KDTree(cloud.points)
    few = body.first(FEW)
    stance = body.upright(_size(body, joints), joints[0].copy(), rotation)
    prior = Prior(body, stance.size, rotation, joints)
    for k in range(ROUNDS):
        expected = stance.size * FAR * (NEAR / FAR) ** (k / (ROUNDS - 1))
        posed = Posed(few if k < ROUGH else body, stance)
        rows, residual, weight = _matches(posed, cloud, tree, WILD * expected)
        weight *= CERTAIN / expected**2
        normal, slope = (rows * weight[:, None]).T @ rows, rows.T @ (weight * residual)
        held, pull = prior(posed)
        stance = body.stepped(stance, -np.linalg.solve(normal + held, slope + pull))
    return Fit(stance.rotation, Posed(body, stance).joints)


def _matches(posed: Posed, cloud: Cloud, tree, wild: float):
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

    def __init__(self, body: Figure, size: float, rotation: np.ndarray, joints: np.ndarray) -> None:
        self.rotation, self.joints = rotation, joints
        self.joint = 1 / (READ_JOINT * size) ** 2
        self.turns = body.unknowns["turns"]
        self.carried = np.kron(body.below.T, np.eye(3))
        self.plain = np.zeros(self.turns.stop)
        self.plain[body.unknowns["shape"]], self.plain[body.unknowns["bones"]] = SHAPE**-2, BONES**-2

    def __call__(self, posed: Posed) -> tuple[Float[np.ndarray, "U U"], Float[np.ndarray, " U"]]:
        """Left and right side of the normal equations."""
        stance, rows = posed.stance, posed.of_joints()
        held = self.joint * rows.T @ rows + np.diag(self.plain)
        pull = self.joint * rows.T @ (posed.joints - self.joints).reshape(-1)
        pull[posed.figure.unknowns["shape"]] += stance.shape * SHAPE**-2
        pull[posed.figure.unknowns["bones"]] += stance.bones * BONES**-2
        off = stance.rotation @ self.rotation.mT
        turned = (
            np.stack([off[:, 2, 1] - off[:, 1, 2], off[:, 0, 2] - off[:, 2, 0], off[:, 1, 0] - off[:, 0, 1]], 1) / 2
        )
        held[self.turns, self.turns] += self.carried.T @ self.carried / READ_TURN**2
        pull[self.turns] += self.carried.T @ turned.reshape(-1) / READ_TURN**2
        return held, pull


def _size(body: Figure, joints: Float[np.ndarray, "J 3"]) -> float:
    """How much longer bones are than the body's, where those are long enough to tell."""
    above = list(body.parents[1:])
    bones, own = (np.linalg.norm(places[1:] - places[above], axis=1) for places in (joints, body.joints))
    long = own > 0.05
    return float(np.exp(np.median(np.log(np.maximum(bones[long], 1e-9) / own[long]))))
