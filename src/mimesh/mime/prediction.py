"""Predict the joints of a mesh several times, each from points of its own, and take the consensus.

A surface is prepared first: noise makes areas and normals meaningless, from which the network's input is sampled,
inverted faces the normals. Then the network predicts joints of the mesh from sampled points, and skinning weights of
any points; every second prediction is of the mirror image. Those that agree are averaged, those that contradict them
are left out. Predictions for the keyframes of a clip are carried to one of them, the reference, by the measured motion
of the surface.

Inputs of the ONNX file are "points" and "normals" (1, N, 3) of the samples, and "vertices" and "vertex_normals"
(1, V, 3), points of the same mesh at which weights are predicted. Outputs are "rotation" (1, J, 3, 3) and "joints"
(1, J, 3), in the world, and "scores" (1, V, J), whose softmax over the joints gives the skinning weights. Any unit and
position will do; normals that are not known are zero.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..bodies.joint_names import other_side
from ..core.canonical_order import CanonicalOrder, canonical_order
from ..core.geometry import MIRROR, angles_between, distinct_rows, edges, face_vectors, links, mirrored_rotations, weld
from ..core.mesh import Mesh
from ..core.normalization import ORIENTATIONS, ROTATIONS
from ..core.rig import Rig, leg_length
from ..core.soles import Soles
from ..core.surface_points import SurfacePoints, batch_of_one
from ..rigs.confidence import Confidence, largest_flexion, mean_angle
from .body_fit import SurfaceSample
from .part_tracking import PartTracker, mean_rotation

if TYPE_CHECKING:
    from onnxruntime import InferenceSession
    from scipy.sparse import csr_array

NOISY, SMOOTH = 0.25, 0.05
"""Share of folded edges (more than a right angle between the faces) from which on a surface is smoothed, and down to
which. Meshes without noise have 0.005 to 0.07, coarse ones up to 0.2; noise of 1 % of the size makes 0.4."""
INVERTED = -3e-3
"""Enclosed volume over area to the power of 1.5 below which a mesh is taken to be inside out; people: about 0.03."""
BACKS = 0.25
"""Share of faces that are there twice from which on one of each is kept; decimated meshes have a few."""
MAX_ROUNDS = 12
"""Rounds of smoothing after which a surface is left as it is."""
CHUNK = 16_384
"""Vertices whose weights are predicted in one run of the network; bounds the memory."""
CONTRADICTION, FACES_AWAY = 60.0, 0.1
"""Mean angle between the joint rotations (degrees) from which on two predictions contradict each other, and the vote of
a prediction whose root is upright and faces away from +z beside the vote 1 of the others."""
ENSEMBLE, WEIGHT_ENSEMBLE = 8, 3
"""Predictions for a mesh, each from other samples, whose consensus is taken; and how many of those that agree predict
weights too (of 6,890 vertices they cost four times as much as the joints)."""
REFERENCE_ENSEMBLE = 4
"""Predictions for the reference among the keyframes of a clip; each other keyframe gets one."""
TRACKED = 2
"""Every TRACKED-th sample is tracked through a clip."""
DECIDED = 0.05
"""Decrease of the skinning weights' mean entropy (nats) from which on another orientation is taken."""


@dataclass(frozen=True, eq=False)
class JointNetwork:
    """A loaded network, and several predictions of a mesh with it."""

    session: InferenceSession
    joints: tuple[str, ...]
    """Names of the joints."""
    parents: tuple[int, ...]
    """Parent of each joint; -1 for the root, which comes first."""
    legs: tuple[tuple[int, ...], ...]
    """Joints of each leg, from hip to ankle."""

    def run(
        self,
        samples: SurfaceSample,
        queries: SurfaceSample | None,
        mirrored: bool = False,
        turn: Float[np.ndarray, "3 3"] | None = None,
    ) -> Rig:
        """Predict joints from samples of a mesh, and skinning weights of the queries, CHUNK at a time.

        With `mirrored` the network gets the mirror image, and its prediction is mirrored back: its errors are others,
        so the mean of both kinds is nearer to the truth than that of as many of one kind. With `turn` it gets the mesh
        after this rotation, which is undone in the prediction.
        """
        if turn is not None:
            rig = self.run(samples.turned(turn), queries and queries.turned(turn), mirrored)
            return Rig(turn.T @ rig.rotation, rig.joints @ turn, rig.weights)
        if mirrored:
            rig = self.run(samples.mirrored(), queries and queries.mirrored())
            rotation = mirrored_rotations(rig.rotation[self._other_sides])
            return Rig(rotation, rig.joints[self._other_sides] * MIRROR, rig.weights[:, self._other_sides])
        given = {"points": batch_of_one(samples.points), "normals": batch_of_one(samples.normals)}
        at = queries or SurfaceSample(*np.zeros((2, 1, 3)))  # the network takes no empty input
        outputs = []
        for start in range(0, len(at), CHUNK):
            chunk = at[start : start + CHUNK]
            given |= {"vertices": batch_of_one(chunk.points), "vertex_normals": batch_of_one(chunk.normals)}
            found = self.session.run(["rotation", "joints", "scores"], given)
            outputs.append([np.asarray(array)[0].astype(np.float64) for array in found])
        rotation, joints, _ = outputs[-1]  # the same for all chunks: they do not depend on the queries
        weights = [softmax(scores) for _, _, scores in outputs] if queries else [np.zeros((0, len(joints)))]
        return Rig(rotation, joints, np.concatenate(weights))

    @cached_property
    def _other_sides(self) -> list[int]:
        index = {name: j for j, name in enumerate(self.joints)}
        return [index.get(other_side(name), j) for name, j in index.items()]

    def predict(
        self,
        samples: SurfacePoints,
        vertices: Float[np.ndarray, "U 3"],
        k: int,
        queries: SurfaceSample | None = None,
        turn: Float[np.ndarray, "3 3"] | None = None,
    ) -> Rig:
        """Make prediction k of ENSEMBLE for a mesh, from samples of its own; odd ones are of the mirror image."""
        sampled = SurfaceSample.of(samples.part(k, ENSEMBLE), vertices)
        return self.run(sampled, queries, k % 2 == 1, turn)

    def weights(
        self,
        rigs: list[Rig],
        samples: SurfacePoints,
        vertices: Float[np.ndarray, "U 3"],
        queries: SurfaceSample,
        turn: Float[np.ndarray, "3 3"] | None = None,
    ) -> Float[np.ndarray, "V J"]:
        """Predict the weights of the queries: the mean of WEIGHT_ENSEMBLE of the predictions that agree."""
        kept = agreeing(rigs)[:WEIGHT_ENSEMBLE]
        total = np.ascontiguousarray(self.predict(samples, vertices, kept[0], queries, turn).weights)
        for k in kept[1:]:  # one after the other: those of all take several times the memory
            total += self.predict(samples, vertices, k, queries, turn).weights
        total /= len(kept)
        return total

    def confidence(self, rigs: list[Rig], mean: Rig, weights: Float[np.ndarray, "N J"]) -> Confidence:
        """Measure how far predictions are from their consensus, and how decided the weights of even samples are."""
        spread = float(np.median([mean_angle(rig.rotation, mean.rotation) for rig in rigs]))
        confidence = Confidence.of(spread, weights, self.joints, self.parents)
        return dataclasses.replace(confidence, flexion=largest_flexion(mean.joints, self.joints))

    def predict_keyframes(
        self,
        samples: SurfacePoints,
        frames: list[np.ndarray],
        denoised: list[np.ndarray],
        t: int,
        turn: Float[np.ndarray, "3 3"] | None = None,
    ) -> KeyframePrediction:
        """Return the consensus of the predictions for all keyframes, with keyframe t as the reference.

        Points are tracked in `frames`; the network's input is taken from the same frames `denoised`, after the rotation
        `turn`.
        """
        # Other keyframes add one prediction each; a single pose gets the whole ensemble.
        tracked, count = samples.part(0, TRACKED), ENSEMBLE if len(denoised) == 1 else REFERENCE_ENSEMBLE
        rigs = [self.predict(samples, denoised[t], k, turn=turn) for k in range(count)]
        weights = self.weights(rigs, samples, denoised[t], SurfaceSample.of(tracked, denoised[t]), turn)
        joints = consensus(rigs).joints  # positions are those of the reference; only rotations are carried back
        tracker = PartTracker.of(tracked.points(frames[t]), weights, joints, self.parents)
        for k, vertices in enumerate(frames):
            if k != t:
                motion = tracker.follow(tracked.points(vertices))[0]  # rotations from the reference to this keyframe
                # The network was trained on people who face +z: the frame is turned back by the motion of the root.
                rig = self.predict(samples, denoised[k] @ motion[0], k % ENSEMBLE, turn=turn)
                # Undo that turn, then the motion of each joint: the rotations as they would be in the reference.
                in_reference = motion.swapaxes(-1, -2) @ motion[0] @ rig.rotation
                rigs.append(dataclasses.replace(rig, rotation=in_reference))
        mean = consensus(rigs)
        leg = float(np.median([leg_length(rig.joints, self.legs) for rig in rigs]))
        confidence = self.confidence(rigs, mean, weights)
        if min(agreeing(rigs)) >= count:  # joints and weights of the reference do not belong to these rotations
            confidence = dataclasses.replace(confidence, prediction_spread=CONTRADICTION)
        rig = Rig(mean.rotation, joints, weights)
        return KeyframePrediction(t, tracked.points(frames[t]), rig, tuple(rigs[:count]), leg, confidence, samples)

    def predict_once(
        self, points: SurfaceSample, turn: Float[np.ndarray, "3 3"] | None = None
    ) -> tuple[float, Float[np.ndarray, "3 3"]]:
        """Predict once: mean entropy (nats) of the skinning weights of the points, and world rotation of the root."""
        rig = self.run(points, points, turn=turn)
        return Confidence.of(0.0, rig.weights, self.joints, self.parents).weight_entropy, rig.rotation[0]

    def turn_to_stand(
        self, samples: SurfacePoints, vertices: Float[np.ndarray, "U 3"]
    ) -> Float[np.ndarray, "3 3"] | None:
        """Return the rotation after which a mesh that lies or leaps stands and faces +z, as the network knows it best.

        It predicts once in each of the 24 orientations along the axes, and the one with the most decided skinning
        weights says how the hips are turned. None: it is as decided as the mesh stands, or it says that the mesh stands
        and faces away, which has been decided before.
        """
        sampled = SurfaceSample.of(samples.part(0, ENSEMBLE), vertices)
        predictions = [self.predict_once(sampled, turn) for turn in ROTATIONS]
        found = [(entropy, hips) for entropy, hips in predictions if not faces_away(hips)]
        if not found:
            return None
        _, hips = min(found, key=lambda prediction: prediction[0])
        as_it_stands, _ = predictions[ORIENTATIONS.index(("+y", "+z"))]
        entropy, _ = self.predict_once(sampled, hips.T)
        return hips.T if entropy < as_it_stands - DECIDED else None


@dataclass(frozen=True, eq=False)
class KeyframePrediction:
    """Consensus of the predictions for all keyframes, carried to one of them, the reference."""

    reference: int
    """Index of the keyframe."""
    points: Float[np.ndarray, "N 3"]
    """Tracked points in the reference."""
    consensus: Rig
    """Joints in the reference, and skinning weights of the tracked points."""
    predictions: tuple[Rig, ...]
    """The predictions for the reference alone."""
    leg: float
    """Length of a leg, in the normalised frame of the driving."""
    confidence: Confidence
    samples: SurfacePoints
    """All samples of the surface, more than are tracked."""
    soles: Soles = ()
    """Contact points of the soles, as indices of samples."""
    body: Int[np.ndarray, " B"] | None = None
    """Outermost points of the rest of the body, as indices of samples."""

    def surface(self, frames: list[np.ndarray], denoised: list[np.ndarray]) -> SurfaceSample:
        """Return the samples in the reference; normals are those of the denoised frame, whose surface is smaller."""
        k = self.reference
        return SurfaceSample(self.samples.points(frames[k]), self.samples.normals(denoised[k]))


def agreeing(rigs: list[Rig]) -> list[int]:
    """Return the indices of the predictions that agree with the one that most agree with, nearest to it first.

    Where the front of a figure looks like its back, predictions contradict each other, and a mean of contradictions is
    none of them. Predictions of a person who faces away count for less, because the facing of the mesh has been decided
    before (docs/log/mime.md, "Agreement").
    """
    rotations = np.stack([rig.rotation for rig in rigs])
    angles = angles_between(rotations, rotations[:, None]).mean(axis=-1)
    votes = np.array([FACES_AWAY if faces_away(rig.rotation[0]) else 1.0 for rig in rigs])
    # Of those with the same votes, the one nearest to the others: the second term is below the smallest vote.
    centre = angles[((angles < CONTRADICTION) @ votes - FACES_AWAY * angles.mean(axis=1) / 180).argmax()]
    return [int(k) for k in np.argsort(centre, kind="stable") if centre[k] < CONTRADICTION]


def faces_away(root: Float[np.ndarray, "3 3"]) -> bool:
    """Tell whether a figure with this rotation of its root joint is upright and faces away from +z."""
    return bool(root[1, 1] > 0 and root[2, 2] <= 0)


def consensus(rigs: list[Rig]) -> Rig:
    """Average the joints of the predictions that agree: robust mean of rotations, mean of positions; no weights."""
    kept = [rigs[k] for k in agreeing(rigs)]
    joints = np.mean([rig.joints for rig in kept], axis=0)
    return Rig(mean_rotation(np.stack([rig.rotation for rig in kept])), joints, np.zeros((0, len(joints))))


def sampled_points(
    mesh: Mesh, denoised: Float[np.ndarray, "V 3"], ranked: CanonicalOrder, count: int, rng: np.random.Generator
) -> SurfacePoints:
    """Draw points of a mesh on its denoised vertices; `ranked` is the canonical order of its own ones."""
    unchanged = np.array_equal(denoised, mesh.vertices)
    return SurfacePoints.of(dataclasses.replace(mesh, vertices=denoised), count, rng, ranked if unchanged else None)


@dataclass(frozen=True, eq=False)
class Denoiser:
    """A mesh topology that smooths noisy frames, and returns all others unchanged to the last bit."""

    ranked: CanonicalOrder
    """Distinct positions of the mesh: seams are smoothed as if they were welded."""
    faces: Int[np.ndarray, "F 3"]
    """Faces between distinct positions."""
    adjacent: Int[np.ndarray, "P 2"]
    """Pairs of faces that share an edge; none for a point cloud."""

    @classmethod
    def of(cls, mesh: Mesh, ranked: CanonicalOrder | None = None) -> Denoiser:
        """Make the denoiser for all frames of a mesh; `ranked` is the canonical order of its vertices, if known."""
        ranked = canonical_order(mesh.vertices) if ranked is None else ranked
        faces = ranked.group[mesh.faces]
        if len(faces) == 0:
            return cls(ranked, faces, np.zeros((0, 2), np.int64))
        # Faces that share an edge and wind alike: one has it from a to b, the other from b to a.
        start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
        rising, falling = np.flatnonzero(start < end), np.flatnonzero(start > end)
        # A rising edge and the falling one with the same number are the two sides of one edge.
        number = np.maximum(start, end) * (faces.max() + 1) + np.minimum(start, end)
        falling = falling[np.argsort(number[falling], kind="stable")]
        position = np.searchsorted(number[falling], number[rising])
        found = position < len(falling)
        rising, opposite = rising[found], falling[position[found]]
        shared = number[rising] == number[opposite]
        return cls(ranked, faces, np.stack([rising[shared] // 3, opposite[shared] // 3], axis=1))

    @cached_property
    def mean(self) -> csr_array:
        """(W, W): the mean of every point and its neighbours. Made when first needed: few meshes are noisy."""
        from scipy.sparse import csr_array, diags_array, eye_array

        neighbours = links(edges(self.faces), len(self.ranked)) + eye_array(len(self.ranked))
        return csr_array(diags_array(1 / neighbours.sum(axis=1)) @ neighbours)

    def __call__(self, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
        """Smooth a frame, replacing points by the mean of their neighbourhood until few edges are folded."""
        points = self.ranked.merge(vertices)
        if self.folded_share(points) < NOISY:
            return vertices
        for _ in range(MAX_ROUNDS):
            points = self.mean @ points
            if self.folded_share(points) < SMOOTH:
                break
        return points[self.ranked.group]

    def folded_share(self, points: Float[np.ndarray, "W 3"]) -> float:
        """Return the share of edges whose two faces have normals more than 90 degrees apart."""
        first, second = face_vectors(points, self.faces)[self.adjacent.T]
        return float(((first * second).sum(axis=1) < 0).mean()) if len(self.adjacent) else 0.0


def face_outward(mesh: Mesh) -> Mesh:
    """Reverse all faces of a mesh that is inside out, as after a mirroring, and keep one of faces drawn twice."""
    corners = np.sort(weld(mesh.vertices)[1][mesh.faces], axis=1)
    first, _ = distinct_rows(list(corners.T))
    # Programs for interiors write each face with its back, in the opposite winding: half of the normals would point
    # inwards. The first of two is the front; fewer than BACKS stay, so that the order of faces says nothing elsewhere.
    if len(corners) - len(first) > BACKS * len(corners):
        kept = mesh.faces[np.sort(first)]
        mesh = dataclasses.replace(mesh, faces=kept, corner_uv=None, corner_normals=None, parts=())
    vectors = face_vectors(mesh.vertices - mesh.vertices.mean(axis=0), mesh.faces)
    corners = mesh.vertices[mesh.faces[:, 0]] - mesh.vertices.mean(axis=0)
    # The signed volumes of the tetrahedra from the centroid to each face add up to the enclosed volume.
    volume, area = (corners * vectors).sum() / 6, np.linalg.norm(vectors, axis=1).sum() / 2
    return dataclasses.replace(mesh, faces=mesh.faces[:, ::-1]) if volume < INVERTED * area**1.5 else mesh


def softmax(scores: Float[np.ndarray, "V J"]) -> Float[np.ndarray, "V J"]:
    """Compute skinning weights from scores; subtracting the largest score first keeps the exponentials finite."""
    weights = np.exp(scores - scores.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    return weights
