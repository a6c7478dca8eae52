"""Read and write USD (.usd, .usda, .usdc, .usdz) with the library usd-core (the extra `usd`).

stage -> skinning, appearance -> read    read a stage as a Mesh or a Clip
         source, package                 write the file that was read again, with other points
         write, write_material           write a new file for any Mesh or Clip

The library is imported only when a USD file is read or written.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path

from ...core.errors import InputError
from ...core.frame_buffer import Progress
from ...core.mesh import Clip, Mesh
from ..atomic import whole_file


def read_usd(path: Path) -> Mesh:
    """Read all visible meshes of a stage as one mesh in world coordinates, at the default time (see `read.read_mesh`).

    Raises:
        InputError: usd-core is not installed, the file is damaged, or it shows no meshes.
    """
    _need_library(path, "read")
    from .read import read_mesh

    with _reading(path):
        return read_mesh(path)


def read_usd_clip(path: Path, fps: float | None = None, progress: Progress | None = None) -> Clip:
    """Read all visible meshes of a stage as one clip: a frame per time code, or `fps` a second (see `read.read_clip`).

    Raises:
        InputError: as `read_usd`, or faces that change over time.
    """
    _need_library(path, "read")
    from .read import read_clip

    with _reading(path):
        return read_clip(path, fps, progress)


def write_usd(mesh: Mesh, path: Path) -> None:
    """Write a mesh as USD: its own file with other points if that was USD, else a new file (see `write.write_new`)."""
    _need_library(path, "write")
    from .source import UsdSource
    from .write import write_new

    with whole_file(path) as temporary, _writing(path):
        if isinstance(mesh.source, UsdSource):
            mesh.source.write(mesh, temporary)
        else:
            write_new(Clip.still(mesh), temporary, path)


def write_usd_clip(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write a clip as a new USD file in which time code k is frame k (see `write.write_new`)."""
    _need_library(path, "write")
    from .write import write_new

    with whole_file(path) as temporary, _writing(path):
        write_new(clip, temporary, path, progress)


def stage_axes(mesh: Mesh) -> tuple[bool, float]:
    """Return whether z is up in the file of a mesh, and the file's unit in metres.

    Only USD sources know both; for all others the answer is y up and one metre.
    """
    return getattr(mesh.source, "up_axis", "Y") == "Z", getattr(mesh.source, "meters_per_unit", 1.0)


def _need_library(path: Path, verb: str) -> None:
    """Raise InputError where usd-core is not installed; `verb` is "read" or "write"."""
    # By default the library memory-maps binary files, and pages that were read of a long clip stay in memory.
    os.environ.setdefault("USDC_USE_PREAD", "1")
    if importlib.util.find_spec("pxr") is None:
        raise InputError(f"{path}: expected usd-core to {verb} USD, found it not installed; pip install 'mimesh[usd]'")


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn errors of the library into an InputError of one line.

    USD reads values lazily, so an error may come long after the stage was opened: the whole read runs in this block.
    """
    from pxr import Tf  # pyright: ignore[reportAttributeAccessIssue]

    try:
        yield
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected a USD stage, found a name that is no UTF-8; export it again") from error
    except Tf.ErrorException as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        found = lines[0].rpartition(" : ")[2] if lines else "nothing"
        raise InputError(f"{path}: expected a USD stage, found {found}; export it again") from error


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn a failed save into an InputError of one line; the library does not report the cause."""
    from pxr import Tf  # pyright: ignore[reportAttributeAccessIssue]

    try:
        yield
    except Tf.ErrorException as error:
        raise InputError(
            f"{path}: expected a place with room for the file, found that it could not be saved; choose another output"
        ) from error
