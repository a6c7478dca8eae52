"""The temporary folder of a studio: what is uploaded and exported lies there, under safe names and within limits."""

from __future__ import annotations

import io
import os
import re
import shutil
import tempfile
import unicodedata
import zipfile
import zlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from ..core.errors import InputError
from ..io.formats import ANIMATED, CACHES, CLIP_READERS, MESH_READERS

MOST_FILES = 20_000
"""Of one upload, a folder of frames for example."""
DEEPEST = 8
"""Folders in folders."""
LONGEST = 120
"""Bytes of a file name."""
DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(10))}
"""Names that are no files on some systems, whatever their suffix."""
PREFIX = "mimesh-studio-"
CHUNK = 2**20
LARGEST_TABLE = MOST_FILES * 256
"""Bytes of the table of contents of an archive."""


class TooLarge(InputError):
    """More bytes than a limit allows."""


@dataclass(eq=False)
class Upload:
    """Files that were given together."""

    number: int
    folder: Path
    files: list[Path] = field(default_factory=list)
    size: int = 0


class UploadFolder:
    """A folder of its own that is gone when the studio ends; `limit` is in bytes a file, `sum_limit` in all."""

    def __init__(self, limit: int, sum_limit: int) -> None:
        self.limit, self.sum_limit = limit, sum_limit
        remove_leftovers(Path(tempfile.gettempdir()))
        self.folder = Path(tempfile.mkdtemp(prefix=f"{PREFIX}{os.getpid()}-"))
        self._uploads: dict[int, Upload] = {}
        self._last = 0

    @property
    def used(self) -> int:
        """Bytes of all uploads."""
        return sum(upload.size for upload in self._uploads.values())

    def new_upload(self) -> Upload:
        """Room for files that belong together."""
        upload = Upload(self._next(), self.folder / "uploads" / str(self._last))
        upload.folder.mkdir(parents=True)
        self._uploads[upload.number] = upload
        return upload

    def upload(self, number: int) -> Upload:
        """Raises InputError where there is none of that number."""
        if number not in self._uploads:
            raise InputError(f"upload {number}: expected one that was begun, found none; choose the files again")
        return self._uploads[number]

    def new_export(self) -> Path:
        """An empty folder."""
        folder = self.folder / "exports" / str(self._next())
        folder.mkdir(parents=True)
        return folder

    def place(self, upload: Upload, name: str) -> Path:
        """Where a file of an upload goes, by the name it has in the browser; its folders are made.

        Raises:
            InputError: too many files, or two of one name.
        """
        if len(upload.files) >= MOST_FILES:
            raise InputError(f"{name}: expected {MOST_FILES:,} files or fewer at a time, found more; give fewer frames")
        path = upload.folder / safe_path(name)
        if path.exists() or any(above.is_file() for above in path.parents):
            raise InputError(f"{path.name}: expected files of different names, found two of this one; rename one")
        path.parent.mkdir(parents=True, exist_ok=True)
        upload.files.append(path)
        return path

    def check(self, path: Path, size: int) -> None:
        """Refuse a file by the size that is announced, before it is sent; `count` is what holds.

        Raises:
            TooLarge: see `count`.
        """
        if size > self.limit:
            raise TooLarge(
                f"{path.name}: expected {self.limit / 2**20:,.0f} MiB or less, found {size / 2**20:,.0f}; start mimesh "
                "studio with a larger --limit, or give the file on its command line"
            )

    def count(self, upload: Upload, path: Path, size: int, more: int) -> None:
        """Take `more` bytes of a file that has `size` of them so far.

        Raises:
            TooLarge: the file, or all uploads together, would pass their limit.
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
        """Take away what came of a file that will not be whole."""
        path.unlink(missing_ok=True)
        upload.files.remove(path)
        upload.size -= size

    def remove_upload(self, number: int) -> None:
        """Take away the files of an upload, if there is one of that number."""
        upload = self._uploads.pop(number, None)
        if upload is not None:
            shutil.rmtree(upload.folder, ignore_errors=True)

    def unzip(self, upload: Upload, archive: Path) -> None:
        """Put the files of a .zip in its place; what it holds is counted as it is unpacked, not as it says.

        Raises:
            InputError: not an archive, an encrypted one, or one with too many files or bytes.
        """
        try:
            with _Frugal(archive) as file, zipfile.ZipFile(file) as pack:
                entries = [entry for entry in pack.infolist() if not entry.is_dir() and not _litter(entry.filename)]
                for entry in entries:
                    self._unpack(upload, pack, entry)
        except (zipfile.BadZipFile, RuntimeError, NotImplementedError, EOFError, zlib.error) as error:
            raise InputError(
                f"{archive.name}: expected a .zip without a password, found '{error}'; pack it again"
            ) from error
        self.remove_file(upload, archive, archive.stat().st_size)

    def close(self) -> None:
        """Take everything away."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _unpack(self, upload: Upload, pack: zipfile.ZipFile, entry: zipfile.ZipInfo) -> None:
        path, size = self.place(upload, entry.filename), 0
        with pack.open(entry) as packed, path.open("xb") as file:
            while chunk := packed.read(CHUNK):
                self.count(upload, path, size, len(chunk))
                size += len(chunk)
                file.write(chunk)

    def _next(self) -> int:
        self._last += 1
        return self._last


def remove_leftovers(folder: Path) -> None:
    """Take away workplaces of our own user whose process, whose number is in their name, was killed.

    Where processes cannot be asked for (Windows), nothing is done.
    """
    if not hasattr(os, "getuid"):
        return
    for left in folder.glob(f"{PREFIX}*-*"):
        number = left.name.removeprefix(PREFIX).partition("-")[0]
        if number.isdigit() and not left.is_symlink() and left.is_dir() and left.stat().st_uid == os.getuid():
            try:
                os.kill(int(number), 0)
            except ProcessLookupError:
                shutil.rmtree(left, ignore_errors=True)
            except (PermissionError, OverflowError):
                continue


class _Frugal(io.FileIO):
    """A file that is not read whole: the table of contents of an archive is, and each entry takes much memory."""

    def read(self, size: int | None = -1) -> bytes:
        whole = os.fstat(self.fileno()).st_size - self.tell()
        if (whole if size is None or size < 0 else min(size, whole)) > LARGEST_TABLE:
            raise zipfile.BadZipFile(f"a table of contents of far more than {MOST_FILES:,} files")
        return super().read(size)


def safe_name(name: str) -> str:
    """One part of a path that is a file's plain name on every system: no control or invisible characters, no devices.

    Letters of all scripts stay; the suffix stays where the name has to be cut.
    """
    text = unicodedata.normalize("NFC", name)
    text = "".join(
        letter for letter in text if not unicodedata.category(letter).startswith(("C", "Z")) or letter == " "
    )
    text = re.sub(r'[<>:"|?*/\\]', "_", text).strip(" ").lstrip(".").rstrip(". ")
    stem, dot, suffix = text.rpartition(".")
    if not dot:
        stem, suffix = text, ""
    if text.split(".")[0].strip().lower() in DEVICES:
        stem = f"_{stem}"
    suffix = dot + suffix if len((dot + suffix).encode()) <= LONGEST // 2 else ""
    stem = stem.encode()[: LONGEST - len(suffix.encode())].decode(errors="ignore")
    return (stem or "file") + suffix


def safe_path(name: str) -> PurePosixPath:
    """A relative path without a way out of its folder: of "../a\\b.obj" it is "a/b.obj".

    Raises:
        InputError: no name is left, or folders lie too deep.
    """
    plain = "".join("/" if {"/", "\\"} & set(unicodedata.normalize("NFKC", letter)) else letter for letter in name)
    parts = [part for part in plain.split("/") if part.strip(". ") and not re.fullmatch(r"[A-Za-z]:", part)]
    if not parts:
        raise InputError(f"{name[:40]!r}: expected the name of a file, found none in it; rename the file")
    if len(parts) > DEEPEST:
        raise InputError(f"{safe_name(parts[-1])}: expected {DEEPEST} folders or fewer, found {len(parts)}; move it up")
    return PurePosixPath(*map(safe_name, parts))


def _litter(name: str) -> bool:
    """What file managers add to archives."""
    return name.startswith("__MACOSX/") or PurePosixPath(name).name in (".DS_Store", "Thumbs.db")


MOST_MESHES = 16
"""Identities of one upload."""


def meshes(files: list[Path]) -> list[Path]:
    """The meshes among files: all but those that others of them draw on.

    Raises:
        InputError: none, or so many that they must be the frames of a clip.
    """
    found = [path for path in files if path.suffix.lower() in MESH_READERS]
    if not found:
        raise InputError(
            f"{_names(files)}: expected a mesh ({' '.join(MESH_READERS)}), found none; choose another file"
        )
    if len(found) > MOST_MESHES:
        raise InputError(
            f"{found[0].name}: expected {MOST_MESHES} meshes or fewer to move, found {len(found)}; "
            "frames of a clip belong under what to imitate"
        )
    return found


def clip(files: list[Path]) -> Path:
    """The one file, or the folder of numbered meshes, that is to be imitated.

    Raises:
        InputError: nothing that can be read, or more than one.
    """
    caches = [path for path in files if path.suffix.lower() in CACHES]
    if len(caches) == 1:
        return caches[0]
    known = MESH_READERS.keys() | CLIP_READERS.keys() | set(ANIMATED)
    found = [path for path in files if path.suffix.lower() in known]
    if len(found) == 1:
        return found[0]
    if not found:
        raise InputError(
            f"{_names(files)}: expected a clip or a mesh ({' '.join(sorted(known))}), found none; choose another file"
        )
    return Counter(path.parent for path in found).most_common(1)[0][0]


def called(path: Path, upload: Upload) -> str:
    """What a clip is called: as its file or its folder; as its frames are, without their numbers, if it has none."""
    if path != upload.folder:
        return path.name
    return upload.files[0].stem.rstrip("0123456789").rstrip("-_. ") or "frames"


def _names(files: list[Path]) -> str:
    return files[0].name if len(files) == 1 else f"{len(files)} files"
