"""Lists of files to measure on: lines of "identity driving truth", as beside the public data of NPT.

    # people of the test set
    id0_17.obj id4_203.obj id0_203.obj
    id1_5 id2_88 id1_88
    "a person.obj" /data/pose.obj truth/17.obj

Three names stand in a line, with blanks between; a name with blanks is put in double quotes. Names are relative to the
list's folder or to another one, and may lack their suffix. Empty lines, and all after a word that begins with `#`, do
not count. Lists are UTF-8 or Latin-1, with line ends of any system.

Beside `seen.txt`, `seen.heights.json` may give the height at rest of each identity, in the unit of its file:
`{"id0_17.obj": 1.71}`, by the names of the list.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import InputError
from ..io import clip_suffixes, mesh_suffixes
from ..io.atomic import together, whole_file
from ..io.text import decoded

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


def list_checksum(path: Path) -> str:
    """Return the first 16 hex digits of the SHA-256 of a list's bytes."""
    return f"sha256 {hashlib.sha256(path.read_bytes()).hexdigest()[:16]}"


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
    """Find the file or folder of a name: as it is, else with the suffix of a mesh or clip.

    Raises:
        InputError: there is none, or the name without suffix fits several files.
    """
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
