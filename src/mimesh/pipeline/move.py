"""Move a mesh in the way that the files of a transfer allow: by copied or matched joints, a reference, or a method.

The same skeleton in both files is copied; rigs of other creatures are matched with each other; two shapes of one mesh
are moved by deformation transfer. Everything else is done by the method (`prepared.py`, `play.py`).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.frame_buffer import LazyFrames, Progress
from ..core.mesh import Clip, Mesh, same_mesh
from ..core.normalization import Normalization
from ..io.beside import missing_images, missing_images_notes
from ..io.gltf.edit import GltfSource
from ..io.gltf.keys import COPY_LIMIT
from ..io.gltf.own_animation import OwnAnimation
from ..methods.base import Method, RigMethod
from .body_choice import looks_like, matched_creatures
from .corrections import NO_CORRECTIONS, Corrections
from .creatures import MatchedCreatures
from .marked_mesh import MarkedFrame, marked_frame
from .matched_rigs import finds_joints, joint_finder
from .play import MovedIdentity, play, pose_frame, surface_report
from .prepared import Choice, MotionOptions, Prepared, check_identity, first_frame, fitted_norms, prepare, read_rigs
from .report import TransferReport, facing
from .result import Timer
from .rigs import NO_RIGS, OTHER, Axes, Rigs
from .same_mesh import ReferenceFrame, nearest_frame


@dataclass(frozen=True, eq=False)
class PreparedNodes:
    """An identity whose nodes get values from the driving's, which are copied or follow matched joints; and a clip."""

    identity: Mesh
    clip: Clip
    axes: Axes
    """Up and front of both, for the report, from which pictures are drawn."""
    rigs: Rigs
    """With the values that are copied, where no joints are matched."""
    matched: MatchedCreatures | None

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the match."""
        return () if self.matched is None else self.matched.notes

    @property
    def facts(self) -> dict:
        """Facts for the report."""
        return {"copied": True} if self.matched is None else {"copied": False, "match": self.matched.facts()}

    def animation(self, root: str = "scale") -> OwnAnimation:
        """Compute the values of the identity's nodes in all frames; `root` is for matched joints (`MotionOptions`)."""
        source, name, length = self.identity.source, self.clip.mesh.name, len(self.clip)
        assert isinstance(source, GltfSource)
        if self.matched is not None:
            return OwnAnimation(source, name, self.matched.tracks(root), self.clip.fps, length, {})
        assert self.rigs.copied is not None
        person = {} if self.rigs.identity is None else self.rigs.identity.person
        tracks, keys = self.rigs.copied.tracks, self.rigs.copied.keys
        return OwnAnimation(source, name, tracks, self.clip.fps, length, person, key_limit=COPY_LIMIT, keys=keys)

    @cached_property
    def scaled(self) -> OwnAnimation:
        """The animation with the path scaled, which single frames are made of."""
        return self.animation()


@dataclass(frozen=True, eq=False)
class PreparedShape:
    """An identity that is moved by deformation transfer from a frame of the driving that has about its pose."""

    prepared: Prepared
    reference: ReferenceFrame | MarkedFrame
    norm: Normalization
    """Of the identity."""


PreparedMove = Prepared | PreparedNodes | PreparedShape
"""An identity and a clip after all work that is done once, in the way that the files allow."""


def move(
    identity: Mesh,
    clip: Clip,
    choice: Choice,
    axes: Axes,
    refine: bool | None,
    timer: Timer,
    options: MotionOptions,
    progress: Progress | None = None,
    dtype: type[np.floating] = np.float64,
    corrections: Corrections = NO_CORRECTIONS,
) -> MovedIdentity:
    """Give the identity the motion of a clip: `prepare_move`, then `play_move`.

    Raises:
        InputError: an axis, the model, its options or the corrections cannot be used.
    """
    with timer.step("prepare"):
        prepared = prepare_move(identity, clip, choice, axes, refine, options, corrections)
    return play_move(prepared, timer, options, progress, dtype)


def prepare_move(
    identity: Mesh,
    clip: Clip,
    choice: Choice,
    axes: Axes,
    refine: bool | None,
    options: MotionOptions,
    corrections: Corrections = NO_CORRECTIONS,
) -> PreparedMove:
    """Choose the way to move a mesh, and prepare it.

    Raises:
        InputError: an axis, the model, its options or the corrections cannot be used.
    """
    check_identity(identity)
    if options.body == OTHER and corrections.given:
        raise InputError(
            "--joints: expected people or four-legged animals, found --body other, which has no joints to correct; "
            "leave one of the two out, or ignore the files with --no-joints"
        )
    rigs = read_rigs(identity, clip, options, corrections, copy=not options.changes_motion)
    matched = _matched_creatures(identity, clip, rigs, choice, axes, options, corrections)
    if (rigs.only_copied or matched is not None) and options.smooth > 0:
        raise InputError(
            f"--smooth: expected the rig of a person, found another one in {identity.name}; leave this option out"
        )
    if matched is not None:
        return PreparedNodes(identity, clip, matched.axes, rigs, matched)
    reference = _other_shape(identity, clip, rigs, choice, axes, options, corrections)
    if reference is not None:
        return _prepare_shape(identity, clip, reference, axes, refine, options)
    if rigs.copied is not None:
        return PreparedNodes(identity, clip, rigs.axes(axes), rigs, None)
    return prepare(identity, clip, choice, axes, refine, options, corrections, rigs)


def play_move(
    prepared: PreparedMove,
    timer: Timer,
    options: MotionOptions,
    progress: Progress | None = None,
    dtype: type[np.floating] = np.float64,
) -> MovedIdentity:
    """Make all frames of a clip and their report; the options have been checked in `prepare_move`."""
    if isinstance(prepared, PreparedNodes):
        return _play_nodes(prepared, timer, options.root, progress, dtype)
    if isinstance(prepared, PreparedShape):
        return _play_shape(prepared, timer, options, progress, dtype)
    return play(prepared, timer, options, progress, dtype)


def frame_of_move(prepared: PreparedMove, t: int) -> Float[np.ndarray, "V 3"]:
    """Make the identity's vertices in frame t only; see `pose_frame`."""
    if isinstance(prepared, PreparedNodes):
        return next(prepared.scaled.vertices(np.array([t])))
    return pose_frame(prepared.prepared if isinstance(prepared, PreparedShape) else prepared, t)


def refined_move(prepared: PreparedMove, refine: bool | None) -> PreparedMove:
    """Switch refinement on or off, where there is any; None takes the method's default."""
    if isinstance(prepared, PreparedNodes):
        return prepared
    if isinstance(prepared, PreparedShape):
        return dataclasses.replace(prepared, prepared=prepared.prepared.with_refinement(refine))
    return prepared.with_refinement(refine)


def _matched_creatures(
    identity: Mesh,
    clip: Clip,
    rigs: Rigs,
    choice: Choice,
    axes: Axes,
    options: MotionOptions,
    corrections: Corrections,
) -> MatchedCreatures | None:
    """Match the rigs of both files with each other where these are of other creatures, and are not the same."""
    if options.rig != "own" or rigs.copied is not None or corrections.given:
        return None

    def method() -> Method:
        return choice(fitted_norms(identity, first_frame(clip), rigs.axes(axes))[1])

    def read(method: RigMethod) -> Rigs:
        find = joint_finder(method, axes[:2]), joint_finder(method, axes[2:])
        return read_rigs(identity, clip, options, corrections, copy=False, find=find)

    asked = OTHER if rigs.only_copied else options.body
    return matched_creatures(method, asked, rigs, read, identity, clip, axes)


def _other_shape(
    identity: Mesh,
    clip: Clip,
    rigs: Rigs,
    choice: Choice,
    axes: Axes,
    options: MotionOptions,
    corrections: Corrections,
) -> ReferenceFrame | MarkedFrame | None:
    """Find the frame of a driving that has about the identity's pose; None where the method of `choice` moves it."""
    if rigs.copied is not None or corrections.given or options.body not in ("auto", OTHER):
        return None
    first = first_frame(clip)
    method = choice(fitted_norms(identity, first, rigs.axes(axes))[1])
    if not finds_joints(method):
        return None
    if options.body == OTHER:
        return nearest_frame(identity, clip) if same_mesh(identity, clip.mesh) else marked_frame(identity, clip, axes)
    if rigs.bodies != (None, None) or len(clip) == 1 or not same_mesh(identity, clip.mesh):
        return None
    if looks_like(method, identity, axes[:2]) or looks_like(method, first, axes[2:]):
        return None
    return nearest_frame(identity, clip)


def prepare_frames(
    identity: Mesh,
    clip: Clip,
    choice: Choice,
    axes: Axes,
    refine: bool | None,
    options: MotionOptions,
    corrections: Corrections = NO_CORRECTIONS,
) -> Prepared:
    """Prepare an identity for frames that are made one by one, as `move` does for a clip without joints in its file.

    Raises:
        InputError: an axis, the model, its options or the corrections cannot be used.
    """
    rigs = read_rigs(identity, clip, options, corrections, copy=False)
    other = _other_shape(identity, clip, rigs, choice, axes, options, corrections)
    if other is None:
        return prepare(identity, clip, choice, axes, refine, options, corrections, rigs)
    shape = _prepare_shape(identity, clip, other, axes, refine, options)
    prepared, norm = shape.prepared, shape.norm
    noted = dataclasses.replace(NO_RIGS, notes=(other.note((identity.name, clip.mesh.name)),))
    # The axes were not given by the caller.
    norms = (
        dataclasses.replace(prepared.identity_norm, up_from=norm.up_from),
        dataclasses.replace(prepared.driving_norm, up_from="shape"),
    )
    return dataclasses.replace(prepared, identity_norm=norms[0], driving_norm=norms[1], rigs=noted)


def _prepare_shape(
    identity: Mesh,
    clip: Clip,
    reference: ReferenceFrame | MarkedFrame,
    axes: Axes,
    refine: bool | None,
    options: MotionOptions,
) -> PreparedShape:
    norm = Normalization.fit(identity, *axes[:2])
    known = (norm.up, norm.front, *reference.axes(norm))

    def choice(driving: Normalization) -> Method:
        return reference.method(clip.mesh, norm, driving)

    options = dataclasses.replace(options, rig="mimesh", body="auto")
    return PreparedShape(prepare(identity, clip, choice, known, refine, options, rigs=NO_RIGS), reference, norm)


def _play_shape(
    shape: PreparedShape,
    timer: Timer,
    options: MotionOptions,
    progress: Progress | None,
    dtype: type[np.floating],
) -> MovedIdentity:
    """Move an identity by deformation transfer."""
    prepared, reference = shape.prepared, shape.reference
    moved = play(prepared, timer, dataclasses.replace(options, rig="mimesh", body="auto"), progress, dtype)
    moved.report["identity"] |= facing(shape.norm)
    if isinstance(reference, ReferenceFrame):
        moved.report["driving"]["up_from"] = "identity"
    moved.report["reference"] = reference.facts()
    names = prepared.identity.name, prepared.clip.mesh.name
    return dataclasses.replace(moved, notes=(reference.note(names), *moved.notes))


def _play_nodes(
    prepared: PreparedNodes,
    timer: Timer,
    root: str,
    progress: Progress | None,
    dtype: type[np.floating],
) -> MovedIdentity:
    """Animate the nodes of the identity's file, and report; nothing is planted."""
    identity, clip = prepared.identity, prepared.clip
    with timer.step("drive"):
        own = prepared.animation(root)
        if progress is not None:
            progress(len(clip), len(clip))
        moved = LazyFrames((own.frames, len(identity.vertices)), own.vertices, np.dtype(dtype))
        report = surface_report(identity, clip, moved, fitted_norms(identity, first_frame(clip), prepared.axes))
    report |= {"rig": "own", **prepared.facts, "fingers": [], "foot_skate": None, "foot_skate_driving": None}
    notes = prepared.notes + missing_images_notes(missing_images(identity))
    return MovedIdentity(moved, None, own, cast(TransferReport, report), notes)
