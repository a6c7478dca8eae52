"""Open USD files of others; runs in a child process (`child_process.child_result`).

The library ends the process at some damage (an abort or a segmentation fault), and for some files it never ends.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from pxr import Tf

from ...core.errors import InputError
from ...core.frame_buffer import Progress
from ...core.mesh import Mesh
from ..beside import confined
from ..guarded import hand_over_clip, hand_over_mesh
from . import read
from .package import check_package
from .source import UsdSource

# usd-core ships no types.
# pyright: reportAttributeAccessIssue=false


def read_mesh(source: Path, target: Path, confined_to: str | None) -> None:
    """Read a stage as a mesh and hand it over (see `guarded.guarded_mesh`).

    Raises:
        InputError: the file is damaged, or shows no meshes.
    """
    with _reading(source, confined_to):
        mesh = read.read_mesh(source)
        hand_over_mesh(target, mesh, _values(mesh))


def read_clip(source: Path, target: Path, confined_to: str | None, fps: float | None, progress: Progress) -> None:
    """Read a stage as a clip and hand it over (see `guarded.guarded_clip`).

    Raises:
        InputError: as `read_mesh`, or faces that change over time.
    """
    with _reading(source, confined_to):
        stream = read.read_clip(source, fps)
        hand_over_clip(target, stream, _values(stream.mesh), progress)


def _values(mesh: Mesh) -> dict:
    assert isinstance(mesh.source, UsdSource)
    return vars(mesh.source)


@contextlib.contextmanager
def _reading(path: Path, confined_to: str | None) -> Iterator[None]:
    """Turn errors of the library into an InputError of one line, and confine references to a folder.

    USD reads values lazily, so an error may come long after the stage was opened: the whole read runs in this block.
    """
    check_package(path)
    try:
        with contextlib.nullcontext() if confined_to is None else confined(Path(confined_to)):
            yield
    except Tf.ErrorException as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        found = lines[0].rpartition(" : ")[2] if lines else "nothing"
        if "bad_alloc" in found:
            raise MemoryError from error
        raise InputError(f"{path}: expected a USD stage, found {found}; export it again") from error
