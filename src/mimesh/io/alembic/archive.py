"""An Alembic archive, opened with care: the library that reads it, and a check of the file before the library's own."""

from __future__ import annotations

import contextlib
import importlib.util
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from ...core.errors import InputError

_HEADER = struct.Struct("<5sBHQ")  # "Ogawa", 255 once the file is finished, version, place of the outermost group
_DATA = 1 << 63  # a child whose place has this bit is data, else it is a group


def library(path: Path, verb: str) -> tuple[Any, Any, Any, Any]:
    """The modules Abc, AbcGeom, AbcCoreAbstract and imath of alembic3d; `verb` says what they are wanted for.

    Raises:
        InputError: it is not installed.
    """
    if importlib.util.find_spec("alembic3d") is None:
        raise InputError(
            f"{path}: expected alembic3d to {verb} Alembic, found it not installed; pip install 'mimesh[alembic]'"
        )
    import alembic3d
    import imath

    return alembic3d.Abc, alembic3d.AbcGeom, alembic3d.AbcCoreAbstract, imath


def open_archive(path: Path) -> Any:
    """Open an archive for reading. The library may crash on a damaged one, so its blocks are checked first.

    Raises:
        InputError: no library, another kind of file, an archive in HDF5, one cut short or never finished.
    """
    abc = library(path, "read")[0]
    data = np.memmap(path, np.uint8, "r")
    _check_blocks(data, _first_group(data[: _HEADER.size].tobytes(), path), path)
    with reading(path):
        return abc.IArchive(str(path))


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """A block that reads with the library: what it complains of becomes an InputError."""
    try:
        yield
    except RuntimeError as error:
        raise InputError(
            f"{path}: expected a sound Alembic archive, found '{' '.join(str(error).split())[:100]}'; "
            "the file is damaged, export it again"
        ) from error


def _first_group(head: bytes, path: Path) -> int:
    if head.startswith(b"\x89HDF"):
        raise InputError(
            f"{path}: expected an Alembic archive of the kind Ogawa, found the older HDF5; "
            "convert it with 'abcconvert -toOgawa', or export it again"
        )
    if not head.startswith(b"Ogawa"):
        raise InputError(f"{path}: expected an Alembic archive, found a file that begins {head[:5]!r}; check its name")
    if len(head) < _HEADER.size or head[5] != 255:
        raise InputError(f"{path}: expected a finished archive, found one whose writing was cut off; export it again")
    return _HEADER.unpack(head)[3]


def _check_blocks(data: UInt8[np.ndarray, " N"], first: int, path: Path) -> None:
    """Every group and every piece of data that can be reached must lie within the file.

    Nor may a group that has begun to list data go on with an empty group, as one does whose list was overwritten by
    zeros. What the pieces of data say is left to the library.
    """
    waiting, seen = [first], set()
    while waiting:
        place = waiting.pop()
        start = place & ~_DATA
        if start == 0 or place in seen:  # empty, or used several times
            continue
        seen.add(place)
        size = int.from_bytes(data[start : start + 8].tobytes(), "little")  # bytes, or children of 8 bytes
        stop = start + 8 + (size if place & _DATA else 8 * size)
        if stop > len(data) or start + 8 > len(data):
            raise InputError(
                f"{path}: expected all of the archive in its {len(data)} bytes, found a reference to byte {stop}; "
                "the file is cut short or damaged, export it again"
            )
        if not place & _DATA:
            children = np.frombuffer(data[start + 8 : stop].tobytes(), "<u8")
            has_begun = np.logical_or.accumulate(children >= _DATA)
            if (has_begun & (children == 0)).any():
                raise InputError(
                    f"{path}: expected samples in all places, found some overwritten by zeros at byte {start}; "
                    "the file is damaged, export it again"
                )
            waiting += children.tolist()
