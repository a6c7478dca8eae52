"""Keep hands and forearms of an identity where the driving's touch its body, and out of the identity's body.

Both bodies have corresponding points (`body_grid`). Where points of the driving's hands and forearms are near its
trunk, head, legs or other arm, the identity's should be as near to the corresponding place, in units of the arm, and
they should not be deeper inside its body than the driving's are. A few Gauss-Newton steps find for each frame and arm
how the wrist moves; shoulder and elbow follow by inverse kinematics, and the hand keeps its direction. Turning hands
and swivelling elbows as well changed next to nothing (docs/log/rigs.md).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

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
NEAR = 3 * CENTIMETRE
"""A point that is further away than the nearest one by this much counts less, by e."""
NEIGHBOURS = 9
"""Points, the nearest one included, that a place on a surface is among."""
SPREAD = 4 * CENTIMETRE
"""Standard deviation of the weights of points around the nearest one: the distance between points is about 6 cm."""
BETWEEN = 4 * CENTIMETRE
"""How far a surface may be from its nearest points."""
TOLERANCE = 0.5 * CENTIMETRE
"""How much deeper in the body points may be than the driving's."""
PUSH = 5.0
"""Weight of points that are too deep; that of all points that touch is 1."""
STIFFNESS = 0.02
"""Weight of the square of a correction (arm lengths)."""
SECONDS = 0.05
"""Standard deviation of the Gaussian filter over corrections."""
ROUNDS = 5
"""Gauss-Newton steps."""
FPS = 30
"""Frames a second for which corrections are found, about; others are interpolated: corrections are smooth."""
LEAST = (1 * CENTIMETRE, 2 * CENTIMETRE)
"""Corrections below the first are none: surfaces are known to about as much. From the second on they are whole."""
BLOCK = 128
"""Frames that are corrected at once: 6 MiB for distances."""
MOVED = {"ForeArm": [1, 2, 3], "Hand": [0, 1, 3]}
"""Rings of forearms and hands whose points touch others: every second point of them."""

Surface = Float[np.ndarray, "T G 6"]
"""Points of a body in T frames, and their normals."""
Corrections = Float[np.ndarray, "A T 3"]
"""Displacement of the wrist of each arm (arm lengths)."""


@dataclass(frozen=True, eq=False)
class Target:
    """Points of a body that an arm may touch."""

    points: Int[np.ndarray, " O"]
    """Which of the body's points these are."""
    beside: Int[np.ndarray, "O K"]
    """Those of the body's points nearest to each of these at rest, itself the first."""

    @classmethod
    def of(cls, points: Int[np.ndarray, " O"], rest: Float[np.ndarray, "G 3"]) -> Target:
        """Find the neighbours among some of a body's points."""
        from scipy.spatial import KDTree

        return cls(points, points[KDTree(rest[points]).query(rest[points], NEIGHBOURS)[1]])


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm of both bodies."""

    joints: tuple[int, ...]
    """The identity's shoulder, elbow and wrist."""
    points: Int[np.ndarray, " M"]
    """Points of forearm and hand that should touch what the driving's do."""
    share: Float[np.ndarray, " M"]
    """How far each goes with the wrist: 1 for those of the hand."""
    body: Target
    """Trunk, head and legs, which it should not be in: the first points of the body."""
    others: Target
    """What it may touch: these and the other arm."""


@dataclass(frozen=True, eq=False)
class Places:
    """Where the M points of an arm are over a surface in T frames."""

    around: Int[np.ndarray, "T M K"]
    """The points of the surface around the nearest one."""
    shares: Float[np.ndarray, "T M K"]
    """Their weights; rows sum to 1."""
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
    def of(cls, surface: Surface, arm: Arm, target: Target) -> Places:
        """Find the points of an arm on the surface."""
        points, others = surface[:, arm.points, :3], surface[:, target.points, :3]
        level = np.square(others).sum(axis=2, keepdims=True) / -2
        ones = np.ones_like(points[..., :1])
        # |p - o|^2 = |p|^2 - 2 (p o - |o|^2 / 2): the nearest point has the largest value in brackets.
        nearest = (
            np.concatenate([points, ones], axis=2) @ np.concatenate([others, level], axis=2).swapaxes(1, 2)
        ).argmax(axis=2)
        around = target.beside[nearest]
        square = np.square(points[:, :, None] - _rows(surface, around)[..., :3]).sum(axis=3)
        shares = np.exp((square[..., :1] - square) / np.float32(2 * SPREAD**2))
        shares /= shares.sum(axis=2, keepdims=True)
        gap, normal, along = _over(surface, arm, around, shares)
        contact = falling(np.maximum(gap, np.sqrt(square[..., 0]) - BETWEEN), TOUCHING)
        alone = 1 - (shares * (around >= len(arm.body.points))).sum(axis=2) / 2
        return cls(around, shares, contact, gap, normal, along, alone)

    def at(self, frames: Bool[np.ndarray, " T"]) -> Places:
        """Select frames."""
        return Places(**{field.name: getattr(self, field.name)[frames] for field in fields(self)})


def _rows(surface: Surface, index: Int[np.ndarray, "T M K"]) -> Float[np.ndarray, "T M K 6"]:
    """Select points of each frame."""
    start = np.arange(len(surface))[:, None, None] * surface.shape[1]
    return surface.reshape(-1, 6).take(start + index, axis=0)


def _over(
    surface: Surface, arm: Arm, around: Int[np.ndarray, "T M K"], shares: Float[np.ndarray, "T M K"]
) -> tuple[Float[np.ndarray, "T M"], Float[np.ndarray, "T M 3"], Float[np.ndarray, "T M 3"]]:
    """Compute distances from a surface, its unit normals, and vectors from the mean of its points.

    The distance is the mean of that from the planes of the points, which is too small over a convex surface, and of
    that from the plane of their mean, which is too large by as much.
    """
    rows = _rows(surface, around)
    offset = surface[:, arm.points, None, :3] - rows[..., :3]
    along, normal = (shares[:, :, None] @ offset)[:, :, 0], unit_vectors((shares[:, :, None] @ rows[..., 3:])[:, :, 0])
    gap = (shares * (offset * rows[..., 3:]).sum(axis=3)).sum(axis=2)
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
        body = [part for part in common if part not in {*limbs[0], *limbs[1]}]
        driving, identity = (grid.chosen([*body, *limbs[0], *limbs[1]]) for grid in (driving, identity))
        cells = [identity.cells(parts) for parts in (body, *limbs)]
        whole = [k for k in range(len(SIDES)) if len(arms[k]) == len(limbs[k]) == len(_arm_parts(SIDES[k]))]
        found = []
        for k in whole:
            targets = [
                Target.of(points, driving.rest) for points in (cells[0], np.concatenate([cells[0], cells[2 - k]]))
            ]
            found.append(Arm(arms[k], *_moved_points(identity, SIDES[k]), *targets))
        return cls(driving, identity, tuple(found), skinned) if found else None

    def kept(self, posed: PosedJoints, track: JointTrack, cyclic: bool) -> PosedJoints:
        """Correct the arms of a motion of the identity that follows the driving's `track`."""
        positions = self.skinned.joint_positions(posed.rotation, posed.root)
        count = len(positions)
        chosen = np.unique(np.append(np.arange(0, count, max(1, round(track.fps / FPS))), count - 1))
        found = np.zeros((len(self.arms), len(chosen), 3))
        for start in range(0, len(chosen), BLOCK):
            block = slice(start, start + BLOCK)
            frames = chosen[block]
            theirs = self.driving.posed(track.rotation[frames], track.positions[frames])
            found[:, block] = self._corrections(theirs, posed.rotation[frames], positions[frames])
        if count > 1:
            found = _smoothed(_between(found, chosen, count), track.fps, cyclic)
        some = found.any(axis=(0, 2))  # the other frames stay as they are to the last bit
        rotation = posed.rotation.copy()
        rotation[some] = self._moved(rotation[some], positions[some], found[:, some])
        return PosedJoints(rotation, posed.root)

    def _corrections(
        self, theirs: Surface, rotation: Float[np.ndarray, "T J 3 3"], positions: Float[np.ndarray, "T J 3"]
    ) -> Corrections:
        """Find the corrections of all arms in some frames."""
        places = [Places.of(theirs, arm, arm.others) for arm in self.arms]
        allowed = [np.maximum(-Places.of(theirs, arm, arm.body).gap, 0) + TOLERANCE for arm in self.arms]
        first = self.identity.posed(rotation, positions)
        found = np.zeros((len(self.arms), len(positions), 3))
        own = [Places.of(first, arm, arm.body) for arm in self.arms]
        deep = [np.maximum(-by.gap - most, 0) for by, most in zip(own, allowed, strict=True)]
        some = np.any([of.contact + depth for of, depth in zip(places, deep, strict=True)], axis=(0, 2))
        if not some.any():
            return found
        places, allowed = [of.at(some) for of in places], [most[some] for most in allowed]
        rotation, positions = rotation[some], positions[some]
        first, steps = first[some], found[:, some]
        now = first
        for _ in range(ROUNDS):
            for k, (arm, of) in enumerate(zip(self.arms, places, strict=True)):
                steps[k] = self._within_reach(
                    positions, arm, steps[k] + _step(first, now, arm, of, allowed[k], steps[k])
                )
            turned = self._moved(rotation, positions, steps)
            now = self.identity.posed(turned, self.skinned.joint_positions(turned, positions[:, 0]))
        found[:, some] = steps * (1 - falling(np.linalg.norm(steps, axis=2, keepdims=True), LEAST))
        return found

    def _within_reach(
        self, positions: Float[np.ndarray, "T J 3"], arm: Arm, steps: Float[np.ndarray, "T 3"]
    ) -> Float[np.ndarray, "T 3"]:
        """Move wrists that are too far away to the nearest place that the arm reaches."""
        shoulder, _, wrist = (positions[:, j] / self.identity.arm for j in arm.joints)
        line = wrist + steps - shoulder
        reach = longest_reach(positions, arm.joints) / self.identity.arm
        line *= np.minimum(1, reach / np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-9))
        return shoulder + line - wrist

    def _moved(
        self, rotation: Float[np.ndarray, "T J 3 3"], positions: Float[np.ndarray, "T J 3"], found: Corrections
    ) -> Float[np.ndarray, "T J 3 3"]:
        """Move wrists."""
        for arm, steps in zip(self.arms, found, strict=True):
            step = self.identity.arm * steps
            rotation = move_ankle(rotation, positions, arm.joints, step, self.skinned.parents, -1.0)
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


def _step(
    first: Surface,
    now: Surface,
    arm: Arm,
    driving: Places,
    allowed: Float[np.ndarray, "T M"],
    found: Float[np.ndarray, "T 3"],
) -> Float[np.ndarray, "T 3"]:
    """Compute a Gauss-Newton step of the displacement of a wrist.

    Minimises the weighted squares of distances of touching points from their targets, of depths that are too large, and
    of the displacement.

    Args:
        first: the identity before any correction.
        now: the identity with the correction found so far.
        arm: the arm.
        driving: its points on the driving.
        allowed: how deep its points may be in the body.
        found: the correction so far.
    """
    own = Places.of(now, arm, arm.body)
    points = now[:, arm.points, :3]
    gap, normal, along = _over(now, arm, driving.around, driving.shares)
    target = driving.along - along
    target += ((driving.gap - gap) - (target * normal).sum(axis=2))[..., None] * normal
    contact = driving.contact[..., None]
    target = contact * target + (1 - contact) * (first[:, arm.points, :3] - points)
    weight = driving.contact * np.exp((driving.gap.min(axis=1, keepdims=True) - driving.gap) / NEAR)
    total = np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
    weight *= driving.contact.max(axis=1, keepdims=True) / total
    depth = np.maximum(-own.gap - allowed, 0)
    push = PUSH / len(arm.points) * (depth > 0)
    # A point moves by its share of the displacement.
    pushed = (push * arm.share**2)[..., None] * own.normal
    diagonal = (weight * arm.share**2).sum(axis=1) + STIFFNESS
    matrix = diagonal[:, None, None] * np.eye(3) + pushed.swapaxes(1, 2) @ own.normal
    side = ((weight * arm.share * driving.alone)[..., None] * target).sum(axis=1) - STIFFNESS * found
    side += ((push * arm.share * depth)[..., None] * own.normal).sum(axis=1)
    return np.linalg.solve(matrix, side[..., None])[..., 0]


def _between(found: Float[np.ndarray, "A K 3"], chosen: Int[np.ndarray, " K"], count: int) -> Corrections:
    """Interpolate corrections of chosen frames, the first and the last of `count` included, linearly to all."""
    if len(chosen) == count:
        return found
    after = np.searchsorted(chosen, np.arange(count)).clip(1)
    share = ((np.arange(count) - chosen[after - 1]) / (chosen[after] - chosen[after - 1]))[:, None]
    return (1 - share) * found[:, after - 1] + share * found[:, after]


def _smoothed(found: Corrections, fps: float, cyclic: bool) -> Corrections:
    """Filter corrections over time."""
    from scipy.ndimage import gaussian_filter1d

    if not cyclic:
        return gaussian_filter1d(found, SECONDS * fps, axis=1, mode="nearest")
    period = gaussian_filter1d(
        found[:, :-1], SECONDS * fps, axis=1, mode="wrap"
    )  # the last frame is the first one again
    return np.concatenate([period, period[:, :1]], axis=1)
