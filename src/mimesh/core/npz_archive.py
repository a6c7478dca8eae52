"""Read untrusted NumPy archives (.npz) without unpickling. Used by `io`, `motions` and `bodies`."""

from __future__ import annotations

import contextlib
import io
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .errors import InputError

POINTS = ("vertices", "v", "verts", "points")
"""Array names that stand for the points of a mesh or clip, in order of preference."""
# What NumPy and zipfile raise for a damaged, encrypted or pickled archive.
_DAMAGE = (ValueError, TypeError, OSError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error)


@contextlib.contextmanager
def open_archive(file: io.BufferedIOBase, path: Path) -> Iterator[tuple[zipfile.ZipFile, list[str]]]:
    """Open an archive: yields it and the names of its arrays. `path` is named in errors.

    Raises:
        InputError: the archive turns out to be damaged, here or while it is read inside the `with` block.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            yield archive, [name.removesuffix(".npy") for name in archive.namelist()]
    except InputError:
        raise
    except _DAMAGE as error:
        raise InputError(
            f"{path}: expected a NumPy archive of plain arrays, found {error!r:.80}; save it again"
        ) from error


def archive_names(path: Path) -> tuple[str, ...]:
    """List the names of the arrays in an archive; none if it is damaged, which its reader reports in detail."""
    try:
        with path.open("rb") as file, open_archive(file, path) as (_, names):
            return tuple(names)
    except (InputError, OSError):
        return ()


def check_unpacked_size(archive: zipfile.ZipFile, path: Path, largest: int) -> None:
    """Check that an archive unpacks to at most `largest` bytes.

    Raises:
        InputError: it unpacks to more.
    """
    if sum(item.file_size for item in archive.infolist()) > largest:
        raise InputError(f"{path}: expected at most {largest >> 20} MB of arrays, found more; split the file")


def read_array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """Read one array of an archive; an array of pickled objects raises ValueError."""
    with archive.open(f"{name}.npy") as member:
        return np.lib.format.read_array(member, allow_pickle=False)
