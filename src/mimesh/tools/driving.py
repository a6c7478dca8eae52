"""Choose the clips of driving files, and read them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .. import io
from ..core.errors import InputError, option
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, check_cut, cut_clip
from ..core.printable import listed
from ..io.formats import CACHE

if TYPE_CHECKING:
    from ..pipeline.read import Told

ALL = "all"
"""Value of `--animation` for all animations of a file."""
MOST_NAMED = 3
"""Animations that are taken together that a note names."""


@dataclass(frozen=True)
class DrivingClip:
    """A clip of a driving file: the whole file, or one of its animations."""

    path: Path
    animation: str | None
    """Name or number of the animation, as `io.load_clip` takes it; None: the first, with those that complement it."""
    name: str
    """Name of the animation in the result: that of the animation if the file has several, else that of the file."""


def choose_clips(driving: Sequence[Path], selectors: Sequence[str] | None) -> list[DrivingClip]:
    """Choose clips of driving files, with distinct names.

    Args:
        selectors: names or numbers of animations, or ALL. Several of one file, one for each of several files in their
            order, or ALL once for all files; empty or None takes the default of each file.

    Raises:
        InputError: another number of selectors, no such animation, or a damaged file.
    """
    from ..pipeline.skinned import distinct_names

    chosen = list(selectors or ())
    if not chosen:
        pairs = [(path, None) for path in driving]
    elif len(driving) == 1:
        pairs = [(driving[0], selector) for selector in chosen]
    elif chosen == [ALL]:
        pairs = [(path, ALL) for path in driving]
    elif len(chosen) == len(driving):
        pairs = list(zip(driving, chosen, strict=True))
    else:
        raise InputError(
            f"{option('animation')}: expected one for each of {len(driving)} DRIVING, found {len(chosen)}; "
            f"give them in the order of the files, or {option('animation', ALL)} once"
        )
    clips = [clip for path, selector in pairs for clip in _clips_of(path, selector)]
    names = distinct_names([clip.name for clip in clips])
    return [dataclasses.replace(clip, name=name) for clip, name in zip(clips, names, strict=True)]


def _clips_of(path: Path, selector: str | None) -> Iterator[DrivingClip]:
    """Yield the clips of a file that one value of `--animation` chooses."""
    names = io.list_animations(path)
    if not names:  # reading the file refuses a selector
        yield DrivingClip(path, None if selector == ALL else selector, file_stem(path))
    elif selector is None:
        yield DrivingClip(path, None, _clip_name(path, names, 0) if len(names) > 1 else file_stem(path))
    else:
        from ..io.gltf.animation import find_animation

        numbers = range(len(names)) if selector == ALL else (find_animation(names, selector, path),)
        for number in numbers:
            # Of animations of one name only the number tells which is meant.
            exact = names[number] if names.count(names[number]) == 1 else str(number)
            yield DrivingClip(path, exact, _clip_name(path, names, number))


def _clip_name(path: Path, names: Sequence[str], number: int) -> str:
    """Return the name of an animation without what Blender puts before it ("Armature|"); the file's if it has none."""
    name = names[number].rpartition("|")[2]
    return file_stem(path) if name in ("", str(number)) else name


def file_stem(path: str | Path) -> str:
    """Return the name of a file without its suffix, or that of a folder, which may be given as "." or "walk/"."""
    resolved = Path(path).resolve()
    return resolved.name if resolved.is_dir() else resolved.stem


def read_driving(
    chosen: DrivingClip,
    body_model: str | Path | None,
    fps: float | None,
    frames: slice,
    progress: Progress | None = None,
    whole: bool = False,
    told: Told = (None, None, "auto"),
) -> tuple[Clip, tuple[str, ...]]:
    """Read a driving clip with notes on what was taken of its file, beside those of the clip itself.

    Args:
        frames: those to take; of a motion file no others are posed, of scans no others are read.
        whole: check `frames`, and return all.
        told: what is known of scans.
    """
    from ..motions.on_body import is_motion_file
    from ..pipeline.read import LONE_FRAMES, first_frame_note, load_moving
    from ..rigs.retarget import ScannedJoints

    path = chosen.path
    early = body_model is None and path.is_file() and is_motion_file(path) and not whole
    if body_model is None:
        taken = frames if early else slice(None)
        clip = load_moving(path, taken, told, fps, chosen.animation, progress, slice(None) if whole else frames)
        notes: tuple[str, ...] = ()
    else:
        clip, notes = read_clip(path, body_model, fps, chosen.animation, progress)
    notes += animations_note(clip, path, several=True) if chosen.animation is None else ()
    notes += taken_rate_note(clip, path) if fps is None else ()
    if frames.start == 0:
        # The capture is kept in memory: nothing is read again.
        first = io.load_driving(path, fps=fps, frames=slice(0, LONE_FRAMES)) if early else clip
        notes += first_frame_note(first, 0, path.name)
    early = early or (isinstance(clip.skeleton, ScannedJoints) and not whole)
    check_cut(clip.mesh.name, len(clip), slice(None) if early else frames)
    return (clip if early or whole else cut_clip(clip, frames.start, frames.stop, frames.step)), notes


def read_clip(
    path: Path,
    body_model: str | Path | None,
    fps: float | None,
    animation: str | None,
    progress: Progress | None = None,
    frames: slice = slice(None),
    betas: np.ndarray | None = None,
) -> tuple[Clip, tuple[str, ...]]:
    """Read a clip, or with a body model the recorded surface; returns notes as well."""
    if body_model is None:
        clip = io.load_driving(path, fps=fps, animation=animation, progress=progress, frames=frames)
        return clip, clip.notes
    clip, notes = io.load_recorded_clip(path, body_model, fps=fps, animation=animation, progress=progress, betas=betas)
    return cut_clip(clip, frames.start or 0, frames.stop, 1 if frames.step is None else frames.step), notes


def taken_rate_note(clip: Clip, path: Path) -> tuple[str, ...]:
    """Return a note that the frame rate of a clip was assumed, because neither its files nor the user gave it."""
    if len(clip) == 1 or not (path.is_dir() or path.suffix.lower() == CACHE):
        return ()
    return (f"{path.name} has no frame rate: {clip.fps:g} frames a second are taken; --fps gives another",)


def animations_note(clip: Clip, path: Path, several: bool = False) -> tuple[str, ...]:
    """Return a note on which animation of a file was taken for a clip, if the file has others.

    Args:
        several: all of them can be taken.
    """
    document = getattr(clip.skeleton, "document", None) or getattr(clip.mesh.source, "document", None)
    if document is None:
        return ()
    from ..io.gltf.animation import animation_names, taken_animations

    names = animation_names(document)
    if len(names) < 2:  # most files: their keys are not read again
        return ()
    taken = taken_animations(document)
    if len(taken) == len(names) or not taken:
        return ()
    if taken == (0,):
        which = f"the first, {names[0]}, is taken"
    else:
        which = f"{listed([names[number] for number in taken], MOST_NAMED)} {'is' if len(taken) == 1 else 'are'} taken"
    others = f"{option('animation', ...)} takes another" + f", {option('animation', ALL)} takes all of them" * several
    return (f"{path.name} has {len(names)} animations: {which}; {others}",)
