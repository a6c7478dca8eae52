"""mime as an ONNX file: predict the joints of both meshes, fit the shipped body to them, then track each frame.

A prediction is one run of the network on points sampled from a surface. Its inputs are "points", "normals" (1, N, 3) of
the samples and "vertices", "vertex_normals" (1, V, 3), points of the same mesh whose skinning weights are wanted; its
outputs "rotation" (1, J, 3, 3) and "joints" (1, J, 3), in the world, and "scores" (1, V, J), whose softmax over the
joints is the skinning weights. Any unit and position will do; normals that are not known are zero.

Preparing (once): several predictions of the identity and of keyframes of the driving, a consensus of each, and a fit of
the body to both surfaces. A frame: the joints' rotations by least squares over tracked points (`part_tracking.py`),
then linear blend skinning.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float

from ...core.canonical_order import canonical_faces, canonical_order
from ...core.geometry import vertex_normals
from ...core.joint_tracks import FootJoints, sole_depths
from ...core.mesh import Clip, Mesh
from ...core.rig import Rig, leg_length
from ...core.skinning import SkinnedMesh
from ...core.surface_points import SurfacePoints
from ..base import Pose, SkinnedDrive
from ..confidence import Confidence, mean_angle
from ..npt import batch_of_one, generator
from .body_fit import SurfaceSample, fit_body, sampled_body
from .denoise import Denoiser, face_outward
from .part_tracking import PartTracker, mean_rotation
from .weight_cleanup import clean_weights

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

CHUNK = 16_384
"""Vertices whose weights are predicted in one run: bounds the memory."""
ENSEMBLE, WEIGHT_ENSEMBLE = 8, 3
"""Predictions of a mesh, each from other samples, whose consensus is taken; and how many of them predict weights."""
TRACKED = 2
"""Every TRACKED-th sample is tracked through a clip."""
RETRIES, DISAGREEMENT = 4, 15.0
"""Further keyframes that may serve as the reference, if predictions carried back to it by the motion differ from their
consensus by more than this angle (degrees, median)."""
Queries = tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "V 3"]]
"""Points and normals of a mesh whose weights are wanted."""


@dataclass(frozen=True, eq=False)
class KeyframePrediction:
    """Consensus of the predictions of all keyframes, carried to one of them, the reference."""

    reference: int
    """Which keyframe."""
    points: Float[np.ndarray, "N 3"]
    """Tracked points in the reference."""
    consensus: Rig
    """Weights are those of the tracked points."""
    leg: float
    """Length of a leg."""
    confidence: Confidence


@dataclass(frozen=True, eq=False)
class MimeMethod:
    """A loaded network, ready for any identity."""

    rough: ClassVar[bool] = False
    skinned: ClassVar[bool] = True
    name: str
    session: InferenceSession
    joints: tuple[str, ...]
    """Their names."""
    parents: tuple[int, ...]
    legs: tuple[tuple[int, ...], ...]
    """Joints from hip to ankle."""
    points: int
    """Samples of a prediction."""
    fits: bool = True
    """Whether the prediction is the start of a fit of the shipped body, where these are its joints."""
    seed: int = 0

    @property
    def fits_body(self) -> bool:
        """Whether the shipped body is fitted: `fits`, and the network's joints are the body's."""
        return self.fits and self.joints == sampled_body().names

    def prepare(self, identity: Mesh, driving: Clip) -> SkinnedDrive:
        """Predict the identity and the driving's keyframes, once; every frame is then measured against those."""
        ranked = canonical_order(identity.vertices)
        with ThreadPoolExecutor(1) as beside:
            identity_rig = beside.submit(self._rig, face_outward(identity))
            follow, keyframes = self._follow(dataclasses.replace(driving, mesh=face_outward(driving.mesh)))
            rig, confidence = identity_rig.result()
        vertices = ranked.merge(identity.vertices)
        feet = self._foot_joints()
        return SkinnedDrive(
            joints=self.joints,
            rig=dataclasses.replace(rig, weights=rig.weights[ranked.group]),
            skinned=SkinnedMesh.of(vertices, rig, self.parents),
            follow=follow,
            stride=leg_length(rig.joints, self.legs) / keyframes.leg,
            feet=FootJoints(
                feet,
                keyframes.leg,
                sole_depths(rig, vertices, feet),
                sole_depths(keyframes.consensus, keyframes.points, feet),
            ),
            group=ranked.group,
            name=driving.mesh.name,
            confidence=(_of_kind(confidence, identity), _of_kind(keyframes.confidence, driving.mesh)),
        )

    def quick_predict(self, mesh: Mesh) -> tuple[float, Float[np.ndarray, "3 3"]]:
        """Mean entropy of the skinning weights of a mesh in one prediction, and the rotation of its root joint."""
        mesh = face_outward(mesh)
        mesh = dataclasses.replace(mesh, vertices=Denoiser.of(mesh)(mesh.vertices))
        samples = SurfacePoints.of(mesh, self.points, generator(self.seed, 0))
        queries = (samples.points(mesh.vertices), samples.normals(mesh.vertices))
        rig = self._predict(samples, mesh.vertices, queries)
        return Confidence.of(0.0, rig.weights, self.joints, self.parents).weight_entropy, rig.rotation[0]

    def _foot_joints(self) -> tuple[int, ...]:
        """Ankles and their children."""
        ankles = [leg[-1] for leg in self.legs]
        return tuple(j for j, parent in enumerate(self.parents) if j in ankles or parent in ankles)

    def _rig(self, mesh: Mesh) -> tuple[Rig, Confidence]:
        """Joints of a mesh and skinning weights of its distinct positions: the consensus of several predictions."""
        ranked = canonical_order(mesh.vertices)
        vertices = ranked.merge(mesh.vertices)
        faces = ranked.group[canonical_faces(mesh.faces, ranked.group)]
        normals = vertex_normals(vertices, faces) if len(faces) else np.zeros_like(vertices)
        denoised = Denoiser.of(mesh)(mesh.vertices)
        samples = SurfacePoints.of(
            dataclasses.replace(mesh, vertices=denoised), ENSEMBLE * self.points, generator(self.seed, 0)
        )
        # Confidence is measured at samples, which are spread evenly over the surface; vertices are not.
        even = samples.part(0, ENSEMBLE)
        queries = np.concatenate([vertices, even.points(denoised)]), np.concatenate([normals, even.normals(denoised)])
        rigs = [
            self._predict(samples.part(k, ENSEMBLE), denoised, queries if k < WEIGHT_ENSEMBLE else None)
            for k in range(ENSEMBLE)
        ]
        consensus = _consensus(rigs)
        weights, even_weights = np.split(consensus.weights, [len(vertices)])
        rig = dataclasses.replace(consensus, weights=clean_weights(weights, vertices, faces, self.parents))
        # Smoothing improves the normals but shrinks the surface: points are taken from the mesh as it was.
        sample = SurfaceSample(samples.points(mesh.vertices), samples.normals(denoised))
        return self._with_fit(rig, self._confidence(rigs, consensus, even_weights), sample)

    def _with_fit(self, rig: Rig, confidence: Confidence, sample: SurfaceSample) -> tuple[Rig, Confidence]:
        """The rig with the joints of the body that fits the surface, where a body is fitted."""
        if not self.fits_body:
            return rig, confidence
        fit = fit_body(sample, rig.rotation, rig.joints)
        rig = dataclasses.replace(rig, rotation=fit.rotation, joints=fit.joints)
        return rig, dataclasses.replace(
            confidence, unmatched_body=fit.unmatched_body, unmatched_surface=fit.unmatched_surface
        )

    def _confidence(self, rigs: list[Rig], consensus: Rig, weights: Float[np.ndarray, "N J"]) -> Confidence:
        spread = float(np.median([mean_angle(rig, consensus) for rig in rigs]))
        return Confidence.of(spread, weights, self.joints, self.parents)

    def _follow(self, keyframes: Clip) -> tuple[Callable[[Float[np.ndarray, "U 3"]], Pose], KeyframePrediction]:
        """How to find the pose of the joints in each frame of a clip.

        In a reference keyframe the network predicts which points belong to which joints. The points are tracked from
        there to the other keyframes, and the rotations predicted in those are carried back by the measured motion. The
        robust mean of all holds for the whole clip, so no frame has errors of its own and what is still stays still.
        The first frame is the first choice of reference, because its facing is known; others are tried if the
        predictions disagree.
        """
        denoiser, frames = Denoiser.of(keyframes.mesh), list(keyframes.vertices)
        denoised = [denoiser(vertices) for vertices in frames]
        mesh = dataclasses.replace(keyframes.mesh, vertices=denoised[0])
        samples = SurfacePoints.of(mesh, ENSEMBLE * self.points, generator(self.seed, 1))
        tracked = samples.part(0, TRACKED)
        best = self._predict_keyframes(samples, frames, denoised, 0)
        for t in range(1, len(denoised), max(1, len(denoised) // RETRIES)):
            if best.confidence.prediction_spread > DISAGREEMENT:
                other = self._predict_keyframes(samples, frames, denoised, t)
                best = min(best, other, key=lambda found: found.confidence.prediction_spread)
        sample = SurfaceSample(samples.points(frames[best.reference]), samples.normals(denoised[best.reference]))
        consensus, confidence = self._with_fit(best.consensus, best.confidence, sample)
        leg = leg_length(consensus.joints, self.legs) if self.fits_body else best.leg
        best = dataclasses.replace(best, consensus=consensus, leg=leg, confidence=confidence)
        tracker = PartTracker.of(best.points, consensus.weights, consensus.joints, self.parents)

        def follow(vertices: Float[np.ndarray, "U 3"]) -> Pose:
            rotation, joints = tracker.follow(tracked.points(vertices))
            return rotation @ consensus.rotation, joints

        return follow, best

    def _predict_keyframes(
        self, samples: SurfacePoints, frames: list[np.ndarray], denoised: list[np.ndarray], t: int
    ) -> KeyframePrediction:
        """The consensus of all keyframes with keyframe t as the reference.

        Points are tracked in `frames` and the network sees them `denoised`.
        """
        tracked, count = samples.part(0, TRACKED), ENSEMBLE if len(denoised) == 1 else 2
        rigs = [self._predict_turned(samples, k, denoised[t], np.eye(3)) for k in range(count)]
        consensus = _consensus(rigs)
        tracker = PartTracker.of(tracked.points(frames[t]), consensus.weights, consensus.joints, self.parents)
        for k, vertices in enumerate(frames):
            if k != t:
                turns = tracker.follow(tracked.points(vertices))[0]
                # The network was trained on people who face +z: the frame is turned back as a whole before it is asked.
                rig = self._predict_turned(samples, k, denoised[k], turns[0])
                back = turns.swapaxes(-1, -2) @ turns[0] @ rig.rotation
                rigs.append(dataclasses.replace(rig, rotation=back))
        joints = consensus.joints
        consensus = _consensus(rigs)
        leg = float(np.median([leg_length(rig.joints, self.legs) for rig in rigs]))
        confidence = self._confidence(rigs, consensus, consensus.weights)
        rig = dataclasses.replace(consensus, joints=joints)
        return KeyframePrediction(t, tracked.points(frames[t]), rig, leg, confidence)

    def _predict_turned(
        self, samples: SurfacePoints, k: int, vertices: Float[np.ndarray, "U 3"], turn: Float[np.ndarray, "3 3"]
    ) -> Rig:
        """Prediction k of a frame turned back by a rotation; the first few predict weights of the tracked points."""
        turned, tracked = vertices @ turn, samples.part(0, TRACKED)
        queries = (tracked.points(turned), tracked.normals(turned)) if k < WEIGHT_ENSEMBLE else None
        return self._predict(samples.part(k, ENSEMBLE), turned, queries)

    def _predict(self, samples: SurfacePoints, vertices: Float[np.ndarray, "U 3"], queries: Queries | None) -> Rig:
        """Run the network: joints from samples of a mesh, and skinning weights of the queries, CHUNK at a time."""
        inputs = {"points": batch_of_one(samples.points(vertices)), "normals": batch_of_one(samples.normals(vertices))}
        points, normals = queries or np.zeros((2, 1, 3))  # the network wants one at least
        weights = []
        for start in range(0, len(points), CHUNK):
            few = slice(start, start + CHUNK)
            inputs |= {"vertices": batch_of_one(points[few]), "vertex_normals": batch_of_one(normals[few])}
            found = self.session.run(["rotation", "joints", "scores"], inputs)
            rotation, joints, scores = (np.asarray(array)[0].astype(np.float64) for array in found)
            weights.append(np.exp(scores - scores.max(axis=1, keepdims=True)))
            weights[-1] /= weights[-1].sum(axis=1, keepdims=True)
        return Rig(rotation, joints, np.concatenate(weights) if queries else np.zeros((0, len(joints))))


def _consensus(rigs: list[Rig]) -> Rig:
    """Robust mean of the rotations, mean of the joints, and mean of the weights where they were predicted."""
    joints = np.mean([rig.joints for rig in rigs], axis=0)
    weights = np.mean([rig.weights for rig in rigs if len(rig.weights)], axis=0)
    return Rig(mean_rotation(np.stack([rig.rotation for rig in rigs])), joints, weights)


def _of_kind(confidence: Confidence, mesh: Mesh) -> Confidence:
    """Without shares of limbs for a point cloud: its points may be denser on one limb than on another."""
    return confidence if len(mesh.faces) else dataclasses.replace(confidence, limbs={}, unmatched_body={})
