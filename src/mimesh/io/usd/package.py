"""Check and write USD packages (.usdz).

A package is a zip archive of uncompressed files whose contents begin at multiples of 64 bytes, so that a reader can map
them into memory. Its first file is the root layer.
"""

from __future__ import annotations

import shutil
import struct
import zipfile
from pathlib import Path

from ...core.errors import InputError

ALIGNMENT = 64
"""Bytes; the content of every file begins at a multiple of it (USDZ file format specification, "Layout")."""
LARGEST = 2**31 - 1
"""Bytes in one package; larger archives need the zip64 extension, which the USDZ specification excludes."""


def check_package(path: Path) -> None:
    """Check the checksums of the files in a package, which the library does not; other files pass.

    Raises:
        InputError: the file is no zip archive, its files are compressed, or one has another checksum.
    """
    if path.suffix.lower() != ".usdz":
        return
    try:
        with zipfile.ZipFile(path) as package:
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in package.infolist()):
                raise zipfile.BadZipFile("compressed files in it")
            broken = package.testzip()
    except (zipfile.BadZipFile, EOFError, RuntimeError, NotImplementedError, ValueError) as error:
        raise InputError(f"{path}: expected a .usdz package, found {error}; export it again") from error
    if broken is not None:
        raise InputError(
            f"{path}: expected the checksum of {broken[:80]!r} in it, found another; "
            "the file is damaged, export it again"
        )


def pack(folder: Path, names: list[str], path: Path) -> None:
    """Write the named files of a folder as a package; the first name must be the root layer.

    Raises:
        InputError: the files have more than `LARGEST` bytes together.
    """
    size = sum((folder / name).stat().st_size for name in names)
    if size > LARGEST:
        raise InputError(f"{path}: expected at most 2 GiB in a package, found {size / 2**30:.1f}; write .usdc instead")
    with path.open("wb") as raw, zipfile.ZipFile(raw, "w") as package:
        for name in names:
            entry = zipfile.ZipInfo(name)
            # A zip entry is a header of 30 bytes, the name, extra fields, the content. One extra field (4 bytes of
            # identifier and length, then zeros) fills the gap up to the next aligned byte. Readers skip identifiers
            # that they do not support; 0x1986 is the one that Pixar's own writer uses.
            padding = -(raw.tell() + 30 + len(name.encode()) + 4) % ALIGNMENT
            entry.extra = struct.pack("<HH", 0x1986, padding) + bytes(padding)
            with package.open(entry, "w") as target, (folder / name).open("rb") as content:
                shutil.copyfileobj(content, target)
