"""Read numbers of text formats in bulk, and files of markers; replace numbers in lines whose other characters stay."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError, damaged
from ..core.system import refuse_pipe

_GAP = rb"(?:\s|\\\r?\n|\\\r)+"  # white space, or a backslash that continues the line
_WORD = rb"[^\s\\#]+"
_WINDOWS_NAN = re.compile(rb"[-+]?\b(?:nan\((?:ind|snan)\)|1\.#(?:IND|QNAN|SNAN|INF)\d*)")
"""What the C libraries of Windows write for NaN, older ones with the sign of a comment, and for infinity."""
_THREE = re.compile(rb"(\s*%b%b)%b(%b)%b(%b)%b" % (_WORD, _GAP, _WORD, _GAP, _WORD, _GAP, _WORD))
"""A word and three numbers: groups of what stays before the first number and between the numbers."""


def without_comments(lines: Iterable[bytes]) -> list[bytes]:
    """Cut each line at its `#`, and replace continuations (a backslash before the line end) by a space."""
    lines = list(lines)
    text = b"".join(lines)
    if b"#" not in text and b"\\" not in text:
        return lines
    for i, line in enumerate(lines):
        if b"#" in line or b"\\" in line:
            line = re.sub(rb"\\(\r\n|\n|\r)", b" ", line)
            lines[i] = (_WINDOWS_NAN.sub(b"nan", line) if b".#" in line else line).partition(b"#")[0]
    return lines


def equal_rows(lines: Sequence[bytes], count: int) -> list[bytes] | None:
    """Split lines of one keyword and `count` words that are no keyword, all at once; None if a line is another one.

    The lines begin with the keyword. It takes a third of the time of splitting line by line.
    """
    words = b" ".join(lines).split()
    if not words or len(words) != len(lines) * (count + 1) or words[:: count + 1].count(words[0]) != len(lines):
        return None
    keyword = words[0]
    del words[:: count + 1]
    return None if keyword in words else words


def decoded(name: bytes) -> str:
    """Decode text of unknown encoding: UTF-8 where it is valid, else Latin-1, which never fails."""
    try:
        return name.decode("utf-8")
    except UnicodeDecodeError:
        return name.decode("latin-1")


def encoded(text: str) -> bytes:
    """Encode text as UTF-8. Bytes of file names that are no text come back as they were, other lone surrogates as `?`.

    Python decodes such bytes to lone surrogates, of which UTF-8 has none.
    """
    try:
        return text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:
        return text.encode("utf-8", "replace")


def line_number(lines: Sequence[bytes], index: int) -> int:
    """Return the line number, from 1, that an editor shows for `lines[index]`; continued lines count as several."""
    return 1 + sum(len(line.splitlines()) for line in lines[:index])


def read_numbers(
    lines: Sequence[bytes], index: Sequence[int], skip: int, count: int, path: Path, least: int | None = None
) -> Float[np.ndarray, "N C"]:
    """Read the `count` numbers after the first `skip` words of each of `lines[index]`.

    Args:
        least: lines with so many numbers get zeros for those that are left out; None: all must be there.

    Raises:
        InputError: a line has fewer numbers, or a word that is no number; the message has the line.
    """
    last, kept = skip + count, without_comments([lines[i] for i in index])
    words = equal_rows(kept, count) if skip == 1 else None
    if words is not None:
        try:
            return np.array(list(map(float, words)), np.float64).reshape(-1, count)
        except ValueError:
            pass
    rows = [line.split(None, last)[skip:last] for line in kept]
    if least is not None:
        rows = [row + [b"0"] * (count - len(row)) if len(row) >= least else row for row in rows]
    # All words are converted at once, which is much faster than line by line; only a failure looks for the line.
    try:
        values = np.array(list(map(float, chain.from_iterable(rows))), np.float64)
        if all(len(row) == count for row in rows):
            return values.reshape(-1, count)
    except ValueError:
        pass
    if any(_WINDOWS_NAN.search(line) for line in kept):
        without = [_WINDOWS_NAN.sub(b"nan", line) for line in kept]
        return read_numbers(without, range(len(kept)), skip, count, path, least)
    wrong = next(i for i, row in zip(index, rows, strict=True) if len(row) != count or not _are_numbers(row))
    found = lines[wrong].strip().decode("utf-8", "replace")[:60]
    raise damaged(path, f"{count} numbers in line {line_number(lines, wrong)}", repr(found))


def replace_rows(
    lines: list[bytes], index: Int[np.ndarray, " N"], new: Float[np.ndarray, "N 3"], old: Float[np.ndarray, "N 3"]
) -> None:
    """Replace the three numbers after the first word of each of `lines[index]`, in place, where `new` is not `old`.

    Spacing, comments and the rest stay. Numbers are written with the fewest digits that read back as the same float64.
    """
    moved = np.flatnonzero((new != old).any(axis=1))
    for number, (x, y, z) in zip(index[moved].tolist(), new[moved].astype(np.float64).tolist(), strict=True):
        match = _THREE.match(lines[number])
        assert match, f"{lines[number]!r} was read as a word and three numbers"
        rest = lines[number][match.end() :]
        lines[number] = b"%b%a%b%a%b%a%b" % (match[1], x, match[2], y, match[3], z, rest)


def _are_numbers(words: Sequence[bytes]) -> bool:
    try:
        return all(isinstance(float(word), float) for word in words)
    except ValueError:
        return False


MOST_DIGITS = 18
"""Digits of a number: any of so many fits into an integer of 64 bits."""


def load_markers(path: Path) -> Int[np.ndarray, "M 2"]:
    """Read a vertex index of the identity and one of the driving mesh from each line, from 0; `#` starts a comment.

    Raises:
        InputError: no such file, no pairs in it, or a line that is not two whole numbers.
    """
    refuse_pipe(path)
    if not path.is_file():
        raise InputError(f"{path}: expected a file of markers, found none; check the path")
    rows = []
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        if len(words) != 2 or not all(_is_number(word) for word in words):
            raise InputError(
                f"{path}, line {number}: expected the numbers of an identity's and a driving vertex, "
                f"found {line.strip()[:40]!r}; correct that line"
            )
        rows.append([int(word) for word in words])
    if not rows:
        raise InputError(f"{path}: expected one pair of vertices a line, found no line; write 5 or more")
    return np.array(rows)


def _is_number(word: str) -> bool:
    return word.isascii() and word.isdigit() and len(word) <= MOST_DIGITS
