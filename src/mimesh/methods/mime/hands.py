"""Fingers: a second, small network finds the joints of hands that show fingers; they are tracked apart from the body.

A hand is the surface whose skinning weights belong to the hand's joint. Its points, turned to the frame of that joint
and mirrored for right hands, give the rotation and position of fifteen joints and the share of each in the weights.
Fingers move where the hands of both meshes show them; all others follow their hand. Only the bend of the fingers
relative to the palm is transferred, so errors of the hand's own rotation do not bend them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ...bodies.character_limbs import SIDES
from ...bodies.hands import HAND_PARENTS, hand_joints
from ...bodies.joint_names import finger_joints
from ...core.geometry import nearest_rotation, vertex_normals
from ...core.mesh import Mesh
from ...core.rig import Rig
from ...core.surface_points import SurfacePoints
from ..base import Pose
from ..npt import generator
from .denoise import NOISY, Denoiser
from .joint_network import MIRROR, NetworkPoints
from .part_tracking import PartTracker, mean_rotation

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

HAND_ENSEMBLE = 3
"""Predictions for a hand, each from other points."""
TRACKED_POINTS = 400
"""Points of a hand that are tracked through a clip."""
HAND_SHARE = 0.5
"""Least mean weight of the hand in a triangle of it."""
MIN_FACES = 48
"""Triangles below which a hand is taken to have no fingers: each of them has at least a triangle on a few sides."""
MAX_SPREAD = 20.0
"""Median angle (degrees) between predictions of a hand and their mean from which on its fingers follow the hand."""
LEAST_SHARE = 1e-3
"""Weight of the hand from which on a vertex is one of the hand's."""
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
class Hand:
    """A hand of a mesh in one frame, and what is asked about it."""

    side: str
    rotation: Float[np.ndarray, "3 3"]
    """World rotation of the hand's joint."""
    joint: Float[np.ndarray, " 3"]
    """Its position."""
    samples: NetworkPoints
    """Points of its surface."""
    queries: NetworkPoints
    """Points whose weights are asked for."""

    def local(self, points: NetworkPoints) -> NetworkPoints:
        """Express points in the frame of the hand's joint, as those of a left hand."""
        mirror = 1.0 if self.side == "Left" else MIRROR
        return NetworkPoints(
            (points.points - self.joint) @ self.rotation * mirror, points.normals @ self.rotation * mirror
        )


@dataclass(frozen=True, eq=False)
class Fingers:
    """Fingers of a hand: its palm and fifteen joints in the world, and the weights of the points asked for."""

    palm: Float[np.ndarray, "3 3"]
    """World rotation of the hand as the small network sees it."""
    rotation: Float[np.ndarray, "15 3 3"]
    """World rotation of the finger joints."""
    joints: Float[np.ndarray, "15 3"]
    shares: Float[np.ndarray, "Q 16"]
    """Share of the hand and of its fingers in the weight that the hand has."""

    @property
    def bends(self) -> Float[np.ndarray, "15 3 3"]:
        """Rotation of each joint relative to the palm."""
        return self.palm.T @ self.rotation


@dataclass(frozen=True, eq=False)
class WeightedMesh:
    """A mesh in one frame, whose hands are looked for."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    rig: Rig
    """Joints of the body; its weights may be those of other points."""
    weights: Float[np.ndarray, "V J"]
    """Skinning weights of the vertices."""
    moves: bool
    """Whether it is moved, so that weights of its vertices are needed; otherwise those of tracked points are."""

    @classmethod
    def of_points(cls, mesh: Mesh, rig: Rig, points: Float[np.ndarray, "N 3"], joints: tuple[str, ...]) -> WeightedMesh:
        """Make it of a driving frame; its vertices around the hands get the weights of the nearest of the rig's points.

        Others get none, which saves time.
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
        return cls(mesh.vertices, mesh.faces, rig, weights, moves=False)


@dataclass(frozen=True, eq=False)
class MeshHand:
    """A hand with its place in the mesh."""

    hand: Hand
    joint: int
    """Index of the hand's joint."""
    base_joint: int
    """Index of the joint that carries the fingers: the base of all fingers, or the hand."""
    base: Float[np.ndarray, "3 3"]
    """World rotation of that joint."""
    samples: SurfacePoints
    asked: Int[np.ndarray, " Q"]
    """Vertices that belong to the hand."""


@dataclass(frozen=True, eq=False)
class FoundFingers:
    """Fingers of a hand that both meshes show."""

    side: str
    own: MeshHand
    """Of the identity."""
    other: MeshHand
    """Of the driving."""
    mine: Fingers
    theirs: Fingers


@dataclass(frozen=True, eq=False)
class HandPredictor:
    """A loaded network of hands; see `learn.models.hands`."""

    session: InferenceSession
    points: int
    """Points of a hand that one prediction takes."""
    joints: tuple[str, ...]
    """Names of all joints of the body's network."""
    seed: int = 0

    def find(self, identity: WeightedMesh, driving: WeightedMesh) -> list[FoundFingers]:
        """Find the hands whose fingers both meshes show, in the order of SIDES."""
        own, other = (self._hands(mesh) for mesh in (identity, driving))
        sides = [side for side in own if side in other]
        fingers = self.predict([one for side in sides for one in (own[side].hand, other[side].hand)])
        return [
            FoundFingers(side, own[side], other[side], mine, theirs)
            for side, mine, theirs in zip(sides, fingers[::2], fingers[1::2], strict=True)
            if mine and theirs
        ]

    def _hands(self, mesh: WeightedMesh) -> dict[str, MeshHand]:
        """Cut out the hands of a mesh; those that are coarse, noisy or missing are left out."""
        found = {}
        for side in SIDES:
            mass = mesh.weights[:, hand_joints(self.joints, side)].sum(axis=1)
            of_hand = mesh.faces[mass[mesh.faces].mean(axis=1) > HAND_SHARE] if len(mesh.faces) else mesh.faces
            if len(of_hand) < MIN_FACES:
                continue
            kept, corners = np.unique(of_hand, return_inverse=True)
            part = Mesh(mesh.vertices[kept], corners.reshape(-1, 3))
            denoiser = Denoiser.of(part)
            if denoiser.folded_share(denoiser.ranked.merge(part.vertices)) >= NOISY:
                continue
            count = max(HAND_ENSEMBLE * self.points, TRACKED_POINTS)
            samples = SurfacePoints.of(part, count, generator(self.seed, 2 + SIDES.index(side)))
            samples = SurfacePoints(kept[samples.corners], samples.barycentric)
            points = NetworkPoints.of(samples, mesh.vertices)
            joint = self.joints.index(f"{side}Hand")
            asked = np.flatnonzero(mass > LEAST_SHARE)
            if mesh.moves:
                near = mesh.faces[(mass > LEAST_SHARE)[mesh.faces].any(axis=1)]
                queries = NetworkPoints(mesh.vertices[asked], vertex_normals(mesh.vertices, near)[asked])
            else:
                queries = points[:TRACKED_POINTS]
            hand = Hand(side, mesh.rig.rotation[joint], mesh.rig.joints[joint], points, queries)
            base = f"{side}FingerBase"
            base_joint = self.joints.index(base) if base in self.joints else joint
            found[side] = MeshHand(hand, joint, base_joint, mesh.rig.rotation[base_joint], samples, asked)
        return found

    def predict(self, hands: list[Hand]) -> list[Fingers | None]:
        """Predict the fingers of hands, all in one run of the network; None for a hand that does not show them."""
        if not hands:
            return []
        given = [hand.local(hand.samples) for hand in hands]
        parts = [
            NetworkPoints(points.points[k::HAND_ENSEMBLE], points.normals[k::HAND_ENSEMBLE])[: self.points]
            for points in given
            for k in range(HAND_ENSEMBLE)
        ]
        rotation, joints, _, separate = self._run(parts, [part[:1] for part in parts])
        rotation, joints = (array.reshape(len(hands), HAND_ENSEMBLE, *array.shape[1:]) for array in (rotation, joints))
        found: list[Fingers | None] = []
        for h, hand in enumerate(hands):
            mean = mean_rotation(rotation[h])
            spread = _angles(rotation[h] @ mean.swapaxes(-1, -2)).mean(axis=1)
            shown = separate.reshape(len(hands), -1)[h].mean() > 0 and np.median(spread) < MAX_SPREAD
            found.append(self._fingers(hand, mean, joints[h], parts[h * HAND_ENSEMBLE]) if shown else None)
        return found

    def _fingers(self, hand: Hand, rotation: Float[np.ndarray, "16 3 3"], joints, part: NetworkPoints) -> Fingers:
        """Return a hand's joints to the world, and predict the weights that are asked for."""
        shares = _softmax(self._run([part], [hand.local(hand.queries)])[2][0])
        mirror = 1.0 if hand.side == "Left" else MIRROR
        turned = hand.rotation @ (rotation * np.reshape(mirror, (-1, 1)) * mirror)
        placed = (joints.mean(axis=0) * mirror) @ hand.rotation.T + hand.joint
        return Fingers(turned[0], turned[1:], placed[1:], shares)

    def _run(self, points: list[NetworkPoints], queries: list[NetworkPoints]) -> list[np.ndarray]:
        """Run the network on a batch: rotations, joints, scores and logits."""
        names = ("points", "normals", "vertices", "vertex_normals")
        arrays = [
            np.stack([getattr(part, name) for part in parts])
            for parts in (points, queries)
            for name in ("points", "normals")
        ]
        given = {name: array.astype(np.float32) for name, array in zip(names, arrays, strict=True)}
        found = self.session.run(["rotation", "joints", "scores", "separate"], given)
        return [np.asarray(array).astype(np.float64) for array in found]


@dataclass(frozen=True, eq=False)
class HandTracker:
    """Fingers of a driving hand, followed through its clip."""

    hand: int
    """Index of the joint that carries the fingers."""
    samples: SurfacePoints
    tracker: PartTracker
    fingers: Fingers
    """In the reference frame."""
    frame: Float[np.ndarray, "3 3"]
    """Rotation from the frame of the identity's hand joint to its palm."""

    @classmethod
    def of(cls, found: FoundFingers) -> HandTracker:
        """Prepare tracking from the reference frame."""
        hand, samples = found.other.hand, found.other.samples
        kept = SurfacePoints(samples.corners[:TRACKED_POINTS], samples.barycentric[:TRACKED_POINTS])
        joints = np.concatenate([hand.joint[None], found.theirs.joints])
        tracker = PartTracker.of(hand.queries.points, found.theirs.shares, joints, HAND_PARENTS)
        frame = found.own.base.T @ found.mine.palm
        return cls(found.other.base_joint, kept, tracker, found.theirs, frame)

    def follow(self, vertices: Float[np.ndarray, "U 3"], hand: Float[np.ndarray, "3 3"]) -> Pose:
        """Return rotations of the finger joints for the identity, and their positions in the driving's frame."""
        bends, positions = self.bends(vertices)
        return hand @ self.frame @ bends, positions

    def bends(self, vertices: Float[np.ndarray, "U 3"]) -> Pose:
        """Return rotations of the finger joints relative to the palm in a frame, and their positions."""
        motion, positions = self.tracker.follow(self.samples.points(vertices))
        return (motion[0] @ self.fingers.palm).T @ motion[1:] @ self.fingers.rotation, positions[1:]

    def bends_otherwise(self, identity: Fingers, frames: Float[np.ndarray, "T U 3"]) -> bool:
        """Tell whether a finger is clearly bent otherwise than the identity's in some frame.

        A rotation that all four fingers have in common does not count: the body's joints of the hand give it too.
        """
        angles = []
        for vertices in frames:
            bends = self.bends(vertices)[0]
            common = nearest_rotation((bends[3:] @ identity.bends[3:].swapaxes(-1, -2)).sum(axis=0))
            angles.append(finger_angles(np.concatenate([identity.bends[:3], common @ identity.bends[3:]]), bends))
        return bool(np.max(angles) > DIFFERENT_ABOVE)


def with_fingers(
    rig: Rig, joints: tuple[str, ...], parents: tuple[int, ...], found: list[FoundFingers]
) -> tuple[Rig, tuple[str, ...], tuple[int, ...]]:
    """Add the fingers of an identity to its rig, joints and parents.

    Of the body's joints of a hand, only the hand and the base of all fingers keep weights: those of the palm.
    """
    weights, rotation, positions = [rig.weights.copy()], [rig.rotation], [rig.joints]
    for fingers in found:
        side, hand, first = fingers.side, fingers.own.joint, len(joints)
        of_hand = hand_joints(joints, side)
        mass = weights[0][:, of_hand].sum(axis=1)
        shares = np.tile(np.eye(16)[0], (len(mass), 1))
        shares[fingers.own.asked] = fingers.mine.shares
        base = fingers.own.base_joint
        palm = [hand] if base == hand else [hand, base]  # these two go on sharing the palm
        kept = weights[0][:, palm] + TINY
        weights[0][:, of_hand] = 0.0
        weights[0][:, palm] = (mass * shares[:, 0])[:, None] * kept / kept.sum(axis=1, keepdims=True)
        weights.append(mass[:, None] * shares[:, 1:])
        rotation.append(fingers.mine.palm @ settled_bends(fingers.mine.bends, fingers.theirs.bends))
        positions.append(fingers.mine.joints)
        joints += finger_joints(side)
        parents += tuple(base if parent == 0 else first + parent - 1 for parent in HAND_PARENTS[1:])
    arrays = (np.concatenate(rotation), np.concatenate(positions), np.concatenate(weights, axis=1))
    return Rig(*arrays), joints, parents


def settled_bends(
    own: Float[np.ndarray, "15 3 3"], driving: Float[np.ndarray, "15 3 3"]
) -> Float[np.ndarray, "15 3 3"]:
    """Return the bends of an identity's fingers, those that the driving's nearly equal replaced by the driving's.

    Small differences are mostly errors of the predictions; fingers without a difference follow the hand exactly.
    """
    share = (
        ((finger_angles(own, driving) - SAME_BELOW) / (DIFFERENT_ABOVE - SAME_BELOW))
        .clip(0, 1)
        .repeat(3)[:, None, None]
    )
    return nearest_rotation(share * own + (1 - share) * driving)


def finger_angles(own: Float[np.ndarray, "15 3 3"], driving: Float[np.ndarray, "15 3 3"]) -> Float[np.ndarray, " 5"]:
    """Return the angle between the bends of each finger of two hands (degrees), the mean over its joints."""
    return _angles(own @ driving.swapaxes(-1, -2)).reshape(5, 3).mean(axis=1)


def follow_fingers(
    follow: Callable[[Float[np.ndarray, "U 3"]], Pose], hands: list[HandTracker]
) -> Callable[[Float[np.ndarray, "U 3"]], Pose]:
    """Extend the function that finds the pose of a frame by fingers; without any it stays as it is."""
    if not hands:
        return follow

    def follow_all(vertices: Float[np.ndarray, "U 3"]) -> Pose:
        rotation, positions = follow(vertices)
        found = [(rotation, positions), *(hand.follow(vertices, rotation[hand.hand]) for hand in hands)]
        rotations, places = zip(*found, strict=True)
        return np.concatenate(rotations), np.concatenate(places)

    return follow_all


def _angles(rotation: Float[np.ndarray, "*B 3 3"]) -> Float[np.ndarray, "*B"]:
    """Return the angles of rotations in degrees."""
    cosine = (np.trace(rotation, axis1=-2, axis2=-1) - 1) / 2
    return np.degrees(np.arccos(cosine.clip(-1, 1)))


def _softmax(scores: Float[np.ndarray, "V J"]) -> Float[np.ndarray, "V J"]:
    weights = np.exp(scores - scores.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)
