"""Which of the files that were given together is the mesh or the clip, and which only belong to it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from ..core.errors import InputError
from ..io.formats import ANIMATED, CACHES, CLIP_READERS, MESH_READERS
from .uploads import Upload

MOST_MESHES = 16
"""Identities of one upload."""


def meshes(files: list[Path]) -> list[Path]:
    """The meshes among files: all but those that others of them draw on.

    Raises:
        InputError: none, or so many that they must be the frames of a clip.
    """
    found = [path for path in files if path.suffix.lower() in MESH_READERS]
    if not found:
        raise InputError(
            f"{_names(files)}: expected a mesh ({' '.join(MESH_READERS)}), found none; choose another file"
        )
    if len(found) > MOST_MESHES:
        raise InputError(
            f"{found[0].name}: expected {MOST_MESHES} meshes or fewer to move, found {len(found)}; "
            "frames of a clip belong under what to imitate"
        )
    return found


def clip(files: list[Path]) -> Path:
    """The one file, or the folder of numbered meshes, that is to be imitated.

    Raises:
        InputError: nothing that can be read, or more than one.
    """
    caches = [path for path in files if path.suffix.lower() in CACHES]
    if len(caches) == 1:
        return caches[0]
    known = MESH_READERS.keys() | CLIP_READERS.keys() | set(ANIMATED)
    found = [path for path in files if path.suffix.lower() in known]
    if len(found) == 1:
        return found[0]
    if not found:
        raise InputError(
            f"{_names(files)}: expected a clip or a mesh ({' '.join(sorted(known))}), found none; choose another file"
        )
    return Counter(path.parent for path in found).most_common(1)[0][0]


def called(path: Path, upload: Upload) -> str:
    """What a clip is called: as its file or its folder; as its frames are, without their numbers, if it has none."""
    if path != upload.folder:
        return path.name
    return upload.files[0].stem.rstrip("0123456789").rstrip("-_. ") or "frames"


def _names(files: list[Path]) -> str:
    return files[0].name if len(files) == 1 else f"{len(files)} files"
