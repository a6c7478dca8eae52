"""Text formats: numbers read in bulk, and numbers replaced inside a line that is otherwise left as it was."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError

_GAP = rb"(?:\s|\\\r?\n|\\\r)+"  # white space, or a backslash that continues the line
_WORD = rb"[^\s\\#]+"
_THREE = {  # by how many words are skipped before three numbers: what stays before, between and after them
    skip: re.compile(rb"(\s*(?:%b%b){%d})%b(%b)%b(%b)%b" % (_WORD, _GAP, skip, _WORD, _GAP, _WORD, _GAP, _WORD))
    for skip in (0, 1, 2, 3)
}


def without_comments(lines: Iterable[bytes]) -> list[bytes]:
    """Each line up to its `#`, with continuations (a backslash before the line end) made plain space."""
    return [line if b"#" not in line and b"\\" not in line else _clean(line) for line in lines]


def decoded(name: bytes) -> str:
    """Text of a file that does not say how it is encoded: UTF-8, else Latin-1."""
    try:
        return name.decode("utf-8")
    except UnicodeDecodeError:
        return name.decode("latin-1")


def line_number(lines: Sequence[bytes], index: int) -> int:
    """The number an editor shows for `lines[index]`, counted from 1; continued lines count as several."""
    return 1 + sum(len(line.splitlines()) for line in lines[:index])


def read_numbers(
    lines: Sequence[bytes], index: Sequence[int], skip: int, count: int, path: Path
) -> Float[np.ndarray, "N C"]:
    """The `count` numbers that follow the first `skip` words of each of `lines[index]`.

    Raises:
        InputError: a line has fewer numbers, or a word that is none; the line is named.
    """
    last = skip + count
    rows = [line.split(None, last)[skip:last] for line in without_comments([lines[i] for i in index])]
    try:
        values = np.array(list(map(float, chain.from_iterable(rows))), np.float64)
        if all(len(row) == count for row in rows):
            return values.reshape(-1, count)
    except ValueError:
        pass  # found again below, to say where
    wrong = next(i for i, row in zip(index, rows, strict=True) if len(row) != count or not _are_numbers(row))
    found = lines[wrong].strip().decode("utf-8", "replace")[:60]
    raise InputError(
        f"{path}: expected {count} numbers in line {line_number(lines, wrong)}, found {found!r}; "
        "the file is damaged or cut short, export it again"
    )


def replace_numbers(line: bytes, values: Sequence[float], skip: int) -> bytes:
    """The line with the three numbers after its first `skip` words replaced; spacing, comments and the rest stay.

    Numbers are written with the fewest digits that read back as the same float64.
    """
    match = _THREE[skip].match(line)
    assert match, f"{line!r} was read as three numbers after {skip} words"
    x, y, z = values
    return b"%b%a%b%a%b%a%b" % (match[1], x, match[2], y, match[3], z, line[match.end() :])


def replace_rows(
    lines: list[bytes],
    index: Int[np.ndarray, " N"],
    new: Float[np.ndarray, "N 3"],
    old: Float[np.ndarray, "N 3"],
    skip: int,
) -> None:
    """Replace the three numbers of each of `lines[index]`, in place, wherever `new` differs from `old`."""
    moved = np.flatnonzero((new != old).any(axis=1))
    for number, row in zip(index[moved].tolist(), new[moved].astype(np.float64).tolist(), strict=True):
        lines[number] = replace_numbers(lines[number], row, skip)


def _clean(line: bytes) -> bytes:
    return re.sub(rb"\\(\r\n|\n|\r)", b" ", line).partition(b"#")[0]


def _are_numbers(words: Sequence[bytes]) -> bool:
    try:
        return all(isinstance(float(word), float) for word in words)
    except ValueError:
        return False
