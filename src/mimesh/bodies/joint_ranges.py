"""How far the joints of a shipped body can turn: clip poses to these ranges, and least squares that keep to them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float, Int

from . import load_body, quadruped
from .body_model import RiggedBody
from .sampling import JOINT_LIMITS, TABLE_6, Range, limits_rotvec, rotvec_to_rotmat

MARGIN = np.radians(10.0)
"""How much farther joints may turn than in random poses: those of gaits do by up to 9 degrees."""
HINGE, TWISTED = np.radians(45.0), np.radians(30.0)
"""Widest range of a hinge about its other axes, and how far beyond the ranges a joint is twisted."""


@dataclass(frozen=True, eq=False)
class JointRanges:
    """Lowest and highest rotation vector (radians) of each joint, from its parent and from rest; not of the root."""

    low: Float[np.ndarray, "B 3"]
    high: Float[np.ndarray, "B 3"]
    parents: Int[np.ndarray, " B"]
    """Parent of each joint but the root, which is joint 0; parents come before their children."""

    def local(self, rotation: Float[np.ndarray, "J 3 3"]) -> Float[np.ndarray, "B 3"]:
        """Turn world rotations into rotation vectors from the parents."""
        from scipy.spatial.transform import Rotation

        return Rotation.from_matrix(rotation[self.parents].swapaxes(-1, -2) @ rotation[1:]).as_rotvec()

    def world(self, root: Float[np.ndarray, "3 3"], local: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "J 3 3"]:
        """Turn rotation vectors from the parents into world rotations."""
        rotation = [root]
        for parent, turn in zip(self.parents, rotvec_to_rotmat(local), strict=True):
            rotation.append(rotation[parent] @ turn)
        return np.stack(rotation)

    def clipped(self, rotation: Float[np.ndarray, "J 3 3"]) -> Float[np.ndarray, "B 3"]:
        """Clip world rotations to the ranges; the result is rotation vectors from the parents.

        Each joint is clipped against its clipped parent, so what one is turned does not add up along a limb. A hinge
        about the first axis that is also twisted far out of its range has a rotation vector about another axis: it
        keeps its angle about the first (the twist of swing and twist).
        """
        from scipy.spatial.transform import Rotation

        world, clipped = [rotation[0]], np.empty_like(self.low)
        for k, (parent, hinge) in enumerate(zip(self.parents, self.hinges, strict=True)):
            turn = Rotation.from_matrix(world[parent].T @ rotation[k + 1])
            vector = turn.as_rotvec()
            clipped[k] = np.clip(vector, self.low[k], self.high[k])
            if hinge and np.linalg.norm(vector - clipped[k]) > TWISTED:
                x, _, _, w = turn.as_quat()
                angle = (2 * np.arctan2(x, w) + np.pi) % (2 * np.pi) - np.pi
                clipped[k, 0] = np.clip(angle, self.low[k, 0], self.high[k, 0])
            world.append(world[parent] @ rotvec_to_rotmat(clipped[k]))
        return clipped

    @property
    def hinges(self) -> Bool[np.ndarray, " B"]:
        """Which joints turn little about any axis but the first."""
        return ((self.high - self.low)[:, 1:] < HINGE).all(axis=1)

    def normal_equations(
        self, rotation: Float[np.ndarray, "J 3 3"]
    ) -> tuple[Float[np.ndarray, "T T"], Float[np.ndarray, " T"]]:
        """Return Hessian (Gauss-Newton) and gradient of half the squared excess over the ranges (radians).

        The unknowns are small turns of the joints about the world's axes, T is 3 J. The turn t of a joint changes its
        rotation vector v from its parent, whose world rotation is R, by J(v) R^T t, with J the inverse of the left
        Jacobian of rotations. Turns of the joints above change nothing.
        """
        local, count = self.local(rotation), len(rotation)
        excess = local - np.clip(local, self.low, self.high)
        # d log(exp(t) exp(v)) / dt at t = 0 (Sola et al. 2018, Eq. 146)
        angle = np.maximum(np.linalg.norm(local, axis=-1), 1e-4)[:, None, None]
        cross = np.zeros((len(local), 3, 3))
        cross[:, [2, 0, 1], [1, 2, 0]], cross[:, [1, 2, 0], [2, 0, 1]] = local, -local
        factor = 1 / angle**2 - (1 + np.cos(angle)) / (2 * angle * np.maximum(np.sin(angle), 1e-6))
        derivative = (np.eye(3) - cross / 2 + factor * (cross @ cross)) @ rotation[self.parents].swapaxes(-1, -2)
        outside = derivative * (excess != 0)[..., None]  # within the range, nothing holds a joint
        hessian, index = np.zeros((count, 3, count, 3)), np.arange(1, count)
        hessian[index, :, index] = outside.swapaxes(-1, -2) @ outside
        gradient = np.zeros((count, 3))
        gradient[1:] = (excess[:, None] @ outside)[:, 0]
        return hessian.reshape(3 * count, 3 * count), gradient.reshape(-1)


def ranges_of(body: RiggedBody) -> tuple[dict[str, tuple[Range, Range, Range]], dict[str, tuple[Range, Range, Range]]]:
    """Give the tables of everyday poses and of joint limits of a shipped body."""
    return (quadruped.USUAL, quadruped.LIMITS) if body.name == "quadruped" else (TABLE_6, JOINT_LIMITS)


@cache
def joint_ranges(name: str) -> JointRanges:
    """Return the ranges of a shipped body's joints, MARGIN wider than those of random poses."""
    body = load_body(name)
    low, high = limits_rotvec(body, ranges_of(body)[1])
    return JointRanges(low[1:] - MARGIN, high[1:] + MARGIN, np.array(body.parents[1:]))
