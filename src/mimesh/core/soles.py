"""Contact points on soles and palms: which points of a surface they are, and where they are in a pose or frame.

Hands that stand on the floor (push-ups, crawling, handstands) are feet like others, whose length is along x.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from .frame_buffer import Frames, Progress, vertices_of_all
from .normalization import Normalization
from .rig import Rig, descendants
from .skinning import SkinnedMesh
from .surface_points import SurfacePoints

CONTACTS = 4
"""Contact points of a foot, in equal parts of its length from heel to toes: a foot rolls from one to the next."""
PITCHES = np.radians([-50.0, -30.0, -10.0, 10.0, 30.0, 50.0])
"""How far a foot is tilted, toes down and up, when each of the points that make a contact point is the lowest."""
OF_EACH = len(PITCHES)
"""Number of surface points of a contact point, of which the lowest stands."""
OUTSIDE = 3.0
"""Points outside a part of the foot count as higher by this multiple of their distance from it, so that parts without
points take the nearest ones."""
LOWEST_PART = 0.2
"""Of a leg without an ankle, the foot is the part below this share of the height of its last joint's surface."""
FEWEST = 4
"""A foot with fewer points than this is not found."""
SHORT = 0.15
"""A leg reaches its ankle if its surface ends at most this share of the shin before it. Figures of blocks end 0.09
before it to 0.15 behind it, a scan that ends 20 cm above the floor 0.3 before."""
DIRECTIONS = np.array([p for p in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(p)])
"""26 directions, along which points are outermost."""
REST_FLOOR = (-0.25, 0.9)
"""Leg lengths over the soles of the rest pose between which the lowest soles of a clip are: in the air, on a seat, with
toes in the ground. Elsewhere the rest pose stands on no floor of the clip, as where its hips are at the origin: planted
soles are then at least 1.1 over it, the height of hips."""

Soles = tuple[Int[np.ndarray, "C M"] | None, ...]
"""For each leg, then for each arm, the C contact points of its foot or hand, each as the indices of the M points that
make it; None: no foot."""


@dataclass(frozen=True, eq=False)
class SolePoints:
    """The contact points of F feet of a surface, C of each, and B outermost points of the rest of it."""

    feet: int
    surface: SurfacePoints
    """The F * C * M points of the surface that make the first, then the others."""
    rest: int = 0
    """B."""

    @classmethod
    def of(cls, soles: Soles, surface: SurfacePoints, body: Int[np.ndarray, " B"] | None = None) -> SolePoints | None:
        """Select those of feet that were found; None if there is none.

        Args:
            soles: contact points as indices of the points of `surface`.
            surface: points of a mesh.
            body: outermost points of the body, as indices of the same.
        """
        found = [indices.ravel() for indices in soles if indices is not None]
        if not found:
            return None
        rest = np.zeros(0, int) if body is None else body
        points = np.concatenate([*found, rest])
        return cls(len(found), SurfacePoints(surface.corners[points], surface.barycentric[points]), len(rest))

    def in_frame(
        self, vertices: Float[np.ndarray, "U 3"]
    ) -> tuple[Float[np.ndarray, "F C 3"], Float[np.ndarray, "B 3"]]:
        """Return the contact points, and those of the body, in a frame."""
        soles, body = self._split(self.surface.points(vertices)[None])
        return soles[0], body[0]

    def in_frames(
        self, frames: Frames, norm: Normalization, progress: Progress | None = None
    ) -> tuple[Float[np.ndarray, "T F C 3"], Float[np.ndarray, "T B 3"]]:
        """Return the same in all frames, of which only their vertices are read, normalised."""
        used, corners = np.unique(self.surface.corners, return_inverse=True)
        few = SurfacePoints(corners.reshape(-1, 3), self.surface.barycentric)
        return self._split(norm.apply(few.points(vertices_of_all(frames, used, progress))))

    def _split(self, points: Float[np.ndarray, "T N 3"]) -> tuple[np.ndarray, np.ndarray]:
        count = points.shape[1] - self.rest
        return _contact_points(points[:, :count].reshape(len(points), self.feet, -1, OF_EACH, 3)), points[:, count:]


@dataclass(frozen=True, eq=False)
class Feet:
    """The F feet that driving and identity both have, with C contact points each."""

    legs: tuple[tuple[int, ...], ...]
    """Of each foot hip, knee and ankle joint, or those of them that the identity has: the last one moves the foot."""
    driving_leg: float
    """Leg length of the driving."""
    driving: SolePoints
    """Contact points of the driving."""
    identity: SkinnedMesh
    """The F * C * M points of the identity that make its contact points."""
    hands: int = 0
    """How many of the feet, the last ones, are hands."""
    body: SkinnedMesh | None = None
    """Outermost points of the rest of the identity; None where they are not known of both."""

    @classmethod
    def of(
        cls,
        legs: tuple[tuple[int, ...], ...],
        driving_leg: float,
        identity: Soles,
        skinned: SkinnedMesh,
        driving: Soles,
        surface: SurfacePoints,
        arms: tuple[tuple[int, ...], ...] = (),
        bodies: tuple[Int[np.ndarray, " A"], Int[np.ndarray, " B"]] | None = None,
    ) -> Feet | None:
        """Select the feet that both meshes have; None if there is none.

        Args:
            legs: joints of each leg, from hip to ankle.
            driving_leg: leg length of the driving.
            identity: contact points as indices of the vertices of `skinned`.
            skinned: the identity.
            driving: contact points as indices of the points of `surface`.
            surface: points of the driving.
            arms: joints of each arm that may stand, from shoulder to wrist.
            bodies: outermost points of the identity and of the driving, as indices of the same (`body_points`).
        """
        both = [
            (leg, mine, other)
            for leg, mine, other in zip(legs + arms, identity, driving, strict=True)
            if mine is not None and other is not None
        ]
        hands = sum(leg in arms for leg, _, _ in both)
        if len(both) == hands:
            return None
        theirs = SolePoints.of(tuple(other for _, _, other in both), surface, None if bodies is None else bodies[1])
        assert theirs is not None
        return cls(
            tuple(leg for leg, _, _ in both),
            driving_leg,
            theirs,
            skinned.part(np.concatenate([mine.ravel() for _, mine, _ in both])),
            hands,
            None if bodies is None else skinned.part(bodies[0]),
        )

    def without_hands(self) -> Feet:
        """Leave out the hands."""
        points = (len(self.legs) - self.hands) * CONTACTS * OF_EACH
        driving = self.driving.surface
        return replace(
            self,
            legs=self.legs[: len(self.legs) - self.hands],
            driving=SolePoints(
                len(self.legs) - self.hands, SurfacePoints(driving.corners[:points], driving.barycentric[:points])
            ),
            identity=self.identity.part(np.arange(points)),
            hands=0,
        )

    @property
    def stiff(self) -> Bool[np.ndarray, " F"]:
        """Whether a leg lacks the two bones and the ankle that inverse kinematics needs."""
        return np.array([len(leg) < 3 for leg in self.legs])

    def identity_soles(
        self, rotation: Float[np.ndarray, "T J 3 3"], root: Float[np.ndarray, "T 3"]
    ) -> Float[np.ndarray, "T F C 3"]:
        """Return the identity's contact points in all frames."""
        return _contact_points(self._sole_points(rotation, root))

    def identity_lowest(
        self, rotation: Float[np.ndarray, "T J 3 3"], root: Float[np.ndarray, "T 3"], with_soles: bool = False
    ) -> Float[np.ndarray, " T"]:
        """Return the height of the identity's lowest point in all frames, by default but those of feet and hands."""
        assert self.body is not None
        body = self.body.posed_frames(rotation, np.zeros_like(root))[..., 1].min(axis=1) + root[:, 1]
        return np.minimum(body, self._sole_points(rotation, root)[..., 1].min(axis=(1, 2, 3))) if with_soles else body

    def _sole_points(
        self, rotation: Float[np.ndarray, "T J 3 3"], root: Float[np.ndarray, "T 3"]
    ) -> Float[np.ndarray, "T F C M 3"]:
        points = self.identity.posed_frames(rotation, np.zeros_like(root))
        return points.reshape(len(rotation), len(self.legs), -1, OF_EACH, 3) + root[:, None, None, None]


def _contact_points(points: Float[np.ndarray, "T F C M 3"]) -> Float[np.ndarray, "T F C 3"]:
    """Return contact points: in the middle of their points over the ground, and as low as the lowest of these.

    A sole that tilts stands on an edge, which no mean shows.
    """
    contacts = points.mean(axis=3)
    contacts[..., 1] = points[..., 1].min(axis=3)
    return contacts


def find_soles(
    points: Float[np.ndarray, "N 3"],
    rig: Rig,
    legs: tuple[tuple[int, ...], ...],
    parents: tuple[int, ...],
    arms: tuple[tuple[int, ...], ...] = (),
) -> Soles:
    """Find the contact points of the foot of each leg, and of the hand of each arm; see `sole_points`."""
    feet = tuple(_foot_points(points, rig, leg, parents) if leg else None for leg in legs)
    return feet + tuple(_palm_points(points, rig, arm, parents) if len(arm) == 3 else None for arm in arms)


def body_points(
    points: Float[np.ndarray, "N 3"], rig: Rig, limbs: tuple[tuple[int, ...], ...], parents: tuple[int, ...]
) -> Int[np.ndarray, " B"]:
    """Find the outermost points of what each joint moves, along DIRECTIONS; feet and hands are left out.

    Args:
        limbs: joints of each leg and arm; what the last of three moves is a foot or a hand.
    """
    ends = descendants([limb[-1] for limb in limbs if len(limb) == 3], parents)
    return _outermost(points, rig.weights.argmax(axis=1), np.setdiff1d(np.arange(len(parents)), ends))


def _outermost(
    points: Float[np.ndarray, "N 3"], joint_of: Int[np.ndarray, " N"], joints: Int[np.ndarray, " K"]
) -> Int[np.ndarray, " B"]:
    """Find the outermost points along DIRECTIONS of each of some joints; `joint_of` is the joint of each point."""
    chosen = [np.zeros(0, int)]
    for joint in np.intersect1d(joint_of, joints):
        of_joint = np.flatnonzero(joint_of == joint)
        chosen.append(of_joint[(points[of_joint] @ DIRECTIONS.T).argmax(axis=0)])
    return np.unique(np.concatenate(chosen))


class LowParts(NamedTuple):
    """Outermost points of the parts of an identity that may be lower than the driving's."""

    trunk: SkinnedMesh
    """Those of all but feet and arms."""
    arms: tuple[tuple[tuple[int, ...], SkinnedMesh], ...]
    """Shoulder, elbow and wrist of each arm, and the points of palms, or else of forearms."""

    @classmethod
    def of(
        cls,
        points: Float[np.ndarray, "N 3"],
        rig: Rig,
        skinned: SkinnedMesh,
        limbs: tuple[tuple[tuple[int, ...], ...], tuple[tuple[int, ...], ...]],
        soles: Soles,
    ) -> LowParts | None:
        """Find them; None of a mesh that has none.

        Args:
            points: positions at rest of `skinned`, which is the identity.
            limbs: joints of each leg and of each arm.
            soles: contact points of feet and hands.
        """
        joint_of, (legs, arms) = rig.weights.argmax(axis=1), limbs
        parts: list[tuple[tuple[int, ...], SkinnedMesh]] = []
        feet = (leg[-1] for leg in legs if len(leg) == 3)
        apart = descendants([*feet, *(joint for arm in arms for joint in arm)], skinned.parents)
        trunk = _outermost(points, joint_of, np.setdiff1d(np.arange(len(skinned.parents)), apart))
        for arm, palm in zip(arms, soles[len(legs) :], strict=True):
            if palm is not None:  # sleeves hang lower
                parts.append((arm, skinned.part(np.unique(palm))))
            elif len(arm) == 3:
                forearm = np.array(descendants([arm[1]], skinned.parents))
                part = _outermost(points, np.where(_near_hand(points, rig, arm), joint_of, -1), forearm)
                parts += [(arm, skinned.part(part))] if len(part) else []
        return cls(skinned.part(trunk), tuple(parts)) if len(trunk) else None


def _foot_points(
    points: Float[np.ndarray, "N 3"], rig: Rig, leg: tuple[int, ...], parents: tuple[int, ...]
) -> Int[np.ndarray, "C M"] | None:
    """Find the contact points of a foot; where an ankle moves none, those of the lowest part of a leg that reaches it.

    Figures of blocks have such legs. Those of scans that end above the floor do not reach the ankle.
    """
    soles = sole_points(points, rig, leg[-1], parents, len(leg) == 3)
    if soles is not None or len(leg) < 2:
        return soles
    start, end = rig.joints[list(leg[-2:])]
    share = (points - start) @ (end - start) / np.square(end - start).sum()
    for joint in leg[-2::-1]:  # a leg of one block may have all of it on the thigh
        of_leg = rig.weights[:, descendants([joint], parents)].sum(axis=1) > 0.5
        if share[of_leg].max(initial=0) > 1 - SHORT:
            return sole_points(points, rig, joint, parents, whole=False)
    return None


def _palm_points(
    points: Float[np.ndarray, "N 3"], rig: Rig, arm: tuple[int, ...], parents: tuple[int, ...]
) -> Int[np.ndarray, "C M"] | None:
    """Find the contact points of a hand: those of a foot along x, of what is no prop in it."""
    hand = replace(rig, weights=np.where(_near_hand(points, rig, arm)[:, None], rig.weights, 0.0))
    return sole_points(points, hand, arm[-1], parents, along=0)


def _near_hand(points: Float[np.ndarray, "N 3"], rig: Rig, arm: tuple[int, ...]) -> Bool[np.ndarray, " N"]:
    """Tell which points may be of the hand of an arm, which is shorter than its forearm: farther away is a prop."""
    _, elbow, wrist = rig.joints[list(arm)]
    return np.linalg.norm(points - wrist, axis=1) < np.linalg.norm(wrist - elbow)


def sole_height(points: Float[np.ndarray, "N 3"], soles: Soles, legs: int) -> float | None:
    """Return the height of the lowest contact point of the first `legs` feet; None if there is none."""
    feet = [points[indices][..., 1].min() for indices in soles[:legs] if indices is not None]
    return float(min(feet)) if feet else None


def floor_height(at_rest: float, lowest: float, leg: float) -> float:
    """Return the height of the floor of a clip: that of the soles at rest, unless the clip does not stand on it.

    Args:
        at_rest: height of the soles at rest.
        lowest: that of the soles that stand in the clip, or of its lowest ones.
        leg: length of a leg.
    """
    return at_rest if REST_FLOOR[0] <= (lowest - at_rest) / leg <= REST_FLOOR[1] else lowest


def sole_points(
    points: Float[np.ndarray, "N 3"], rig: Rig, ankle: int, parents: tuple[int, ...], whole: bool = True, along: int = 2
) -> Int[np.ndarray, "C M"] | None:
    """Find the contact points of a foot: indices of the M points that make each of them (some repeated).

    In each of CONTACTS parts of the foot's length, they are the lowest points when the foot, with straightened toes, is
    tilted by PITCHES. None if the surface has no such foot.

    Args:
        ankle: the joint, or the last one of a leg that has no ankle.
        whole: whether it is an ankle; else its surface is that of a leg, of which the lowest part is the foot.
        along: axis of its length, from heel to toes.
    """
    below = descendants([ankle], parents)
    on_foot = np.flatnonzero(rig.weights[:, below].sum(axis=1) > 0.5)
    if len(on_foot) < FEWEST:
        return None
    strongest = rig.weights[on_foot][:, below].argmax(axis=1)
    joint = np.array(below)[strongest]
    # In the frame of its own joint, at the place that joint has at rest, where all frames have the same axes.
    rest = {ankle: np.zeros(3)}
    for j in below[1:]:
        rest[j] = rest[parents[j]] + rig.rotation[parents[j]].T @ (rig.joints[j] - rig.joints[parents[j]])
    straight = np.einsum("nkl,nk->nl", rig.rotation[joint], points[on_foot] - rig.joints[joint])
    straight += np.stack([rest[j] for j in below])[strongest]
    if not whole:
        low = straight[:, 1] <= straight[:, 1].min() + LOWEST_PART * np.ptp(straight[:, 1])
        on_foot, straight = on_foot[low], straight[low]
    heel, toe = np.percentile(straight[:, along], (1, 99))
    length = max(toe - heel, 1e-9)
    part = length / CONTACTS
    middles = heel + (np.arange(CONTACTS) + 0.5) * part
    outside = np.maximum(np.abs(straight[:, along] - middles[:, None]) - part / 2, 0)
    tilted = np.cos(PITCHES)[:, None] * straight[:, 1] - np.sin(PITCHES)[:, None] * straight[:, along]
    return on_foot[(tilted + OUTSIDE * outside[:, None]).argmin(axis=-1)]
