"""Move an identity by joints: those of its file or found on it follow those of the driving.

`joint_route` finds a `Character` and a `JointMotion`, each in a thread of its own; `JointRoute.play` moves the joints.
The vertices of frames are made when they are asked for.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from jaxtyping import Float, Int

from ..bodies.anatomy import body_of_joints
from ..bodies.joint_names import without_fingers
from ..core.animated_rig import AnimatedRig
from ..core.errors import InputError, RefusedMeshError, option
from ..core.foot_planting import PosedJoints, foot_skate
from ..core.frame_buffer import LazyFrames, Progress, evenly_spread
from ..core.joint_tracks import JointTrack
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization
from ..core.options import MotionOptions
from ..core.threads import both
from ..methods.find import NETWORK_OF_BODY
from ..mime.model import CapturedMotion, FittedJoints, Mime
from ..mime.prediction import face_outward
from ..rigs.character import Character
from ..rigs.retarget import JointMotion, Pose, Retarget, ScannedJoints
from . import look, placed
from .file_rigs import Rigs, heading_note, read_rigs
from .known import Corrections, Known
from .refine import Refinement
from .report import TransferReport, fingered_hands, torn_note
from .result import Precision, Timer

if TYPE_CHECKING:
    from ..io.gltf.own_animation import OwnAnimation
    from .parts import MeshPart

Found = TypeVar("Found", Character, JointMotion, FittedJoints)


@dataclass(frozen=True, eq=False)
class JointRoute(placed.Placed):
    """A character and a motion that it follows."""

    mime: Mime = field(kw_only=True)
    retarget: Retarget = field(kw_only=True)

    def with_refinement(self, refine: bool | None) -> JointRoute:
        """Switch refinement on or off; None is off, as joints move surfaces smoothly."""
        return dataclasses.replace(self, refinement=Refinement.of(self.rest) if refine else None)

    def frame(self, t: int) -> Float[np.ndarray, "V 3"]:
        """Make the identity's vertices in frame t only, at their position in the whole clip, without MotionOptions."""
        chosen = [0] if t == 0 else [0, t]  # the first frame fixes the position of the whole clip
        frames = [self.refined(self.retarget.frame(k, self.driving_frame(k))) @ self.turn.T for k in chosen]
        return self.norms[0].undo(frames[-1] + self.shift(frames[0], self.lift_of_frames))

    @property
    def stride(self) -> float:
        """Displacement of the result over the driving's, each normalised."""
        return self.retarget.stride

    def floor(self, lowest: float) -> float:
        """Return the height of the driving's floor, normalised; `lowest` is that of its lowest vertex in keyframes."""
        return self.retarget.motion.floor(lowest)

    @cached_property
    def lift_of_frames(self) -> float | None:
        """How far up frames go that are made one by one; see `Retarget.lift`."""
        return self.retarget.lift_of_frames(self.clip, self.norms[1])

    def joints(self, t: int) -> placed.FoundJoints:
        """Return the joints of the identity, and of the driving in a frame."""
        character, motion = self.retarget.character, self.retarget.motion
        identity = self.norms[0].undo(character.rig.joints)
        driving = self.norms[1].undo(motion.pose(t, self.driving_frame(t))[1])
        mine = without_fingers({name: identity[j] for name, j in character.roles.items()})
        theirs = without_fingers(dict(zip(motion.joints, driving, strict=True)))
        return placed.FoundJoints(body_of_joints(motion.joints), mine, theirs)

    def play(
        self, timer: Timer, options: MotionOptions, progress: Progress | None = None, dtype: Precision = np.float64
    ) -> placed.Moved:
        """Move the joints in all frames, and report."""
        identity, clip = self.identity, self.clip
        with timer.step("drive"):
            limited = len(clip) > 1 if options.skinned is None else options.skinned
            # The weights of an identity's own file stay as they are.
            limited = limited and self.rigs.humanoid is None
            retarget = self.retarget.limited(options.influences) if limited else self.retarget
            measured = retarget.motion.over(clip, self.norms[1], retarget.driving_soles, progress)
            track, notes = measured.smoothed(options.smooth), ()
            if options.ground:
                standing = retarget.standing(track)
                if standing is not track:
                    notes = (
                        f"{clip.mesh.name} does not move its hips from their place: the lowest sole stands on the "
                        f"floor in every frame; {option('ground', False)} leaves the hips at one height",
                    )
                track = retarget.levelled(standing)
            across = self.norms[1].radius / self.norms[0].radius if options.root == "keep" else None
            posed = retarget.posed_joints(track, across, options.root == "drop", options.ground, options.contacts)
            route = dataclasses.replace(self, retarget=retarget)
            shift = self.shift(route.turned(posed, 0), retarget.lift(posed, track))
            skeleton = dataclasses.replace(route.animated_rig(posed, shift), influences=options.influences)
            own = self.own_animation(skeleton)
            moved = route.made_frames(posed, shift, own, np.dtype(dtype))
            if len(clip) == 1:
                moved = moved.kept()
            report = placed.surface_report(identity, moved, self.facings)
        report |= {"body": self.mime.body} | ({} if self.rigs.humanoid is None else {"rig": "own"})
        notes += report_confidence(retarget, report, self.names)
        notes += torn_note(report, identity.name, self.rigs.humanoid is None, skeleton)
        notes += self.all_notes(own is not None)
        report["fingers"] = fingered_hands(retarget.character.joints)  # elsewhere they follow the hand
        report |= self._skates(retarget, track, posed, across, options)
        if limited:
            report["influence_deviation"] = self._influence_deviation(retarget, posed)
        positions = self.norms[1].undo(measured.positions[0])
        driving_joints = without_fingers(dict(zip(retarget.motion.joints, positions, strict=True)))
        return placed.Moved(moved, skeleton, own, cast(TransferReport, report), notes, driving_joints)

    def turned(self, posed: PosedJoints, t: int) -> Float[np.ndarray, "V 3"]:
        """Make a frame, refined, with the driving's heading."""
        return self.refined(self.retarget.character.posed(posed.rotation[t], posed.root[t])) @ self.turn.T

    def made_frames(
        self, posed: PosedJoints, shift: Float[np.ndarray, " 3"], own: OwnAnimation | None, dtype: np.dtype
    ) -> LazyFrames:
        """Return frames that are made of the joints when they are asked for: a file of joints needs few of them."""
        shape = len(posed.root), len(self.identity.vertices)
        # The joints of a person alone move neither morph targets nor what else has been copied.
        if own is not None and (own.morphs or self.rigs.beside):
            return LazyFrames(shape, own.vertices, dtype)

        character = self.retarget.character
        group = None if self.refinement else character.shared

        def points(t: int) -> Float[np.ndarray, "P 3"]:
            if group is None:
                return self.turned(posed, t)
            return character.posed_points(posed.rotation[t], posed.root[t]) @ self.turn.T

        def make(chosen: Int[np.ndarray, " N"]) -> Iterator[Float[np.ndarray, "P 3"]]:
            return (self.norms[0].undo(points(t) + shift) for t in chosen.tolist())

        return LazyFrames(shape, make, dtype, group=group)

    def animated_rig(self, posed: PosedJoints, shift: Float[np.ndarray, " 3"]) -> AnimatedRig:
        """Return the rig and its motion in the identity's axes, unit and position."""
        identity, norm, character = self.identity, self.norms[0], self.retarget.character
        undo = norm.rotation.T
        rotation, root = undo @ self.turn @ posed.rotation, norm.undo(posed.root @ self.turn.T + shift)
        if self.rigs.humanoid is not None:
            identity = identity.with_vertices(self.rigs.humanoid.character.mesh.vertices)
        rig, roles = character.rig_of_file(norm), character.roles
        return AnimatedRig(
            identity, character.joints, character.parents, rig, rotation, root, roles, group=character.shared
        )

    def own_animation(self, skeleton: AnimatedRig) -> OwnAnimation | None:
        """Return the motion on the bones of the identity's own file, if its rig is used."""
        own, clip = self.rigs.identity, self.clip
        if own is None:
            return None
        from ..io.gltf.own_animation import OwnAnimation
        from .gltf_rigs import face_tracks

        tracks = own.tracks(own.humanoid.tree()[0], skeleton.transforms()) | self.rigs.beside | face_tracks(own, clip)
        return OwnAnimation(own.source, clip.mesh.name, tracks, clip.fps, len(clip), own.person)

    def _skates(
        self, retarget: Retarget, track: JointTrack, posed: PosedJoints, across: float | None, options: MotionOptions
    ) -> dict[str, float | None]:
        """Measure how fast soles slide that should stand, of result and driving (identity heights a second)."""
        keys = ("foot_skate", "foot_skate_driving")
        scale = (retarget.stride if across is None else across, retarget.stride)
        speeds = foot_skate(posed, track, retarget.feet, scale)
        if speeds is None or options.root == "drop":  # in place, feet slide as they should
            return dict.fromkeys(keys)
        height = np.ptp(self.rest.vertices[:, 1])
        return {key: None if speed is None else speed / height for key, speed in zip(keys, speeds, strict=True)}

    def _influence_deviation(self, limited: Retarget, posed: PosedJoints) -> float:
        """Measure how far vertices are from where all their weights take them, over the longest side of the mesh."""
        largest = 0.0
        for t in evenly_spread(len(self.clip), placed.KEYFRAMES):
            pose = posed.rotation[t], posed.root[t]
            difference = limited.character.posed(*pose) - self.retarget.character.posed(*pose)
            largest = max(largest, float(np.linalg.norm(difference, axis=-1).max()))
        return largest / float(np.ptp(self.rest.vertices, axis=0).max())


@dataclass(frozen=True, eq=False)
class FoundCharacter:
    """A character that was found on a mesh, and what moves it."""

    character: Character
    """With the joints of all fingers that are found, if these were asked for."""
    plain: Character
    """Without those of fingers that were found."""
    norm: Normalization
    rigs: Rigs
    """The identity's rig."""
    part: MeshPart | None = None
    """The part of the mesh that it is; None: it is all of it."""


@dataclass(frozen=True, eq=False)
class FoundMotion:
    """A motion that was found in a clip, and what follows it."""

    clip: Clip
    motion: JointMotion
    track: JointTrack
    """The joints in all frames, without smoothing."""
    smooth: float
    """See `MotionOptions`."""
    norm: Normalization
    rigs: Rigs
    """The driving's joints."""
    network: Mime


def report_confidence(retarget: Retarget, report: dict[str, Any], names: tuple[str, str]) -> tuple[str, ...]:
    """Add the confidences of joints that were found to the report, and return notes on low ones."""
    notes: tuple[str, ...] = ()
    found = retarget.character.confidence, retarget.motion.confidence
    for which, confidence, name in zip(("identity", "driving"), found, names, strict=True):
        if confidence is not None:
            report[which] |= confidence.facts()
            notes += confidence.notes(name)
    return notes


def joint_route(identity: Mesh, clip: Clip, mime: Mime, known: Known, rigs: Rigs) -> JointRoute:
    """Find the joints of both meshes, and let the identity's follow the driving's."""
    first, asked = placed.first_frame(clip), known.asked_body
    subjects = rigs.subjects(identity, first, known.axes)
    unnamed = any(rigs.unnamed) and look.finds_joints(mime)
    try:
        network, looks = look.agreed(mime, asked, subjects)
    except RefusedMeshError:
        if not unnamed:
            raise
        network, looks = mime, None  # a tail or a dress may hide the shape of who is known by the joints
    if unnamed and look.finds_joints(network):
        find = look.joint_finder(network, known.axes[:2]), look.joint_finder(network, known.axes[2:])
        rigs = read_rigs(identity, clip, known, find=find).with_notes((identity.name, clip.mesh.name), rigs)
        subjects = rigs.subjects(identity, first, known.axes)
        if looks is None:
            network, looks = look.agreed(mime, asked, subjects)
        looks = look.known_look(network, subjects[0]), look.known_look(network, subjects[1])
    assert looks is not None
    (character, mine), (motion, theirs) = _found(network, clip, subjects, looks, known, rigs)
    if known.body == "auto" and len(mime.bodies) > 1 and not known.corrections.given:
        confidences = character.confidence, motion.confidence
        other = look.other_body(mime, network.body, subjects, confidences)
        if other is not None:
            network, looks = look.agreed(mime, other, subjects)
            (character, mine), (motion, theirs) = _found(network, clip, subjects, looks, known, rigs)
    rest = look.normalised(identity, mine)
    if rigs.humanoid is None and isinstance(motion, CapturedMotion):
        character, motion = network.with_fingers(character, rest, motion, partial(placed.surface_motion, clip, theirs))
    retarget = Retarget.of(character, motion)
    notes = heading_note(rigs.driving, clip.mesh.name, theirs.front)
    named = placed.with_up(identity, mine)
    return JointRoute(named, clip, (mine, theirs), rest, rigs=rigs, notes=notes, mime=network, retarget=retarget)


def _found(
    mime: Mime,
    clip: Clip,
    subjects: tuple[look.Subject, look.Subject],
    looks: tuple[look.Look, look.Look],
    known: Known,
    rigs: Rigs,
) -> tuple[tuple[Character, Normalization], tuple[JointMotion, Normalization]]:
    """Find the joints of both meshes, each with the normalisation in which it was recognised."""
    corrections = known.corrections
    return both(
        lambda: find_character(mime, subjects[0], looks[0], rigs, corrections),
        lambda: find_motion(mime, clip, subjects[1], looks[1], rigs, corrections),
    )


def rigs_alone(mime: Mime, identity: Mesh, clip: Clip, known: Known) -> Rigs:
    """Read the rig of a single mesh or clip; joints whose names say nothing are found as for a transfer."""
    rigs = read_rigs(identity, clip, known)
    if not any(rigs.unnamed) or not look.finds_joints(mime):
        return rigs
    find = look.joint_finder(mime, known.axes[:2]), look.joint_finder(mime, known.axes[2:])
    return read_rigs(identity, clip, known, find=find).with_notes((identity.name, clip.mesh.name), rigs)


def found_alone(
    mime: Mime, subject: look.Subject, asked: str, find: Callable[[Mime, look.Look], tuple[Found, Normalization]]
) -> tuple[look.Look, Found, Normalization]:
    """Decide which body a single mesh has, and find its joints; what looks like none is refused.

    Args:
        asked: the body that the user says; "auto" looks at the mesh, whose file may have joints.
        find: finds the joints of the body that a network is for.

    Raises:
        InputError: a body that joints are not found on.
        RefusedMeshError: the mesh looks neither like a person nor like a four-legged animal.
    """
    if asked == look.OTHER:
        raise InputError(
            f"{option('body')}: expected {', '.join(NETWORK_OF_BODY)} or auto, found {asked}: joints are found on "
            "people and four-legged animals alone"
        )
    if len(mime.bodies) == 1:
        look.check_known_body(mime, asked)
        seen = look.known_look(mime, subject)
        return seen, *find(mime, seen)
    seen = look.look(mime, subject, None if asked == "auto" else asked, quick=True)
    found, norm = find(mime.of_body(seen.body), seen)
    if asked != "auto" or subject.body is not None:
        return seen, found, norm
    kind = look.second_look(mime, seen.body, subject, found.confidence)
    if kind is not None and kind != seen.body:
        seen = look.look(mime, subject, kind)
        found, norm = find(mime.of_body(kind), seen)
        # The second look fits it as it stands; found are the joints of what faces the front.
        fit = found.confidence
        kind = None if fit is not None and fit.fitted and fit.misfit > look.REJECTION_THRESHOLD else kind
    if kind is None:
        raise RefusedMeshError(look.different_kinds([None, None], (subject, subject)))
    return seen, found, norm


def find_character(
    mime: Mime, subject: look.Subject, seen: look.Look, rigs: Rigs, corrections: Corrections
) -> tuple[Character, Normalization]:
    """Find the joints of a mesh: those of its file if they are used, else on its surface."""

    def character(norm: Normalization) -> Character:
        mesh = look.normalised(subject.mesh, norm)
        if rigs.humanoid is not None:
            return Character.of_file(rigs.humanoid, norm, mesh.vertices)
        return mime.rig(mesh, corrections.of_identity(subject.mesh, mime.joints, norm))

    return _settled(mime, subject, seen, character)


def found_character(
    mime: Mime, subject: look.Subject, asked: str, rigs: Rigs, corrections: Corrections
) -> tuple[look.Look, Character, Normalization]:
    """Decide which body a single mesh has, and find its joints, as `found_alone`; for `mimesh rig` and `look`."""
    return found_alone(
        mime, subject, asked, lambda network, seen: find_character(network, subject, seen, rigs, corrections)
    )


def find_motion(
    mime: Mime, clip: Clip, subject: look.Subject, seen: look.Look, rigs: Rigs, corrections: Corrections
) -> tuple[JointMotion, Normalization]:
    """Find the joints of a clip: those of its file if they are used, else on its surface."""

    def motion(norm: Normalization) -> JointMotion:
        if rigs.driving is not None:
            mesh = face_outward(look.normalised(subject.mesh, norm))
            found, skeleton = JointMotion.of_file(rigs.driving, mesh, clip.fps, norm), clip.skeleton
            confidence = skeleton.confidence if isinstance(skeleton, ScannedJoints) else None
            return dataclasses.replace(found, confidence=confidence)
        corrected, keyframes = corrections.of_driving(placed.keyframes_of(clip, norm), mime.joints, norm)
        return mime.capture(keyframes, corrected)

    return _settled(mime, subject, seen, motion)


def find_pose(
    mime: Mime, subject: look.Subject, seen: look.Look, near: Pose | None = None
) -> tuple[FittedJoints, Normalization]:
    """Find the joints on the surface of a mesh, whatever its file has, without what they move.

    Args:
        near: rotations and positions in the axes of the file that they may be near to.
    """

    def fitted(norm: Normalization) -> FittedJoints:
        start = near and (norm.rotation @ near[0], norm.apply(near[1]))
        return mime.fit_near(look.normalised(subject.mesh, norm), start)

    return _settled(mime, subject, seen, fitted)


def _settled(
    mime: Mime, subject: look.Subject, seen: look.Look, find: Callable[[Normalization], Found]
) -> tuple[Found, Normalization]:
    """Find the joints of a mesh; where it is not recognised, once more in the axes that a prediction shows."""
    mesh, axes, norm = subject.mesh, subject.axes, seen.norm
    turned = seen.front or look.facing_front(mime, mesh, norm, subject.knows_front)[0]
    found = find(turned)
    corrected = look.reorient(mime, mesh, norm, axes, found.confidence)
    if corrected is norm:
        return found, turned
    turned, _ = look.facing_front(mime, mesh, corrected, known=True)
    return find(turned), turned
