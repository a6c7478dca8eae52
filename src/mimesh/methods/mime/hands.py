"""Fingers: find the hands that show fingers on both meshes, follow them through the clip, and add them to the rig.

A hand is the surface whose skinning weights belong to the hand's joint and its finger stubs. A second, small network
(`hand_network.py`) finds fifteen joints in it and their shares in these weights. Fingers move where the hands of both
meshes show them and the driving bends them otherwise than the identity in some frame that is looked at; all others
follow their hand. Only the bend of the fingers relative to the palm is transferred, so errors of the hand's own
rotation do not bend them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from ...bodies.character_limbs import SIDES
from ...bodies.hands import HAND_PARENTS, hand_joints
from ...bodies.joint_names import finger_joints
from ...core.canonical_order import canonical_order
from ...core.geometry import angles_between, border_edges, nearest_rotation, vertex_normals
from ...core.mesh import Mesh
from ...core.rig import Rig
from ...core.surface_points import SurfacePoints
from ..base import Pose, SurfaceMotion
from ..npt import generator
from .denoise import NOISY, Denoiser
from .hand_network import HAND_ENSEMBLE, FingerNetwork, Fingers, Hand
from .joint_network import NetworkPoints
from .part_tracking import PartTracker

TRACKED_POINTS = 400
"""Points of a hand that are tracked through a clip."""
HAND_SHARE = 0.5
"""Least mean weight of the hand in a triangle of it."""
MIN_FACES = 48
"""Triangles below which a hand is taken to have no fingers: each of them has at least a triangle on a few sides."""
LEAST_SHARE = 1e-3
"""Weight of the hand from which on a vertex is one of the hand's."""
WRIST_REACH, MAX_BORDER = 0.35, 0.01
"""A hand has holes if it has more border edges than this share of its triangles, those not counted that are nearer to
the wrist than so many lengths of the hand. Hands of the noise protocol's pierced meshes have 1.4 to 18 %, all hands of
the pool's `val` characters that show fingers none. A finger in which a hole is bends wrongly."""
TINY = 1e-9
"""Added to weights before they are divided by their sum."""
NEAREST, REACH = 3, 1.6
"""Tracked points whose mean weights a vertex of a driving mesh gets, and the distance from the wrist, in lengths of the
forearm, within which vertices can be the hand's."""
SAME_BELOW, DIFFERENT_ABOVE = 8.0, 16.0
"""Angle (degrees, mean of a finger's joints) between the bends of both meshes' fingers below which they count as equal,
and above which as different. Hands that are bent alike differ by 1 to 3 degrees, their worst fingers by up to 10 (val).
A hand of which no finger is ever different keeps the joints that it has without the network of hands."""


@dataclass(frozen=True, eq=False)
class WeightedMesh:
    """A mesh in one frame, in which hands are looked for."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    rig: Rig
    """Joints of the body; its weights may be those of other points."""
    weights: Float[np.ndarray, "V J"]
    """Skinning weights of the vertices."""

    @classmethod
    def of_points(cls, mesh: Mesh, rig: Rig, points: Float[np.ndarray, "N 3"], joints: tuple[str, ...]) -> WeightedMesh:
        """Make it of a mesh and a rig whose weights are those of some points of its surface.

        Vertices around the hands get the weights of the nearest points. Others get none, which saves time.
        """
        from scipy.spatial import KDTree

        near = np.zeros(len(mesh.vertices), bool)
        for side in SIDES:
            wrist, elbow = (rig.joints[joints.index(side + part)] for part in ("Hand", "ForeArm"))
            near |= np.linalg.norm(mesh.vertices - wrist, axis=1) < REACH * np.linalg.norm(wrist - elbow)
        weights = np.zeros((len(mesh.vertices), len(joints)))
        if near.any():
            nearest = KDTree(points).query(mesh.vertices[near], k=NEAREST)[1]
            weights[near] = rig.weights[nearest].mean(axis=1)
        return cls(mesh.vertices, mesh.faces, rig, weights)


@dataclass(frozen=True, eq=False)
class HandPart:
    """The part of a mesh that is a hand."""

    hand: int
    """Index of the hand's joint."""
    base: int
    """Index of the joint that carries the fingers: the base of all fingers, or the hand."""
    base_rotation: Float[np.ndarray, "3 3"]
    """World rotation of that joint."""
    samples: SurfacePoints
    """Points of its surface."""
    vertices: Int[np.ndarray, " Q"]
    """Vertices that the hand moves."""
    surface: Hand


@dataclass(frozen=True, eq=False)
class FingeredHand:
    """A hand that shows its fingers."""

    part: HandPart
    fingers: Fingers

    @cached_property
    def tracker(self) -> PartTracker:
        """Tracks the hand, which is the first joint, and its fingers; the queries are the tracked points."""
        surface = self.part.surface
        joints = np.concatenate([surface.position[None], self.fingers.joints])
        return PartTracker.of(surface.queries.points, self.fingers.shares, joints, HAND_PARENTS)


@dataclass(frozen=True, eq=False)
class FoundFingers:
    """The hands of one side of both meshes, which show their fingers."""

    side: str
    identity: FingeredHand
    """The shares are those of its vertices."""
    driving: FingeredHand
    """In the reference frame; the shares are those of its tracked points."""


@dataclass(frozen=True, eq=False)
class HandFinder:
    """Finds hands with fingers."""

    network: FingerNetwork
    joints: tuple[str, ...]
    """Names of the joints of the body's network."""
    seed: int = 0

    def find_moving(
        self, identity: WeightedMesh, driving: Callable[[], WeightedMesh], motion: SurfaceMotion
    ) -> list[FoundFingers]:
        """Find the hands whose fingers both meshes show and the driving bends otherwise in some frame.

        Args:
            identity: the mesh to move.
            driving: makes the driving mesh in the reference frame; not called if the identity shows no fingers.
            motion: of the driving's surface.
        """
        mine = self._fingered(identity, SIDES, by_vertex=True)
        theirs = self._fingered(driving(), tuple(mine), by_vertex=False) if mine else {}
        found = [FoundFingers(side, mine[side], hand) for side, hand in theirs.items()]
        if not found:
            return []
        tracker = FingerTracker.of(found)
        moving = tracker.bend_otherwise([hand.identity.fingers for hand in found], motion(tracker.samples))
        return [hand for hand, moves in zip(found, moving, strict=True) if moves]

    def _fingered(self, mesh: WeightedMesh, sides: tuple[str, ...], by_vertex: bool) -> dict[str, FingeredHand]:
        """Find the hands of a mesh that show fingers; weights are predicted by vertex, or else of tracked points."""
        hands = {side: hand for side in sides if (hand := self._hand(mesh, side, by_vertex)) is not None}
        predictions = self.network.predict([hand.surface for hand in hands.values()])
        return {
            side: FingeredHand(hand, fingers)
            for (side, hand), fingers in zip(hands.items(), predictions, strict=True)
            if fingers is not None
        }

    def _hand(self, mesh: WeightedMesh, side: str, by_vertex: bool) -> HandPart | None:
        """Cut a hand out of a mesh; None if it is coarse, noisy, full of holes or missing."""
        weight = mesh.weights[:, hand_joints(self.joints, side)].sum(axis=1)
        of_hand = mesh.faces[weight[mesh.faces.T].sum(axis=0) > 3 * HAND_SHARE]
        if len(of_hand) < MIN_FACES:
            return None
        kept, corners = np.unique(of_hand, return_inverse=True)
        part = Mesh(mesh.vertices[kept], corners.reshape(-1, 3))
        ranked = canonical_order(part.vertices)
        if Denoiser.of(part, ranked).folded_share(ranked.merge(part.vertices)) >= NOISY:
            return None
        hand = self.joints.index(f"{side}Hand")
        if _has_holes(ranked.merge(part.vertices), ranked.group[part.faces], mesh.rig.joints[hand]):
            return None
        count = max(HAND_ENSEMBLE * self.network.points, TRACKED_POINTS)
        samples = SurfacePoints.of(part, count, generator(self.seed, 2 + SIDES.index(side)), ranked)
        samples = SurfacePoints(kept[samples.corners], samples.barycentric)
        points, moved = NetworkPoints.of(samples, mesh.vertices), weight > LEAST_SHARE
        queries = _vertices(mesh, moved) if by_vertex else points[:TRACKED_POINTS]
        base = self.joints.index(f"{side}FingerBase") if f"{side}FingerBase" in self.joints else hand
        rotation = mesh.rig.rotation
        surface = Hand(side, rotation[hand], mesh.rig.joints[hand], points, queries)
        return HandPart(hand, base, rotation[base], samples, np.flatnonzero(moved), surface)


def _has_holes(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], wrist: Float[np.ndarray, " 3"]
) -> bool:
    """Tell whether the surface of a hand is open elsewhere than at the wrist."""
    distance = np.linalg.norm(vertices - wrist, axis=1)
    far = (distance > WRIST_REACH * distance.max())[border_edges(faces)].all(axis=1)
    return bool(far.sum() > MAX_BORDER * len(faces))


def _vertices(mesh: WeightedMesh, chosen: Bool[np.ndarray, " V"]) -> NetworkPoints:
    """Return some vertices of a mesh with their normals."""
    around = mesh.faces[chosen[mesh.faces.T].any(axis=0)]
    return NetworkPoints(mesh.vertices[chosen], vertex_normals(mesh.vertices, around)[chosen])


@dataclass(frozen=True, eq=False)
class FingerTracker:
    """Fingers of H driving hands, followed through their clip."""

    bases: list[int]
    """Index of the joint that carries the fingers of each hand."""
    samples: SurfacePoints
    """The tracked points of all hands."""
    tracker: PartTracker
    palm: Float[np.ndarray, "H 1 3 3"]
    """World rotation of the palms in the reference frame."""
    rotation: Float[np.ndarray, "H 15 3 3"]
    """World rotation of the finger joints in the reference frame."""
    to_palm: Float[np.ndarray, "H 1 3 3"]
    """Rotation from the frame of the identity's joint that carries the fingers to its palm."""

    @classmethod
    def of(cls, hands: list[FoundFingers]) -> FingerTracker:
        """Prepare tracking from the reference frame."""
        corners, barycentric = (
            np.concatenate([getattr(hand.driving.part.samples, field)[:TRACKED_POINTS] for hand in hands])
            for field in ("corners", "barycentric")
        )
        return cls(
            [hand.driving.part.base for hand in hands],
            SurfacePoints(corners, barycentric),
            PartTracker.stacked(hand.driving.tracker for hand in hands),
            np.stack([hand.driving.fingers.palm[None] for hand in hands]),
            np.stack([hand.driving.fingers.rotation for hand in hands]),
            np.stack([(hand.identity.part.base_rotation.T @ hand.identity.fingers.palm)[None] for hand in hands]),
        )

    def follow(self, vertices: Float[np.ndarray, "U 3"], rotation: Float[np.ndarray, "B 3 3"]) -> Pose:
        """Return rotations of the finger joints for the identity, and their positions in the driving's frame.

        Args:
            vertices: the driving in a frame.
            rotation: of the driving's joints in that frame.
        """
        bends, positions = self.bends(self.samples.points(vertices))
        fingers = rotation[self.bases][:, None] @ self.to_palm @ bends
        return fingers.reshape(-1, 3, 3), positions.reshape(-1, 3)

    def bends(
        self, points: Float[np.ndarray, "*T N 3"]
    ) -> tuple[Float[np.ndarray, "*T H 15 3 3"], Float[np.ndarray, "*T H 15 3"]]:
        """Return rotations of the finger joints relative to the palm, and their positions, from the tracked points."""
        by_hand = points.reshape(*points.shape[:-2], len(self.bases), -1, 3)
        motion, positions = self.tracker.follow(by_hand)
        palm = motion[..., :1, :, :] @ self.palm
        return palm.swapaxes(-1, -2) @ motion[..., 1:, :, :] @ self.rotation, positions[..., 1:, :]

    def bend_otherwise(self, identity: list[Fingers], points: Float[np.ndarray, "T N 3"]) -> Bool[np.ndarray, " H"]:
        """Tell of each hand whether a finger is clearly bent otherwise than the identity's in some frame.

        A rotation that all four fingers have in common does not count: the body's joints of the hand give it too.
        """
        own, bends = np.stack([fingers.bends for fingers in identity]), self.bends(points)[0]
        common = nearest_rotation((bends[..., 3:, :, :] @ own[:, 3:].swapaxes(-1, -2)).sum(axis=-3))
        thumb = np.broadcast_to(own[:, :3], (*bends.shape[:2], 3, 3, 3))
        turned = np.concatenate([thumb, common[..., None, :, :] @ own[:, 3:]], axis=2)
        return finger_angles(turned, bends).max(axis=(0, 2)) > DIFFERENT_ABOVE


def with_fingers(
    rig: Rig, joints: tuple[str, ...], parents: tuple[int, ...], found: list[FoundFingers]
) -> tuple[Rig, tuple[str, ...], tuple[int, ...]]:
    """Add the fingers of an identity to its rig, joints and parents; the body's joints stay where they are.

    Of the body's joints of a hand, only the hand and the base of all fingers keep weights: those of the palm.
    """
    rotation, positions, weights = [rig.rotation], [rig.joints], [rig.weights.copy() if found else rig.weights]
    for hand in found:
        part, fingers = hand.identity.part, hand.identity.fingers
        of_hand, palm = hand_joints(joints, hand.side), list(dict.fromkeys([part.hand, part.base]))
        weights.append(_divided_weights(weights[0], of_hand, palm, part.vertices, fingers.shares))
        rotation.append(fingers.palm @ settled_bends(fingers.bends, hand.driving.fingers.bends))
        positions.append(fingers.joints)
        parents += tuple(part.base if parent == 0 else len(joints) + parent - 1 for parent in HAND_PARENTS[1:])
        joints += finger_joints(hand.side)
    return Rig(np.concatenate(rotation), np.concatenate(positions), np.concatenate(weights, axis=1)), joints, parents


def _divided_weights(
    weights: Float[np.ndarray, "V J"],
    of_hand: list[int],
    palm: list[int],
    vertices: Int[np.ndarray, " Q"],
    shares: Float[np.ndarray, "Q 16"],
) -> Float[np.ndarray, "V 15"]:
    """Return the weights of the fingers of a hand, and leave the rest of the hand's to the joints of its palm.

    Args:
        weights: of the body's joints; changed in place.
        of_hand: all joints of the body's hand.
        palm: those that go on sharing the palm.
        vertices: whose shares are known; the rest of what the hand moves belongs to the palm.
        shares: of the palm and of the fingers in the weight that the hand has.
    """
    rows = np.flatnonzero(weights[:, of_hand].any(axis=1))
    all_shares = np.zeros((len(rows), 16))
    all_shares[:, 0] = 1.0
    all_shares[np.searchsorted(rows, vertices)] = shares
    mass = weights[rows][:, of_hand].sum(axis=1, keepdims=True)
    kept = weights[rows][:, palm] + TINY
    weights[rows[:, None], of_hand] = 0.0
    weights[rows[:, None], palm] = mass * all_shares[:, :1] * kept / kept.sum(axis=1, keepdims=True)
    fingers = np.zeros((len(weights), 15))
    fingers[rows] = mass * all_shares[:, 1:]
    return fingers


def settled_bends(
    own: Float[np.ndarray, "15 3 3"], driving: Float[np.ndarray, "15 3 3"]
) -> Float[np.ndarray, "15 3 3"]:
    """Return the bends of an identity's fingers, those that the driving's nearly equal replaced by the driving's.

    Small differences are mostly errors of the predictions; fingers without a difference follow the hand exactly.
    """
    share = ((finger_angles(own, driving) - SAME_BELOW) / (DIFFERENT_ABOVE - SAME_BELOW)).clip(0, 1)
    of_joint = share.repeat(3)[:, None, None]
    return nearest_rotation(of_joint * own + (1 - of_joint) * driving)


def finger_angles(
    own: Float[np.ndarray, "*H 15 3 3"], driving: Float[np.ndarray, "*H 15 3 3"]
) -> Float[np.ndarray, "*H 5"]:
    """Return the angle between the bends of each finger of two hands (degrees), the mean over its joints."""
    angles = angles_between(own, driving)
    return angles.reshape(*angles.shape[:-1], 5, 3).mean(axis=-1)


def follow_fingers(
    follow: Callable[[Float[np.ndarray, "U 3"]], Pose], hands: list[FoundFingers]
) -> Callable[[Float[np.ndarray, "U 3"]], Pose]:
    """Extend the function that finds the pose of a frame by fingers; without any it stays as it is."""
    if not hands:
        return follow
    tracker = FingerTracker.of(hands)

    def follow_all(vertices: Float[np.ndarray, "U 3"]) -> Pose:
        rotation, positions = follow(vertices)
        fingers, places = tracker.follow(vertices, rotation)
        return np.concatenate([rotation, fingers]), np.concatenate([positions, places])

    return follow_all
