"""Choose the clips of driving files, by `--animation`, and name them in the result."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import InputError
from ..io import list_animations
from ..io.gltf.animation import find_animation
from ..pipeline.skinned import distinct_names

ALL = "all"
"""Value of `--animation` for all animations of a file."""


@dataclass(frozen=True)
class DrivingClip:
    """A clip of a driving file: the whole file, or one of its animations."""

    path: Path
    animation: str | None
    """Name or number of the animation, as `io.load_clip` takes it; None: the first, with those that complement it."""
    name: str
    """Name of the animation in the result: that of the animation if the file has several, else that of the file."""
    animations: tuple[str, ...] = ()
    """Names of all animations of the file."""


def choose_clips(driving: Sequence[Path], selectors: Sequence[str] | None) -> list[DrivingClip]:
    """Choose clips of driving files, with distinct names.

    Args:
        driving: the files or folders.
        selectors: names or numbers of animations, or ALL. Several of one file, one for each of several files in their
            order, or ALL once for all files; empty or None takes the default of each file.

    Raises:
        InputError: another number of selectors, no such animation, or a damaged file.
    """
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
            f"--animation: expected one for each of {len(driving)} DRIVING, found {len(chosen)}; "
            f"give them in the order of the files, or --animation {ALL} once"
        )
    clips = [clip for path, selector in pairs for clip in _clips_of(path, selector)]
    names = distinct_names([clip.name for clip in clips])
    return [dataclasses.replace(clip, name=name) for clip, name in zip(clips, names, strict=True)]


def _clips_of(path: Path, selector: str | None) -> Iterator[DrivingClip]:
    """Yield the clips of a file that one value of `--animation` chooses."""
    names = list_animations(path)
    if not names:  # reading the file refuses a selector
        yield DrivingClip(path, None if selector == ALL else selector, _file_name(path))
    elif selector is None:
        yield DrivingClip(path, None, _clip_name(path, names, 0) if len(names) > 1 else _file_name(path), names)
    else:
        numbers = range(len(names)) if selector == ALL else (find_animation(names, selector, path),)
        for number in numbers:
            # Of animations of one name only the number tells which is meant.
            exact = names[number] if names.count(names[number]) == 1 else str(number)
            yield DrivingClip(path, exact, _clip_name(path, names, number), names)


def _file_name(path: Path) -> str:
    """Return the name of a file without its suffix, or that of a folder, which may be given as "." or "walk/"."""
    resolved = path.resolve()
    return resolved.name if resolved.is_dir() else resolved.stem


def _clip_name(path: Path, names: Sequence[str], number: int) -> str:
    """Return the name of an animation without what Blender puts before it ("Armature|"); the file's if it has none."""
    name = names[number].rpartition("|")[2]
    return _file_name(path) if name in ("", str(number)) else name
