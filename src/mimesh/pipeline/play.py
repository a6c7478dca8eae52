"""Make the frames of a prepared transfer: drive, refine, align, undo the normalisation, and report."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_limbs import SIDES
from ..bodies.joint_names import finger_joints, without_fingers
from ..core.animated_rig import INFLUENCES, AnimatedRig
from ..core.foot_planting import PosedJoints, foot_skate
from ..core.frame_buffer import LazyFrames, Progress, counted, each_frame, evenly_spread, store_frames
from ..core.joint_tracks import JointTrack
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization
from ..core.rig import Rig
from ..io.beside import missing_images, missing_images_notes
from ..io.gltf.own_animation import OwnAnimation
from ..methods.base import BodyMethod, SkinnedDrive
from .corrections import JointPositions
from .prepared import KEYFRAMES, MotionOptions, Prepared
from .refine import Refinement
from .report import TransferReport, accelerations, facing, facing_note, quality
from .result import Timer
from .rigs import face_tracks


@dataclass(frozen=True, eq=False)
class MovedIdentity:
    """A result in the identity's axes, unit and position, with its report."""

    frames: LazyFrames
    skeleton: AnimatedRig | None
    """Joints, skinning weights and motion of the identity, if the method has joints."""
    own: OwnAnimation | None
    """The motion on the bones of the identity's own file, if it has a rig that is used."""
    report: TransferReport
    notes: tuple[str, ...]
    driving_joints: JointPositions | None = None
    """Joints of the driving in its first frame, in its axes, unit and position, if the method has joints."""


@dataclass(frozen=True, eq=False)
class _JointMotion:
    """The motion of a skinned identity's joints over a whole clip."""

    drive: SkinnedDrive
    track: JointTrack
    posed: PosedJoints
    scale: tuple[float, float]
    """The identity's displacements over the driving's: over the ground and vertically."""

    def frame(self, t: int) -> Float[np.ndarray, "V 3"]:
        """Make the identity's vertices in a frame."""
        return self.drive.posed(self.posed.rotation[t], self.posed.root[t])


def pose_frame(prepared: Prepared, t: int) -> Float[np.ndarray, "V 3"]:
    """Make the identity's vertices in frame t only, at their position in the whole clip.

    Methods that work in windows of frames get only frames 0 and t, so their result may differ from that of the clip.
    `MotionOptions` are not applied: they need the whole clip (see `play`).
    """
    # Frame 0 is needed too: it fixes the position of the whole clip, and the size of results of some methods.
    indices = [0] if t == 0 else [0, t]
    driving = (prepared.driving_norm.apply(np.asarray(prepared.clip.vertices[k], np.float64)) for k in indices)
    drive = prepared.drive.at(indices) if isinstance(prepared.drive, SkinnedDrive) else prepared.drive
    refined = _refined(drive(driving), prepared.refinement, Timer())
    shift, frames = _aligned((vertices @ prepared.turn.T for vertices in refined), prepared)
    *_, vertices = frames
    return prepared.identity_norm.undo(vertices + shift)


def play(
    prepared: Prepared,
    timer: Timer,
    options: MotionOptions,
    progress: Progress | None = None,
    dtype: type[np.floating] = np.float64,
) -> MovedIdentity:
    """Move an identity, and report; frames of methods with joints are made when they are asked for.

    The options have been checked in `prepare`.
    """
    identity, clip, rest = prepared.identity, prepared.clip, prepared.rest
    identity_norm, driving_norm = prepared.identity_norm, prepared.driving_norm
    with timer.step("drive"):
        driving = (driving_norm.apply(vertices) for vertices in each_frame(clip.vertices))
        motion = skeleton = own = None
        if isinstance(prepared.drive, SkinnedDrive):
            scale = driving_norm.radius / identity_norm.radius
            limited = len(clip) > 1 if options.skinned is None else options.skinned
            # The weights of an identity's own file stay as they are.
            limited = limited and prepared.rigs.humanoid is None
            drive = prepared.drive.limited(rest.vertices, INFLUENCES) if limited else prepared.drive
            motion = _joint_motion(drive, counted(driving, len(clip), progress), clip.fps, options, scale)
            shift = prepared.shift(_turned(motion, 0, prepared.turn, prepared.refinement))
            skeleton = _animated_rig(prepared, motion, shift)
            own = _own_animation(prepared, skeleton)
            moved = _made_frames(prepared, motion, shift, own, np.dtype(dtype))
        else:
            refined = _refined(prepared.drive(driving), prepared.refinement, timer)
            shift, frames = _aligned((vertices @ prepared.turn.T for vertices in refined), prepared)
            placed = (identity_norm.undo(vertices + shift) for vertices in frames)
            moved = LazyFrames.stored(store_frames(placed, len(clip), len(identity.vertices), dtype, progress))
        if len(clip) == 1:
            moved = LazyFrames.stored(moved.every(1))
        report = surface_report(identity, clip, moved, (identity_norm, driving_norm))
    report |= {"body": prepared.method.body} if isinstance(prepared.method, BodyMethod) else {}
    notes = prepared.notes + facing_note(identity_norm, identity.name, "--front")
    notes += facing_note(driving_norm, clip.mesh.name, "--driving-front")
    driving_joints = None
    if motion is not None:
        positions = driving_norm.undo(motion.track.positions[0])
        driving_joints = without_fingers(dict(zip(motion.drive.driving_joints, positions, strict=True)))
        report |= {} if prepared.rigs.humanoid is None else {"rig": "own"}
        height = np.ptp(rest.vertices[:, 1])
        notes = _report_joints(motion, report, (identity.name, clip.mesh.name), height) + notes
        if motion.drive is not prepared.drive:
            report["influence_deviation"] = _influence_deviation(prepared, motion)
        if options.root == "drop":
            report["foot_skate"] = report["foot_skate_driving"] = None  # in place, feet slide as they should
    notes += prepared.rigs.notes
    notes += () if own is not None else tuple(getattr(identity.source, "notes", ()))
    notes += missing_images_notes(missing_images(identity))
    return MovedIdentity(moved, skeleton, own, cast(TransferReport, report), notes, driving_joints)


def surface_report(
    identity: Mesh, clip: Clip, moved: LazyFrames, norms: tuple[Normalization, Normalization]
) -> dict[str, Any]:
    """Return the part of the report that all methods have."""
    return {
        **quality(identity, moved),
        **accelerations(clip, moved),
        "identity": facing(norms[0]),
        "driving": facing(norms[1]),
    }


def _made_frames(
    prepared: Prepared, motion: _JointMotion, shift: Float[np.ndarray, " 3"], own: OwnAnimation | None, dtype: np.dtype
) -> LazyFrames:
    """Return frames that are made of the joints when they are asked for: a file of joints needs few of them."""
    count = len(prepared.identity.vertices)
    # The joints of a person alone move neither morph targets nor what else has been copied.
    if own is not None and (own.morphs or prepared.rigs.beside):
        return LazyFrames((own.frames, count), own.vertices, dtype)

    norm, turn, refinement = prepared.identity_norm, prepared.turn, prepared.refinement

    def make(chosen: Int[np.ndarray, " N"]) -> Iterator[Float[np.ndarray, "V 3"]]:
        return (norm.undo(_turned(motion, t, turn, refinement) + shift) for t in chosen.tolist())

    return LazyFrames((len(motion.posed.root), count), make, dtype)


def _turned(
    motion: _JointMotion, t: int, turn: Float[np.ndarray, "3 3"], refinement: Refinement | None
) -> Float[np.ndarray, "V 3"]:
    """Make a frame, refined, with the driving's heading."""
    vertices = motion.frame(t)
    return (vertices if refinement is None else refinement(vertices)) @ turn.T


def _joint_motion(
    drive: SkinnedDrive,
    frames: Iterable[Float[np.ndarray, "U 3"]],
    fps: float,
    options: MotionOptions,
    scale: float,
) -> _JointMotion:
    """Track the joints and apply the options; `scale` is the driving's radius over the identity's, in their units."""
    track = drive.track(frames, fps).smoothed(options.smooth)
    across = scale if options.root == "keep" else None
    posed = drive.motion(track, across, options.root == "drop", options.ground)
    return _JointMotion(drive, track, posed, (drive.stride if across is None else across, drive.stride))


def _influence_deviation(prepared: Prepared, motion: _JointMotion) -> float:
    """Measure how far vertices are from where all their weights take them; over the size, in at most KEYFRAMES frames.

    The size is the longest side of the bounding box.
    """
    assert isinstance(prepared.drive, SkinnedDrive)
    poses = [(motion.posed.rotation[t], motion.posed.root[t]) for t in evenly_spread(len(prepared.clip), KEYFRAMES)]
    differences = (motion.drive.posed(*pose) - prepared.drive.posed(*pose) for pose in poses)
    largest = max(float(np.linalg.norm(difference, axis=-1).max()) for difference in differences)
    return largest / float(np.ptp(prepared.rest.vertices, axis=0).max())


def _report_joints(motion: _JointMotion, report: dict, names: tuple[str, str], height: float) -> tuple[str, ...]:
    """Add confidences, foot skates (identity heights a second) and the hands whose fingers move to the report.

    Returns notes on low confidence.
    """
    notes = report_confidence(motion.drive, report, names)
    moved = [side.lower() for side in SIDES if finger_joints(side)[0] in motion.drive.joints]
    report["fingers"] = moved  # of these hands; elsewhere fingers follow the hand
    speeds = foot_skate(motion.posed, motion.track, motion.drive.feet, motion.scale)
    for key, speed in zip(("foot_skate", "foot_skate_driving"), speeds or (None, None), strict=True):
        report[key] = None if speed is None else speed / height
    return notes


def report_confidence(drive: SkinnedDrive, report: dict, names: tuple[str, str]) -> tuple[str, ...]:
    """Add the confidences of predicted joints to the report, and return notes on low ones."""
    notes = ()
    for which, confidence, name in zip(("identity", "driving"), drive.confidence or (None, None), names, strict=True):
        if confidence is not None:
            report[which] |= confidence.facts()
            notes += confidence.notes(name)
    return notes


def _refined(
    frames: Iterable[Float[np.ndarray, "V 3"]], refinement: Refinement | None, timer: Timer
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield the frames refined. Their time is moved from the step "drive", inside which this runs, to "refine"."""
    for vertices in frames:
        before = timer["refine"]
        with timer.step("refine"):
            refined = vertices if refinement is None else refinement(vertices)
        timer["drive"] -= timer["refine"] - before
        yield refined


def _aligned(
    frames: Iterator[Float[np.ndarray, "V 3"]], prepared: Prepared
) -> tuple[Float[np.ndarray, " 3"], Iterator[Float[np.ndarray, "V 3"]]]:
    """Return the shift that brings the first frame to the identity's position, and the frames (not yet shifted)."""
    first = next(frames)
    return prepared.shift(first), itertools.chain([first], frames)


def _animated_rig(prepared: Prepared, motion: _JointMotion, shift: Float[np.ndarray, " 3"]) -> AnimatedRig:
    """Return the rig and its motion in the identity's axes, unit and position."""
    identity, norm, known = prepared.identity, prepared.identity_norm, prepared.rigs.humanoid
    undo, turn, drive = norm.rotation.T, prepared.turn, motion.drive
    rig = Rig(undo @ drive.rig.rotation, norm.undo(drive.rig.joints), drive.rig.weights)
    rotation, root = undo @ turn @ motion.posed.rotation, norm.undo(motion.posed.root @ turn.T + shift)
    if known is not None:
        identity = identity.with_vertices(known.character.mesh.vertices)
    return AnimatedRig(identity, drive.joints, drive.skinned.parents, rig, rotation, root, drive.person)


def _own_animation(prepared: Prepared, skeleton: AnimatedRig) -> OwnAnimation | None:
    """Return the motion on the bones of the identity's own file, if its rig is used."""
    own, clip = prepared.rigs.identity, prepared.clip
    if own is None:
        return None
    tracks = own.tracks(own.humanoid.tree()[0], skeleton.transforms()) | prepared.rigs.beside | face_tracks(own, clip)
    return OwnAnimation(own.source, clip.mesh.name, tracks, clip.fps, len(clip), own.person)
