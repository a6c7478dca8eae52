"""Keep hands and forearms of an identity where the driving's touch its body, and out of the identity's body.

Both bodies have corresponding points (`body_grid`). Where points of the driving's hands and forearms are near its
trunk, head, legs or other arm, the identity's should be as near to the corresponding place, in units of the arm, and
they should not be deeper inside its body than the driving's are. For each frame and arm, least squares find how the
wrist moves; shoulder and elbow follow by inverse kinematics, and the hand keeps its direction. Turning hands and
swivelling elbows as well changed next to nothing (docs/log/rigs.md). Bodies of the same shape move nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_limbs import SIDES
from ..core.foot_planting import PosedJoints, falling, longest_reach, move_ankle
from ..core.joint_tracks import JointTrack
from ..core.skinning import SkinnedMesh
from .body_grid import ROWS, BodyGrid

CENTIMETRE = 1 / 53
"""Arm lengths: a person of 1.75 m has arms of 53 cm, from shoulder to wrist."""
SAME = (0.8 * CENTIMETRE, 1.6 * CENTIMETRE)
"""Difference of two bodies (`difference`) below which they are the same, as far as surfaces are known: nothing moves.
From the second on corrections are whole."""
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
PUSH = 10.0
"""Weight of points that are too deep; that of all points that touch is 1."""
STIFFNESS = 0.02
"""Weight of the square of a correction (arm lengths)."""
SECONDS = 0.05
"""Standard deviation of the Gaussian filter over corrections."""
ROUNDS = 2
"""Times that points that are too deep are looked for."""
FPS = 30
"""Frames a second for which corrections are found, about; others are interpolated: corrections are smooth."""
BLOCK = 32
"""Frames that are corrected at once: their distances stay in the processor's cache."""
LEAST = (0.3 * CENTIMETRE, 0.6 * CENTIMETRE)
"""Corrections below the first are none: surfaces are known to about as much. From the second on they are whole."""
MOVED = {"ForeArm": [1, 2, 3], "Hand": [0, 1, 3]}
"""Rings of forearms and hands whose points touch others: every second point of them."""

Surface = Float[np.ndarray, "6 T G"]
"""Points of a body in T frames, and their normals: coordinates come first, as sums over long last axes are faster."""
Corrections = Float[np.ndarray, "A T 3"]
"""Displacement of the wrist of each arm (arm lengths)."""


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm of both bodies."""

    joints: tuple[int, ...]
    """The identity's shoulder, elbow and wrist."""
    points: Int[np.ndarray, " M"]
    """Points of forearm and hand that should touch what the driving's do."""
    others: Int[np.ndarray, " O"]
    """Points that it may touch: trunk, head and legs, which it should not be in, then the other arm."""
    body: int
    """How many of these are trunk, head and legs: the first points of a body."""


@dataclass(frozen=True, eq=False)
class Places:
    """Where the M points of an arm are over a surface in T frames."""

    around: Int[np.ndarray, "K T M"]
    """Points of the surface around each."""
    nearest: Int[np.ndarray, "T M"]
    """The nearest one of them."""
    away: Float[np.ndarray, "T M"]
    """How far away it is (arm lengths)."""
    shares: Float[np.ndarray, "K T M"]
    """Weights of the points around; columns sum to 1."""
    gap: Float[np.ndarray, "T M"]
    """Distance from the surface, negative inside (arm lengths)."""
    normal: Float[np.ndarray, "3 T M"]
    """Unit normal of the surface."""
    along: Float[np.ndarray, "3 T M"]
    """From the mean of the points of the surface (arm lengths)."""

    @classmethod
    def over(
        cls,
        surface: Surface,
        points: Float[np.ndarray, "3 T M"],
        around: Int[np.ndarray, "K T M"],
        shares: Float[np.ndarray, "K T M"] | None = None,
    ) -> Places:
        """Compute where points are over those of a surface around them.

        The distance is the mean of that from the planes of the points, which is too small over a convex surface, and of
        that from the plane of their mean, which is too large by as much.

        Args:
            shares: weights; None: they fall with the distance.
        """
        _, frames, count = surface.shape
        rows = surface.reshape(6, -1).take(around + count * np.arange(frames)[:, None], axis=1)
        offset, normals = points[:, None] - rows[:3], rows[3:]
        square = np.square(offset).sum(axis=0)
        least = square.min(axis=0)
        falls = np.exp((least - square) / np.float32(2 * SPREAD**2))
        weights = falls / falls.sum(axis=0) if shares is None else shares
        nearest = np.take_along_axis(around, square.argmin(axis=0)[None], axis=0)[0]
        along, normal = (weights * offset).sum(axis=1), (weights * normals).sum(axis=1)
        normal /= np.maximum(np.sqrt(np.square(normal).sum(axis=0)), 1e-12)
        gap = (weights * (offset * normals).sum(axis=0)).sum(axis=0) + (along * normal).sum(axis=0)
        return cls(around, nearest, np.sqrt(least), weights, gap / 2, normal, along)


@dataclass(frozen=True, eq=False)
class Pull:
    """What the contacts of an arm ask for, in T frames."""

    takes: Float[np.ndarray, "T A M"]
    """How far each of its points goes with the wrist of each arm, relative to what it touches."""
    goal: Float[np.ndarray, "3 T M"]
    """How far it should go (arm lengths)."""
    weight: Float[np.ndarray, "T M"]
    """How much this counts."""
    allowed: Float[np.ndarray, "T M"]
    """How deep it may be in the body (arm lengths)."""
    inside: Int[np.ndarray, "T M"]
    """The nearest point of the body, before it goes."""


@dataclass(frozen=True, eq=False)
class Contacts:
    """An identity whose arms keep the contacts of a driving."""

    driving: BodyGrid
    identity: BodyGrid
    arms: tuple[Arm, ...]
    beside: Int[np.ndarray, "K G"]
    """The points nearest to each point at rest, itself the first: of the body, or of its arm."""
    takes: Float[np.ndarray, "A G"]
    """How far each point goes with the wrist of each arm: 1 for those of the hand."""
    strength: float
    """0 of bodies that are the same, 1 of those that surely differ."""
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
        """Find what both bodies have; None where that is no whole arm, and where the bodies are the same.

        Args:
            driving: points of the driving; None: its joints are not known well enough.
            identity: those of the identity.
            skinned: the identity.
            arms: its joints of each arm, from shoulder to wrist, those of them that it has.
        """
        from scipy.spatial import KDTree

        if driving is None or identity is None:
            return None
        common = [part for part in driving.parts if part in identity.parts]
        if "Trunk" not in common:
            return None
        strength = 1 - float(falling(np.array([difference(driving, identity, common)]), SAME)[0])
        limbs = [[f"{side}{part}" for part in ("Arm", "ForeArm", "Hand")] for side in SIDES]
        body = [part for part in common if part not in {*limbs[0], *limbs[1]}]
        limbs = [limb if len(arms[k]) == 3 and set(limb) <= set(common) else [] for k, limb in enumerate(limbs)]
        if not strength or not any(limbs):
            return None
        driving, identity = (grid.chosen([*body, *limbs[0], *limbs[1]]) for grid in (driving, identity))
        cells = [identity.cells(parts) for parts in (body, *limbs)]
        beside = [of[KDTree(driving.rest[of]).query(driving.rest[of], NEIGHBOURS)[1]] for of in cells]
        whole = [k for k in range(len(SIDES)) if limbs[k]]
        takes = np.stack([_takes(identity, SIDES[k]) for k in whole])
        found = tuple(
            Arm(arms[k], _moved_points(identity, SIDES[k]), np.concatenate([cells[0], cells[2 - k]]), len(cells[0]))
            for k in whole
        )
        return cls(driving, identity, found, np.concatenate(beside).T.copy(), takes, strength, skinned)

    def kept(self, posed: PosedJoints, track: JointTrack, cyclic: bool) -> PosedJoints:
        """Correct the arms of a motion of the identity that follows the driving's `track`."""
        positions = self.skinned.joint_positions(posed.rotation, posed.root)
        count = len(positions)
        chosen = np.unique(np.append(np.arange(0, count, max(1, round(track.fps / FPS))), count - 1))
        found = np.zeros((len(self.arms), len(chosen), 3))
        # Spheres around rings tell where arms of the driving may touch, or the identity's be inside.
        their_rings = self.driving.spheres(track.rotation[chosen], track.positions[chosen])
        own_rings = self.identity.spheres(posed.rotation[chosen], positions[chosen])
        near = np.zeros(len(chosen), bool)
        for grid, centres, apart in ((self.driving, their_rings, TOUCHING[1]), (self.identity, own_rings, 0.0)):
            for arm in self.arms:
                rings, others = (np.unique(grid.ring[points]) for points in (arm.points, arm.others))
                reach = grid.radius[rings][:, None] + grid.radius[others] + apart
                offset = centres[:, rings, None] - centres[:, None, others]
                near |= (np.square(offset).sum(axis=3) < reach**2).any(axis=(1, 2))
        near = np.flatnonzero(near)
        for start in range(0, len(near), BLOCK):
            block = near[start : start + BLOCK]
            frames = chosen[block]
            theirs = self.driving.posed(track.rotation[frames], track.positions[frames])
            own = self.identity.posed(posed.rotation[frames], positions[frames])
            found[:, block] = self._corrections(theirs, own, positions[frames])
        if not found.any():
            return posed
        if count > 1:
            found = _smoothed(_between(found, chosen, count), track.fps, cyclic)
        some = found.any(axis=(0, 2))  # the other frames stay as they are to the last bit
        rotation = posed.rotation[some]
        for arm, steps in zip(self.arms, self.identity.arm * found[:, some], strict=True):
            rotation = move_ankle(rotation, positions[some], arm.joints, steps, self.skinned.parents, -1.0)
        moved = posed.rotation.copy()
        moved[some] = rotation
        return PosedJoints(moved, posed.root)

    def _corrections(self, theirs: Surface, own: Surface, positions: Float[np.ndarray, "T J 3"]) -> Corrections:
        """Find the displacements of the identity's wrists.

        They minimise the weighted squares of distances of touching points from their goals, of depths that are too
        large, and of the displacements, of which each point takes its share.
        """
        pulls, count = [self._pull(arm, theirs, own) for arm in self.arms], len(self.arms)
        weighted = [of.takes * of.weight[:, None] for of in pulls]
        both = list(zip(weighted, pulls, strict=True))
        square = STIFFNESS * np.eye(count) + np.sum([w @ of.takes.swapaxes(1, 2) for w, of in both], axis=0)
        side = np.sum([w @ np.moveaxis(of.goal, 0, 2) for w, of in both], axis=0)
        steps = self._within_reach(positions, np.linalg.solve(square, side))
        square = (square[:, :, None, :, None] * np.eye(3)[:, None]).reshape(-1, 3 * count, 3 * count)
        inside = [of.inside for of in pulls]
        for _ in range(ROUNDS):
            matrix, right = square.copy(), side.copy()
            for k, (arm, of) in enumerate(zip(self.arms, pulls, strict=True)):
                share, step = self.takes[k, arm.points], steps[:, k].T[..., None]
                moved = own[:3, :, arm.points] + (share * step).astype(np.float32)
                at = Places.over(own, moved, self.beside[:, inside[k]])
                inside[k] = at.nearest
                depth = np.maximum(-at.gap - of.allowed, 0)
                normal = share * at.normal
                pushed = PUSH / len(share) * (depth > 0) * normal
                block = slice(3 * k, 3 * k + 3)
                matrix[:, block, block] += np.einsum("itm,jtm->tij", pushed, normal)
                # Depths are those after the step so far, which is part of the one that is looked for.
                right[:, k] += np.einsum("itm,tm->ti", pushed, depth + (normal * step).sum(axis=0))
            steps = np.linalg.solve(matrix, right.reshape(-1, 3 * count, 1)).reshape(-1, count, 3)
            steps = self._within_reach(positions, steps)
        steps *= 1 - falling(np.linalg.norm(steps, axis=2, keepdims=True), LEAST)
        return self.strength * steps.swapaxes(0, 1)

    def _pull(self, arm: Arm, theirs: Surface, own: Surface) -> Pull:
        points = theirs[:3, :, arm.points]
        nearest, inside = _nearest(theirs, points, arm.others, arm.body)
        touched = Places.over(theirs, points, self.beside[:, nearest])
        entered = Places.over(theirs, points, self.beside[:, inside])
        points = own[:3, :, arm.points]
        inside = _nearest(own, points, arm.others[: arm.body], arm.body)[1]
        now = Places.over(own, points, touched.around, touched.shares)
        goal = touched.along - now.along
        goal += (touched.gap - now.gap - (goal * now.normal).sum(axis=0)) * now.normal
        contact = falling(np.maximum(touched.gap, touched.away - BETWEEN), TOUCHING)
        weight = contact * np.exp((touched.gap.min(axis=1, keepdims=True) - touched.gap) / NEAR)
        weight *= contact.max(axis=1, keepdims=True) / np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
        takes = self.takes[:, None, arm.points] - (touched.shares * self.takes[:, touched.around]).sum(axis=1)
        return Pull(takes.swapaxes(0, 1), contact * goal, weight, np.maximum(-entered.gap, 0) + TOLERANCE, inside)

    def _within_reach(
        self, positions: Float[np.ndarray, "T J 3"], steps: Float[np.ndarray, "T A 3"]
    ) -> Float[np.ndarray, "T A 3"]:
        """Move wrists that are too far away to the nearest place that the arm reaches."""
        shoulder, wrist = (np.stack([positions[:, arm.joints[j]] for arm in self.arms], axis=1) for j in (0, -1))
        reach = np.stack([longest_reach(positions, arm.joints) for arm in self.arms], axis=1)
        line = (wrist - shoulder) / self.identity.arm + steps
        length = np.linalg.norm(line, axis=2, keepdims=True)
        return steps + (np.minimum(1, reach / self.identity.arm / np.maximum(length, 1e-9)) - 1) * line


def difference(driving: BodyGrid, identity: BodyGrid, parts: list[str]) -> float:
    """Measure how far two surfaces are apart in a T-pose, in the part but hands where that is most (arm lengths)."""
    grids = [(grid.rest - grid.rest[grid.parts["Trunk"]].mean(axis=0)) / grid.arm for grid in (driving, identity)]
    apart = [
        grids[0][driving.parts[part]] - grids[1][identity.parts[part]] for part in parts if not part.endswith("Hand")
    ]
    return max(float(np.sqrt(np.square(of).sum(axis=1).mean())) for of in apart)


def _nearest(
    surface: Surface, points: Float[np.ndarray, "3 T M"], others: Int[np.ndarray, " O"], body: int
) -> tuple[Int[np.ndarray, "T M"], Int[np.ndarray, "T M"]]:
    """Find the nearest of some of a surface's points, and the nearest of the first `body` of them."""
    targets = surface[:3, :, others]
    level = np.square(targets).sum(axis=0, keepdims=True) / -2
    # |p - o|^2 = |p|^2 - 2 (p o - |o|^2 / 2): the nearest point has the largest value in brackets.
    points = np.concatenate([points, np.ones_like(points[:1])]).transpose(1, 2, 0)
    value = points @ np.concatenate([targets, level]).swapaxes(0, 1)
    inside = value[..., :body].argmax(axis=2)
    return inside if len(others) == body else others[value.argmax(axis=2)], inside


def _moved_points(grid: BodyGrid, side: str) -> Int[np.ndarray, " M"]:
    rings = (grid.cells([side + part]).reshape(-1, ROWS[part][0])[rows, ::2] for part, rows in MOVED.items())
    return np.concatenate([ring.ravel() for ring in rings])


def _takes(grid: BodyGrid, side: str) -> Float[np.ndarray, " G"]:
    """Return how far points go with the wrist of an arm; its elbow goes half as far, on average."""
    takes = np.zeros(len(grid.rest))
    for part, (start, end) in {"Arm": (0, 0.5), "ForeArm": (0.5, 1), "Hand": (1, 1)}.items():
        count, rows = ROWS[part]
        takes[grid.parts[side + part]] = np.repeat([start + (end - start) * at for at, _ in rows], count)
    return takes


def _between(found: Float[np.ndarray, "A K 3"], chosen: Int[np.ndarray, " K"], count: int) -> Corrections:
    """Interpolate corrections of chosen frames, the first and the last of `count` included, linearly to all."""
    if len(chosen) == count:
        return found
    after = np.searchsorted(chosen, np.arange(count)).clip(1)
    share = ((np.arange(count) - chosen[after - 1]) / (chosen[after] - chosen[after - 1]))[:, None]
    return (1 - share) * found[:, after - 1] + share * found[:, after]


def _smoothed(found: Corrections, fps: float, cyclic: bool) -> Corrections:
    from scipy.ndimage import gaussian_filter1d

    if not cyclic:
        return gaussian_filter1d(found, SECONDS * fps, axis=1, mode="nearest")
    # The last frame is the first one again.
    period = gaussian_filter1d(found[:, :-1], SECONDS * fps, axis=1, mode="wrap")
    return np.concatenate([period, period[:, :1]], axis=1)
