"""Open an Alembic archive: import the library, and check the file's structure before the library reads it."""

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

_HEADER = struct.Struct("<5sBHQ")
"""Header of an Ogawa file: the word "Ogawa", 255 once writing has finished, version, offset of the root group."""
_DATA = 1 << 63
"""Bit of a child's offset: set for a data block, clear for a group (Alembic's `Ogawa/Foundation.h`)."""


def library(path: Path, verb: str) -> tuple[Any, Any, Any, Any]:
    """Import alembic3d and return its modules Abc, AbcGeom, AbcCoreAbstract and imath; `verb` is "read" or "write".

    Raises:
        InputError: alembic3d is not installed.
    """
    need_library(path, verb)
    import alembic3d
    import imath

    return alembic3d.Abc, alembic3d.AbcGeom, alembic3d.AbcCoreAbstract, imath


def need_library(path: Path, verb: str) -> None:
    """Raise InputError where alembic3d is not installed; `verb` is "read" or "write"."""
    if importlib.util.find_spec("alembic3d") is None:
        raise InputError(
            f"{path}: expected alembic3d to {verb} Alembic, found it not installed; pip install 'mimesh[alembic]'"
        )


def open_archive(path: Path) -> Any:
    """Open an archive for reading. The library may crash on a damaged file, so all offsets are checked first.

    Raises:
        InputError: alembic3d is missing; the file is no Alembic archive, is stored as HDF5, truncated or unfinished.
    """
    abc = library(path, "read")[0]
    data = np.memmap(path, np.uint8, "r")
    _check_blocks(data, _root_offset(data[: _HEADER.size].tobytes(), path), path)
    with reading(path):
        return abc.IArchive(str(path))


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Turn errors of the library into an InputError of one line, for a block that reads with it."""
    try:
        yield
    except RuntimeError as error:
        raise InputError(
            f"{path}: expected a sound Alembic archive, found '{' '.join(str(error).split())[:100]}'; "
            "the file is damaged, export it again"
        ) from error


def _root_offset(head: bytes, path: Path) -> int:
    """Read the offset of the root group from the first bytes of a file; raises InputError for other kinds of files."""
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


def _check_blocks(data: UInt8[np.ndarray, " N"], root: int, path: Path) -> None:
    """Check that every group and data block reachable from the root group lies within the file.

    An Ogawa file is a graph: a group is a child count and the offsets of its children, a data block is a byte count
    and its bytes. No writer lists an empty group after a data block in one group: where that is found, part of the list
    was overwritten by zeros. The contents of data blocks are left to the library.

    Raises:
        InputError: an offset beyond the end of the file, or samples overwritten by zeros.
    """
    pending, visited = [root], set()
    while pending:
        offset = pending.pop()
        start = offset & ~_DATA
        if start == 0 or offset in visited:  # offset 0 is an empty block; equal samples share one block
            continue
        visited.add(offset)
        size = int.from_bytes(data[start : start + 8].tobytes(), "little")  # bytes, or children of 8 bytes each
        stop = start + 8 + (size if offset & _DATA else 8 * size)
        if stop > len(data) or start + 8 > len(data):
            raise InputError(
                f"{path}: expected all of the archive in its {len(data)} bytes, found a reference to byte {stop}; "
                "the file is cut short or damaged, export it again"
            )
        if not offset & _DATA:
            children = np.frombuffer(data[start + 8 : stop].tobytes(), "<u8")
            follows_data = np.logical_or.accumulate(children >= _DATA)
            if (follows_data & (children == 0)).any():
                raise InputError(
                    f"{path}: expected samples in all places, found some overwritten by zeros at byte {start}; "
                    "the file is damaged, export it again"
                )
            pending += children.tolist()
