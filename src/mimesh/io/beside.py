"""Control access to files that a mesh file refers to: buffers, images, material libraries and layers.

They may be anywhere when a user reads their own file. The studio reads uploaded files, whose references must not open
other files of the machine: it confines them to the folder of the upload.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING

from ..core.printable import listed

if TYPE_CHECKING:
    from ..core.mesh import Mesh

SHOWN = 3
"""Largest number of missing files that a note lists."""
LONGEST_NAME = 80
"""Characters of the name of a missing file that a note shows, the last ones."""
_FOLDER: ContextVar[Path | None] = ContextVar("folder", default=None)


@contextlib.contextmanager
def confined(folder: Path) -> Iterator[None]:
    """Treat referenced files outside of `folder` as missing, within this context and thread; links are resolved."""
    token = _FOLDER.set(folder.resolve())
    try:
        yield
    finally:
        _FOLDER.reset(token)


def confining_folder() -> Path | None:
    """Return the folder that referenced files are confined to; None where they are not."""
    return _FOLDER.get()


def may_be_read(path: str | Path) -> bool:
    """Return whether a referenced file is inside the confining folder; always true where nothing is confined.

    Both the name and the target of links must be inside. The name is tested first, so that no file outside of the
    folder is accessed, not even to test whether it exists.
    """
    folder = _FOLDER.get()
    if folder is None:
        return True
    named = Path(os.path.abspath(path))
    return named.is_relative_to(folder) and named.resolve().is_relative_to(folder)


def is_there(path: str | Path) -> bool:
    """Return whether a referenced file exists and may be read."""
    return may_be_read(path) and os.path.isfile(path)


def find_beside(folder: Path, names: Iterable[str]) -> str | None:
    """Find the file that a file in `folder` refers to by the first of some names; returns its name from the folder.

    Exporters write paths of their own machine, with backslashes, and letters of another case where it knows none: so
    the bare name is looked up in the folder, too.
    """
    paths = [path for name in names for path in (name, name.replace("\\", "/")) if name]
    bare = [path.rpartition("/")[2] for path in paths]
    for path in (*paths, *bare):
        if is_there(folder / path):
            return path
    folded = {path.casefold() for path in bare if path}
    with contextlib.suppress(OSError):
        for path in sorted(os.listdir(folder)) if folded and may_be_read(folder) else ():
            if path.casefold() in folded and is_there(folder / path):
                return path
    return None


def missing_images(mesh: Mesh) -> tuple[str, ...]:
    """List the images that the file of a mesh names and that do not exist, if its format says so."""
    return tuple(dict.fromkeys(getattr(mesh.source, "missing_images", ())))


def _shown_file(name: str) -> str:
    """Return the name of a file for a note: without the folder, unless this is one below that of the file it is of."""
    path = PureWindowsPath(name)  # splits at both kinds of slashes
    elsewhere = "\\" in name or path.drive or path.root or ".." in path.parts
    return (path.name if elsewhere and path.name else name)[-LONGEST_NAME:]


def missing_images_notes(names: Sequence[str]) -> tuple[str, ...]:
    """Return a note on images that a file names and that do not exist; none where there are none."""
    if not names:
        return ()
    files = list(dict.fromkeys(_shown_file(name) for name in names))
    one = len(files) == 1
    return (
        f"{listed(files, SHOWN)}, which the file names, {'is' if one else 'are'} not "
        f"beside it: the surface is shown without; copy {'it' if one else 'them'} there",
    )
