"""Write files and folders to a temporary name beside the target, which is then renamed: a file is whole or absent.

`together` does so with all files of a command. A run that is killed leaves its temporary files; the next one that
writes to their folder deletes those that are a day old.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import secrets
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

from ..core.errors import InputError
from ..core.system import rename

PREFIX = ".mimesh-tmp-"
"""What names of temporary files and folders begin with; nothing else has such names."""
STEM_LENGTH = 40
"""Characters of the target's name in a temporary name; file systems limit names to 255 bytes."""
STALE_SECONDS = 24 * 3600.0
"""Age from which temporary files count as left over: no run takes so long between two writes to one."""


@dataclass(eq=False)
class _Outputs:
    """Finished temporary files, and the names that they will get."""

    files: dict[Path, Path] = field(default_factory=dict)
    """Target -> temporary file."""
    temporaries: list[Path] = field(default_factory=list)
    """What is deleted at the end, if it is still there."""


_OUTPUTS: ContextVar[_Outputs | None] = ContextVar("outputs", default=None)


@contextlib.contextmanager
def together() -> Iterator[None]:
    """Let the files that the block writes appear at its end, all of them, or none if it fails.

    A block inside another belongs to the outer one. `written` finds a file before the end.

    Raises:
        InputError: a file cannot get its name. Where that is for another reason than a folder of this name, those
            before it have theirs.
    """
    if _OUTPUTS.get() is not None:
        yield
        return
    outputs = _Outputs()
    token = _OUTPUTS.set(outputs)
    try:
        yield
        _rename(outputs.files)
    finally:
        _OUTPUTS.reset(token)
        for temporary in outputs.temporaries:
            _delete(temporary)


def written(path: str | Path) -> Path:
    """Return where an output is at the moment: inside `together` still under its temporary name."""
    outputs = _OUTPUTS.get()
    return Path(path) if outputs is None else outputs.files.get(_target(Path(path)), Path(path))


@contextlib.contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` with the same suffix, which is renamed to `path` if the block succeeds.

    Where `path` is a symbolic link, the file that it points to is replaced, and the link stays.

    Raises:
        InputError: `path` is a pipe or a device.
    """
    path = Path(path)
    target = _target(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    _remove_left_over(target.parent)
    temporary = _temporary_name(target.parent, path.stem, path.suffix)
    try:  # from before the file exists: a signal may come as soon as it does
        temporary.touch(exist_ok=False)
        mode = temporary.stat().st_mode
        yield temporary
        temporary.chmod(mode)  # some writers, as of .safetensors, make a file that only its owner can read
        _finish({target: temporary}, temporary)
    except BaseException:
        _delete(temporary)
        raise


@contextlib.contextmanager
def whole_folder(path: str | Path) -> Iterator[Path]:
    """Yield a temporary folder whose files are moved into `path` if the block succeeds.

    It is made inside `path` where that exists, since the parent may be on another disk, else beside it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    parent = path if path.is_dir() else path.parent
    _remove_left_over(parent)
    temporary = _temporary_name(parent, path.name)
    try:  # from before the folder exists: a signal may come as soon as it does
        temporary.mkdir(mode=0o700)
        yield temporary
        _finish({_target(path / file.name): file for file in sorted(temporary.iterdir())}, temporary)
    except BaseException:
        _delete(temporary)
        raise


@contextlib.contextmanager
def scratch_folder(parent: Path | None = None) -> Iterator[Path]:
    """Yield a folder in `parent`, by default the system's for temporary files, that is deleted after the block."""
    parent = parent or Path(tempfile.gettempdir())
    _remove_left_over(parent)
    temporary = _temporary_name(parent, "work")
    try:
        temporary.mkdir(mode=0o700)
        yield temporary
    finally:
        _delete(temporary)


@contextlib.contextmanager
def writing(path: Path, expected: str = "a place to write to", advice: str = "choose another output") -> Iterator[None]:
    """Turn a failed write, or read, into an InputError of one line that names the cause."""
    try:
        yield
    except UnicodeEncodeError as error:
        raise InputError(
            f"{path}: expected a path of text for {path.suffix}, found bytes that are none; choose another name"
        ) from error
    except OSError as error:
        raise InputError(f"{path}: expected {expected}, found '{error.strerror}'; {advice}") from error


def _temporary_name(parent: Path, stem: str, suffix: str = "") -> Path:
    return parent / f"{PREFIX}{stem[:STEM_LENGTH]}-{secrets.token_hex(8)}{suffix}"


def _target(path: Path) -> Path:
    """Return the file that a path stands for: itself, or what a symbolic link points to, be it there or not."""
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if target.exists() and not target.is_file() and not target.is_dir():
        raise InputError(f"{path}: expected a file to write, found a pipe or a device; name a file")
    return target


def _finish(files: dict[Path, Path], temporary: Path) -> None:
    """Rename finished files, or leave that to the surrounding `together`.

    What is written inside a temporary folder gets its name at once, because it is read there.
    """
    outputs = _OUTPUTS.get()
    if outputs is None or any(part.startswith(PREFIX) for target in files for part in target.parent.parts):
        _rename(files)
        _delete(temporary)
        return
    outputs.files |= files
    outputs.temporaries.append(temporary)


def _rename(files: dict[Path, Path]) -> None:
    """Give all files their names, one after another; none if one of the names is a folder's."""
    for target in files:
        with writing(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    for target, temporary in files.items():
        with writing(target):
            rename(temporary, target)


@functools.cache
def _remove_left_over(folder: Path) -> None:
    """Delete temporary files and folders of killed runs, once for each folder that this process writes to."""
    with contextlib.suppress(OSError):  # a folder that cannot be listed; the write itself will tell
        for entry in os.scandir(folder):
            if (
                entry.name.startswith(PREFIX)
                and time.time() - entry.stat(follow_symlinks=False).st_mtime > STALE_SECONDS
            ):
                _delete(Path(entry.path))


def _delete(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
