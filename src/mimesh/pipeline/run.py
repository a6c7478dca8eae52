"""The steps of every transfer: normalise, prepare, drive, refine, place, undo the normalisation, and report.

No model is named here. A method that moves joints returns a `SkinnedDrive`; only those take `MotionOptions`.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ..core.animated_rig import AnimatedRig
from ..core.errors import InputError
from ..core.frame_buffer import PAGED, Progress, allocate_frames, each_frame, release_pages
from ..core.joint_tracks import JointTrack, foot_skate
from ..core.mesh import Clip, Mesh
from ..core.normalization import AXES, ORIENTATIONS, Normalization, parse_axis
from ..core.rig import Rig
from ..methods.base import Drive, Method, QuickPredictor, SkinnedDrive, SkinnedMethod
from ..methods.confidence import Confidence
from .refine import Refinement
from .report import accelerations, facing, facing_note, quality
from .result import Timer

Choice = Callable[[Normalization], Method]
"""A method with its options, given the driving's normalisation."""
Axes = tuple[str | None, str | None, str | None, str | None]
"""Up and front of the identity and of the driving; None is detected."""
KEYFRAMES = 16
"""Frames of a clip, evenly spread, that a method sees while preparing."""
ROOTS = ("scale", "keep", "drop")
MIN_GAIN = 0.15
"""Nats by which the entropy of the skinning weights must fall for other axes to be taken (docs/LOG.md)."""


@dataclass(frozen=True)
class MotionOptions:
    """What is wanted of a model with joints; see `pipeline.animate`."""

    root: str = "scale"
    ground: bool = False
    smooth: float = 0.0
    skinned: bool = False

    def check(self, method: Method) -> None:
        """Raise InputError where a value makes no sense, or needs joints that the model does not have."""
        if self.root not in ROOTS:
            raise InputError(f"--root: expected one of {', '.join(ROOTS)}, found {self.root!r}; choose one of them")
        if not 0 <= self.smooth < np.inf:
            raise InputError(f"--smooth: expected seconds, 0 or more, found {self.smooth}; try 0.05")
        if not isinstance(method, SkinnedMethod):
            for field in dataclasses.fields(self):
                if getattr(self, field.name) != field.default:
                    raise InputError(
                        f"--{field.name}: expected a model with joints (mime), found {method.name}; choose it with -m"
                    )


@dataclass(frozen=True, eq=False)
class MovedIdentity:
    """A result in the identity's axes, unit and place."""

    vertices: Float[np.ndarray, "T V 3"]
    skeleton: AnimatedRig | None
    """What moved the identity, if the method has joints."""
    report: dict
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _JointMotion:
    """The motion of a skinned identity's joints over a whole clip."""

    drive: SkinnedDrive
    track: JointTrack
    path: Float[np.ndarray, "T 3"]
    """Positions of the root joint."""

    def frames(self) -> Iterator[Float[np.ndarray, "V 3"]]:
        return (self.drive.posed(*pose) for pose in zip(self.track.rotation, self.path, strict=True))


@dataclass(frozen=True, eq=False)
class Prepared:
    """An identity and a clip after all work that is done once: frames follow one by one."""

    identity: Mesh
    clip: Clip
    method: Method
    drive: Drive
    identity_norm: Normalization
    driving_norm: Normalization
    rest: Mesh
    """The identity, normalised."""
    surface: Refinement | None
    """Refines results; None leaves them as they are."""

    def refined(self, refine: bool | None) -> Prepared:
        """The same with results refined, or not, or as the method has it (None)."""
        surface = Refinement.of(self.rest) if (self.method.rough if refine is None else refine) else None
        return dataclasses.replace(self, surface=surface)


def prepare(
    identity: Mesh, clip: Clip, choice: Choice, axes: Axes, refine: bool | None, options: MotionOptions
) -> Prepared:
    """Normalise both inputs, choose the method and prepare it.

    The options are only checked against the method here: joints move in `play`.

    Raises:
        InputError: an axis, the model or its options cannot be used.
    """
    first = dataclasses.replace(clip.mesh, vertices=clip.vertices[0].astype(np.float64))
    norms = Normalization.fit(identity, *axes[:2]), Normalization.fit(first, *axes[2:])
    method = choice(norms[1])
    options.check(method)
    drive = method.prepare(_normalised(identity, norms[0]), _keyframes(clip, first, norms[1]))
    if isinstance(method, QuickPredictor) and isinstance(drive, SkinnedDrive):
        better = (
            reorient(method, identity, norms[0], axes[:2], drive.confidence[0]),
            reorient(method, first, norms[1], axes[2:], drive.confidence[1]),
        )
        if better != norms:
            norms = better
            drive = method.prepare(_normalised(identity, norms[0]), _keyframes(clip, first, norms[1]))
    rest = _normalised(identity, norms[0])
    return Prepared(identity, clip, method, drive, norms[0], norms[1], rest, None).refined(refine)


def reorient(
    method: QuickPredictor,
    mesh: Mesh,
    norm: Normalization,
    axes: tuple[str | None, str | None],
    confidence: Confidence,
) -> Normalization:
    """Correct axes that were detected wrongly: the same normalisation, or a better one.

    Only where the method hardly recognises the mesh. All orientations that the user's axes leave are tried, the one
    with the most decided skinning weights wins, and the predicted hips then say where up and front are in it.
    """
    if not norm.detected or confidence.recognised:
        return norm
    up, front = parse_axis(axes[0], "--up"), parse_axis(axes[1], "--front")
    allowed = [names for names in ORIENTATIONS if up in (None, names[0]) and front in (None, names[1])]
    tried = []
    for names in allowed:
        fitted = Normalization.fit(mesh, *names)
        entropy, hips = method.quick_predict(_normalised(mesh, fitted))
        tried.append((entropy, fitted, hips))
    least, best, hips = min(tried, key=lambda each: each[0])
    names = tuple(_nearest_axis(best.rotation.T @ hips[:, k]) for k in (1, 2))
    chosen = Normalization.fit(mesh, *names) if names in allowed else best
    before = next(entropy for entropy, fitted, _ in tried if (fitted.up, fitted.front) == (norm.up, norm.front))
    if least > before - MIN_GAIN or (chosen.up, chosen.front) == (norm.up, norm.front):
        return norm
    return dataclasses.replace(chosen, detected=True, margin=0.0)


def pose_frame(prepared: Prepared, t: int) -> Float[np.ndarray, "V 3"]:
    """The identity in frame t alone, where that frame of the whole clip stands.

    Methods that work in windows of frames see it out of context. Paths of joints that are smoothed, grounded or not
    scaled are for whole clips: see `play`.
    """
    chosen = [0] if t == 0 else [0, t]
    driving = (prepared.driving_norm.apply(np.asarray(prepared.clip.vertices[k], np.float64)) for k in chosen)
    refined = _refined(prepared.drive(driving), prepared.surface, Timer())
    shift, frames = _placed(refined, prepared.rest.vertices)
    *_, vertices = frames
    return prepared.identity_norm.undo(vertices + shift)


def move(
    identity: Mesh,
    clip: Clip,
    choice: Choice,
    axes: Axes,
    refine: bool | None,
    timer: Timer,
    options: MotionOptions = MotionOptions(),
    progress: Progress | None = None,
    dtype: type[np.floating] = np.float64,
) -> MovedIdentity:
    """Give the identity the motion of a clip.

    Raises:
        InputError: an axis, the model or its options cannot be used.
    """
    with timer.step("prepare"):
        prepared = prepare(identity, clip, choice, axes, refine, options)
    return play(prepared, timer, options, progress, dtype)


def play(
    prepared: Prepared,
    timer: Timer,
    options: MotionOptions = MotionOptions(),
    progress: Progress | None = None,
    dtype: type[np.floating] = np.float64,
) -> MovedIdentity:
    """All frames of a clip and their report; the options have been checked."""
    identity, clip, rest = prepared.identity, prepared.clip, prepared.rest
    identity_norm, driving_norm = prepared.identity_norm, prepared.driving_norm
    with timer.step("drive"):
        driving = (driving_norm.apply(vertices) for vertices in each_frame(clip.vertices))
        motion, passes = None, 1
        if isinstance(prepared.drive, SkinnedDrive):
            # All joints are found before the first frame is made: the clip is passed through twice.
            passes = 2
            driving = _counted(driving, progress, len(clip))
            scale = driving_norm.radius / identity_norm.radius
            motion = _joint_motion(prepared.drive, driving, clip.fps, options, scale)
        frames = prepared.drive(driving) if motion is None else motion.frames()
        shift, frames = _placed(_refined(frames, prepared.surface, timer), rest.vertices)
        moved = allocate_frames(len(clip), len(identity.vertices), dtype)
        before = (passes - 1) * len(clip)
        for t, vertices in enumerate(frames):
            moved[t] = identity_norm.undo(vertices + shift)
            if t % PAGED == 0:
                release_pages(moved)
            if progress is not None:
                progress((before + t + 1) // passes, len(clip))
    report = _report(prepared, moved)
    notes = facing_note(identity_norm, identity.name, "--front")
    notes += facing_note(driving_norm, clip.mesh.name, "--driving-front")
    skeleton = None
    if motion is not None:
        skeleton = _animated_rig(identity, motion, identity_norm, shift)
        notes += _report_joints(motion, report, (identity.name, clip.mesh.name), np.ptp(rest.vertices[:, 1]))
        if options.root == "drop":
            report["foot_skate"] = None  # in place, feet slide as they should
    return MovedIdentity(moved, skeleton, report, notes + tuple(getattr(identity.source, "notes", ())))


def _report(prepared: Prepared, moved: Float[np.ndarray, "T V 3"]) -> dict:
    return {
        **quality(prepared.identity, moved),
        **accelerations(prepared.clip, moved),
        "identity": facing(prepared.identity_norm),
        "driving": facing(prepared.driving_norm),
    }


def _joint_motion(
    drive: SkinnedDrive,
    frames: Iterable[Float[np.ndarray, "U 3"]],
    fps: float,
    options: MotionOptions,
    scale: float,
) -> _JointMotion:
    """The joints' motion with its options; `scale` is the driving's unit over the identity's."""
    track = drive.track(frames, fps).smoothed(options.smooth)
    across = scale if options.root == "keep" else None
    return _JointMotion(drive, track, drive.path(track, across, options.root == "drop", options.ground))


def _report_joints(motion: _JointMotion, report: dict, names: tuple[str, str], height: float) -> tuple[str, ...]:
    """Add confidences and foot skate (identity heights a second) to the report; return notes on low confidence."""
    notes = ()
    for which, confidence, name in zip(("identity", "driving"), motion.drive.confidence, names, strict=True):
        report[which] |= confidence.facts()
        notes += confidence.notes(name)
    speed = foot_skate(motion.track, motion.path, motion.drive.skinned, motion.drive.feet)
    report["foot_skate"] = None if speed is None else speed / height
    return notes


def _counted(
    frames: Iterable[Float[np.ndarray, "U 3"]], progress: Progress | None, count: int
) -> Iterator[Float[np.ndarray, "U 3"]]:
    """The frames of the first of two passes."""
    for t, vertices in enumerate(frames):
        yield vertices
        if progress is not None:
            progress((t + 1) // 2, count)


def _normalised(mesh: Mesh, norm: Normalization) -> Mesh:
    return dataclasses.replace(mesh, vertices=norm.apply(mesh.vertices))


def _keyframes(clip: Clip, first: Mesh, norm: Normalization) -> Clip:
    """The driving as methods are prepared for it: a few frames, normalised."""
    chosen = np.linspace(0, len(clip) - 1, min(len(clip), KEYFRAMES)).round().astype(int)
    vertices = norm.apply(clip.vertices[chosen])
    return Clip(dataclasses.replace(first, vertices=vertices[0]), vertices, clip.fps)


def _refined(
    frames: Iterable[Float[np.ndarray, "V 3"]], surface: Refinement | None, timer: Timer
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """The frames, refined; the time this takes is moved from the step "drive", inside which it runs, to "refine"."""
    for vertices in frames:
        before = timer["refine"]
        with timer.step("refine"):
            refined = vertices if surface is None else surface(vertices)
        timer["drive"] -= timer["refine"] - before
        yield refined


def _placed(
    frames: Iterator[Float[np.ndarray, "V 3"]], rest: Float[np.ndarray, "V 3"]
) -> tuple[Float[np.ndarray, " 3"], Iterator[Float[np.ndarray, "V 3"]]]:
    """The shift of all frames after which the first stands where the identity stood; and the frames."""
    first = next(frames)
    return _ground_point(rest) - _ground_point(first), itertools.chain([first], frames)


def _ground_point(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " 3"]:
    """Middle of the bounding box over the ground (x and z), its lowest point along up (y)."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])


def _animated_rig(
    identity: Mesh, motion: _JointMotion, norm: Normalization, shift: Float[np.ndarray, " 3"]
) -> AnimatedRig:
    """The joints of a result in the identity's axes, unit and place."""
    back, drive = norm.rotation.T, motion.drive
    rig = Rig(back @ drive.rig.rotation, norm.undo(drive.rig.joints), drive.rig.weights)
    turned, root = back @ motion.track.rotation, norm.undo(motion.path + shift)
    return AnimatedRig(identity, drive.joints, drive.skinned.parents, rig, turned, root)


def _nearest_axis(direction: Float[np.ndarray, " 3"]) -> str:
    k = int(np.abs(direction).argmax())
    return AXES[k if direction[k] > 0 else k + 3]
