"""Move a mesh in the way that the files of a transfer allow: by copied or matched joints, a reference, or a method.

The same skeleton in both files is copied; rigs of other creatures are matched with each other; two shapes of one mesh
are moved by deformation transfer. Everything else is done by the method (`run.py`).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ..core.errors import InputError
from ..core.frame_buffer import Progress, allocate_frames
from ..core.mesh import Clip, Mesh
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
from .report import facing
from .result import Timer
from .rigs import NO_RIGS, OTHER, Axes, Rigs
from .run import (
    Choice,
    MotionOptions,
    MovedIdentity,
    check_identity,
    first_frame,
    fitted_norms,
    play,
    prepare,
    read_rigs,
    surface_report,
)
from .same_mesh import ReferenceFrame, nearest_frame, same_mesh


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
    """Give the identity the motion of a clip: `prepare`, then `play`.

    Raises:
        InputError: an axis, the model, its options or the corrections cannot be used.
    """
    check_identity(identity)
    with timer.step("prepare"):
        rigs = read_rigs(identity, clip, options, corrections, copy=not options.changes_motion)
        matched = _matched_creatures(identity, clip, rigs, choice, axes, options, corrections)
        if (rigs.only_copied or matched is not None) and options.smooth > 0:
            raise InputError(
                f"--smooth: expected the rig of a person, found another one in {identity.name}; leave this option out"
            )
        other = _other_shape(identity, clip, rigs, choice, axes, options, corrections) if matched is None else None
        if other is not None:
            return move_shape(identity, clip, other, axes, refine, timer, options, progress, dtype)
        copied = rigs.copied is not None or matched is not None
        prepared = None if copied else prepare(identity, clip, choice, axes, refine, options, corrections, rigs)
    if matched is not None:
        return move_creature(identity, clip, matched, options.root, timer, progress, dtype)
    if prepared is None:
        return copy_animation(identity, clip, rigs, axes, timer, progress, dtype)
    return play(prepared, timer, options, progress, dtype)


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
        return nearest_frame(identity, clip) if same_mesh(identity, clip) else marked_frame(identity, clip, axes)
    if rigs.bodies != (None, None) or len(clip) == 1 or not same_mesh(identity, clip):
        return None
    if looks_like(method, identity, axes[:2]) or looks_like(method, first, axes[2:]):
        return None
    return nearest_frame(identity, clip)


def move_shape(
    identity: Mesh,
    clip: Clip,
    reference: ReferenceFrame | MarkedFrame,
    axes: Axes,
    refine: bool | None,
    timer: Timer,
    options: MotionOptions,
    progress: Progress | None,
    dtype: type[np.floating],
) -> MovedIdentity:
    """Move an identity by deformation transfer from a frame of the driving that has about its pose."""
    with timer.step("prepare"):
        norm = Normalization.fit(identity, *axes[:2])
        known = (norm.up, norm.front, *reference.axes(norm))

        def choice(driving: Normalization) -> Method:
            return reference.method(clip.mesh, norm, driving)

        options = dataclasses.replace(options, rig="mimesh", body="auto")
        prepared = prepare(identity, clip, choice, known, refine, options, rigs=NO_RIGS)
    moved = play(prepared, timer, options, progress, dtype)
    moved.report["identity"] |= facing(norm)
    if isinstance(reference, ReferenceFrame):
        moved.report["driving"]["up_from"] = "identity"
    moved.report["reference"] = reference.facts()
    return dataclasses.replace(moved, notes=(reference.note((identity.name, clip.mesh.name)), *moved.notes))


def copy_animation(
    identity: Mesh,
    clip: Clip,
    rigs: Rigs,
    axes: Axes,
    timer: Timer,
    progress: Progress | None,
    dtype: type[np.floating],
) -> MovedIdentity:
    """Move an identity whose skeleton is the driving's: its joints get the same values, and nothing is planted.

    Axes are found only for the report, from which pictures are drawn.
    """
    assert isinstance(identity.source, GltfSource)
    assert rigs.copied is not None
    person = {} if rigs.identity is None else rigs.identity.person
    tracks, keys = rigs.copied.tracks, rigs.copied.keys
    own = OwnAnimation(
        identity.source, clip.mesh.name, tracks, clip.fps, len(clip), person, key_limit=COPY_LIMIT, keys=keys
    )
    return _moved_nodes(identity, clip, own, rigs.axes(axes), {"copied": True}, timer, progress, dtype)


def move_creature(
    identity: Mesh,
    clip: Clip,
    matched: MatchedCreatures,
    root: str,
    timer: Timer,
    progress: Progress | None,
    dtype: type[np.floating],
) -> MovedIdentity:
    """Move an identity whose joints are matched with those of the driving, whatever creature it is."""
    with timer.step("prepare"):
        tracks = matched.tracks(root)
    own = OwnAnimation(matched.identity.source, clip.mesh.name, tracks, clip.fps, len(clip), {})
    facts = {"copied": False, "match": matched.facts()}
    moved = _moved_nodes(identity, clip, own, matched.axes, facts, timer, progress, dtype)
    return dataclasses.replace(moved, notes=matched.notes + moved.notes)


def _moved_nodes(
    identity: Mesh,
    clip: Clip,
    own: OwnAnimation,
    axes: Axes,
    facts: dict,
    timer: Timer,
    progress: Progress | None,
    dtype: type[np.floating],
) -> MovedIdentity:
    """Make all frames of an animation of the nodes of the identity's file, and their report."""
    moved = allocate_frames(len(clip), len(identity.vertices), dtype)
    with timer.step("drive"):
        for t, vertices in enumerate(own.vertices()):
            moved[t] = vertices
            if progress is not None:
                progress(t + 1, len(clip))
    report = surface_report(identity, clip, moved, fitted_norms(identity, first_frame(clip), axes))
    report |= {"rig": "own", **facts, "fingers": [], "foot_skate": None, "foot_skate_driving": None}
    return MovedIdentity(moved, None, own, report, missing_images_notes(missing_images(identity)))
