"""Read a folder of rigged characters: those of a split of its pool, and rigged files in it and its sub-folders.

A sub-folder is a pack, files of the folder itself are one more. A licence that a file does not state is that of the
nearest file named LICENSE or License, in its folder or above it up to the folder, which is quoted by name.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from ..bodies.character_pool import Pool, read_pool
from ..core.errors import InputError
from ..core.frame_buffer import Progress, counted
from ..io.formats import JOINTED
from ..io.gltf.character import read_rigged_character

LICENCE_NAMES = ("license", "licence", "copying")
"""Beginnings of the names of licence files, in lower case."""
DAMAGED = (InputError, ArithmeticError, AttributeError, LookupError, OSError, RecursionError, TypeError, ValueError)
"""What reading a damaged file may raise: one bad file must not end the reading of a folder."""
INDEX = "index.json"


def read_character_folder(
    folder: str | Path, split: str = "train", progress: Progress | None = None, body: str = "human"
) -> Pool:
    """Read the humanoids of a folder, or its animals: those of a split of its pool, then all rigged files, by path.

    Args:
        body: shipped body whose joints the characters have, `human` or `quadruped`.

    Raises:
        InputError: neither a pool nor a rigged file.
    """
    folder = Path(folder)
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in JOINTED and path.is_file())
    has_index = (folder / INDEX).is_file()
    if not has_index and not paths:
        raise InputError(
            f"{folder}: expected a folder of rigged characters (.glb, .gltf, .vrm, .fbx, or .npz with an {INDEX}), "
            "found none; give the folder that has some"
        )
    pool = read_pool(folder, split, progress if not paths else None, body) if has_index else Pool((), {})
    characters, refused = list(pool.characters), dict(pool.refused)
    rows = json.loads((folder / INDEX).read_text(encoding="utf-8")) if has_index else []
    elsewhere = {str(row["file"]): f"the split {row['split']} of the index" for row in rows if row["split"] != split}
    for path in counted(paths, len(paths), progress):
        name = str(path.relative_to(folder))
        try:
            if path.stem in elsewhere:
                raise InputError(f"{path}: expected one of the split {split}, found {elsewhere[path.stem]}")
            characters.append(read_rigged_character(path, pack_of(path, folder), licence_of(path, folder), body))
        except DAMAGED as error:
            plain = str(error) if isinstance(error, InputError) else f"expected a sound file, found {error!r:.80}"
            refused[name] = plain.removeprefix(f"{path}: ").removeprefix(f"{path.stem}: ")
    # Makers export clips of one name, length and skeleton with each character of a pack: they are kept once. Clips of a
    # pool are kept: they say which file they are from.
    seen: set[object] = set()
    kept = []
    for character in characters:
        clips = character.clips
        if Path(character.meta.clips_from).suffix.lower() in JOINTED:
            keys = {
                name: (character.meta.pack, character.rig.skeleton, name, len(clip)) for name, clip in clips.items()
            }
            clips = {name: clip for name, clip in clips.items() if keys[name] not in seen}
            seen.update(keys.values())
        kept.append(dataclasses.replace(character, clips=clips))
    return Pool(tuple(kept), refused)


def pack_of(path: Path, folder: Path) -> str:
    """Name the pack of a file: the sub-folder of the folder that it is in, or the folder itself."""
    parts = path.relative_to(folder).parts
    return parts[0] if len(parts) > 1 else folder.resolve().name


def licence_of(path: Path, folder: Path) -> str:
    """Name the nearest licence file of a file, in its folder or above; empty if there is none."""
    for above in path.relative_to(folder).parents:
        names = sorted(entry.name for entry in (folder / above).iterdir() if entry.is_file())
        found = [name for name in names if name.lower().startswith(LICENCE_NAMES)]
        if found:
            return found[0]
    return ""
