"""Pairs and clips of a user's own files, as lists name them: lines of "identity driving truth", as beside NPT's data.

    # people of the test set
    id0_17.obj id4_203.obj id0_203.obj
    id1_5 id2_88 id1_88
    "a person.obj" /data/pose.obj truth/17.obj

Three names stand in a line, with blanks between; a name with blanks is put in double quotes. Names are relative to the
list's folder or to another one, and may lack their suffix. Empty lines, and all after a word that begins with `#`, do
not count. Lists are UTF-8 or Latin-1, with line ends of any system.

Beside `seen.txt`, `seen.heights.json` may give the height at rest of each identity, in the unit of its file:
`{"id0_17.obj": 1.71}`, by the names of the list.

Meshes are y up and face +z. The truth has the vertices of the identity in the identity's order, as in the public data
of NPT. Where the driving mesh has the identity's triangles, its vertices are taken to correspond by number, for the
baseline `copy`. Both meshes are shuffled before a method gets them, the truth with the identity.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import re
import sys
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..core.errors import InputError
from ..core.mesh import Clip, Mesh, same_mesh
from ..io import clip_suffixes, load_clip, load_mesh, mesh_suffixes
from ..io.atomic import together, whole_file
from ..io.text import decoded
from .clip_protocols import ClipPair
from .pairs import Pair
from .protocols import Protocol

HEIGHT = 1.7
"""Height (metres) at which millimetres of the files are those of reports; taken where nothing is known."""
METRES = (0.3, 10.0)
"""Diagonals of the bounding box, or known heights, that a figure in metres can have."""
_LAYOUT = re.compile(r"(?:id)?(\d+)_(.+)")
"""<person>_<pose>, with or without "id": names of the public data, and of what `mimesh generate` writes."""
T = TypeVar("T")


@dataclass(frozen=True)
class ListedPairs(Protocol):
    """Pairs of meshes; a kind is a list, called by its name without suffix. There are no splits."""

    source: Path = Path()
    """A list, or a folder of lists."""
    data: Path | None = None
    """The folder that names are relative to; None: the folder of the list."""
    height: float | None = None
    """Height of all identities at rest in the unit of the files; None: of the file beside the list, else HEIGHT."""
    fps: float | None = None
    """Frames per second of clips; None: those of the files."""

    @cached_property
    def lists(self) -> dict[str, tuple[Triple, ...]]:
        """The lines of each list, by kind."""
        return {path.stem: read_list(path, self.data) for path in find_lists(self.source)}

    @cached_property
    def heights(self) -> dict[str, dict[str, float] | None]:
        """The heights beside each list, by kind."""
        return {path.stem: read_heights(path) for path in find_lists(self.source)}

    def rng(self, split: str, kind: str, i: int) -> np.random.Generator:
        """Return the random generator of the vertex orders of pair `i`, which no other list has a part in."""
        return np.random.default_rng([zlib.crc32(kind.encode()), i])

    def count(self, kind: str, requested: int = 0, split: str = "test") -> int:
        """Return the number of pairs to measure: the first ones that are requested, or the whole list for 0."""
        return min(requested or len(self.lists[kind]), len(self.lists[kind]))

    def check(self, split: str) -> None:
        """Raise InputError for a split that is not the default: lists have none."""
        if split != "test":
            raise InputError(f"--split: expected none with the list {self.name}, found {split}; leave it out")

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> Pair:
        """Read pair `i`."""
        triple = self.lists[kind][i]
        identity, driving, truth = (_read(triple, load_mesh, path) for path in triple.paths)
        _check_truth(triple, identity, truth)
        return self._pair(kind, triple, identity, driving, truth)

    def _pair(self, kind: str, triple: Triple, identity: Mesh, driving: Mesh, truth: Mesh) -> Pair:
        height = self._height(kind, triple, identity)
        # The driving mesh corresponds by number where it has the identity's triangles.
        same = len(identity.faces) > 0 and same_mesh(driving, identity)
        return Pair(
            identity=_plain(identity, triple),
            driving=_plain(driving, triple),
            truth=truth.vertices,
            height=height,
            metres=1.0 if METRES[0] <= height <= METRES[1] else HEIGHT / height,
            aligned=driving.vertices if same else None,
            truth_name=triple.paths[2].stem,
            groups=(_person(triple.names[0]), _person(triple.names[1])),
        )

    def _height(self, kind: str, triple: Triple, identity: Mesh) -> float:
        known = self.heights[kind]
        if self.height is not None:
            return self.height
        if known is None:
            size = float(np.linalg.norm(np.ptp(identity.vertices, axis=0)))
            if not METRES[0] <= size <= METRES[1]:
                raise InputError(
                    f"{triple.where}: expected a figure in metres, found {triple.names[0]} with a diagonal of "
                    f"{size:.4g}; give the height of a person at rest in the unit of the files with --height"
                )
            return HEIGHT
        if triple.names[0] not in known:
            raise InputError(
                f"{triple.where}: expected the height of {triple.names[0]} in the file of heights beside the list, "
                "found none; add it, or give --height"
            )
        return known[triple.names[0]]

    def files(self) -> dict[str, Path]:
        """Return the files of all lists, those in folders of frames and the heights by their paths in the folder."""
        lists = find_lists(self.source)
        named = [path for triples in self.lists.values() for triple in triples for path in triple.paths]
        found = [file for path in named for file in (files_below(path) if path.is_dir() else [path])]
        heights = [path for path in map(heights_file, lists) if path.is_file()]
        base = self.data or lists[0].parent
        return {str(path.relative_to(base) if path.is_relative_to(base) else path): path for path in (*heights, *found)}

    def checksums(self) -> dict[str, str]:
        """Return the first 16 hex digits of the SHA-256 of each list's bytes, by kind."""
        digests = {path.stem: hashlib.sha256(path.read_bytes()).hexdigest() for path in find_lists(self.source)}
        return {kind: f"sha256 {digest[:16]}" for kind, digest in digests.items()}


@dataclass(frozen=True)
class ListedClips(ListedPairs):
    """Clips; the identity is a mesh, driving and truth are clips of equal length and rate."""

    def unshuffled_pair(self, split: str, kind: str, i: int, rng: np.random.Generator) -> ClipPair:
        """Read clip `i`; errors as for meshes."""
        triple = self.lists[kind][i]
        identity = _read(triple, load_mesh, triple.paths[0])
        clip, truth = (_read(triple, lambda path: load_clip(path, fps=self.fps), path) for path in triple.paths[1:])
        facts = [f"{len(frames)} frames at {frames.fps:g} a second" for frames in (clip, truth)]
        if len(clip) != len(truth) or not np.isclose(clip.fps, truth.fps):
            raise InputError(
                f"{triple.where}: expected the truth {triple.names[2]} with the {facts[0]} of {triple.names[1]}, found "
                f"{facts[1]}; save both with the same frames"
            )
        meshes = [dataclasses.replace(c.mesh, vertices=np.asarray(c.vertices[0], np.float64)) for c in (clip, truth)]
        _check_truth(triple, identity, meshes[1])
        first = self._pair(kind, triple, identity, *meshes)
        first = dataclasses.replace(first, groups=(first.groups[0], _take(triple.names[1])))
        frames = np.asarray(clip.vertices, np.float64)
        aligned = None if first.aligned is None else frames
        truth_frames = np.asarray(truth.vertices, np.float64)
        return ClipPair.of(first, Clip(first.driving, frames, clip.fps), truth_frames, aligned)


def listed_pairs(
    source: Path, data: Path | None = None, height: float | None = None, fps: float | None = None
) -> ListedPairs:
    """Return the pairs of a list, or of the lists of a folder; the first true result of each says whether it has clips.

    Raises:
        InputError: no list, a damaged one, missing files, or lists of meshes together with lists of clips.
    """
    for option, value in (("--height", height), ("--fps", fps)):
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"{option}: expected a positive number, found {value:g}; give another")
    name = source.resolve().name + ("/" if source.is_dir() else "")
    pairs = ListedPairs(name, 1, (), 0, 0.0, source=source, data=data, height=height, fps=fps)
    truths = {kind: (triples[0], triples[0].paths[2]) for kind, triples in pairs.lists.items()}
    # A clip is a folder, or a file of several frames.
    has_clips = {
        kind: path.is_dir() or len(_read(triple, load_clip, path)) > 1 for kind, (triple, path) in truths.items()
    }
    if len(set(has_clips.values())) > 1:
        meshes, clips = (next(kind for kind, found in has_clips.items() if found is clip) for clip in (False, True))
        raise InputError(
            f"{source}: expected lists of meshes or lists of clips, found {meshes} with meshes and {clips} with "
            "clips; give one list"
        )
    chosen = ListedClips if any(has_clips.values()) else ListedPairs
    fields = {field.name: getattr(pairs, field.name) for field in dataclasses.fields(pairs)}
    longest = max(map(len, pairs.lists.values()))
    return chosen(**{**fields, "kinds": tuple(pairs.lists), "pairs": longest})


def _read(triple: Triple, read: Callable[[Path], T], path: Path) -> T:
    try:
        return read(path)
    except InputError as error:
        raise InputError(f"{triple.where}: {error}") from error


def _plain(mesh: Mesh, triple: Triple) -> Mesh:
    """Return the vertices and faces of a mesh alone: appearance, rig and file are no part of what is measured."""
    if mesh.up not in (None, "+y"):
        raise InputError(
            f"{triple.where}: expected meshes with y up, found {mesh.name} with {mesh.up} up; save it with y up"
        )
    return Mesh(mesh.vertices, mesh.faces, name=mesh.name)


def _check_truth(triple: Triple, identity: Mesh, truth: Mesh) -> None:
    """Check that the truth has the identity's vertices and, if both have any, the identity's triangles."""
    names = f"the truth {triple.names[2]}", f"the identity {triple.names[0]}"
    counts = len(truth.vertices), len(identity.vertices)
    if counts[0] != counts[1]:
        raise InputError(
            f"{triple.where}: expected {names[0]} with the {counts[1]} vertices of {names[1]}, found {counts[0]}; "
            "name the same person in the driving pose"
        )
    if len(truth.faces) and len(identity.faces) and not np.array_equal(truth.faces, identity.faces):
        raise InputError(
            f"{triple.where}: expected {names[0]} with the triangles of {names[1]}, found others; save both with one "
            "order of vertices and faces"
        )


def _person(name: str) -> str:
    """Return the person of a file called <person>_<pose>, else the file: pairs that share one are not independent."""
    return found[1] if (found := _LAYOUT.fullmatch(_stem(name))) else _stem(name)


def _take(name: str) -> str:
    """Return the take of a driving clip called <person>_<take> or <person>_<take>@<seconds>, else the file."""
    return found[2].partition("@")[0] if (found := _LAYOUT.fullmatch(_stem(name))) else _stem(name)


def _stem(name: str) -> str:
    """Return the last part of a path, without the suffix of a mesh or clip; names may lack it, and may have dots."""
    last = re.split(r"[/\\]", name.rstrip("/\\"))[-1]
    return re.sub(r"\.[A-Za-z]\w*$", "", last)


def files_below(folder: Path) -> list[Path]:
    """List the files of a folder and of its subfolders, links to folders included, in a fixed order."""
    return sorted(Path(parent, name) for parent, _, names in os.walk(folder, followlinks=True) for name in names)


SUFFIX = ".txt"
"""Suffix of the lists in a folder."""
HEIGHTS = ".heights.json"
"""What the name of a list's heights ends with, instead of its suffix."""
_WORD = re.compile(r'"([^"]*)"|(\S+)')


@dataclass(frozen=True)
class Triple:
    """A line of a list: the names and paths of an identity, of a driving mesh or clip, and of the true result."""

    where: str
    """The list and the number of the line, for errors."""
    names: tuple[str, str, str]
    """As in the list."""
    paths: tuple[Path, Path, Path]
    """Files, or folders of a clip's frames."""


def find_lists(source: Path) -> list[Path]:
    """Return the lists of a folder in the order of their names, or the one that is given.

    Raises:
        InputError: nothing of that name, or a folder without lists.
    """
    if source.is_file():
        return [source]
    if not source.is_dir():
        raise InputError(f"{source}: expected a list of files or a folder of lists, found nothing; check the path")
    found = sorted(path for path in source.glob(f"*{SUFFIX}") if path.is_file() and not path.name.startswith("."))
    if not found:
        raise InputError(
            f"{source}: expected lists (*{SUFFIX}) with lines of identity, driving and truth, found none in the "
            "folder; name the list"
        )
    return found


def read_list(path: Path, folder: Path | None = None) -> tuple[Triple, ...]:
    """Read a list and find its files.

    Args:
        folder: what names are relative to; None: the list's folder.

    Raises:
        InputError: no text, a line that is not three names, a file that does not exist, or no line.
    """
    content = path.read_bytes()
    if b"\0" in content:
        raise InputError(f"{path}: expected a list as text, found binary data or UTF-16; save it as UTF-8")
    triples = []
    for number, line in enumerate(re.split(r"\r\n|\r|\n", decoded(content).removeprefix("\ufeff")), 1):
        names = _names(line)
        if not names:
            continue
        where = f"{path}, line {number}"
        if len(names) != 3:
            raise InputError(
                f"{where}: expected three names (identity, driving, truth), found {len(names)} in "
                f"{line.strip()[:60]!r}; put a name with blanks in double quotes, or name the lists if this is none"
            )
        identity, driving, truth = names
        found = [_find(name, folder or path.parent, where) for name in names]
        triples.append(Triple(where, (identity, driving, truth), (found[0], found[1], found[2])))
    if not triples:
        raise InputError(f"{path}: expected lines of identity, driving and truth, found none; write one for each pair")
    return tuple(triples)


def read_heights(path: Path) -> dict[str, float] | None:
    """Read the heights beside a list, by the name of the identity in the list; None where there are none.

    Raises:
        InputError: a file that does not hold a positive number for each name.
    """
    path = heights_file(path)
    if not path.is_file():
        return None
    try:
        heights = json.loads(path.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected heights as JSON, found '{str(error)[:80]}'; correct that place") from None
    wrong = [value for value in heights.values() if not _is_height(value)] if isinstance(heights, dict) else [heights]
    if wrong:
        raise InputError(
            f'{path}: expected an object such as {{"id0_17.obj": 1.71}}, found {str(wrong[0])[:40]!r}; correct it'
        )
    return {name: float(height) for name, height in heights.items()}


def write_list(path: Path, triples: Iterable[tuple[str, str, str]], heights: Mapping[str, float]) -> None:
    """Write a list, and beside it the heights of its identities by their names."""
    with together(), whole_file(heights_file(path)) as temporary, whole_file(path) as listed:
        temporary.write_text(json.dumps(dict(heights), indent=2) + "\n", encoding="utf-8", newline="\n")
        listed.write_text(
            "".join(" ".join(map(_quoted, names)) + "\n" for names in triples), encoding="utf-8", newline="\n"
        )


def heights_file(path: Path) -> Path:
    """Return the path of the heights that belong to a list: seen.txt has seen.heights.json."""
    return path.with_name(path.stem + HEIGHTS)


def _names(line: str) -> list[str]:
    """Split a line at its blanks, up to a comment; what stands in double quotes is one name."""
    names = []
    for word in _WORD.finditer(line):
        if word[0].startswith("#"):
            break
        names.append(word[2] if word[1] is None else word[1])
    return names


def _quoted(name: str) -> str:
    return f'"{name}"' if name.startswith("#") or re.search(r"\s", name) else name


def _find(name: str, folder: Path, where: str) -> Path:
    """Find the file or folder of a name: as it is, else with the suffix of a mesh or clip."""
    suffixes = dict.fromkeys((*mesh_suffixes(), *clip_suffixes()))
    for spelled in (name, name.replace("\\", "/")) if name else ():
        path = folder / spelled
        if os.path.exists(path):  # unlike Path.exists, False for a name that is too long
            return path
        found = [Path(f"{path}{suffix}") for suffix in suffixes if os.path.isfile(f"{path}{suffix}")]
        if len(found) > 1:
            raise InputError(
                f"{where}: expected one file called {name!r}, found {' and '.join(file.name for file in found)} in "
                f"{path.parent}; write the suffix, too"
            )
        if found:
            return found[0]
    raise InputError(
        f"{where}: expected the file {name!r} in {folder}, found none; correct the name, or give the folder of the "
        "files with --data"
    )


def _is_height(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value <= sys.float_info.max
