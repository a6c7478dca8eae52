"""What keeps a fitted body near the prediction, near the mean, and within the ranges of its joints."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ...bodies.joint_ranges import JointRanges
from ...bodies.sampled_body import PosedBody, SampledBody
from .joint_targets import JointTargets

ROTATION_SIGMA, JOINT_SIGMA = 0.2, 0.1
"""Standard deviation of the predicted rotations (radians) and joint positions (metres of the body)."""
SHAPE_SIGMA, BONE_SIGMA = 3.0, 0.1
"""Standard deviation of the shape coefficients, and of the logarithms of bone lengths and girths; their mean is 0."""
RANGE_SIGMA = 0.1
"""Standard deviation (radians) of how far joints turn beyond their ranges."""
CORRECTED_SIGMA = 0.005
"""Standard deviation (metres of the body) of joint positions that the user has picked."""


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
        hessian[self.turns, self.turns] += self.turn_jacobian.T @ self.turn_jacobian / ROTATION_SIGMA**2
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
