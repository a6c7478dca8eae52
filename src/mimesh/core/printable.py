"""Print lines, lists of names, and names in files of text, without the control characters of names.

An escape sequence in the name of a material can move a terminal's cursor, recolour or hide text; a mark of direction
can show a name in another order than it is stored in (Boucher and Anderson 2021, "Trojan Source").
"""

from __future__ import annotations

import itertools
import re
import shlex
import sys
from collections.abc import Iterator, Sequence

_UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]")
"""C0 and C1 control characters, marks of direction, line separators, byte order marks, and surrogates, which are no
text and which UTF-8 cannot encode."""
_FORBIDDEN = re.compile(r'[<>:"/\\|?*]')
"""Characters that file names cannot have on some system."""


def printable(text: str) -> str:
    """Return a text as one line to be shown: what is not printable is escaped as in Python, such as `\\x1b`."""
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def plain(name: str) -> str:
    """Return a name to be written to a file of text or used as a file name: what is not printable becomes `_`."""
    return _UNPRINTABLE.sub("_", name)


def file_name(name: str) -> str:
    """Return a name that a file can have on any system: what is not printable or forbidden becomes `_`."""
    return _FORBIDDEN.sub("_", plain(name))


def listed(names: Sequence[str], most: int) -> str:
    """Join the first names of a list, and say how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def shell_line(*words: object) -> str:
    """Join the words of a command, quoted for a shell where they have spaces, brackets and the like."""
    return shlex.join(map(str, words))


def say(*lines: str, error: bool = False) -> None:
    """Print lines to stdout, or with `error` to stderr; every text for a terminal goes through here."""
    stream = sys.stderr if error else sys.stdout
    print(*map(printable, lines), sep="\n", file=stream, flush=error)


def numbered(stem: str, gap: str = "-", suffix: str = "") -> Iterator[str]:
    """Yield a name, then the same with numbers from 2 on (hat.png, hat-2.png, ...), to take the first free one.

    Args:
        gap: what stands before the number.
        suffix: the end of every name.
    """
    yield stem + suffix
    yield from (f"{stem}{gap}{number}{suffix}" for number in itertools.count(2))
