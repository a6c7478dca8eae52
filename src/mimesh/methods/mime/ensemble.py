"""Several predictions of a mesh, each from points of its own, and their consensus.

Every second prediction is of the mirror image. Predictions for the keyframes of a clip are carried to one of them, the
reference, by the measured motion of the surface.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ...core.canonical_order import CanonicalOrder
from ...core.mesh import Mesh
from ...core.normalization import ORIENTATIONS, ROTATIONS
from ...core.rig import Rig, leg_length
from ...core.soles import Soles
from ...core.surface_points import SurfacePoints
from ..confidence import Confidence, largest_flexion, mean_angle
from .consensus import CONTRADICTION, agreeing, consensus, faces_away
from .joint_network import JointNetwork, NetworkPoints
from .part_tracking import PartTracker
from .surface_sample import SurfaceSample

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

    def surface(self, frames: list[np.ndarray], denoised: list[np.ndarray]) -> SurfaceSample:
        """Return the samples in the reference; normals are those of the denoised frame, whose surface is smaller."""
        k = self.reference
        return SurfaceSample(self.samples.points(frames[k]), self.samples.normals(denoised[k]))


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Makes ENSEMBLE predictions of a mesh with a network of joints."""

    network: JointNetwork
    parents: tuple[int, ...]
    """Parent of each joint; -1 for the root, which comes first."""
    legs: tuple[tuple[int, ...], ...]
    """Joints of each leg, from hip to ankle."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.network.joints

    def predict(
        self,
        samples: SurfacePoints,
        vertices: Float[np.ndarray, "U 3"],
        k: int,
        queries: NetworkPoints | None = None,
        turn: Float[np.ndarray, "3 3"] | None = None,
    ) -> Rig:
        """Make prediction k of ENSEMBLE for a mesh, from samples of its own; odd ones are of the mirror image."""
        sampled = NetworkPoints.of(samples.part(k, ENSEMBLE), vertices)
        return self.network.predict(sampled, queries, k % 2 == 1, turn)

    def weights(
        self,
        rigs: list[Rig],
        samples: SurfacePoints,
        vertices: Float[np.ndarray, "U 3"],
        queries: NetworkPoints,
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
        weights = self.weights(rigs, samples, denoised[t], NetworkPoints.of(tracked, denoised[t]), turn)
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
        self, points: NetworkPoints, turn: Float[np.ndarray, "3 3"] | None = None
    ) -> tuple[float, Float[np.ndarray, "3 3"]]:
        """Predict once: mean entropy (nats) of the skinning weights of the points, and world rotation of the root."""
        rig = self.network.predict(points, points, turn=turn)
        return Confidence.of(0.0, rig.weights, self.joints, self.parents).weight_entropy, rig.rotation[0]

    def turn_to_stand(
        self, samples: SurfacePoints, vertices: Float[np.ndarray, "U 3"]
    ) -> Float[np.ndarray, "3 3"] | None:
        """Return the rotation after which a mesh that lies or leaps stands and faces +z, as the network knows it best.

        It predicts once in each of the 24 orientations along the axes, and the one with the most decided skinning
        weights says how the hips are turned. None: it is as decided as the mesh stands, or it says that the mesh stands
        and faces away, which has been decided before.
        """
        sampled = NetworkPoints.of(samples.part(0, ENSEMBLE), vertices)
        predictions = [self.predict_once(sampled, turn) for turn in ROTATIONS]
        found = [(entropy, hips) for entropy, hips in predictions if not faces_away(hips)]
        if not found:
            return None
        _, hips = min(found, key=lambda prediction: prediction[0])
        as_it_stands, _ = predictions[ORIENTATIONS.index(("+y", "+z"))]
        entropy, _ = self.predict_once(sampled, hips.T)
        return hips.T if entropy < as_it_stands - DECIDED else None


def sampled_points(
    mesh: Mesh,
    denoised: Float[np.ndarray, "V 3"],
    ranked: CanonicalOrder,
    count: int,
    rng: np.random.Generator,
) -> SurfacePoints:
    """Draw points of a mesh on its denoised vertices; `ranked` is the canonical order of its own ones."""
    unchanged = np.array_equal(denoised, mesh.vertices)
    return SurfacePoints.of(dataclasses.replace(mesh, vertices=denoised), count, rng, ranked if unchanged else None)
