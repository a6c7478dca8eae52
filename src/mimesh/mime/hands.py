"""Fingers: find the hands that show fingers on both meshes, follow them through the clip, and add them to the rig.

A hand is the surface whose skinning weights belong to the hand's joint and its finger stubs. A second, small network
finds fifteen joints in it and their shares in these weights. Fingers move where the hands of both meshes show them and
the driving bends them otherwise than the identity in some frame that is looked at; all others follow their hand. Only
the bend of the fingers relative to the palm is transferred, so errors of the hand's own rotation do not bend them.

The network (`learn.hands`) knows left hands in the frame of the hand's joint; right hands are mirrored for it.
Inputs of the ONNX file are those of the body's network (`prediction.py`), of B hands at once. Outputs are "rotation"
(B, 16, 3, 3), "joints" (B, 16, 3) and "scores" (B, V, 16) of the hand and its fifteen finger joints, and "separate"
(B,), the logit of whether the hand shows separate fingers.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_limbs import SIDES
from ..bodies.hands import HAND_PARENTS, hand_joints
from ..bodies.joint_names import finger_joints
from ..core.canonical_order import canonical_order
from ..core.geometry import (
    MIRROR,
    angles_between,
    border_edges,
    mirrored_rotations,
    nearest_points,
    nearest_rotation,
    vertex_normals,
)
from ..core.mesh import Mesh
from ..core.rig import Rig
from ..core.surface_points import SurfacePoints, generator
from ..rigs.retarget import Pose, SurfaceMotion
from .part_tracking import PartTracker, mean_rotation
from .prediction import CHUNK, NOISY, Denoiser, SurfaceSample, softmax

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

HAND_ENSEMBLE = 3
"""Predictions for a hand, each from other points. The first one also decides whether there are fingers: logits are
near 10 or -11, hardly ever between. And it gives the weights."""
MAX_SPREAD = 20.0
"""Median angle (degrees) between predictions of a hand and their mean from which on its fingers follow the hand."""
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
Bends = Float[np.ndarray, "15 3 3"]
"""Rotation of each finger joint of a hand relative to its palm."""
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
class HandFinder:
    """Finds hands with fingers."""

    network: FingerNetwork
    joints: tuple[str, ...]
    """Names of the joints of the body's network."""
    seed: int = 0

    def find(self, mesh: WeightedMesh) -> list[Fingers]:
        """Find the hands of a mesh that show their fingers."""
        return list(self._fingered(mesh, SIDES, by_vertex=True).values())

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
        found = [(mine[side], fingers) for side, fingers in theirs.items()]
        if not found:
            return []
        tracker = FingerTracker.of(found)
        own = np.stack([own.bends for own, _ in found])
        bends = tracker.bends(motion(tracker.samples))[0]
        # A rotation that all four fingers have in common does not count: the body's joints of the hand give it too.
        common = nearest_rotation((bends[..., 3:, :, :] @ own[:, 3:].swapaxes(-1, -2)).sum(axis=-3))
        thumb = np.broadcast_to(own[:, :3], (*bends.shape[:2], 3, 3, 3))
        turned = np.concatenate([thumb, common[..., None, :, :] @ own[:, 3:]], axis=2)
        moving = finger_angles(turned, bends).max(axis=(0, 2)) > DIFFERENT_ABOVE
        return [hand for hand, moves in zip(found, moving, strict=True) if moves]

    def _fingered(self, mesh: WeightedMesh, sides: tuple[str, ...], by_vertex: bool) -> dict[str, Fingers]:
        """Find the hands of a mesh that show fingers; weights are predicted by vertex, or else of tracked points."""
        hands = {side: hand for side in sides if (hand := self._hand(mesh, side, by_vertex)) is not None}
        predictions = self.network.predict(list(hands.values()))
        return {side: fingers for side, fingers in zip(hands, predictions, strict=True) if fingers is not None}

    def _hand(self, mesh: WeightedMesh, side: str, by_vertex: bool) -> Hand | None:
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
        distance = np.linalg.norm(ranked.merge(part.vertices) - mesh.rig.joints[hand], axis=1)
        far = (distance > WRIST_REACH * distance.max())[border_edges(ranked.group[part.faces])].all(axis=1)
        if far.sum() > MAX_BORDER * len(part.faces):
            return None
        count = max(HAND_ENSEMBLE * self.network.points, TRACKED_POINTS)
        samples = SurfacePoints.of(part, count, generator(self.seed, 2 + SIDES.index(side)), ranked)
        samples = SurfacePoints(kept[samples.corners], samples.barycentric)
        points, moved = SurfaceSample.of(samples, mesh.vertices), weight > LEAST_SHARE
        queries = points[:TRACKED_POINTS]
        if by_vertex:
            around = mesh.faces[moved[mesh.faces.T].any(axis=0)]
            queries = SurfaceSample(mesh.vertices[moved], vertex_normals(mesh.vertices, around)[moved])
        base = self.joints.index(f"{side}FingerBase") if f"{side}FingerBase" in self.joints else hand
        return Hand(side, hand, base, mesh.rig, samples, points, np.flatnonzero(moved), queries)


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
        near = np.zeros(len(mesh.vertices), bool)
        for side in SIDES:
            wrist, elbow = (rig.joints[joints.index(side + part)] for part in ("Hand", "ForeArm"))
            near |= np.linalg.norm(mesh.vertices - wrist, axis=1) < REACH * np.linalg.norm(wrist - elbow)
        weights = np.zeros((len(mesh.vertices), len(joints)))
        if near.any():
            nearest = nearest_points(points, mesh.vertices[near], NEAREST)[1]
            weights[near] = rig.weights[nearest].mean(axis=1)
        return cls(mesh.vertices, mesh.faces, rig, weights)


@dataclass(frozen=True, eq=False)
class Hand:
    """The part of a mesh that is a hand, in one frame."""

    side: str
    """Left or Right."""
    joint: int
    """Index of the hand's joint."""
    base: int
    """Index of the joint that carries the fingers: the base of all fingers, or the hand."""
    rig: Rig
    """Joints of the body."""
    surface: SurfacePoints
    """Points of the hand, HAND_ENSEMBLE times as many as one prediction takes, or more."""
    samples: SurfaceSample
    """The same points in this frame."""
    vertices: Int[np.ndarray, " V"]
    """Vertices that the hand moves."""
    queries: SurfaceSample
    """Points whose weights are predicted."""

    @property
    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """World rotation of the hand's joint."""
        return self.rig.rotation[self.joint]

    @property
    def position(self) -> Float[np.ndarray, " 3"]:
        """World position of the hand's joint."""
        return self.rig.joints[self.joint]

    def local(self, points: SurfaceSample) -> SurfaceSample:
        """Express points in the frame of the hand's joint, as those of a left hand."""
        turned = SurfaceSample((points.points - self.position) @ self.rotation, points.normals @ self.rotation)
        return turned if self.side == "Left" else turned.mirrored()

    def fingers(
        self,
        rotation: Float[np.ndarray, "16 3 3"],
        joints: Float[np.ndarray, "16 3"],
        shares: Float[np.ndarray, "Q 16"],
    ) -> Fingers:
        """Return the palm and the fingers of a left hand to the world; the predicted wrist is not needed."""
        if self.side == "Right":
            rotation, joints = mirrored_rotations(rotation), joints * MIRROR
        turned, placed = self.rotation @ rotation, joints @ self.rotation.T + self.position
        return Fingers(self, turned[0], turned[1:], placed[1:], shares)


@dataclass(frozen=True, eq=False)
class Fingers:
    """Fingers of a hand that shows them: its palm and fifteen joints in the world, and the weights of its queries."""

    hand: Hand
    palm: Float[np.ndarray, "3 3"]
    """World rotation of the palm."""
    rotation: Float[np.ndarray, "15 3 3"]
    """World rotation of the finger joints."""
    joints: Float[np.ndarray, "15 3"]
    """Their positions."""
    shares: Float[np.ndarray, "Q 16"]
    """Share of the hand and of its fingers in the weight that the hand has."""

    @property
    def bends(self) -> Float[np.ndarray, "15 3 3"]:
        """Rotation of each joint relative to the palm."""
        return self.palm.T @ self.rotation

    @cached_property
    def tracker(self) -> PartTracker:
        """Tracks the hand, which is the first joint, and its fingers; the queries are the tracked points."""
        joints = np.concatenate([self.hand.position[None], self.joints])
        return PartTracker.of(self.hand.queries.points, self.shares, joints, HAND_PARENTS)


FoundFingers = tuple[Fingers, Fingers]
"""Fingers of one side of both meshes, the identity's first. Shares are those of the identity's vertices, and of the
tracked points of the driving, which is in the reference frame."""


@dataclass(frozen=True, eq=False)
class FingerNetwork:
    """A loaded network."""

    session: InferenceSession
    points: int
    """Points of a hand that one prediction takes."""

    def predict(self, hands: list[Hand]) -> list[Fingers | None]:
        """Predict the fingers of hands; None for a hand that does not show any, or whose predictions differ."""
        samples = [hand.local(hand.samples) for hand in hands]
        parts = [[of[k::HAND_ENSEMBLE][: self.points] for k in range(HAND_ENSEMBLE)] for of in samples]
        # Each hand has another number of queries, so the first predictions are single runs.
        first = [
            self._run_in_chunks(part[0], hand.local(hand.queries)) for hand, part in zip(hands, parts, strict=True)
        ]
        shown = [h for h, outputs in enumerate(first) if outputs.separate[0] > 0]
        found: list[Fingers | None] = [None] * len(hands)
        if not shown:
            return found
        others = [points for h in shown for points in parts[h][1:]]
        further = self._run(others, [points[:1] for points in others])  # the network takes no empty queries
        more = HAND_ENSEMBLE - 1
        for k, h in enumerate(shown):
            of_hand = slice(k * more, (k + 1) * more)
            rotations = np.concatenate([first[h].rotation, further.rotation[of_hand]])
            joints = np.concatenate([first[h].joints, further.joints[of_hand]])
            mean = mean_rotation(rotations)
            if np.median(angles_between(rotations, mean).mean(axis=1)) < MAX_SPREAD:
                found[h] = hands[h].fingers(mean, joints.mean(axis=0), softmax(first[h].scores[0]))
        return found

    def _run_in_chunks(self, points: SurfaceSample, queries: SurfaceSample) -> _Outputs:
        """Run the network on one hand with any number of queries, CHUNK at a time."""
        outputs = [self._run([points], [queries[k : k + CHUNK]]) for k in range(0, len(queries), CHUNK)]
        # All but the scores are the same for all chunks: they do not depend on the queries.
        return dataclasses.replace(outputs[0], scores=np.concatenate([part.scores for part in outputs], axis=1))

    def _run(self, points: list[SurfaceSample], queries: list[SurfaceSample]) -> _Outputs:
        given = {
            name: np.stack([getattr(part, field) for part in parts]).astype(np.float32)
            for parts, names in ((points, ("points", "normals")), (queries, ("vertices", "vertex_normals")))
            for name, field in zip(names, ("points", "normals"), strict=True)
        }
        found = self.session.run(["rotation", "joints", "scores", "separate"], given)
        return _Outputs(*(np.asarray(array).astype(np.float64) for array in found))


@dataclass(frozen=True, eq=False)
class _Outputs:
    """What the network returns for B hands."""

    rotation: Float[np.ndarray, "B 16 3 3"]
    joints: Float[np.ndarray, "B 16 3"]
    scores: Float[np.ndarray, "B V 16"]
    separate: Float[np.ndarray, " B"]


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
        tracked = [driving.hand.surface for _, driving in hands]
        samples = SurfacePoints(
            np.concatenate([points.corners[:TRACKED_POINTS] for points in tracked]),
            np.concatenate([points.barycentric[:TRACKED_POINTS] for points in tracked]),
        )
        return cls(
            [driving.hand.base for _, driving in hands],
            samples,
            PartTracker.stacked(driving.tracker for _, driving in hands),
            np.stack([driving.palm[None] for _, driving in hands]),
            np.stack([driving.rotation for _, driving in hands]),
            np.stack([(own.hand.rig.rotation[own.hand.base].T @ own.palm)[None] for own, _ in hands]),
        )

    def bends(
        self, points: Float[np.ndarray, "*T N 3"]
    ) -> tuple[Float[np.ndarray, "*T H 15 3 3"], Float[np.ndarray, "*T H 15 3"]]:
        """Return rotations of the finger joints relative to the palm, and their positions, from the tracked points."""
        by_hand = points.reshape(*points.shape[:-2], len(self.bases), -1, 3)
        motion, positions = self.tracker.follow(by_hand)
        palm = motion[..., :1, :, :] @ self.palm
        return palm.swapaxes(-1, -2) @ motion[..., 1:, :, :] @ self.rotation, positions[..., 1:, :]


def with_fingers(
    rig: Rig, joints: tuple[str, ...], parents: tuple[int, ...], found: Sequence[tuple[Fingers, Bends]]
) -> tuple[Rig, tuple[str, ...], tuple[int, ...]]:
    """Add fingers to a rig, its joints and parents; the body's joints stay where they are.

    Of the body's joints of a hand, only the hand and the base of all fingers keep weights: those of the palm.

    Args:
        found: hands, and the rotation of each finger joint relative to the palm at rest.
    """
    rotation, positions, weights = [rig.rotation], [rig.joints], [rig.weights.copy() if found else rig.weights]
    for fingers, bends in found:
        mine = fingers.hand
        of_hand, palm = hand_joints(joints, mine.side), list(dict.fromkeys([mine.joint, mine.base]))
        # The rest of what the hand moves than the vertices whose shares are known belongs to the palm.
        rows = np.flatnonzero(weights[0][:, of_hand].any(axis=1))
        shares = np.eye(1, 16).repeat(len(rows), axis=0)
        shares[np.searchsorted(rows, mine.vertices)] = fingers.shares
        mass = weights[0][rows][:, of_hand].sum(axis=1, keepdims=True)
        kept = weights[0][rows][:, palm] + TINY
        weights[0][rows[:, None], of_hand] = 0.0
        weights[0][rows[:, None], palm] = mass * shares[:, :1] * kept / kept.sum(axis=1, keepdims=True)
        weights.append(np.zeros((len(weights[0]), 15)))
        weights[-1][rows] = mass * shares[:, 1:]
        rotation.append(fingers.palm @ bends)
        positions.append(fingers.joints)
        parents += tuple(mine.base if parent == 0 else len(joints) + parent - 1 for parent in HAND_PARENTS[1:])
        joints += finger_joints(mine.side)
    return Rig(np.concatenate(rotation), np.concatenate(positions), np.concatenate(weights, axis=1)), joints, parents


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
        bends, places = tracker.bends(tracker.samples.points(vertices))
        fingers = rotation[tracker.bases][:, None] @ tracker.to_palm @ bends
        return (
            np.concatenate([rotation, fingers.reshape(-1, 3, 3)]),
            np.concatenate([positions, places.reshape(-1, 3)]),
        )

    return follow_all
