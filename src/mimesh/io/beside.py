"""Files that a mesh's file names: its buffers, images, libraries and layers.

Who reads a file of their own may have them anywhere. Who reads a stranger's confines it to the folder it came in, so
that its word opens nothing else of this machine.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path

_FOLDER: ContextVar[Path | None] = ContextVar("folder", default=None)


@contextlib.contextmanager
def confined(folder: Path) -> Iterator[None]:
    """Within this context and this thread, named files outside of `folder` count as not there; links are followed."""
    token = _FOLDER.set(folder.resolve())
    try:
        yield
    finally:
        _FOLDER.reset(token)


def is_confined() -> bool:
    """Whether some files may not be read."""
    return _FOLDER.get() is not None


def may_be_read(path: str | Path) -> bool:
    """Whether a file that another names is within the folder, by name and by where that leads; always if unconfined.

    The name is looked at first: nothing outside is touched, not even to see whether it is there.
    """
    folder = _FOLDER.get()
    if folder is None:
        return True
    named = Path(os.path.abspath(path))
    return named.is_relative_to(folder) and named.resolve().is_relative_to(folder)


def is_there(path: str | Path) -> bool:
    """Whether a file that another names is there and may be read."""
    return may_be_read(path) and os.path.isfile(path)
