"""NumPy archives (.npz) from anywhere: opened with care, never unpickled. `io.npz` and `motions.amass` read them."""

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
"""What the points of a mesh or clip are called, the likeliest first."""
# What opening a damaged, encrypted or pickled archive raises, as NumPy and zipfile have it.
_DAMAGE = (ValueError, TypeError, OSError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error)


@contextlib.contextmanager
def open_archive(file: io.BufferedIOBase, path: Path) -> Iterator[tuple[zipfile.ZipFile, list[str]]]:
    """An archive and the names of its arrays, for a block that reads them; `path` is what errors call it.

    Raises:
        InputError: whatever goes wrong with it in the block, in one line.
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


def read_array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """One array of an archive; one of objects raises ValueError."""
    with archive.open(f"{name}.npy") as member:
        return np.lib.format.read_array(member, allow_pickle=False)
