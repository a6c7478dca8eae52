"""Packages (.usdz): a zip archive of uncompressed files that begin at multiples of 64 bytes, the root layer first."""

from __future__ import annotations

import shutil
import struct
import zipfile
from pathlib import Path

from ...core.errors import InputError

ALIGNMENT = 64
LARGEST = 2**31 - 1
"""Bytes; larger files would need the extension that packages must not use."""


def unpack(path: Path, folder: Path) -> list[str]:
    """Extract a package; returns the names of its files in order, the root layer first.

    Raises:
        InputError: it is not a package.
    """
    try:
        with zipfile.ZipFile(path) as package:
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in package.infolist()):
                raise zipfile.BadZipFile("compressed files in it")
            package.extractall(folder)
            return [entry.filename for entry in package.infolist() if not entry.is_dir()]
    except zipfile.BadZipFile as error:
        raise InputError(f"{path}: expected a .usdz package, found {error}; export it again") from error


def pack(folder: Path, names: list[str], path: Path) -> None:
    """Write files of a folder as a package.

    Raises:
        InputError: they are too large for one.
    """
    size = sum((folder / name).stat().st_size for name in names)
    if size > LARGEST:
        raise InputError(f"{path}: expected at most 2 GiB in a package, found {size / 2**30:.1f}; write .usdc instead")
    with path.open("wb") as raw, zipfile.ZipFile(raw, "w") as package:
        for name in names:
            entry = zipfile.ZipInfo(name)
            padding = -(raw.tell() + 30 + len(name.encode()) + 4) % ALIGNMENT  # header, name, head of the padding
            entry.extra = struct.pack("<HH", 0x1986, padding) + bytes(padding)
            with package.open(entry, "w") as target, (folder / name).open("rb") as content:
                shutil.copyfileobj(content, target)
