"""transfer() and animate(): read, normalise, move, undo, place."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from .frame import Frame
from .mesh import Clip, InputError, Mesh, check_clip, check_mesh
from .methods import Drive, Method, find_method
from .methods.mime import Pose, Puppet
from .paging import PAGED, let_go, new_frames
from .refine import Refinement
from .report import facing, facing_note, quality
from .result import ClipResult, Result, no_time_yet, timed
from .rig import Rig, Skeleton

Progress = Callable[[int, int], None]
"""Called after each frame with (frames done, frames in all)."""
GLIMPSES = 16
"""Frames of a clip that a method may look at before it begins."""
Choice = Callable[[Frame], Method]
"""A method with its options, but for the driving's frame."""


def transfer(
    identity: Mesh | str | Path,
    driving: Mesh | str | Path,
    model: str = "mime",
    *,
    up: str | None = None,
    front: str | None = None,
    driving_up: str | None = None,
    driving_front: str | None = None,
    ensemble: int = 1,
    seed: int = 0,
    refine: bool | None = None,
    reference: Mesh | str | Path | None = None,
    markers: ArrayLike | str | Path | None = None,
) -> Result:
    """Give the identity the pose of the driving mesh: animate() with one frame, in double precision.

    Takes meshes or paths. Axes ("+y", "-z") that are not given are found from the shapes. The result stands where the
    identity stood and heads where the driving does.

    Args:
        ensemble: average over this many random pairings (index-paired networks only).
        refine: smooth the result as the identity's surface allows; None leaves it to the model.
        reference: the driving mesh in the identity's pose (deformation transfer only).
        markers: pairs (identity vertex, driving vertex) that correspond, or a file of them (deformation transfer only).

    Raises:
        InputError: a file, an axis, the model or its options cannot be used; the message says why and what to do.
    """
    seconds = no_time_yet()
    with timed(seconds, "load"):
        identity, driving = _read_mesh(identity), _read_mesh(driving)
    axes = (up, front, driving_up, driving_front)
    method = _choice(model, ensemble, seed, reference, markers)
    moved, _, report, notes = _move(identity, Clip.still(driving), method, axes, seconds, refine, None, np.float64)
    return Result(identity.with_vertices(moved[0]), model, seconds, report, notes)


def animate(
    identity: Mesh | str | Path,
    driving: Clip | str | Path,
    model: str = "mime",
    *,
    up: str | None = None,
    front: str | None = None,
    driving_up: str | None = None,
    driving_front: str | None = None,
    ensemble: int = 1,
    seed: int = 0,
    refine: bool | None = None,
    reference: Mesh | str | Path | None = None,
    markers: ArrayLike | str | Path | None = None,
    fps: float | None = None,
    start: int = 0,
    stop: int | None = None,
    step: int = 1,
    progress: Progress | None = None,
) -> ClipResult:
    """Make the identity move as the driving clip does; see `transfer` for the arguments they share.

    Args:
        fps: frame rate of the driving clip, where its file has none or a wrong one. Every `step`-th frame of it is
            taken from `start` up to `stop`, and the result plays at fps / step: as fast as the driving.

    The first frame taken stands where the identity stood; later ones move by the driving's displacement, in the
    identity's size.

    Raises:
        InputError: a file, an axis, the range, the model or its options cannot be used.
    """
    seconds = no_time_yet()
    with timed(seconds, "load"):
        identity = _read_mesh(identity)
        clip = _cut(_read_clip(driving, fps), start, stop, step)
    axes = (up, front, driving_up, driving_front)
    method = _choice(model, ensemble, seed, reference, markers)
    moved, skeleton, report, notes = _move(identity, clip, method, axes, seconds, refine, progress, np.float32)
    if len(clip) == 1:
        notes += (f"{clip.mesh.name} has one frame, a pose; animations inside glTF files are not read: give a folder",)
    mesh = identity.with_vertices(moved[0].astype(np.float64))
    return ClipResult(Clip(mesh, moved, clip.fps), model, seconds, report, notes, skeleton)


def _choice(model: str, ensemble: int, seed: int, reference, markers) -> Choice:
    """The method of a name with its options, once the driving's frame is known."""
    mesh = None if reference is None else _read_mesh(reference)
    if isinstance(markers, (str, Path)):
        from .io.markers import load_markers

        markers = load_markers(Path(markers))
    elif markers is not None:
        markers = _pairs(markers)

    def choose(frame: Frame) -> Method:
        third = None if mesh is None else dataclasses.replace(mesh, vertices=frame.apply(mesh.vertices))
        return find_method(model, ensemble=ensemble, seed=seed, reference=third, markers=markers)

    return choose


def _pairs(markers: ArrayLike) -> Int[np.ndarray, "M 2"]:
    try:
        found = np.asarray(markers)
    except ValueError:  # rows of different lengths
        found = np.asarray(markers, object)
    if found.ndim != 2 or found.shape[1] != 2 or found.dtype.kind not in "iu":
        raise InputError(
            f"markers: expected whole numbers of shape (M, 2), found {found.dtype} {found.shape}; "
            "rows are (identity vertex, driving vertex)"
        )
    return found.astype(np.int64)


def _move(
    identity: Mesh,
    clip: Clip,
    choice: Choice,
    axes: tuple[str | None, str | None, str | None, str | None],
    seconds: dict[str, float],
    refine: bool | None,
    progress: Progress | None,
    dtype: type[np.floating],
) -> tuple[Float[np.ndarray, "T V 3"], Skeleton | None, dict, tuple[str, ...]]:
    """Normalise, move, undo, place: vertices in the identity's axes, its joints, the report and the notes."""
    with timed(seconds, "prepare"):
        first = dataclasses.replace(clip.mesh, vertices=clip.vertices[0].astype(np.float64))
        own, theirs = Frame.fit(identity, *axes[:2]), Frame.fit(first, *axes[2:])
        still = dataclasses.replace(identity, vertices=own.apply(identity.vertices))
        method = choice(theirs)
        drive = method.prepare(still, _glimpses(clip, first, theirs))
        surface = Refinement.of(still) if (method.rough if refine is None else refine) else None
    with timed(seconds, "drive"):
        poses: list[Pose] = []
        frames = _recorded(drive, (theirs.apply(vertices) for vertices in clip.vertices), poses)
        shift, frames = _placed(_refined(frames, surface, seconds), still.vertices)
        moved = new_frames(len(clip), len(identity.vertices), dtype)
        for t, vertices in enumerate(frames):
            moved[t] = own.undo(vertices + shift)
            if t % PAGED == 0:
                let_go(moved)
                let_go(clip.vertices)
            if progress is not None:
                progress(t + 1, len(clip))
    report = {**quality(identity, moved), "identity": facing(own), "driving": facing(theirs)}
    notes = facing_note(own, identity.name, "--front") + facing_note(theirs, first.name, "--driving-front")
    skeleton = _skeleton(identity, drive, poses, own, shift) if isinstance(drive, Puppet) else None
    return moved, skeleton, report, notes + tuple(getattr(identity.source, "notes", ()))


def _glimpses(clip: Clip, first: Mesh, frame: Frame) -> Clip:
    """The driving as methods are prepared for it: normalised, a few frames of it."""
    chosen = np.linspace(0, len(clip) - 1, min(len(clip), GLIMPSES)).round().astype(int)
    vertices = frame.apply(clip.vertices[chosen])
    return Clip(dataclasses.replace(first, vertices=vertices[0]), vertices, clip.fps)


def _refined(
    frames: Iterable[Float[np.ndarray, "V 3"]], surface: Refinement | None, seconds: dict[str, float]
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """The frames on the identity's surface; the time that takes is taken off that of driving."""
    for vertices in frames:
        before = seconds["refine"]
        with timed(seconds, "refine"):
            refined = vertices if surface is None else surface(vertices)
        seconds["drive"] -= seconds["refine"] - before
        yield refined


def _recorded(
    drive: Drive, frames: Iterable[Float[np.ndarray, "U 3"]], poses: list[Pose]
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """The results of all frames; what the joints do, if the method has some, is kept in `poses`."""
    if not isinstance(drive, Puppet):
        yield from drive(frames)
        return
    for pose in drive.poses(frames):
        poses.append(pose)
        yield drive.posed(*pose)


def _placed(
    frames: Iterator[Float[np.ndarray, "V 3"]], still: Float[np.ndarray, "V 3"]
) -> tuple[Float[np.ndarray, " 3"], Iterator[Float[np.ndarray, "V 3"]]]:
    """What shifts all frames so that the first stands on the identity's ground, in the middle of its place; frames."""
    first = next(frames)
    return _stand(still) - _stand(first), itertools.chain([first], frames)


def _skeleton(
    identity: Mesh, puppet: Puppet, poses: list[Pose], own: Frame, shift: Float[np.ndarray, " 3"]
) -> Skeleton:
    """The joints of a result in the identity's axes, unit and place."""
    back = own.rotation.T
    rotation, root = (np.stack(arrays) for arrays in zip(*poses, strict=True))
    rig = Rig(back @ puppet.rig.rotation, own.undo(puppet.rig.joints), puppet.rig.weights)
    return Skeleton(identity, puppet.joints, puppet.skinned.parents, rig, back @ rotation, own.undo(root + shift))


def _stand(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, " 3"]:
    """Middle of the bounding box across the ground, its lowest point along up (y)."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])


def _read_mesh(mesh: Mesh | str | Path) -> Mesh:
    if isinstance(mesh, Mesh):
        return check_mesh(mesh, mesh.name)
    from .io import load_mesh

    return load_mesh(Path(mesh))


def _read_clip(clip: Clip | str | Path, fps: float | None) -> Clip:
    if isinstance(clip, Clip):
        return check_clip(clip if fps is None else dataclasses.replace(clip, fps=fps), clip.mesh.name)
    from .io import load_clip

    return load_clip(Path(clip), fps=fps)


def _cut(clip: Clip, start: int, stop: int | None, step: int) -> Clip:
    if step < 1:
        raise InputError(f"--step: expected 1 or more, found {step}; give a positive number")
    vertices = clip.vertices[start:stop:step]
    if len(vertices) == 0:
        raise InputError(
            f"{clip.mesh.name}: expected --start and --stop within its {len(clip)} frames, found {start} to "
            f"{'the end' if stop is None else stop}, which leaves none; change them"
        )
    return dataclasses.replace(clip, vertices=vertices, fps=clip.fps / step)
