"""The temporary folder of a studio: stores uploads and exports under safe names and within limits of size."""

from __future__ import annotations

import re
import shutil
import tempfile
import unicodedata
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from ..core.errors import InputError
from ..io.formats import ANIMATED, CACHE, CLIP_READERS, MESH_READERS

MOST_FILES = 20_000
"""Largest number of files in one upload, a folder of frames for example."""
MOST_MESHES = 16
"""Largest number of meshes to move in one upload; more must be the frames of a clip."""
MAX_DEPTH = 8
"""Largest number of nested folders in an upload, the file name included."""
MAX_NAME = 120
"""Largest length of a file name in bytes."""
DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(10))}
"""Names of devices on Windows, whatever their suffix."""


class TooLarge(InputError):
    """Raised for files above a limit of size."""


@dataclass(eq=False)
class Upload:
    """Files that were sent together."""

    number: int
    folder: Path
    files: list[Path] = field(default_factory=list)
    size: int = 0
    """Bytes of all files."""


class UploadFolder:
    """A temporary folder, deleted by `close`; `limit` is in bytes for one file, `sum_limit` for all uploads."""

    def __init__(self, limit: int, sum_limit: int) -> None:
        self.limit, self.sum_limit = limit, sum_limit
        self.folder = Path(tempfile.mkdtemp(prefix="mimesh-studio-"))
        self._uploads: dict[int, Upload] = {}
        self._last = 0

    @property
    def used(self) -> int:
        """Bytes of all uploads together."""
        return sum(upload.size for upload in self._uploads.values())

    def new_upload(self) -> Upload:
        """Create a folder for files that belong together."""
        upload = Upload(self._next(), self.folder / "uploads" / str(self._last))
        upload.folder.mkdir(parents=True)
        self._uploads[upload.number] = upload
        return upload

    def upload(self, number: int) -> Upload:
        """Return the upload of a number."""
        if number not in self._uploads:
            raise InputError(f"upload {number}: expected one that was begun, found none; choose the files again")
        return self._uploads[number]

    def new_export(self) -> Path:
        """Create an empty folder for an export."""
        folder = self.folder / "exports" / str(self._next())
        folder.mkdir(parents=True)
        return folder

    def add_file(self, upload: Upload, name: str) -> Path:
        """Add a file to an upload by its name in the browser; creates its folders and returns its path."""
        if len(upload.files) >= MOST_FILES:
            raise InputError(f"{name}: expected {MOST_FILES:,} files or fewer at a time, found more; give fewer frames")
        path = upload.folder / safe_path(name)
        # A folder of the path may be a file of the same upload.
        if path.exists() or any(above.is_file() for above in path.parents):
            raise InputError(f"{path.name}: expected files of different names, found two of this one; rename one")
        path.parent.mkdir(parents=True, exist_ok=True)
        upload.files.append(path)
        return path

    def count(self, upload: Upload, path: Path, size: int, more: int) -> None:
        """Count `more` bytes of a file that has `size` bytes so far.

        Raises:
            TooLarge: the file, or all uploads together, would exceed their limit.
        """
        if size + more > self.limit:
            raise TooLarge(
                f"{path.name}: expected {self.limit / 2**20:,.0f} MiB or less, found more; start mimesh studio with a "
                "larger --limit, or give the file on its command line"
            )
        if self.used + more > self.sum_limit:
            raise TooLarge(
                f"{path.name}: expected {self.sum_limit / 2**20:,.0f} MiB or less in all, found more; remove a mesh "
                "that is no longer needed"
            )
        upload.size += more

    def remove_file(self, upload: Upload, path: Path, size: int) -> None:
        """Delete an incomplete file."""
        path.unlink(missing_ok=True)
        upload.files.remove(path)
        upload.size -= size

    def remove_upload(self, number: int) -> None:
        """Delete the files of an upload, if there is one of that number."""
        upload = self._uploads.pop(number, None)
        if upload is not None:
            shutil.rmtree(upload.folder, ignore_errors=True)

    def close(self) -> None:
        """Delete everything."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _next(self) -> int:
        self._last += 1
        return self._last


def safe_name(name: str) -> str:
    """Make a file name that is safe on every system: no control or invisible characters, no separators, no devices.

    Letters of all scripts stay; the suffix stays if the name has to be cut to MAX_NAME bytes.
    """
    # Categories C (control, invisible) and Z (separators) could hide a part of the name, such as its suffix.
    text = unicodedata.normalize("NFC", name)
    text = "".join(
        character
        for character in text
        if not unicodedata.category(character).startswith(("C", "Z")) or character == " "
    )
    text = re.sub(r'[<>:"|?*/\\]', "_", text).strip(" ").lstrip(".").rstrip(". ")
    stem, dot, suffix = text.rpartition(".")
    if not dot:
        stem, suffix = text, ""
    # Windows opens a device for "con.obj", too.
    if text.split(".")[0].strip().lower() in DEVICES:
        stem = f"_{stem}"
    suffix = dot + suffix if len((dot + suffix).encode()) <= MAX_NAME // 2 else ""
    # Cut by bytes, as file systems count; half a character at the end is dropped.
    stem = stem.encode()[: MAX_NAME - len(suffix.encode())].decode(errors="ignore")
    return (stem or "file") + suffix


def safe_path(name: str) -> PurePosixPath:
    """Make a relative path that stays in its folder: "../a\\b.obj" becomes "a/b.obj"."""
    # Characters that normalize to a separator, such as a full-width slash, count as one.
    separated = "".join("/" if {"/", "\\"} & set(unicodedata.normalize("NFKC", c)) else c for c in name)
    parts = [part for part in separated.split("/") if part.strip(". ") and not re.fullmatch(r"[A-Za-z]:", part)]
    if not parts:
        raise InputError(f"{name[:40]!r}: expected the name of a file, found none in it; rename the file")
    if len(parts) > MAX_DEPTH:
        raise InputError(
            f"{safe_name(parts[-1])}: expected {MAX_DEPTH} folders or fewer, found {len(parts)}; move it up"
        )
    return PurePosixPath(*map(safe_name, parts))


def find_meshes(files: list[Path]) -> list[Path]:
    """Find the meshes among files; materials, textures and buffers are no meshes."""
    found = [path for path in files if path.suffix.lower() in MESH_READERS]
    if not found:
        raise InputError(
            f"{_describe_files(files)}: expected a mesh ({' '.join(MESH_READERS)}), found none; choose another file"
        )
    if len(found) > MOST_MESHES:
        raise InputError(
            f"{found[0].name}: expected {MOST_MESHES} meshes or fewer to move, found {len(found)}; "
            "add the frames of a clip under Driving motion"
        )
    return found


def find_clip(files: list[Path]) -> Path:
    """Find the driving clip among files: a point cache, the only readable file, or the folder with most of them.

    A point cache (positions without faces) comes with the mesh that it moves, which its reader finds beside it.
    """
    caches = [path for path in files if path.suffix.lower() == CACHE]
    if len(caches) == 1:
        return caches[0]
    known = MESH_READERS.keys() | CLIP_READERS.keys() | set(ANIMATED)
    found = [path for path in files if path.suffix.lower() in known]
    if len(found) == 1:
        return found[0]
    if not found:
        raise InputError(
            f"{_describe_files(files)}: expected a clip or a mesh ({' '.join(sorted(known))}), found none; "
            "choose another file"
        )
    return Counter(path.parent for path in found).most_common(1)[0][0]


def clip_name(path: Path, upload: Upload) -> str:
    """Name a clip after its file or folder; frames without a folder give their name without the number."""
    if path != upload.folder:
        return path.name
    return upload.files[0].stem.rstrip("0123456789").rstrip("-_. ") or "frames"


def _describe_files(files: list[Path]) -> str:
    return files[0].name if len(files) == 1 else f"{len(files)} files"
