"""Write files and folders atomically: to a temporary name beside the target, which is then renamed.

`together` does so with all files of a command. Temporary files are locked while they are written: those of a run that
was killed are not, and the next run that writes to their folder deletes them. A run that is killed between two renames
has listed them: the next one does those that are left.
"""

from __future__ import annotations

import contextlib
import functools
import json
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
from ..core.output_size import check_output_size
from ..core.system import file_mode_mask, has_locks, lock, open_to_lock, rename

PREFIX = ".mimesh-tmp-"
"""What names of temporary files and folders begin with; nothing else has such names."""
STEM_LENGTH = 40
"""Characters of the target's name in a temporary name; file systems limit names to 255 bytes."""
RENAMES = ".renames"
"""Suffix of the temporary file that lists renames under way; no format has it."""
STALE_SECONDS = 24 * 3600.0
"""Age from which temporary files count as left over where the system has no locks."""


@dataclass(eq=False)
class _Temporary:
    """A temporary file or folder, locked where the system has locks."""

    path: Path
    descriptor: int | None = None

    @classmethod
    def file(cls, folder: Path, stem: str, suffix: str) -> _Temporary:
        """Make an empty one; again if another process, which takes it for a left over one, was faster to lock it."""
        while True:
            start = f"{PREFIX}{stem[:STEM_LENGTH]}-"
            descriptor, name = tempfile.mkstemp(prefix=start, suffix=suffix, dir=folder)
            os.close(descriptor)
            temporary = cls(Path(name))
            temporary.lock()
            if temporary.path.exists():
                return temporary
            temporary.remove()

    @classmethod
    def folder(cls, parent: Path, stem: str) -> _Temporary:
        """Return the name of a folder that is to be made."""
        return cls(parent / f"{PREFIX}{stem[:STEM_LENGTH]}-{secrets.token_hex(8)}")

    def lock(self) -> None:
        """Lock what has the name now: some libraries replace the file that they write by another."""
        self.unlock()
        self.descriptor = open_to_lock(self.path)
        if self.descriptor is not None:
            lock(self.descriptor, wait=True)

    def unlock(self) -> None:
        if self.descriptor is not None:
            os.close(self.descriptor)
        self.descriptor = None

    def remove(self) -> None:
        """Delete it if it is still there."""
        _delete(self.path)
        self.unlock()


@dataclass(eq=False)
class _Outputs:
    """Finished temporary files, and the names that they will get."""

    files: dict[Path, Path] = field(default_factory=dict)
    """Target -> temporary file."""
    temporaries: list[_Temporary] = field(default_factory=list)

    def publish(self) -> None:
        """Rename all files; if one cannot be renamed, put back what was there before.

        Raises:
            InputError: the first that cannot be renamed.
        """
        earlier: dict[Path, Path | None] = {}
        made: list[Path] = []
        renames: _Temporary | None = None
        try:
            for target in self.files:
                if not target.parent.exists():
                    made.append(target.parent)
                with writing(target):
                    target.parent.mkdir(parents=True, exist_ok=True)
                    if (kept := _kept(target)) is not None or not target.exists():
                        earlier[target] = kept
            renames = _list_renames(self.files)
            for target, temporary in self.files.items():
                with writing(target):
                    rename(temporary, target)
        except BaseException:
            if renames is not None:
                renames.remove()  # a run that is killed from here on has nothing to be finished
            _restore(earlier)
            for folder in reversed(made):
                with contextlib.suppress(OSError):
                    folder.rmdir()
            raise
        finally:
            if renames is not None:
                renames.remove()
            for path in filter(None, earlier.values()):
                path.unlink(missing_ok=True)


_OUTPUTS: ContextVar[_Outputs | None] = ContextVar("outputs", default=None)


@contextlib.contextmanager
def together() -> Iterator[None]:
    """Let the files that the block writes appear at its end, all of them, or none if it fails.

    A block inside another belongs to the outer one. Only a crash between two renames, of microseconds each, leaves a
    part of them, until the next run that writes to their folder. `written` finds a file before the end.

    Raises:
        InputError: a file cannot get its name.
    """
    if _OUTPUTS.get() is not None:
        yield
        return
    outputs = _Outputs()
    token = _OUTPUTS.set(outputs)
    try:
        yield
        outputs.publish()
    finally:
        _OUTPUTS.reset(token)
        for temporary in outputs.temporaries:
            temporary.remove()


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
    _remove_left_over(None)
    temporary = _Temporary.file(target.parent, path.stem, path.suffix)
    try:
        yield temporary.path
        check_output_size(temporary.path.stat().st_size, path, "write less of it", estimated=False)
        temporary.path.chmod(0o666 & ~file_mode_mask())  # mkstemp makes files that only their owner can read
        _finish({target: temporary.path}, temporary)
    except BaseException:
        temporary.remove()
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
    temporary = _Temporary.folder(parent, path.name)
    try:  # from before the folder exists: a signal may come as soon as it does
        temporary.path.mkdir(mode=0o700)
        temporary.lock()
        yield temporary.path
        files = {_target(path / file.name): file for file in sorted(temporary.path.iterdir())}
        _finish(files, temporary)
    except BaseException:
        temporary.remove()
        raise


@contextlib.contextmanager
def scratch_folder(parent: Path | None = None) -> Iterator[Path]:
    """Yield a folder in `parent`, by default the system's for temporary files, that is deleted after the block."""
    parent = parent or temporary_folder()
    _remove_left_over(parent)
    temporary = _Temporary.folder(parent, "work")
    try:
        temporary.path.mkdir(mode=0o700)
        temporary.lock()
        yield temporary.path
    finally:
        temporary.remove()


def temporary_folder() -> Path:
    """Return the system's folder for temporary files, as TMPDIR may say.

    Raises:
        OSError: there is none that can be written to.
    """
    return Path(tempfile.gettempdir())


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


def _target(path: Path) -> Path:
    """Return the file that a path stands for: itself, or what a symbolic link points to, be it there or not."""
    target = Path(os.path.realpath(path)) if path.is_symlink() else path
    if target.exists() and not target.is_file() and not target.is_dir():
        raise InputError(f"{path}: expected a file to write, found a pipe or a device; name a file")
    return target


def _finish(files: dict[Path, Path], temporary: _Temporary) -> None:
    """Rename finished files, or leave that to the surrounding `together`.

    What is written inside a temporary folder gets its name at once, because it is read there.
    """
    outputs = _OUTPUTS.get()
    if outputs is None or any(part.startswith(PREFIX) for target in files for part in target.parent.parts):
        if len(files) == 1:
            [(target, path)] = files.items()
            target.parent.mkdir(exist_ok=True)
            rename(path, target)
        else:
            _Outputs(files).publish()
        temporary.remove()
        return
    temporary.lock()
    outputs.files |= files
    outputs.temporaries.append(temporary)


def _kept(target: Path) -> Path | None:
    """Give what has a name now a second one, and return it; None if there is nothing, or no second name is possible."""
    second = target.with_name(f"{PREFIX}{secrets.token_hex(8)}")
    try:
        os.link(target, second)
    except OSError:
        return None
    return second


def _restore(earlier: dict[Path, Path | None]) -> None:
    """Give files their former contents; None is a file that was not there."""
    for target, kept in reversed(earlier.items()):
        with contextlib.suppress(OSError):
            if kept is None:
                target.unlink(missing_ok=True)
            else:
                rename(kept, target)


def _list_renames(files: dict[Path, Path]) -> _Temporary | None:
    """List renames in a locked file, each with the facts that identify both files; None where it would be of no use.

    It lies in the folder that holds all files, if one of them or a temporary folder lies directly in it: only there the
    next run looks.
    """
    if len(files) < 2:
        return None
    targets = [target.absolute() for target in files]
    places = {target.parent for target in targets} | {_place(temporary.absolute()) for temporary in files.values()}
    try:
        folder = Path(os.path.commonpath(places))
    except ValueError:  # several drives
        return None
    if folder not in places:
        return None
    rows = [
        (os.path.relpath(temporary, folder), os.path.relpath(target, folder), _identity(temporary), _identity(target))
        for target, temporary in zip(targets, files.values(), strict=True)
    ]
    try:
        listed = _Temporary.file(folder, "all", RENAMES)
    except OSError:  # the renames themselves will tell
        return None
    with contextlib.suppress(OSError):  # a list that is cut off is none
        listed.path.write_text(json.dumps(rows), encoding="utf-8", newline="\n")
    return listed


def _place(temporary: Path) -> Path:
    """Return the folder in which a temporary file lies, or the temporary folder that holds it."""
    inside = [path for path in temporary.parents if path.name.startswith(PREFIX)]
    return inside[-1].parent if inside else temporary.parent


def _finish_renames(listed: Path) -> None:
    """Do the renames that a killed run has left, if it did some and no file has changed since."""
    folder = listed.parent
    try:
        rows = [(Path(name), Path(target), *files) for name, target, *files in json.loads(listed.read_bytes())]
    except (OSError, ValueError, TypeError):  # killed before the list was whole, and so before the first rename
        return
    if any(path.is_absolute() or ".." in path.parts for row in rows for path in row[:2]):
        return
    left = [row for row in rows if _identity(folder / row[1]) != row[2]]
    unchanged = all([_identity(folder / row[0]), _identity(folder / row[1])] == [*row[2:]] for row in left)
    if unchanged and len(left) < len(rows):
        for temporary, target, *_ in left:
            rename(folder / temporary, folder / target)


def _identity(path: Path) -> list[int] | None:
    """Return what identifies a file and its contents, and stays when it is renamed; None if there is none."""
    try:
        facts = path.stat()
    except OSError:
        return None
    return [facts.st_dev, facts.st_ino, facts.st_mtime_ns, facts.st_size]


@functools.cache
def _remove_left_over(folder: Path | None) -> None:
    """Delete temporary files and folders of killed runs, once for each folder that this process writes to.

    Before, renames that a run has left are done. None is the system's folder for temporary files.
    """
    with contextlib.suppress(OSError):  # a folder that cannot be listed; the write itself will tell
        for entry in sorted(
            os.scandir(folder or temporary_folder()), key=lambda entry: not entry.name.endswith(RENAMES)
        ):
            if entry.name.startswith(PREFIX) and not entry.is_symlink():
                _remove_if_left_over(Path(entry.path))


def _remove_if_left_over(path: Path) -> None:
    if not has_locks():
        with contextlib.suppress(OSError):  # Windows deletes no file that is open
            if time.time() - path.stat().st_mtime > STALE_SECONDS:
                _remove_left(path)
        return
    descriptor = open_to_lock(path)
    if descriptor is None:
        return
    try:
        # Renames under way are waited for: they take microseconds.
        if lock(descriptor, wait=path.suffix == RENAMES):
            _remove_left(path)
    finally:
        os.close(descriptor)


def _remove_left(path: Path) -> None:
    if path.suffix == RENAMES:
        with contextlib.suppress(OSError, ValueError, IndexError):
            _finish_renames(path)
    _delete(path)


def _delete(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
