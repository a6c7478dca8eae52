"""Keep hands and forearms of a moved identity where the driving's touch its own body, and out of the identity's body.

Both bodies have corresponding points (`body_grid`). Where points of the driving's hands and forearms are near its trunk,
head, legs or other arm, the identity's should be as near to the corresponding place, in units of the arm. Where they are
inside the identity though the driving's are not inside itself, they should be pushed out. Each arm follows by inverse
kinematics: shoulder and elbow turn, the hand keeps its direction. Two hands that meet go half-way each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_limbs import SIDES
from ..core.foot_planting import PosedJoints, falling, longest_reach, move_ankle
from ..core.geometry import unit_vectors
from ..core.joint_tracks import JointTrack
from ..core.skinning import SkinnedMesh
from .body_grid import ROWS, BodyGrid

CENTIMETRE = 1 / 53
"""Arm lengths: a person of 1.75 m has arms of 53 cm, from shoulder to wrist."""
TOUCHING = (2 * CENTIMETRE, 8 * CENTIMETRE)
"""Distances below which a point touches, and from which on it does not."""
SPREAD = 4 * CENTIMETRE
"""Standard deviation of the weights of points around the nearest one: the distance between points is about 6 cm."""
BETWEEN = 4 * CENTIMETRE
"""How far a surface may be from its nearest points."""
DEPTH = (1 * CENTIMETRE, 4 * CENTIMETRE)
"""Depths inside the body up to which points stay there, and from which on they are pushed out fully."""
MISSED = (0.1, 0.5)
"""Arm lengths: a place that the arm fails to reach by less is reached for, one by more is not."""
SECONDS = 0.05
"""Standard deviation of the Gaussian filter over corrections."""
ROUNDS = 3
"""How often corrections are found anew: points of an arm are not moved as its wrist is, and two hands meet."""
LEAST = 1e-6
"""Arm lengths: smaller corrections are none."""
MOVED = {"ForeArm": [1, 2, 3], "Hand": [0, 1, 3]}
"""Rings of forearms and hands whose points touch others: every second point of them."""


Surface = tuple[Float[np.ndarray, "T G 3"], Float[np.ndarray, "T G 3"]]
"""Points of a body in T frames, and their normals."""


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm of both bodies."""

    joints: tuple[int, ...]
    """The identity's shoulder, elbow and wrist."""
    points: Int[np.ndarray, " M"]
    """Points of hand and forearm that should touch what the driving's do."""
    others: Int[np.ndarray, " O"]
    """What they may touch: all points but those of the arm."""
    arm_from: int
    """From which of these on they are those of the other arm."""


@dataclass(frozen=True, eq=False)
class Places:
    """Where the points of an arm are over a surface in T frames."""

    shares: Float[np.ndarray, "T M O"]
    """Weights of the points of the surface, around the nearest one; rows sum to 1."""
    contact: Float[np.ndarray, "T M"]
    """1 of a point that touches, 0 of one that is away."""
    gap: Float[np.ndarray, "T M"]
    """Distance from the surface, negative inside (arm lengths)."""
    normal: Float[np.ndarray, "T M 3"]
    """Unit normal of the surface."""
    along: Float[np.ndarray, "T M 3"]
    """From the mean of the points of the surface (arm lengths)."""

    @classmethod
    def of(cls, surface: Surface, arm: Arm) -> Places:
        """Find the points of an arm on the surface."""
        points, (others, normals) = surface[0][:, arm.points], (array[:, arm.others] for array in surface)
        square = np.square(points).sum(axis=2)[..., None] + np.square(others).sum(axis=2)[:, None]
        square -= 2 * points @ others.swapaxes(1, 2)
        nearest = square.min(axis=2, keepdims=True)
        shares = np.exp((nearest - square) / np.float32(2 * SPREAD**2))
        shares /= shares.sum(axis=2, keepdims=True)
        gap, normal, along = _over(points, shares, others, normals)
        away = np.sqrt(np.maximum(nearest[..., 0], 0)) - BETWEEN
        return cls(shares, falling(np.maximum(gap, away), TOUCHING), gap, normal, along)


def _over(
    points: Float[np.ndarray, "T M 3"],
    shares: Float[np.ndarray, "T M O"],
    others: Float[np.ndarray, "T O 3"],
    normals: Float[np.ndarray, "T O 3"],
) -> tuple[Float[np.ndarray, "T M"], Float[np.ndarray, "T M 3"], Float[np.ndarray, "T M 3"]]:
    """Compute mean distance from the planes of a surface, its normal, and vector from the mean of its points."""
    planes = np.concatenate([others, normals, (others * normals).sum(axis=2, keepdims=True)], axis=2)
    mean = shares @ planes
    centre, normal, level = mean[..., :3], mean[..., 3:6], mean[..., 6]
    return (points * normal).sum(axis=2) - level, unit_vectors(normal), points - centre


@dataclass(frozen=True, eq=False)
class Contacts:
    """An identity whose arms keep the contacts of a driving."""

    driving: BodyGrid
    identity: BodyGrid
    arms: tuple[Arm, ...]
    skinned: SkinnedMesh
    """The identity."""

    @classmethod
    def of(
        cls, driving: BodyGrid | None, identity: BodyGrid | None, skinned: SkinnedMesh, arms: tuple[tuple[int, ...], ...]
    ) -> Contacts | None:
        """Find what both bodies have; None where that is no whole arm.

        Args:
            driving: points of the driving; None: its joints are not known well enough.
            identity: those of the identity.
            skinned: the identity.
            arms: its joints of each arm, from shoulder to wrist, those of them that it has.
        """
        if driving is None or identity is None:
            return None
        common = [part for part in driving.parts if part in identity.parts]
        limbs = [[part for part in common if part in _arm_parts(side)] for side in SIDES]
        body = [part for part in common if part not in sum(limbs, [])]
        driving, identity = (grid.chosen([*body, *limbs[0], *limbs[1]]) for grid in (driving, identity))
        cells = [identity.cells(parts) for parts in (body, *limbs)]
        whole = [k for k in range(len(SIDES)) if len(arms[k]) == len(limbs[k]) == len(_arm_parts(SIDES[k]))]
        found = tuple(
            Arm(
                arms[k],
                np.concatenate([identity.cells([part]).reshape(len(ROWS[own][1]), -1)[rings, ::2].ravel()
                                for own, rings in MOVED.items() for part in [SIDES[k] + own]]),
                np.concatenate([cells[0], cells[2 - k]]),
                len(cells[0]),
            )
            for k in whole
        )  # fmt: skip
        return cls(driving, identity, found, skinned) if found else None

    def kept(self, posed: PosedJoints, track: JointTrack) -> PosedJoints:
        """Correct the arms of a motion of the identity that follows the driving's `track`."""
        theirs = self.driving.posed(track.rotation, track.positions)
        places = [Places.of(theirs, arm) for arm in self.arms]
        positions = self.skinned.joint_positions(posed.rotation, posed.root)
        steps = np.zeros((len(self.arms), *posed.root.shape))
        rotation, smooth = posed.rotation, steps
        for _ in range(ROUNDS):
            mine = self.identity.posed(rotation, self.skinned.joint_positions(rotation, posed.root))
            steps = smooth + np.stack([_missing(mine, arm, of) for arm, of in zip(self.arms, places, strict=True)])
            smooth = np.stack([self._reached(positions, arm, step) for arm, step in zip(self.arms, steps, strict=True)])
            smooth = _smoothed(smooth, track.fps)
            rotation = self._moved(posed.rotation, positions, smooth)
        return PosedJoints(rotation, posed.root)

    def _reached(
        self, positions: Float[np.ndarray, "T J 3"], arm: Arm, step: Float[np.ndarray, "T 3"]
    ) -> Float[np.ndarray, "T 3"]:
        """Take back corrections that the arm is much too short for."""
        shoulder, _, wrist = (positions[:, j] / self.identity.arm for j in arm.joints)
        reach = longest_reach(positions, arm.joints)[:, 0] / self.identity.arm
        missed = np.linalg.norm(wrist + step - shoulder, axis=1) - reach
        return step * falling(missed, MISSED)[:, None]

    def _moved(
        self,
        rotation: Float[np.ndarray, "T J 3 3"],
        positions: Float[np.ndarray, "T J 3"],
        steps: Float[np.ndarray, "A T 3"],
    ) -> Float[np.ndarray, "T J 3 3"]:
        """Move the wrists; frames without a correction stay as they are to the last bit."""
        moved = rotation.copy()
        for arm, step in zip(self.arms, steps, strict=True):
            some = np.flatnonzero(np.linalg.norm(step, axis=1) > LEAST)
            if len(some):
                step = self.identity.arm * step[some]
                moved[some] = move_ankle(moved[some], positions[some], arm.joints, step, self.skinned.parents, -1.0)
        return moved


def _arm_parts(side: str) -> list[str]:
    return [f"{side}{part}" for part in ("Arm", "ForeArm", "Hand")]


def _missing(surface: Surface, arm: Arm, driving: Places) -> Float[np.ndarray, "T 3"]:
    """Compute how far the wrist of an identity has to move, from its surface and the places on the driving's."""
    points, (others, normals) = surface[0][:, arm.points], (array[:, arm.others] for array in surface)
    gap, normal, along = _over(points, driving.shares, others, normals)
    across = driving.along - along
    across -= (across * normal).sum(axis=2, keepdims=True) * normal
    step = (driving.gap - gap)[..., None] * normal + across
    step *= 1 - driving.shares[..., arm.arm_from :].sum(axis=2, keepdims=True) / 2  # two arms that meet go half-way
    own = Places.of(surface, arm)
    depth = np.maximum(-own.gap - np.maximum(-driving.gap, 0) - DEPTH[0], 0)
    push = np.minimum(depth / (DEPTH[1] - DEPTH[0]), 1)
    weight = np.square(driving.contact)
    total = (weight + push).sum(axis=1)[:, None]
    found = driving.contact.max(axis=1)[:, None] * (weight[..., None] * step).sum(axis=1)
    found += ((push * depth)[..., None] * own.normal).sum(axis=1)
    return found / np.maximum(total, 1e-9)


def _smoothed(steps: Float[np.ndarray, "A T 3"], fps: float) -> Float[np.ndarray, "A T 3"]:
    """Filter corrections over time."""
    from scipy.ndimage import gaussian_filter1d

    if steps.shape[1] == 1:
        return steps
    return gaussian_filter1d(steps, SECONDS * fps, axis=1, mode="nearest")
