"""Write files and folders atomically: to a temporary name beside the target, which is then renamed."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ..core.errors import InputError

PREFIX_LENGTH = 40
"""Characters of the target's name that a temporary name begins with; file systems limit names to 255 bytes."""


@contextlib.contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` with the same suffix, which is renamed to `path` if the block succeeds."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(prefix=f".{path.stem[:PREFIX_LENGTH]}-", suffix=path.suffix, dir=path.parent)
    os.close(descriptor)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~_umask())  # mkstemp makes files that only their owner can read
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def whole_folder(path: str | Path) -> Iterator[Path]:
    """Yield a temporary folder whose files are moved into `path` if the block succeeds.

    It is made inside `path` where that exists, since the parent may be on another disk, else beside it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    parent = path if path.is_dir() else path.parent
    temporary = parent / f".{path.name[:PREFIX_LENGTH]}-{secrets.token_hex(8)}"
    try:  # from before the folder exists: a signal may come as soon as it does
        temporary.mkdir(mode=0o700)
        yield temporary
        path.mkdir(exist_ok=True)
        for file in temporary.iterdir():
            os.replace(file, path / file.name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


@contextlib.contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn a failed write into an InputError of one line that names the cause."""
    try:
        yield
    except UnicodeEncodeError as error:
        raise InputError(
            f"{path}: expected a path of text for {path.suffix}, found bytes that are none; choose another name"
        ) from error
    except OSError as error:
        raise InputError(
            f"{path}: expected a place to write to, found '{error.strerror}'; choose another output"
        ) from error


def _umask() -> int:
    """Return the process's file mode mask; the system can only report it by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
