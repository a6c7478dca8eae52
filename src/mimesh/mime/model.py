"""mime as an ONNX file: finds the joints of a mesh (`Mime.rig`), and follows them through a clip (`Mime.capture`).

A prediction is one run of the network on points sampled from a surface (`prediction.py`); every second one is of the
mirror image. A mesh gets several, a consensus of them, and a fit of the shipped body. In each frame of a clip the
joints' rotations are found by least squares over tracked points (`part_tracking.py`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Float

from ..bodies.anatomy import anatomy_of
from ..core.canonical_order import CanonicalOrder, canonical_faces, canonical_order
from ..core.geometry import nearest_points, vertex_normals
from ..core.mesh import Clip, Mesh
from ..core.rig import Rig, leg_length
from ..core.skinning import SkinnedMesh
from ..core.soles import body_points, find_soles
from ..core.surface_points import SurfacePoints, generator
from ..rigs.character import Character, names_above
from ..rigs.confidence import MAX_UNMATCHED_SURFACE, Confidence
from ..rigs.retarget import Follow, JointMotion, Pose, SurfaceMotion
from .body_fit import RELIABLE_MISMATCH, BodyFit, SurfaceSample, fit_body, fit_predictions, sampled_body
from .hands import Bends, Fingers, HandFinder, WeightedMesh, follow_fingers, settled_bends, with_fingers
from .joint_targets import JointTargets
from .kept_results import kept
from .misread import lost_shin, share_enclosed, with_block_arms
from .part_tracking import PartTracker
from .prediction import (
    ENSEMBLE,
    TRACKED,
    Denoiser,
    JointNetwork,
    KeyframePrediction,
    consensus,
    face_outward,
    sampled_points,
)
from .weights import COUNT, DENSE, CoarseSurface, clean_weights, corrected_weights, with_whole_tail, without_steps

KEPT_RIGS, KEPT_DRIVINGS, KEPT_QUICK = 8, 16, 256
"""How many results are kept (see `kept_results.py`): the weights of 10,000 vertices
take 2.4 MB, a driving 8 MB. One pair may need four rigs: both meshes as both bodies."""
RETRIES, DISAGREEMENT = 4, 15.0
"""How many further keyframes are tried as the reference while the predictions for all keyframes, carried back to the
reference by the measured motion, differ from their consensus by more than this angle (degrees, median)."""
LIE = ("quadruped",)
"""Bodies for which other orientations are tried where the predictions disagree: animals lie on their sides, and trunks
of leaping ones point up or down. Of people figures of blocks became worse (docs/log/animals.md)."""


CLEARLY = 0.95
"""Ratio of the costs of two fits from which down on the one that does not start from what was predicted is taken."""

Positions = Mapping[str, Float[np.ndarray, " 3"]]
"""Joint -> position, normalised."""


@dataclass(frozen=True, eq=False)
class CapturedMotion(JointMotion):
    """A motion that was found on the surfaces of a clip."""

    keyframes: Clip = field(kw_only=True)
    found: KeyframePrediction = field(kw_only=True)
    """What was found in one of these."""


@dataclass(frozen=True, eq=False)
class FittedJoints:
    """The joints of a mesh, without what they move."""

    rotation: Float[np.ndarray, "J 3 3"]
    """World rotation of each joint from the body at rest."""
    joints: Float[np.ndarray, "J 3"]
    confidence: Confidence


@dataclass(frozen=True, eq=False)
class Mime(JointNetwork):
    """A loaded network that finds the joints of one shipped body, ready for any mesh."""

    name: str
    points: int
    """Samples of the surface that one prediction takes."""
    body: str = "human"
    """Name of the shipped body."""
    fits: bool = True
    """Fit the shipped body to each surface; has no effect if the network's joints are not the body's."""
    seed: int = 0
    other_bodies: Mapping[str, Callable[[], Mime]] = field(default_factory=dict)
    """Name of each other body that there is a network for -> opens it."""
    hands: HandFinder | None = None
    """Finds hands that show fingers; without it fingers follow the hand."""

    @property
    def kept_key(self) -> Hashable:
        """What results for a mesh depend on besides the mesh."""
        return self.session, self.body, self.fits, self.seed

    @property
    def bone_counts(self) -> dict[int, int]:
        """As how many bones some joints' bones count where weights of neighbouring vertices are compared.

        The trunk of an animal may be one joint's, beside those of the legs, so its bones do not count. Arms border on
        the trunk at the shoulder alone, so their first bone counts twice: hems and pockets do not go with hands.
        """
        anatomy = anatomy_of(self.body)
        counts = dict.fromkeys(anatomy.optional_trunk, 0) | {arm[0]: 2 for arm in anatomy.arms}
        return {self.joints.index(name): count for name, count in counts.items() if name in self.joints}

    @property
    def arms(self) -> tuple[tuple[int, ...], ...]:
        """Joints of each arm whose hand may stand, from shoulder to wrist, those of them that the network has."""
        chains = anatomy_of(self.body).arms
        return tuple(tuple(self.joints.index(name) for name in arm if name in self.joints) for arm in chains)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies that there are networks for."""
        return (self.body, *self.other_bodies)

    def of_body(self, body: str) -> Mime:
        """Return this method with the network of another body."""
        return self if body == self.body else dataclasses.replace(self.other_bodies[body](), name=self.name)

    @property
    def fits_body(self) -> bool:
        """Whether a body is fitted: it is not switched off, and the network's joints are the body's."""
        return self.fits and self.joints == sampled_body(self.body).names

    def rig(self, mesh: Mesh, corrected: Positions | None = None) -> Character:
        """Find the joints of a mesh, which is normalised.

        Args:
            corrected: positions of some joints that the user has corrected, normalised.
        """
        mesh = face_outward(mesh)
        rig, confidence = self._rig(mesh) if not corrected else self._consensus(mesh, self._targets(corrected))
        ranked = canonical_order(mesh.vertices)
        points = ranked.merge(mesh.vertices)
        return Character(
            joints=self.joints,
            parents=self.parents,
            rig=rig,
            points=points,
            group=ranked.group,
            skinned=SkinnedMesh.of(points, rig, self.parents),
            roles={name: j for j, name in enumerate(self.joints)},
            above=names_above(self.joints, self.parents),
            legs=self.legs,
            leg=leg_length(rig.joints, self.legs),
            soles=find_soles(points, rig, self.legs, self.parents, self.arms),
            faces=ranked.group[mesh.faces],
            arms=self.arms,
            confidence=_without_shares(confidence, mesh),
        )

    def capture(self, keyframes: Clip, corrected: Positions | None = None) -> CapturedMotion:
        """Find the joints of a clip in its keyframes; in all others they are tracked from there.

        Args:
            keyframes: a few frames of the clip, normalised: evenly spread, the first one first. Its `mesh` has the
                vertices of that one.
            corrected: positions of some joints in the last keyframe that the user has corrected, normalised.
        """
        keyframes = dataclasses.replace(keyframes, mesh=face_outward(keyframes.mesh))
        follow, found = self._tracked(keyframes) if not corrected else self._follow(keyframes, self._targets(corrected))
        return CapturedMotion(
            joints=self.joints,
            follow=follow,
            leg=found.leg,
            surface=found.samples,
            soles=found.soles,
            body=found.body,
            ankles=tuple(self.joints[leg[-1]] for leg in self.legs),
            skin=(Mesh(found.points, np.zeros((0, 3), int)), found.consensus),
            confidence=_without_shares(found.confidence, keyframes.mesh),
            keyframes=keyframes,
            found=found,
        )

    def with_fingers(
        self, character: Character, mesh: Mesh, motion: CapturedMotion, surface: SurfaceMotion
    ) -> tuple[Character, JointMotion]:
        """Add the fingers of hands of which both meshes show them, and the driving bends them otherwise.

        Args:
            character: made by `rig` of `mesh`.
            surface: motion of the driving's surface in frames of the whole clip: it says whether fingers ever move.
        """
        if self.hands is None:
            return character, motion
        identity = _with_weights_of(character, mesh)

        def reference() -> WeightedMesh:
            frames, found = motion.keyframes, motion.found
            shown = dataclasses.replace(frames.mesh, vertices=frames.vertices[found.reference])
            return WeightedMesh.of_points(shown, found.consensus, found.points, self.joints)

        hands = self.hands.find_moving(identity, reference, surface)
        if not hands:
            return character, motion
        fingered = _with_hands(character, [(own, settled_bends(own.bends, driving.bends)) for own, driving in hands])
        assert motion.follow is not None
        follow = follow_fingers(motion.follow, hands)
        return fingered, dataclasses.replace(motion, joints=fingered.joints, follow=follow)

    def with_all_fingers(self, character: Character, mesh: Mesh) -> Character:
        """Add the fingers of all hands that show them to a character that was made by `rig` of `mesh`."""
        hands = [] if self.hands is None else self.hands.find(_with_weights_of(character, mesh))
        return _with_hands(character, [(hand, hand.bends) for hand in hands]) if hands else character

    def _targets(self, known: Positions) -> JointTargets:
        return JointTargets([self.joints.index(name) for name in known], np.array(list(known.values())), self.body)

    def predict_rig(self, mesh: Mesh) -> tuple[Rig, Confidence]:
        """Predict the joints of a normalised mesh, whatever its file has, and their weights of its vertices."""
        mesh = face_outward(mesh)
        rig, confidence = self._rig(mesh)
        group = canonical_order(mesh.vertices).group
        return dataclasses.replace(rig, weights=rig.weights.take(group, axis=0)), _without_shares(confidence, mesh)

    @kept(most=KEPT_RIGS)
    def fit(self, mesh: Mesh) -> FittedJoints:
        """Find the joints of a normalised mesh as `predict_rig` does, which also weighs the vertices."""
        return self.fit_near(mesh, None)

    def fit_near(self, mesh: Mesh, near: Pose | None) -> FittedJoints:
        """Find joints as `fit` does; the body is fitted from the pose `near`, too, and the better fit is taken."""
        mesh = face_outward(mesh)
        rig, confidence = self._consensus(mesh, weighted=False, near=near)
        return FittedJoints(rig.rotation, rig.joints, _without_shares(confidence, mesh))

    @kept(most=KEPT_QUICK)
    def quick_predict(self, mesh: Mesh) -> tuple[float, Float[np.ndarray, "3 3"]]:
        """Predict once: mean entropy (nats) of the skinning weights of a mesh, and world rotation of its root joint."""
        mesh = face_outward(mesh)
        samples, denoised = self._sampled(mesh, canonical_order(mesh.vertices), 1)
        return self.predict_once(SurfaceSample.of(samples, denoised))

    @kept(most=KEPT_RIGS)
    def _rig(self, mesh: Mesh) -> tuple[Rig, Confidence]:
        return self._consensus(mesh)

    def _consensus(
        self, mesh: Mesh, targets: JointTargets | None = None, weighted: bool = True, near: Pose | None = None
    ) -> tuple[Rig, Confidence]:
        """Predict the joints of a mesh and the skinning weights of its distinct positions: a consensus of ENSEMBLE.

        Args:
            weighted: whether the weights are needed; without, there are none.
            near: see `fit_near`.
        """
        ranked = canonical_order(mesh.vertices)
        vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
        if weighted:
            vertices = ranked.merge(mesh.vertices)
            faces = ranked.group[canonical_faces(mesh.faces, ranked.group)]
        coarse = CoarseSurface.of(vertices, faces, COUNT) if len(vertices) > DENSE and len(faces) else None
        if coarse is not None:
            vertices, faces = coarse.points, coarse.faces
        normals = vertex_normals(vertices, faces) if len(faces) else np.zeros_like(vertices)
        samples, denoised = self._sampled(mesh, ranked, ENSEMBLE)
        # Confidence is measured at samples, which are spread evenly over the surface; vertices are not.
        even = SurfaceSample.of(samples.part(0, ENSEMBLE), denoised)
        queries = SurfaceSample(np.concatenate([vertices, even.points]), np.concatenate([normals, even.normals]))
        rigs = [self.predict(samples, denoised, k) for k in range(ENSEMBLE)]
        mean = dataclasses.replace(consensus(rigs), weights=self.weights(rigs, samples, denoised, queries))
        # Smoothing improves the normals but shrinks the surface: points are taken from the original mesh.
        sample = SurfaceSample(samples.points(mesh.vertices), samples.normals(denoised))
        confidence = self.confidence(rigs, mean, mean.weights[len(vertices) :])
        measured = slice(len(vertices), None)
        rig, confidence, fit = self._with_body(mean, confidence, sample, rigs, queries, measured, targets, near)
        weights, nearest, known = rig.weights[: len(vertices)], None, 0.0
        if not weighted:
            return dataclasses.replace(rig, weights=weights), confidence
        if fit:
            nearest, known = fit.nearest(vertices), fit.share
            weights = fit.blended_weights(weights, nearest)
        weights = with_whole_tail(weights, vertices, faces, self.joints, self.parents)
        weights = clean_weights(weights, vertices, faces, self.parents, nearest, self.bone_counts)
        weights = without_steps(weights, vertices, faces, known)
        weights = weights if coarse is None else coarse.carried(weights)
        return dataclasses.replace(rig, weights=weights), confidence

    def _sampled(
        self, mesh: Mesh, ranked: CanonicalOrder, predictions: int
    ) -> tuple[SurfacePoints, Float[np.ndarray, "V 3"]]:
        """Draw points for some predictions from a mesh, and return its denoised vertices, on which they were drawn."""
        denoised = Denoiser.of(mesh, ranked)(mesh.vertices)
        return sampled_points(mesh, denoised, ranked, predictions * self.points, generator(self.seed, 0)), denoised

    def _with_body(
        self,
        rig: Rig,
        confidence: Confidence,
        sample: SurfaceSample,
        predictions: Sequence[Rig],
        queries: SurfaceSample,
        measured: slice,
        targets: JointTargets | None,
        near: Pose | None = None,
    ) -> tuple[Rig, Confidence, BodyFit | None]:
        """Fit the body to the consensus of predictions; with some joints at their targets if they are known or found.

        Args:
            queries: the points that have the weights of the rig.
            measured: those of them that are spread evenly over the surface.
            targets: joints that the user has corrected; None: a shin may be found on the other leg.
            near: see `fit_near`.
        """
        if targets is not None:
            rig, confidence, fit = self._with_corrections(rig, confidence, sample, queries, targets)
            again = Confidence.of(confidence.prediction_spread, rig.weights[measured], self.joints, self.parents)
            sure = dataclasses.replace(confidence, weight_entropy=again.weight_entropy, limbs=again.limbs)
            if sure.unmatched_surface <= MAX_UNMATCHED_SURFACE:  # predictions may differ where the body covers all
                sure = dataclasses.replace(sure, prediction_spread=0.0, fit_angle=0.0, flexion=0.0)
            return rig, sure, fit
        if not self.fits_body:
            return rig, confidence, None
        fit = fit_predictions(sample, rig, predictions, self.body)
        if near is not None:
            other = fit_body(sample, *near, name=self.body)
            fit = other if other.cost < CLEARLY * fit.cost else fit
        fitted = dataclasses.replace(rig, rotation=fit.rotation, joints=fit.joints)
        sure = self._measured(confidence, fit, sample)
        if self.body != "human":
            return fitted, sure, fit
        # What is found is as uncertain as what was predicted: weights are not measured again.
        if found := lost_shin(sample, fit):
            return self._with_corrections(rig, confidence, sample, queries, found)
        if fit.distance > RELIABLE_MISMATCH:
            fitted = with_block_arms(fitted, sample.points, queries.points, self.joints, self.parents)
        return fitted, sure, fit

    def _cost(self, reading: KeyframePrediction, frames: list[np.ndarray], denoised: list[np.ndarray]) -> float:
        """Measure how badly the body fits a reading of a driving; without a fit, how far its predictions disagree."""
        if not self.fits_body:
            return reading.confidence.prediction_spread
        sample = reading.surface(frames, denoised)
        return fit_predictions(sample, reading.consensus, reading.predictions, self.body).cost

    def _with_corrections(
        self, rig: Rig, confidence: Confidence, sample: SurfaceSample, queries: SurfaceSample, targets: JointTargets
    ) -> tuple[Rig, Confidence, BodyFit]:
        """Replace joints and weights of a rig by those of the body that is fitted with some joints at their targets.

        The weights are those of the points `queries`.
        """
        fit = fit_body(sample, *targets.move(rig.rotation, rig.joints), targets, self.body)
        displacement = fit.joints - rig.joints
        weights = corrected_weights(rig.weights, queries.points, queries.normals, displacement, fit.posed)
        return Rig(fit.rotation, fit.joints, weights), self._measured(confidence, fit, sample), fit

    def _measured(self, confidence: Confidence, fit: BodyFit, sample: SurfaceSample) -> Confidence:
        """Add how well a fitted body covers the surface, and how many of its joints are inside."""
        inner = [self.joints.index(name) for name in anatomy_of(self.body).inner]
        return dataclasses.replace(
            confidence,
            unmatched_body=fit.unmatched_body,
            unmatched_surface=fit.unmatched_surface,
            surface_distance=fit.surface_distance,
            fit_distance=fit.distance,
            fit_angle=fit.angle,
            enclosed=share_enclosed(fit.joints[inner], sample.points, sample.normals),
        )

    @kept(most=KEPT_DRIVINGS)
    def _tracked(self, keyframes: Clip) -> tuple[Follow, KeyframePrediction]:
        return self._follow(keyframes)

    def _follow(self, keyframes: Clip, targets: JointTargets | None = None) -> tuple[Follow, KeyframePrediction]:
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
        best = self.predict_keyframes(samples, frames, denoised, 0 if targets is None else len(frames) - 1)
        # Points were drawn on the first frame; they are the same points of the surface in every other one.
        for t in range(1, len(denoised), max(1, len(denoised) // RETRIES)):
            if targets is None and best.confidence.prediction_spread > DISAGREEMENT:
                other = self.predict_keyframes(samples, frames, denoised, t)
                best = min(best, other, key=lambda keyframes: keyframes.confidence.prediction_spread)
        if targets is None and self.body in LIE and best.confidence.prediction_spread > DISAGREEMENT:
            turn = self.turn_to_stand(samples, denoised[best.reference])
            if turn is not None:
                other = self.predict_keyframes(samples, frames, denoised, best.reference, turn)
                best = min(best, other, key=lambda reading: self._cost(reading, frames, denoised))
        sample = best.surface(frames, denoised)
        queries = SurfaceSample(best.points, tracked.normals(denoised[best.reference]))
        rig, confidence, _ = self._with_body(
            best.consensus, best.confidence, sample, best.predictions, queries, slice(None), targets
        )
        # Without a fit the median over all keyframes is more reliable than the reference alone.
        leg = leg_length(rig.joints, self.legs) if self.fits_body else best.leg
        near = dataclasses.replace(rig, weights=rig.weights[nearest_points(best.points, sample.points)[1]])
        soles = find_soles(sample.points, near, self.legs, self.parents, self.arms)
        body = body_points(sample.points, near, self.legs + self.arms, self.parents)
        best = dataclasses.replace(best, consensus=rig, leg=leg, confidence=confidence, soles=soles, body=body)
        tracker = PartTracker.of(best.points, rig.weights, rig.joints, self.parents)
        return partial(_tracked_pose, tracker, tracked, rig.rotation), best  # which can be pickled


def _with_weights_of(character: Character, mesh: Mesh) -> WeightedMesh:
    """Return the mesh of a character, in which its hands are looked for."""
    faces = character.group[face_outward(mesh).faces]
    return WeightedMesh(character.points, faces, character.rig, character.rig.weights)


def _tracked_pose(
    tracker: PartTracker, tracked: SurfacePoints, frames: Float[np.ndarray, "J 3 3"], vertices: Float[np.ndarray, "U 3"]
) -> Pose:
    """Return the pose of the joints in a frame of a clip, from the points of its surface that are tracked."""
    rotation, joints = tracker.follow(tracked.points(vertices))
    return rotation @ frames, joints


def _with_hands(character: Character, hands: Sequence[tuple[Fingers, Bends]]) -> Character:
    """Add the fingers of hands to a character, with their bends at rest."""
    rig, joints, parents = with_fingers(character.rig, character.joints, character.parents, hands)
    return dataclasses.replace(
        character,
        joints=joints,
        parents=parents,
        rig=rig,
        skinned=SkinnedMesh.of(character.points, rig, parents),
        roles={name: j for j, name in enumerate(joints)},
        above=names_above(joints, parents),
    )


def _without_shares(confidence: Confidence, mesh: Mesh) -> Confidence:
    """Remove the shares of limbs if the mesh is a point cloud: its points may be denser on one limb than on another."""
    return confidence if len(mesh.faces) else dataclasses.replace(confidence, limbs={}, unmatched_body={}, enclosed=1.0)
