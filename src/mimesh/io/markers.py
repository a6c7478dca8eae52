"""Read marker files: pairs of corresponding vertices, one pair per line, for methods that need them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Int

from ..core.errors import InputError
from ..core.system import refuse_pipe

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
