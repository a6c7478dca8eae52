"""Keep hands and forearms of a moved identity where the driving's touch its own body, and out of the identity's body.

Both bodies have corresponding points (`body_grid`). Where points of the driving's hands and forearms are near its trunk,
head, legs or other arm, the identity's should be as near to the corresponding place, in units of the arm, and they should
not be deeper inside its body than the driving's are. A few Gauss-Newton steps find for each frame and arm how the wrist
moves, the hand turns and the elbow swivels about the line from shoulder to wrist. The arm follows by inverse kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from ..bodies.character_limbs import SIDES
from ..bodies.sampling import rotvec_to_rotmat
from ..core.foot_planting import PosedJoints, falling, longest_reach, move_ankle
from ..core.geometry import unit_vectors
from ..core.joint_tracks import JointTrack
from ..core.rig import descendants
from ..core.skinning import SkinnedMesh
from .body_grid import ROWS, BodyGrid

CENTIMETRE = 1 / 53
"""Arm lengths: a person of 1.75 m has arms of 53 cm, from shoulder to wrist."""
TOUCHING = (2 * CENTIMETRE, 8 * CENTIMETRE)
"""Distances below which a point touches, and from which on it does not."""
NEAR = 2 * CENTIMETRE
"""A point that is further away than the nearest one by this much counts less, by e."""
SPREAD = 4 * CENTIMETRE
"""Standard deviation of the weights of points around the nearest one: the distance between points is about 6 cm."""
BETWEEN = 4 * CENTIMETRE
"""How far a surface may be from its nearest points."""
DEEPEST, TOLERANCE = 1 * CENTIMETRE, 0.5 * CENTIMETRE
"""How deep points may be inside the body where the driving's are; what they may be deeper than the driving's."""
PUSH = 2.0
"""Weight of points that are too deep; that of all points that touch is 1."""
STIFFNESS = np.array([0.02] * 3 + [0.01] * 3 + [0.01])
"""Weights of the squares of a correction: displacement (arm lengths), turn of the hand and swivel of the elbow (radians)."""
MISSED = (0.1, 0.5)
"""Arm lengths: a place that the arm fails to reach by less is reached for, one by more is not."""
SECONDS = 0.05
"""Standard deviation of the Gaussian filter over corrections."""
ROUNDS = 4
"""Gauss-Newton steps."""
LEAST = 1e-6
"""Smaller corrections are none."""
BLOCK = 128
"""Frames that are corrected at once: 10 MiB for each array of distances."""
MOVED = {"ForeArm": [1, 2, 3], "Hand": [0, 1, 3]}
"""Rings of forearms and hands whose points touch others: every second point of them."""

Surface = tuple[Float[np.ndarray, "T G 3"], Float[np.ndarray, "T G 3"]]
"""Points of a body in T frames, and their normals."""
Corrections = Float[np.ndarray, "A T 7"]
"""Of each arm: displacement of the wrist (arm lengths), turn of the hand (rotation vector), swivel of the elbow (radians)."""


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm of both bodies."""

    joints: tuple[int, ...]
    """The identity's shoulder, elbow and wrist."""
    points: Int[np.ndarray, " M"]
    """Points of forearm and hand that should touch what the driving's do."""
    share: Float[np.ndarray, " M"]
    """How far each goes with the wrist: 1 for those of the hand."""
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
    alone: Float[np.ndarray, "T M"]
    """1, less half of what the weights of the other arm are: two arms that meet go half-way each."""

    @classmethod
    def of(cls, surface: Surface, arm: Arm) -> Places:
        """Find the points of an arm on the surface."""
        points, others = surface[0][:, arm.points], surface[0][:, arm.others]
        square = np.square(points).sum(axis=2)[..., None] + np.square(others).sum(axis=2)[:, None]
        square -= 2 * points @ others.swapaxes(1, 2)
        nearest = square.min(axis=2, keepdims=True)
        shares = np.exp((nearest - square) / np.float32(2 * SPREAD**2))
        shares /= shares.sum(axis=2, keepdims=True)
        gap, normal, along = _over(surface, arm, shares)
        away = np.sqrt(np.maximum(nearest[..., 0], 0)) - BETWEEN
        alone = 1 - shares[..., arm.arm_from :].sum(axis=2) / 2
        return cls(shares, falling(np.maximum(gap, away), TOUCHING), gap, normal, along, alone)

    def at(self, frames: Bool[np.ndarray, " T"]) -> Places:
        """Select frames."""
        arrays = (self.shares, self.contact, self.gap, self.normal, self.along, self.alone)
        return Places(*(array[frames] for array in arrays))


def _over(
    surface: Surface, arm: Arm, shares: Float[np.ndarray, "T M O"]
) -> tuple[Float[np.ndarray, "T M"], Float[np.ndarray, "T M 3"], Float[np.ndarray, "T M 3"]]:
    """Compute distances from a surface, its unit normals, and vectors from the mean of its points.

    The distance is the mean of that from the planes of the points, which is too small over a convex surface, and of that
    from the plane of their mean, which is too large by as much.
    """
    points, (others, normals) = surface[0][:, arm.points], (array[:, arm.others] for array in surface)
    planes = np.concatenate([others, normals, (others * normals).sum(axis=2, keepdims=True)], axis=2)
    mean = shares @ planes
    along, normal = points - mean[..., :3], unit_vectors(mean[..., 3:6])
    gap = (points * mean[..., 3:6]).sum(axis=2) - mean[..., 6]
    return (gap + (along * normal).sum(axis=2)) / 2, normal, along


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
        cls,
        driving: BodyGrid | None,
        identity: BodyGrid | None,
        skinned: SkinnedMesh,
        arms: tuple[tuple[int, ...], ...],
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
        found = []
        for k in whole:
            others = np.concatenate([cells[0], cells[2 - k]])
            found.append(Arm(arms[k], *_moved_points(identity, SIDES[k]), others, len(cells[0])))
        return cls(driving, identity, tuple(found), skinned) if found else None

    def kept(self, posed: PosedJoints, track: JointTrack, cyclic: bool) -> PosedJoints:
        """Correct the arms of a motion of the identity that follows the driving's `track`."""
        positions = self.skinned.joint_positions(posed.rotation, posed.root)
        found = np.zeros((len(self.arms), len(positions), 7))
        for start in range(0, len(positions), BLOCK):
            block = slice(start, start + BLOCK)
            theirs = self.driving.posed(track.rotation[block], track.positions[block])
            found[:, block] = self._corrections(theirs, posed.rotation[block], positions[block])
        if len(positions) > 1:
            found = _smoothed(found, track.fps, cyclic)
        some = (np.abs(found) > LEAST).any(axis=(0, 2))  # the other frames stay as they are to the last bit
        rotation = posed.rotation.copy()
        rotation[some] = self._moved(rotation[some], positions[some], found[:, some])
        return PosedJoints(rotation, posed.root)

    def _corrections(
        self, theirs: Surface, rotation: Float[np.ndarray, "T J 3 3"], positions: Float[np.ndarray, "T J 3"]
    ) -> Corrections:
        """Find the corrections of all arms in some frames."""
        places = [Places.of(theirs, arm) for arm in self.arms]
        first = self.identity.posed(rotation, positions)
        found = np.zeros((len(self.arms), len(positions), 7))
        own = [Places.of(first, arm) for arm in self.arms]
        some = np.any(
            [
                (of.contact > 0).any(axis=1) | (_too_deep(by, of) > 0).any(axis=1)
                for of, by in zip(places, own, strict=True)
            ],
            axis=0,
        )
        if not some.any():
            return found
        places, rotation, positions = [of.at(some) for of in places], rotation[some], positions[some]
        first, steps = (first[0][some], first[1][some]), found[:, some]
        now, turned = first, rotation
        for _ in range(ROUNDS):
            joints = self.skinned.joint_positions(turned, positions[:, 0])
            joints = (joints - joints[:, :1]) / self.identity.arm
            for k, (arm, of) in enumerate(zip(self.arms, places, strict=True)):
                steps[k] += _step(first, now, arm, of, joints, steps[k])
                steps[k] = self._within_reach(positions, arm, steps[k])
            turned = self._moved(rotation, positions, steps)
            now = self.identity.posed(turned, self.skinned.joint_positions(turned, positions[:, 0]))
        found[:, some] = steps
        return found

    def _within_reach(
        self, positions: Float[np.ndarray, "T J 3"], arm: Arm, steps: Float[np.ndarray, "T 7"]
    ) -> Float[np.ndarray, "T 7"]:
        """Move wrists that are too far away to the nearest place that the arm reaches."""
        shoulder, _, wrist = (positions[:, j] / self.identity.arm for j in arm.joints)
        line = wrist + steps[:, :3] - shoulder
        reach = longest_reach(positions, arm.joints) / self.identity.arm
        line *= np.minimum(1, reach / np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-9))
        return np.concatenate([shoulder + line - wrist, steps[:, 3:]], axis=1)

    def _moved(
        self, rotation: Float[np.ndarray, "T J 3 3"], positions: Float[np.ndarray, "T J 3"], found: Corrections
    ) -> Float[np.ndarray, "T J 3 3"]:
        """Move wrists, swivel elbows, turn hands."""
        parents = self.skinned.parents
        for arm, steps in zip(self.arms, found, strict=True):
            before, step = rotation, self.identity.arm * steps[:, :3]
            rotation = move_ankle(before, positions, arm.joints, step, parents, -1.0)
            upper, hand = (descendants([arm.joints[k]], parents) for k in (0, 2))
            axis = unit_vectors(positions[:, arm.joints[2]] + step - positions[:, arm.joints[0]])
            rotation[:, upper] = rotvec_to_rotmat(steps[:, 6:] * axis)[:, None] @ rotation[:, upper]
            rotation[:, hand] = rotvec_to_rotmat(steps[:, 3:6])[:, None] @ before[:, hand]
        return rotation


def _arm_parts(side: str) -> list[str]:
    return [f"{side}{part}" for part in ("Arm", "ForeArm", "Hand")]


def _moved_points(grid: BodyGrid, side: str) -> tuple[Int[np.ndarray, " M"], Float[np.ndarray, " M"]]:
    """Return the points of an arm that touch others, and how far each goes with the wrist."""
    points, shares = [], []
    for part, rings in MOVED.items():
        count, rows = ROWS[part]
        some = grid.cells([side + part]).reshape(len(rows), count)[rings, ::2]
        points.append(some.ravel())
        # The elbow goes half as far as the wrist, on average.
        share = [(1 + rows[ring][0]) / 2 if part == "ForeArm" else 1.0 for ring in rings]
        shares.append(np.repeat(share, some.shape[1]))
    return np.concatenate(points), np.concatenate(shares)


def _too_deep(own: Places, driving: Places) -> Float[np.ndarray, "T M"]:
    """Compute how much deeper points are inside the identity than they may be."""
    return np.maximum(-own.gap - np.clip(-driving.gap, 0, DEEPEST) - TOLERANCE, 0)


def _step(
    first: Surface,
    now: Surface,
    arm: Arm,
    driving: Places,
    joints: Float[np.ndarray, "T J 3"],
    found: Float[np.ndarray, "T 7"],
) -> Float[np.ndarray, "T 7"]:
    """Compute a Gauss-Newton step of the correction of an arm.

    Args:
        first: the identity before any correction.
        now: the identity with the correction found so far.
        arm: the arm.
        driving: its points on the driving.
        joints: the identity's joints now.
        found: the correction so far.
    """
    own = Places.of(now, arm)
    points = now[0][:, arm.points]
    gap, normal, along = _over(now, arm, driving.shares)
    target = driving.along - along
    target += ((np.maximum(driving.gap, -DEEPEST) - gap) - (target * normal).sum(axis=2))[..., None] * normal
    contact = driving.contact[..., None]
    target = contact * target + (1 - contact) * (first[0][:, arm.points] - points)
    weight = driving.contact * np.exp((driving.gap.min(axis=1, keepdims=True) - driving.gap) / NEAR)
    weight *= driving.contact.max(axis=1, keepdims=True) / np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
    depth = _too_deep(own, driving)
    push = PUSH / len(arm.points) * (depth > 0)
    jacobian = _jacobian(points, arm, joints)
    frames = len(points)
    pushed = (own.normal[..., None, :] @ jacobian)[..., 0, :]
    jacobian, target = jacobian.reshape(frames, -1, 7), (target * driving.alone[..., None]).reshape(frames, -1, 1)
    left = np.concatenate([np.repeat(weight, 3, axis=1)[..., None] * jacobian, push[..., None] * pushed], axis=1)
    left = left.swapaxes(1, 2)
    matrix = left @ np.concatenate([jacobian, pushed], axis=1) + np.diag(STIFFNESS)
    side = left @ np.concatenate([target, (depth * own.alone)[..., None]], axis=1) - (STIFFNESS * found)[..., None]
    return np.linalg.solve(matrix, side)[..., 0]


def _jacobian(
    points: Float[np.ndarray, "T M 3"], arm: Arm, joints: Float[np.ndarray, "T J 3"]
) -> Float[np.ndarray, "T M 3 7"]:
    """Compute how points of an arm move with its correction."""
    shoulder, _, wrist = (joints[:, None, j] for j in arm.joints)
    hand = arm.share == 1
    x, y, z = np.moveaxis(np.where(hand[:, None], points - wrist, 0), 2, 0)
    found = np.zeros((*points.shape, 7))
    found[..., [0, 1, 2], [0, 1, 2]] = arm.share[:, None]
    found[..., [0, 1, 2], [4, 5, 3]] = np.stack([z, x, y], axis=2)  # turn x (point - wrist)
    found[..., [0, 1, 2], [5, 3, 4]] = -np.stack([y, z, x], axis=2)
    found[..., 6] = np.where(hand[:, None], 0, np.cross(unit_vectors(wrist - shoulder), points - shoulder))
    return found


def _smoothed(found: Corrections, fps: float, cyclic: bool) -> Corrections:
    """Filter corrections over time."""
    from scipy.ndimage import gaussian_filter1d

    if not cyclic:
        return gaussian_filter1d(found, SECONDS * fps, axis=1, mode="nearest")
    period = gaussian_filter1d(
        found[:, :-1], SECONDS * fps, axis=1, mode="wrap"
    )  # the last frame is the first one again
    return np.concatenate([period, period[:, :1]], axis=1)
