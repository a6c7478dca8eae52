"""Find who is in which pose in a folder of registered meshes or clips, by the names of its files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import InputError
from ..io import list_animations
from ..io.formats import CACHES, CLIP_READERS, COLLECTIONS, MESH_READERS, MOTIONS

SUFFIXES = (MESH_READERS.keys() | CLIP_READERS.keys()) - MOTIONS
"""Of files that may hold a mesh or a clip."""
LAYOUTS = ("id{person:d}_{pose}", "tr_reg_{person:2}{pose:1}", "{person}/{pose}", "{person:d}_{pose}")
"""Patterns that are tried in this order: the public data of NPT and `mimesh generate`, FAUST, a folder a person, and
names of clips as in DFAUST's files (.hdf5)."""
FIELD = re.compile(r"\{(person|pose|motion)(?::(d|[1-9]))?\}")
"""A field of a pattern: any characters of a name, with `:d` digits only, with a number so many characters."""


@dataclass(frozen=True)
class Entry:
    """A mesh or clip: a file, a folder of frames, or a clip of a file that has several."""

    person: str
    pose: str
    path: Path
    clip: str | None = None
    """Name of the clip in a file of several."""


@dataclass(frozen=True)
class MeshLayout:
    """What a pattern finds in a folder."""

    pattern: str
    entries: tuple[Entry, ...]
    """In the natural order of people and poses: 2 before 10."""
    ignored: int
    """Number of files that the pattern does not match."""


def find_layout(folder: Path, pattern: str = "") -> MeshLayout:
    """Find the meshes or clips of a folder by a pattern, or by the first of LAYOUTS that matches any.

    Raises:
        InputError: no folder, a pattern without its two fields, no match, or two files of one person in one pose.
    """
    if not folder.is_dir() and folder.suffix.lower() not in COLLECTIONS:
        raise InputError(f"{folder}: expected a folder of registered meshes, found none; check the path")
    found = list(_candidates(folder))
    for tried in (pattern,) if pattern else LAYOUTS:
        expression = compiled(tried)
        named = {(path, clip): expression.fullmatch(clip or _plain(path, folder, tried)) for path, clip in found}
        entries = [Entry(match["person"], match["pose"], *key) for key, match in named.items() if match]
        if entries:
            _refuse_twins(entries)
            entries.sort(key=lambda entry: (natural(entry.person), natural(entry.pose)))
            inside = {entry.path for entry in entries if entry.path.is_dir()}
            others = [key for key in found if not named[key] and key[0].is_file() and key[0].parent not in inside]
            return MeshLayout(tried, tuple(entries), len(others))
    tried = pattern or ", ".join(FIELD.sub(r"{\1}", layout) for layout in LAYOUTS)
    raise InputError(
        f"{folder}: expected meshes or clips named by person and pose ({tried}), found {len(found)} files, none named "
        "so; give their names with --pattern, such as '{person}-{pose}.ply'"
    )


def compiled(pattern: str) -> re.Pattern[str]:
    """Compile a pattern such as "{person}/{pose}.ply" to a regular expression.

    Raises:
        InputError: it has not one {person} and one {pose}, or braces of another kind.
    """
    fields = [match[1].replace("motion", "pose") for match in FIELD.finditer(pattern)]
    literal = FIELD.split(pattern)[:: FIELD.groups + 1]
    if sorted(fields) != ["person", "pose"] or any("{" in part or "}" in part for part in literal):
        raise InputError(
            f"--pattern {pattern}: expected one {{person}} and one {{pose}} (or {{motion}}), found "
            f"{' and '.join(fields) or 'none'}; for example '{{person}}-{{pose}}.ply'"
        )
    expression = re.escape(literal[0])
    for match, name, part in zip(FIELD.finditer(pattern), fields, literal[1:], strict=True):
        kind = match[2]
        text = "[^/]+?" if kind is None else r"\d+" if kind == "d" else f"[^/]{{{kind}}}"
        expression += f"(?P<{name}>{text}){re.escape(part)}"
    return re.compile(expression)


def natural(name: str) -> list[tuple[int, int | str]]:
    """Give a key that sorts names by the numbers in them: walk2 before walk10."""
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in re.split(r"(\d+)", name) if part]


def _candidates(folder: Path) -> Iterator[tuple[Path, str | None]]:
    """Walk through the files that may be meshes or clips, the folders that hold some, and clips of files of several.

    The mesh of a point cache, which has its name, is a part of that clip.
    """
    for path in sorted(folder.rglob("*")) if folder.is_dir() else [folder]:
        if folder.is_dir() and any(part.startswith(".") for part in path.relative_to(folder).parts):
            continue
        if path.is_dir():
            if any(file.suffix.lower() in SUFFIXES for file in path.iterdir()):
                yield path, None
        elif path.suffix.lower() in COLLECTIONS:
            yield from ((path, name) for name in list_animations(path))
        elif path.suffix.lower() in CACHES or (path.suffix.lower() in SUFFIXES and not _has_cache(path)):
            yield path, None


def _has_cache(path: Path) -> bool:
    return any(path.with_suffix(suffix).exists() for suffix in CACHES)


def _plain(path: Path, folder: Path, pattern: str) -> str:
    """Write a path relative to the folder as a pattern does: without its suffix where the pattern has none."""
    named = path.is_dir() or Path(pattern).suffix.lower() in SUFFIXES
    relative = path.relative_to(folder)
    return (relative if named else relative.with_suffix("")).as_posix()


def _refuse_twins(entries: list[Entry]) -> None:
    seen: dict[tuple[str, str], Path] = {}
    for entry in entries:
        other = seen.setdefault((entry.person, entry.pose), entry.path)
        if other != entry.path:
            raise InputError(
                f"{entry.path}: expected one file of person {entry.person} in pose {entry.pose}, found {other.name} "
                "too; move one of them away, or give the names with --pattern"
            )
