"""Read untrusted NumPy archives (.npz) without unpickling. Used by `io`, `motions` and `bodies`."""

from __future__ import annotations

import contextlib
import io
import lzma
import math
import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from .budgets import UNPACKED
from .errors import InputError

SEEN_POINTS = "pred_vertices"
"""Name of points that were estimated from an image by SAM 3D Body (github.com/facebookresearch/sam-3d-body)."""
POINTS = ("vertices", "v", "verts", "points", SEEN_POINTS)
"""Array names that stand for the points of a mesh or clip, in order of preference."""
LARGEST_HEADER = 1 << 16
"""Bytes of the header of an array; NumPy itself parses up to 10,000."""
# What NumPy and zipfile raise for a damaged, encrypted or pickled archive. The headers of arrays are Python literals.
DAMAGE = (
    ValueError, TypeError, LookupError, OverflowError, OSError, EOFError, RuntimeError, MemoryError, SyntaxError,
    tokenize.TokenError, struct.error, zipfile.BadZipFile, zlib.error, lzma.LZMAError,
)  # fmt: skip


@dataclass(frozen=True)
class ArrayHeader:
    """The header of a stored array."""

    shape: tuple[int, ...]
    fortran: bool
    """Whether the numbers are in Fortran order."""
    dtype: np.dtype
    size: int
    """Bytes of the header itself."""

    @property
    def nbytes(self) -> int:
        """Bytes of the numbers."""
        return math.prod(self.shape) * self.dtype.itemsize


@contextlib.contextmanager
def open_archive(file: io.BufferedIOBase, path: Path) -> Iterator[tuple[zipfile.ZipFile, list[str]]]:
    """Open an archive: yields it and the names of its arrays. `path` is named in errors.

    Raises:
        InputError: the archive turns out to be damaged, here or while it is read inside the `with` block, or unpacks to
            far more than its size (see `budgets`).
    """
    try:
        size = file.seek(0, io.SEEK_END)
        file.seek(0)
        with zipfile.ZipFile(file) as archive:
            UNPACKED.check(sum(entry.file_size for entry in archive.infolist()), path, size)
            yield archive, [name.removesuffix(".npy") for name in archive.namelist()]
    except InputError:
        raise
    except DAMAGE as error:
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
    """Read one array of an archive; pickled objects, and a header that claims another size, raise ValueError."""
    with archive.open(f"{name}.npy") as member:
        header = read_array_header(member)
        check_array_size(header, archive.getinfo(f"{name}.npy").file_size)
        member.seek(0)
        with warnings.catch_warnings(action="ignore"):  # as in `read_array_header`
            return np.lib.format.read_array(member, allow_pickle=False)


def read_array_header(file: IO[bytes] | io.BufferedIOBase, objects: bool = False) -> ArrayHeader:
    """Read the header of an array; the file is then positioned at its first number.

    Args:
        objects: accept an array of pickled objects, which the caller must not unpickle.

    Raises:
        ValueError: a damaged header, or an array of pickled objects; other errors of DAMAGE for text that is no header.
    """
    version = np.lib.format.read_magic(file)
    start = file.tell()
    length = int.from_bytes(file.read(2 if version == (1, 0) else 4), "little")
    if length > LARGEST_HEADER:  # before NumPy asks for so many bytes
        raise ValueError(f"a header of {length} bytes")
    file.seek(start)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    # NumPy warns of numbers such as 3L, as Python 2 wrote them, Python of escapes in the header.
    with warnings.catch_warnings(action="ignore"):
        shape, fortran, dtype = read(file)
    if dtype.hasobject and not objects:
        raise ValueError("objects, which are never unpickled")
    whole = all(type(number) is int for number in shape)  # the header may say True
    if not whole or min(shape, default=0) < 0 or not dtype.itemsize:
        raise ValueError(f"an array of {dtype} {shape}")
    return ArrayHeader(shape, fortran, dtype, file.tell())


def rate_of(values: np.ndarray, name: str, path: Path) -> float:
    """Return the frame rate that an array of one number has, of any number of dimensions; text is parsed.

    Raises:
        InputError: no number, or several.
    """
    with contextlib.suppress(ValueError):  # text, which some tools write
        values = values.astype(np.float64) if values.size == 1 and values.dtype.kind in "US" else values
    if values.size != 1 or values.dtype.kind not in "fiu":
        wrong = f"{values.item()!r:.60}" if values.size == 1 else f"{values.dtype} {values.shape}"
        raise InputError(f"{path}: expected a positive frame rate, found {wrong}; save one as {name}")
    return float(values.item())


def check_array_size(header: ArrayHeader, size: int) -> None:
    """Raise ValueError where a file or an entry of an archive, of `size` bytes, has not the numbers of its header."""
    if header.size + header.nbytes > size:
        raise ValueError(f"{size} bytes for an array {header.shape} of {header.dtype}")
