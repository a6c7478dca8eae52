"""mime as an ONNX file: predict the joints of both meshes, fit the shipped body to them, then track each frame.

A prediction is one run of the network on points sampled from a surface (`prediction.py`); every second one is of the
mirror image.

Preparing (once): several predictions for the identity and for keyframes of the driving, a consensus of each, and a fit
of the body to both surfaces. Each frame: the joints' rotations by least squares over tracked points
(`part_tracking.py`), then linear blend skinning.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Float, Int

from ...bodies.anatomy import anatomy_of
from ...bodies.sampled_body import PosedBody
from ...core.canonical_order import CanonicalOrder, canonical_faces, canonical_order
from ...core.errors import InputError
from ...core.geometry import closest_on_mesh, vertex_normals
from ...core.joint_tracks import JointTrack
from ...core.mesh import Clip, Mesh
from ...core.rig import Rig, leg_length
from ...core.skinning import SkinnedMesh
from ...core.soles import Feet, Soles, find_soles
from ...core.surface_points import SurfacePoints
from ..base import (
    KnownDriving,
    KnownIdentity,
    LinkedJoints,
    Pose,
    RestPose,
    SkinnedDrive,
    SurfaceMotion,
    linked_to_body,
)
from ..confidence import MAX_UNMATCHED_SURFACE, Confidence
from ..npt import generator
from .body_fit import (
    RELIABLE_MISMATCH,
    BodyFit,
    SurfaceSample,
    fit_body,
    fit_predictions,
    nearest_shares,
    sampled_body,
    whole_body,
)
from .hands import FoundFingers, HandFinder, WeightedMesh, follow_fingers, with_fingers
from .joint_targets import JointTargets
from .kept_results import kept
from .part_tracking import PartTracker
from .prediction import (
    ENSEMBLE,
    TRACKED,
    Denoiser,
    JointNetwork,
    KeyframePrediction,
    NetworkPoints,
    consensus,
    face_outward,
    sampled_points,
)
from .weights import DENSE, CoarseSurface, clean_weights, corrected_weights, with_whole_tail

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

SOLE_SAMPLES = 8192
"""Points of a driving's surface among which those of the soles are, where its joints are known."""
KEPT_RIGS, KEPT_DRIVINGS, KEPT_QUICK = 8, 16, 256
"""How many results are kept (see `kept_results.py`): the weights of 10,000 vertices
take 2.4 MB, a driving 8 MB. One pair may need four rigs: both meshes as both bodies."""
RETRIES, DISAGREEMENT = 4, 15.0
"""How many further keyframes are tried as the reference while the predictions for all keyframes, carried back to the
reference by the measured motion, differ from their consensus by more than this angle (degrees, median)."""
LIE = ("quadruped",)
"""Bodies for which other orientations are tried where the predictions disagree: animals lie on their sides, and trunks
of leaping ones point up or down. Of people figures of blocks became worse (docs/log/animals.md)."""


@dataclass(frozen=True, eq=False)
class IdentityReading:
    """The joints of an identity: of its file, or predicted."""

    vertices: Float[np.ndarray, "W 3"]
    joints: tuple[str, ...]
    parents: tuple[int, ...]
    rig: Rig
    group: Int[np.ndarray, " V"]
    """Index of each vertex of the mesh among `vertices`."""
    legs: tuple[tuple[int, ...], ...]
    leg: float
    confidence: Confidence | None = None
    skinned: SkinnedMesh | None = None
    """The skinned mesh of the file."""


@dataclass(frozen=True, eq=False)
class DrivingReading:
    """The joints of a driving clip: of its file, or predicted and tracked."""

    joints: tuple[str, ...]
    follow: Callable[[Float[np.ndarray, "U 3"]], Pose]
    leg: float
    samples: SurfacePoints
    soles: Soles
    confidence: Confidence | None = None
    keyframes: KeyframePrediction | None = None
    known: JointTrack | None = None
    rest: RestPose | None = None
    """The joints at rest, where the file has them."""


@dataclass(frozen=True, eq=False)
class MimeMethod:
    """The method `mime`: a loaded network, ready for any identity."""

    rough: ClassVar[bool] = False
    skinned: ClassVar[bool] = True
    name: str
    session: InferenceSession
    joints: tuple[str, ...]
    """Names of the network's joints."""
    parents: tuple[int, ...]
    """Parent of each joint; -1 for the root, which comes first."""
    legs: tuple[tuple[int, ...], ...]
    """Joints of each leg, from hip to ankle."""
    points: int
    """Samples of the surface that one prediction takes."""
    body: str = "human"
    """Name of the shipped body."""
    fits: bool = True
    """Fit the shipped body to each surface; has no effect if the network's joints are not the body's."""
    seed: int = 0
    other_bodies: Mapping[str, Callable[[], MimeMethod]] = field(default_factory=dict)
    """Name of each other body that there is a network for -> opens it."""
    hands: HandFinder | None = None
    """Finds hands that show fingers; without it fingers follow the hand."""
    identity_targets: JointTargets | None = None
    """Joints of the identity that the user has corrected."""
    driving_targets: JointTargets | None = None
    """Joints of the driving that the user has corrected, in its last keyframe."""
    motion: SurfaceMotion | None = None
    """Motion of the driving's surface, which says whether fingers ever move; without it the keyframes do."""
    known_identity: KnownIdentity | None = None
    """Joints of the identity that its file has."""
    known_driving: KnownDriving | None = None
    """Joints of the driving that its file has."""

    @cached_property
    def network(self) -> JointNetwork:
        """The network."""
        return JointNetwork(self.session, self.joints, self.parents, self.legs)

    @property
    def kept_key(self) -> Hashable:
        """What results for a mesh depend on besides the mesh; None with corrected joints, which belong to one mesh."""
        if self.identity_targets is not None or self.driving_targets is not None:
            return None
        return self.session, self.body, self.fits, self.seed

    @property
    def trunk(self) -> list[int]:
        """Return the joints of the body's trunk that many rigs lack."""
        return [self.joints.index(name) for name in anatomy_of(self.body).optional_trunk if name in self.joints]

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that there are networks for."""
        return (self.body, *self.other_bodies)

    def of_body(self, body: str) -> MimeMethod:
        """Return this method with the network of another body."""
        return self if body == self.body else dataclasses.replace(self.other_bodies[body](), name=self.name)

    @property
    def fits_body(self) -> bool:
        """Whether a body is fitted: it is not switched off, and the network's joints are the body's."""
        return self.fits and self.joints == sampled_body(self.body).names

    def with_joints(
        self,
        identity: Mapping[str, Float[np.ndarray, " 3"]],
        driving: Mapping[str, Float[np.ndarray, " 3"]],
    ) -> MimeMethod:
        """Return this method with known joints of the identity, and of the driving in its last keyframe."""
        return dataclasses.replace(
            self, identity_targets=self._targets(identity), driving_targets=self._targets(driving)
        )

    def _targets(self, known: Mapping[str, Float[np.ndarray, " 3"]]) -> JointTargets | None:
        if not known:
            return None
        return JointTargets([self.joints.index(name) for name in known], np.array(list(known.values())), self.body)

    def with_rigs(self, identity: KnownIdentity | None, driving: KnownDriving | None) -> MimeMethod:
        """Return this method with the known joints of the identity, of the driving, or of both."""
        return dataclasses.replace(self, known_identity=identity, known_driving=driving)

    def with_motion(self, motion: SurfaceMotion) -> MimeMethod:
        """Return this method with the motion of the driving's surface in more frames than the keyframes."""
        return dataclasses.replace(self, motion=motion)

    def prepare(self, identity: Mesh, driving: Clip) -> SkinnedDrive:
        """Predict the joints of the identity and of the driving's keyframes; later frames are tracked from those.

        Joints that the files have (`with_rigs`) are not predicted.
        """
        identity, driving = face_outward(identity), dataclasses.replace(driving, mesh=face_outward(driving.mesh))
        # The two meshes are independent: the identity is prepared in a second thread.
        with ThreadPoolExecutor(1) as executor:
            reading = executor.submit(self._read_identity, identity)
            theirs = self._read_driving(driving)
            mine = reading.result()
        full_rig, joints, parents, follow = mine.rig, mine.joints, mine.parents, theirs.follow
        if mine.skinned is None and theirs.keyframes is not None:  # both were predicted, so fingers may be, too
            body = WeightedMesh(mine.vertices, mine.group[identity.faces], mine.rig, mine.rig.weights)
            fingers = self._moving_fingers(body, driving, theirs.keyframes)
            full_rig, joints, parents = with_fingers(mine.rig, joints, parents, fingers)
            follow = follow_fingers(follow, fingers)
        skinned = mine.skinned or SkinnedMesh.of(mine.vertices, full_rig, parents)
        confidences = mine.confidence, theirs.confidence
        return SkinnedDrive(
            joints=joints,
            rig=dataclasses.replace(full_rig, weights=full_rig.weights.take(mine.group, axis=0)),
            skinned=skinned,
            follow=follow,
            # Steps scale with the length of the legs.
            stride=mine.leg / theirs.leg,
            feet=_feet(mine, theirs, skinned),
            group=mine.group,
            name=driving.mesh.name,
            confidence=confidences if any(confidences) else None,
            known=theirs.known,
            linked=self._linked(theirs),
        )

    def _read_identity(self, mesh: Mesh) -> IdentityReading:
        """Return the joints of the identity: those of its file, else predicted ones."""
        known = self.known_identity
        if known is not None:
            group = np.arange(len(mesh.vertices))
            of_file = (known.joints, known.parents, known.rig, group, known.legs, known.leg)
            return IdentityReading(mesh.vertices, *of_file, skinned=known.skinned)
        ranked = canonical_order(mesh.vertices)
        rig, confidence = self._rig(mesh)
        leg = leg_length(rig.joints, self.legs)
        merged = (ranked.merge(mesh.vertices), self.joints, self.parents, rig, ranked.group, self.legs, leg)
        return IdentityReading(*merged, confidence=_without_shares(confidence, mesh))

    def _read_driving(self, clip: Clip) -> DrivingReading:
        """Return the joints of the driving: those of its file, else predicted and tracked ones."""
        known = self.known_driving
        if known is None:
            follow, keyframes = self._follow(clip)
            confidence = _without_shares(keyframes.confidence, clip.mesh)
            return DrivingReading(
                self.joints, follow, keyframes.leg, keyframes.samples, keyframes.soles, confidence, keyframes
            )
        samples = SurfacePoints.of(clip.mesh, SOLE_SAMPLES, generator(self.seed, 1))
        soles = known.soles(samples, clip.vertices[0])
        return DrivingReading(known.joints, _unread, known.leg, samples, soles, known=known.track, rest=known.rest)

    def _linked(self, theirs: DrivingReading) -> LinkedJoints | None:
        """Return which joint of the driving each joint of the identity follows, where the two have not the same."""
        if self.known_identity is not None:
            return self.known_identity.linked(theirs.joints, theirs.rest)
        if theirs.known is None:
            return None
        return linked_to_body(self.joints, self.parents, theirs.joints)

    def _moving_fingers(
        self, identity: WeightedMesh, driving: Clip, keyframes: KeyframePrediction
    ) -> list[FoundFingers]:
        """Find the hands of which both meshes show the fingers, and the driving bends them otherwise."""
        if self.hands is None:
            return []

        def reference() -> WeightedMesh:
            mesh = dataclasses.replace(driving.mesh, vertices=driving.vertices[keyframes.reference])
            return WeightedMesh.of_points(mesh, keyframes.consensus, keyframes.points, self.joints)

        def keyframes_of(samples: SurfacePoints) -> Float[np.ndarray, "T N 3"]:
            return np.stack([samples.points(vertices) for vertices in driving.vertices])

        return self.hands.find_moving(identity, reference, self.motion or keyframes_of)

    def predict_rig(self, mesh: Mesh) -> tuple[Rig, Confidence]:
        """Predict the joints of a normalised mesh, whatever its file has, and their weights of its vertices."""
        mesh = face_outward(mesh)
        rig, confidence = self._rig(mesh)
        group = canonical_order(mesh.vertices).group
        return dataclasses.replace(rig, weights=rig.weights.take(group, axis=0)), _without_shares(confidence, mesh)

    @kept(most=KEPT_QUICK)
    def quick_predict(self, mesh: Mesh) -> tuple[float, Float[np.ndarray, "3 3"]]:
        """Predict once: mean entropy (nats) of the skinning weights of a mesh, and world rotation of its root joint."""
        mesh = face_outward(mesh)
        samples, denoised = self._sampled(mesh, canonical_order(mesh.vertices), 1)
        return self.network.predict_once(NetworkPoints.of(samples, denoised))

    @kept(most=KEPT_RIGS)
    def _rig(self, mesh: Mesh) -> tuple[Rig, Confidence]:
        """Predict the joints of a mesh and the skinning weights of its distinct positions: a consensus of ENSEMBLE."""
        ranked = canonical_order(mesh.vertices)
        vertices = ranked.merge(mesh.vertices)
        faces = ranked.group[canonical_faces(mesh.faces, ranked.group)]
        coarse = CoarseSurface.of(vertices, faces) if len(vertices) > DENSE and len(faces) else None
        if coarse is not None:
            vertices, faces = coarse.points, coarse.faces
        normals = vertex_normals(vertices, faces) if len(faces) else np.zeros_like(vertices)
        samples, denoised = self._sampled(mesh, ranked, ENSEMBLE)
        # Confidence is measured at samples, which are spread evenly over the surface; vertices are not.
        queries = NetworkPoints(vertices, normals).joined(NetworkPoints.of(samples.part(0, ENSEMBLE), denoised))
        rigs = [self.network.predict(samples, denoised, k) for k in range(ENSEMBLE)]
        mean = dataclasses.replace(consensus(rigs), weights=self.network.weights(rigs, samples, denoised, queries))
        # Smoothing improves the normals but shrinks the surface: points are taken from the original mesh.
        sample = SurfaceSample(samples.points(mesh.vertices), samples.normals(denoised))
        confidence = self.network.confidence(rigs, mean, mean.weights[len(vertices) :])
        if self.identity_targets is None:
            rig, confidence, fit = self._with_fit(mean, confidence, sample, rigs)
        else:
            rig, confidence, fit = self._with_corrections(mean, confidence, sample, queries, self.identity_targets)
            confidence = self._with_weights(confidence, rig.weights[len(vertices) :])
        weights, nearest = rig.weights[: len(vertices)], None
        if fit:
            nearest = fit.nearest(vertices)
            weights = fit.blended_weights(weights, nearest)
        weights = with_whole_tail(weights, vertices, faces, self.joints, self.parents)
        weights = clean_weights(weights, vertices, faces, self.parents, nearest, self.trunk)
        weights = weights if coarse is None else coarse.carried(weights)
        return dataclasses.replace(rig, weights=weights), confidence

    def _sampled(
        self, mesh: Mesh, ranked: CanonicalOrder, predictions: int
    ) -> tuple[SurfacePoints, Float[np.ndarray, "V 3"]]:
        """Draw points for some predictions from a mesh, and return its denoised vertices, on which they were drawn."""
        denoised = Denoiser.of(mesh, ranked)(mesh.vertices)
        return sampled_points(mesh, denoised, ranked, predictions * self.points, generator(self.seed, 0)), denoised

    def _with_fit(
        self, rig: Rig, confidence: Confidence, sample: SurfaceSample, predictions: Sequence[Rig]
    ) -> tuple[Rig, Confidence, BodyFit | None]:
        """Replace the joints of a rig, the consensus of predictions, by those of the body fitted to its surface.

        Unchanged if not `fits_body`.
        """
        if not self.fits_body:
            return rig, confidence, None
        fit = fit_predictions(sample, rig, predictions, self.body)
        return dataclasses.replace(rig, rotation=fit.rotation, joints=fit.joints), _with_measures(confidence, fit), fit

    def _cost(self, reading: KeyframePrediction, frames: list[np.ndarray], denoised: list[np.ndarray]) -> float:
        """Measure how badly the body fits a reading of a driving; without a fit, how far its predictions disagree."""
        if not self.fits_body:
            return reading.confidence.prediction_spread
        sample = reading.surface(frames, denoised)
        return fit_predictions(sample, reading.consensus, reading.predictions, self.body).cost

    def _with_corrections(
        self,
        rig: Rig,
        confidence: Confidence,
        sample: SurfaceSample,
        queries: NetworkPoints,
        targets: JointTargets,
    ) -> tuple[Rig, Confidence, BodyFit]:
        """Replace joints and weights of a rig by those of the body that is fitted with some joints at their targets.

        The weights are those of the points `queries`.
        """
        fit = fit_body(sample, *targets.move(rig.rotation, rig.joints), targets, self.body)
        displacement = fit.joints - rig.joints
        weights = corrected_weights(rig.weights, queries.points, queries.normals, displacement, fit.posed)
        return Rig(fit.rotation, fit.joints, weights), _with_measures(confidence, fit), fit

    def _with_weights(self, confidence: Confidence, weights: Float[np.ndarray, "N J"]) -> Confidence:
        """Measure a corrected rig again: predictions may differ where the corrected body covers the surface."""
        measured = Confidence.of(confidence.prediction_spread, weights, self.joints, self.parents)
        confidence = dataclasses.replace(confidence, weight_entropy=measured.weight_entropy, limbs=measured.limbs)
        if confidence.unmatched_surface > MAX_UNMATCHED_SURFACE:
            return confidence
        return dataclasses.replace(confidence, prediction_spread=0.0, fit_angle=0.0, flexion=0.0)

    @kept(most=KEPT_DRIVINGS)
    def _follow(self, keyframes: Clip) -> tuple[Callable[[Float[np.ndarray, "U 3"]], Pose], KeyframePrediction]:
        """Return the function that finds the pose of the joints in each frame of a clip, and what it starts from.

        In a reference keyframe the network predicts which points belong to which joints. The points are tracked from
        there to the other keyframes, and the rotations predicted in those are carried back by the measured motion. The
        robust mean of all is used for the whole clip, so the network's errors are the same in every frame and add no
        jitter. The first frame is the first choice of reference, because its facing is known; others are tried if the
        predictions disagree. Where the user has corrected joints, the reference is the keyframe that this was done in.
        """
        ranked, frames = canonical_order(keyframes.mesh.vertices), list(keyframes.vertices)
        denoiser = Denoiser.of(keyframes.mesh, ranked)
        denoised = [denoiser(vertices) for vertices in frames]
        samples = sampled_points(keyframes.mesh, denoised[0], ranked, ENSEMBLE * self.points, generator(self.seed, 1))
        tracked = samples.part(0, TRACKED)
        targets = self.driving_targets
        best = self.network.predict_keyframes(samples, frames, denoised, 0 if targets is None else len(frames) - 1)
        # Points were drawn on the first frame; they are the same points of the surface in every other one.
        for t in range(1, len(denoised), max(1, len(denoised) // RETRIES)):
            if targets is None and best.confidence.prediction_spread > DISAGREEMENT:
                other = self.network.predict_keyframes(samples, frames, denoised, t)
                best = min(best, other, key=lambda keyframes: keyframes.confidence.prediction_spread)
        if targets is None and self.body in LIE and best.confidence.prediction_spread > DISAGREEMENT:
            turn = self.network.turn_to_stand(samples, denoised[best.reference])
            if turn is not None:
                other = self.network.predict_keyframes(samples, frames, denoised, best.reference, turn)
                best = min(best, other, key=lambda reading: self._cost(reading, frames, denoised))
        sample = best.surface(frames, denoised)
        if targets is None:
            rig, confidence, _ = self._with_fit(best.consensus, best.confidence, sample, best.predictions)
        else:
            queries = NetworkPoints(best.points, tracked.normals(denoised[best.reference]))
            rig, confidence, _ = self._with_corrections(best.consensus, best.confidence, sample, queries, targets)
            confidence = self._with_weights(confidence, rig.weights)
        # Without a fit the median over all keyframes is more reliable than the reference alone.
        leg = leg_length(rig.joints, self.legs) if self.fits_body else best.leg
        soles = find_soles(sample.points, _nearest_weights(sample.points, best.points, rig), self.legs, self.parents)
        best = dataclasses.replace(best, consensus=rig, leg=leg, confidence=confidence, soles=soles)
        tracker = PartTracker.of(best.points, rig.weights, rig.joints, self.parents)

        def follow(vertices: Float[np.ndarray, "U 3"]) -> Pose:
            rotation, joints = tracker.follow(tracked.points(vertices))
            return rotation @ rig.rotation, joints

        return follow, best

    def body_pairs(self, identity: Mesh, driving: Mesh) -> SurfacePoints:
        """Find the point of the driving for each distinct position of the identity, by rank (`canonical_order`).

        The shipped body is fitted to both normalised meshes, whatever faces they have. A vertex of the identity lies
        near some vertices of the body at its own fit; the same vertices at the driving's fit say where it belongs
        there, and the nearest point of the driving is taken. The order of vertices and faces has no influence.

        Raises:
            InputError: the body does not have the shape of one of the meshes.
        """
        from scipy.spatial import KDTree

        mine, theirs = self._fitted_body(identity), self._fitted_body(driving)
        rest = canonical_order(identity.vertices).merge(identity.vertices)
        _, share, index = nearest_shares(KDTree(mine.points), rest, mine.state.size)
        targets = np.einsum("wn,wnc->wc", share, theirs.points[index])
        ranked = canonical_order(driving.vertices)
        points, vertex = ranked.merge(driving.vertices), ranked.order[ranked.start]
        if len(driving.faces) == 0:
            nearest = vertex[np.asarray(KDTree(points).query(targets)[1])]
            return SurfacePoints(np.repeat(nearest[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(targets), 1)))
        faces = ranked.group[canonical_faces(driving.faces, ranked.group)]
        face, barycentric, _ = closest_on_mesh(targets, points, faces)
        return SurfacePoints(vertex[faces[face]], barycentric)

    def _fitted_body(self, mesh: Mesh) -> PosedBody:
        """Fit the shipped body to a normalised mesh, and return it with all of its vertices."""
        mesh = face_outward(mesh)
        samples, denoised = self._sampled(mesh, canonical_order(mesh.vertices), ENSEMBLE)
        rigs = [self.network.predict(samples, denoised, k) for k in range(ENSEMBLE)]
        surface = SurfaceSample(samples.points(mesh.vertices), samples.normals(denoised))
        fit = fit_predictions(surface, consensus(rigs), rigs, self.body)
        if fit.distance > RELIABLE_MISMATCH:
            raise InputError(
                f"{mesh.name}: expected a shape that the shipped {self.body} can be fitted to, found one that differs "
                f"by {1e3 * fit.distance:.1f} mm; give --pairing random"
            )
        return PosedBody(whole_body(self.body), fit.posed.state)


def _feet(mine: IdentityReading, theirs: DrivingReading, skinned: SkinnedMesh) -> Feet | None:
    """Find the contact points of the feet that both have; None where a leg was not found."""
    lacking = any(of.confidence is not None and of.confidence.lacks_leg for of in (mine, theirs))
    if lacking or len(mine.legs) != len(theirs.soles):
        return None
    soles = find_soles(mine.vertices, mine.rig, mine.legs, mine.parents)
    return Feet.of(mine.legs, theirs.leg, soles, skinned, theirs.soles, theirs.samples)


def _unread(vertices: Float[np.ndarray, "U 3"]) -> Pose:
    raise ValueError("the joints of this driving are known for each frame: call driving_pose")


def _nearest_weights(points: Float[np.ndarray, "N 3"], known: Float[np.ndarray, "M 3"], rig: Rig) -> Rig:
    """Return a rig with the weights of `points`: those of the nearest of the points whose weights are known."""
    from scipy.spatial import KDTree

    return dataclasses.replace(rig, weights=rig.weights[np.asarray(KDTree(known).query(points)[1])])


def _without_shares(confidence: Confidence, mesh: Mesh) -> Confidence:
    """Remove the shares of limbs if the mesh is a point cloud: its points may be denser on one limb than on another."""
    return confidence if len(mesh.faces) else dataclasses.replace(confidence, limbs={}, unmatched_body={})


def _with_measures(confidence: Confidence, fit: BodyFit) -> Confidence:
    """Add how well a fitted body covers the surface."""
    return dataclasses.replace(
        confidence,
        unmatched_body=fit.unmatched_body,
        unmatched_surface=fit.unmatched_surface,
        fit_distance=fit.distance,
        fit_angle=fit.angle,
    )
