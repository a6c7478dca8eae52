"""The steps of every transfer: normalise, prepare, drive, refine, align, undo the normalisation, and report.

No model is named here. Methods that move joints return a `SkinnedDrive`; `MotionOptions` are for these only.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from jaxtyping import Float, Int

from ..bodies.character_limbs import SIDES, FindJoints
from ..bodies.joint_names import finger_joints, without_fingers
from ..core.animated_rig import INFLUENCES, AnimatedRig
from ..core.errors import InputError
from ..core.foot_planting import PosedJoints, foot_skate
from ..core.frame_buffer import PAGED, Progress, allocate_frames, counted, each_frame, release_pages
from ..core.heading import turn, turned_to_front, without_heading
from ..core.joint_tracks import JointTrack
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization
from ..core.rig import Rig
from ..io.beside import missing_images, missing_images_notes
from ..io.gltf.own_animation import OwnAnimation
from ..methods.base import (
    BodyMethod,
    Drive,
    Method,
    MotionMethod,
    QuickPredictor,
    SkinnedDrive,
    SkinnedMethod,
    SurfaceMotion,
)
from ..motions.humanoid_rig import HumanoidRig
from .body_choice import check_body, trained_on_people, with_body
from .corrections import NO_CORRECTIONS, Corrections, JointPositions
from .matched_rigs import finds_joints, joint_finder
from .orientation import normalised, reorient
from .refine import Refinement
from .report import TransferReport, accelerations, facing, facing_note, quality
from .result import Timer
from .rigs import NO_RIGS, Axes, Rigs, face_tracks
from .second_look import body_after_all

Choice = Callable[[Normalization], Method]
"""Makes a method with its options, given the driving's normalisation."""
KEYFRAMES = 16
"""Largest number of frames, evenly spread over a clip, that a method gets in `prepare`."""
MOTION_FRAMES = 120
"""Largest number of frames, evenly spread, in which a method that asks for it gets points of the surface."""
ROOTS = ("scale", "keep", "drop")
FEWEST_VERTICES = 4
"""Vertices of the smallest solid, a tetrahedron; two points and one triangle have no pose."""


@dataclass(frozen=True)
class MotionOptions:
    """Options of models with joints; see `pipeline.animate`."""

    root: str = "scale"
    ground: bool = True
    """Has no effect on a single pose, nor with a method without joints."""
    smooth: float = 0.0
    skinned: bool | None = False
    """Move each vertex by its INFLUENCES largest weights, as files of skinned meshes do; None: if the method has joints
    and the clip is more than a pose."""
    rig: str | HumanoidRig = "own"
    """One of `rigs.RIGS`, or the identity's rig itself. Other values have no effect on a method without joints."""
    body: str = "auto"
    """One of `body_choice.BODIES`."""

    @property
    def changes_motion(self) -> bool:
        """Whether the result differs from the driving's motion on the same skeleton."""
        return self.root != "scale" or self.smooth > 0

    def __post_init__(self) -> None:
        """Raise InputError if a value is not allowed."""
        if self.root not in ROOTS:
            raise InputError(f"--root: expected one of {', '.join(ROOTS)}, found {self.root!r}; choose one of them")
        if not 0 <= self.smooth < np.inf:
            raise InputError(f"--smooth: expected seconds, 0 or more, found {self.smooth}; try 0.05")
        check_body(self.body)

    def check(self, method: Method) -> None:
        """Raise InputError if a value needs joints and the method has none."""
        if not isinstance(method, SkinnedMethod):
            for field in dataclasses.fields(self):
                if field.name not in ("ground", "rig", "body") and getattr(self, field.name) not in (
                    field.default,
                    None,
                ):
                    raise InputError(
                        f"--{field.name}: expected a model with joints (mime), found {method.name}; choose it with -m"
                    )


@dataclass(frozen=True, eq=False)
class MovedIdentity:
    """A result in the identity's axes, unit and position, with its report."""

    vertices: Float[np.ndarray, "T V 3"]
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

    def frames(self) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Yield the identity's vertices in every frame."""
        return (self.drive.posed(*pose) for pose in zip(self.posed.rotation, self.posed.root, strict=True))


@dataclass(frozen=True, eq=False)
class Prepared:
    """An identity and a clip after all work that is done once; frames are then made one by one."""

    identity: Mesh
    clip: Clip
    method: Method
    drive: Drive
    identity_norm: Normalization
    driving_norm: Normalization
    rest: Mesh
    """The identity, normalised."""
    refinement: Refinement | None
    """Refines results; None leaves them as they are."""
    rigs: Rigs = NO_RIGS
    """The rigs of the files that are used."""
    notes: tuple[str, ...] = ()
    """Notes for the user on what the meshes show."""

    @property
    def turn(self) -> Float[np.ndarray, "3 3"]:
        """The turn of results about y: results have the driving's heading, not the identity's."""
        return turn(self.driving_norm.heading - self.identity_norm.heading)

    def shift(self, first: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " 3"]:
        """Return the displacement that brings the first frame of a result to the identity's position; normalised."""
        upright = turn(self.identity_norm.heading)  # bounding boxes are those in the axes of the file
        return (ground_point(self.rest.vertices @ upright.T) - ground_point(first @ upright.T)) @ upright

    def with_refinement(self, refine: bool | None) -> Prepared:
        """Switch refinement on or off; None takes the method's default."""
        refinement = Refinement.of(self.rest) if (self.method.rough if refine is None else refine) else None
        return dataclasses.replace(self, refinement=refinement)


def prepare(
    identity: Mesh,
    clip: Clip,
    choice: Choice,
    axes: Axes,
    refine: bool | None,
    options: MotionOptions,
    corrections: Corrections = NO_CORRECTIONS,
    rigs: Rigs | None = None,
) -> Prepared:
    """Normalise both inputs, choose the method and prepare it.

    The options are only checked here; `play` applies them. Rigs are read if none are given.

    Raises:
        InputError: an axis, the model, its options or the corrections cannot be used.
    """
    check_identity(identity)
    # The normalisation of the first frame is used for the whole clip, so that the driving's displacement is kept.
    first = first_frame(clip)
    rigs = read_rigs(identity, clip, options, corrections, copy=False) if rigs is None else rigs
    norms = fitted_norms(identity, first, rigs.axes(axes))
    chosen = choice(norms[1])
    options.check(chosen)
    body = (corrections.body or options.body) if options.body == "auto" else options.body
    notes = trained_on_people(chosen, body, (identity, first), norms, rigs.axes(axes))
    method, norms = with_body(chosen, body, rigs, (identity, first), norms, rigs.axes(axes))
    if any(rigs.unnamed) and finds_joints(method):
        find = joint_finder(method, axes[:2]), joint_finder(method, axes[2:])
        matched = read_rigs(identity, clip, options, corrections, copy=False, find=find)
        rigs = matched.with_notes((identity.name, clip.mesh.name), rigs)
        norms = fitted_norms(identity, first, rigs.axes(axes))
    given_axes, axes = axes, rigs.axes(axes)
    turned = _without_headings(method, (identity, first), norms, axes)
    drive = _prepared_drive(method, identity, clip, first, turned, corrections, rigs)
    corrected = _corrected_norms(method, drive, (identity, first), norms, axes)
    if corrected != norms:  # `reorient` returns the same object where it changes nothing
        known = [axis for norm in corrected for axis in (norm.up, norm.front)]
        turned = _without_headings(method, (identity, first), corrected, known)
        drive = _prepared_drive(method, identity, clip, first, turned, corrections, rigs)
    if options.body == "auto" and not corrections.given and isinstance(drive, SkinnedDrive):
        other = body_after_all((chosen, method), rigs, (identity, first), axes, drive.confidence)
        if other is not None:
            options = dataclasses.replace(options, body=other)
            return prepare(identity, clip, choice, given_axes, refine, options, corrections, rigs)
    rest = normalised(identity, turned[0])
    prepared = Prepared(identity, clip, method, drive, turned[0], turned[1], rest, None, rigs, notes)
    return prepared.with_refinement(refine)


def _corrected_norms(
    method: Method, drive: Drive, meshes: tuple[Mesh, Mesh], norms: tuple[Normalization, Normalization], axes: Axes
) -> tuple[Normalization, Normalization]:
    """Correct detected axes; the confidence is known only after preparing. Where axes were wrong, it is done again."""
    if not (isinstance(method, QuickPredictor) and isinstance(drive, SkinnedDrive) and drive.confidence is not None):
        return norms
    return (
        reorient(method, meshes[0], norms[0], axes[:2], drive.confidence[0]),
        reorient(method, meshes[1], norms[1], axes[2:], drive.confidence[1]),
    )


def check_identity(identity: Mesh) -> None:
    """Raise InputError for a mesh to move that has too few points for a pose: they have no volume."""
    if len(identity.vertices) < FEWEST_VERTICES:
        raise InputError(
            f"{identity.name}: expected at least {FEWEST_VERTICES} vertices in the mesh to move, found "
            f"{len(identity.vertices)}; check that it is the whole character"
        )


def first_frame(clip: Clip) -> Mesh:
    """Return the driving mesh in the first frame of a clip, in double precision."""
    return dataclasses.replace(clip.mesh, vertices=clip.vertices[0].astype(np.float64))


def read_rigs(
    identity: Mesh,
    clip: Clip,
    options: MotionOptions,
    corrections: Corrections,
    copy: bool,
    find: tuple[FindJoints | None, FindJoints | None] = (None, None),
) -> Rigs:
    """Read the rigs of both files (see `Rigs.read`); that of a mesh whose joints the user has corrected is not used."""
    choice = options.rig if corrections.identity is None else "mimesh"
    rigs = Rigs.read(identity, clip, choice, copy and corrections.driving is None, find, options.body)
    return rigs if corrections.driving is None else dataclasses.replace(rigs, driving=None)


def fitted_norms(identity: Mesh, first: Mesh, axes: Axes) -> tuple[Normalization, Normalization]:
    """Fit the normalisations of the identity and of the driving's first frame."""
    return Normalization.fit(identity, *axes[:2]), Normalization.fit(first, *axes[2:])


def _without_headings(
    method: Method, meshes: tuple[Mesh, Mesh], norms: tuple[Normalization, Normalization], axes: Sequence[str | None]
) -> tuple[Normalization, Normalization]:
    """Take the headings of both meshes out for a method whose predictions depend on them; `axes` are those known."""
    if not isinstance(method, QuickPredictor):
        return norms
    # The front of an animal was found by its network (see `with_body`).
    person = not isinstance(method, BodyMethod) or method.body == "human"
    turned = []
    for mesh, norm, front in zip(meshes, norms, axes[1::2], strict=True):
        known = front is not None or not norm.detected
        rough = without_heading(mesh, norm, known, person)
        _, hips = method.quick_predict(normalised(mesh, rough))
        turned.append(turned_to_front(mesh, rough, hips[:, 2], known or not person))
    return turned[0], turned[1]


def _prepared_drive(
    method: Method,
    identity: Mesh,
    clip: Clip,
    first: Mesh,
    norms: tuple[Normalization, Normalization],
    corrections: Corrections,
    rigs: Rigs,
) -> Drive:
    """Prepare a method with the rigs of the files and the corrected joints."""
    method = rigs.apply(method, clip.fps, norms)
    corrected, keyframes = corrections.apply(method, identity, _keyframes(clip, first, norms[1]), norms)
    if isinstance(corrected, MotionMethod):
        corrected = corrected.with_motion(_surface_motion(clip, norms[1]))
    return corrected.prepare(normalised(identity, norms[0]), keyframes)


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
    options: MotionOptions = MotionOptions(),
    progress: Progress | None = None,
    dtype: type[np.floating] = np.float64,
) -> MovedIdentity:
    """Make all frames of a clip and their report; the options have been checked in `prepare`."""
    identity, clip, rest = prepared.identity, prepared.clip, prepared.rest
    identity_norm, driving_norm = prepared.identity_norm, prepared.driving_norm
    with timer.step("drive"):
        driving = (driving_norm.apply(vertices) for vertices in each_frame(clip.vertices))
        motion, passes = None, 1
        if isinstance(prepared.drive, SkinnedDrive):
            # Options need the whole motion, so all joints are tracked before the first frame is made: two passes.
            passes = 2
            half = progress and (lambda done, total: None if done % 2 else progress(done // 2, total))
            driving = counted(driving, len(clip), half)
            scale = driving_norm.radius / identity_norm.radius
            limited = len(clip) > 1 if options.skinned is None else options.skinned
            # The weights of an identity's own file stay as they are.
            limited = limited and prepared.rigs.humanoid is None
            drive = prepared.drive.limited(rest.vertices, INFLUENCES) if limited else prepared.drive
            motion = _joint_motion(drive, driving, clip.fps, options, scale)
        frames = prepared.drive(driving) if motion is None else motion.frames()
        refined = _refined(frames, prepared.refinement, timer)
        shift, frames = _aligned((vertices @ prepared.turn.T for vertices in refined), prepared)
        skeleton = None if motion is None else _animated_rig(prepared, motion, shift)
        own = None if skeleton is None else _own_animation(prepared, skeleton)
        placed = (identity_norm.undo(vertices + shift) for vertices in frames)
        # The joints of a person alone move neither morph targets nor what else has been copied.
        frames = own.vertices() if own is not None and (own.morphs or prepared.rigs.beside) else placed
        moved = allocate_frames(len(clip), len(identity.vertices), dtype)
        before = (passes - 1) * len(clip)  # frames counted in the first pass
        for t, vertices in enumerate(frames):
            moved[t] = vertices
            # Long results are on disk: pages that have been written need not stay in memory.
            if t % PAGED == 0:
                release_pages(moved)
            if progress is not None and (before + t + 1) % passes == 0:
                progress((before + t + 1) // passes, len(clip))
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
    identity: Mesh, clip: Clip, moved: Float[np.ndarray, "T V 3"], norms: tuple[Normalization, Normalization]
) -> dict[str, Any]:
    """Return the part of the report that all methods have."""
    return {
        **quality(identity, moved),
        **accelerations(clip, moved),
        "identity": facing(norms[0]),
        "driving": facing(norms[1]),
    }


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
    poses = [(motion.posed.rotation[t], motion.posed.root[t]) for t in _evenly_spread(prepared.clip, KEYFRAMES)]
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


def _surface_motion(clip: Clip, norm: Normalization) -> SurfaceMotion:
    """Return the motion of a clip's surface in at most MOTION_FRAMES frames; of each, only the points are read."""
    chosen = _evenly_spread(clip, MOTION_FRAMES)
    return lambda samples: np.stack([norm.apply(samples.points(clip.vertices[t])) for t in chosen])


def _evenly_spread(clip: Clip, most: int) -> Int[np.ndarray, " T"]:
    """Choose frames of a clip, evenly spread, the first and the last among them; all if there are no more than that."""
    return np.linspace(0, len(clip) - 1, min(len(clip), most)).round().astype(int)


def _keyframes(clip: Clip, first: Mesh, norm: Normalization) -> Clip:
    """Return at most KEYFRAMES frames of a clip, evenly spread and normalised; `first` is its first frame."""
    vertices = norm.apply(clip.vertices[_evenly_spread(clip, KEYFRAMES)])
    return Clip(dataclasses.replace(first, vertices=vertices[0], up="+y"), vertices, clip.fps)


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


def ground_point(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " 3"]:
    """Return the centre of the bounding box in x and z, at its lowest y."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])


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
