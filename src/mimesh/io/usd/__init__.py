"""USD in and out (.usd, .usda, .usdc, .usdz), by the library usd-core (the extra `usd`).

usd_stage -> usd_skin, usd_looks -> usd_read      a stage becomes a Mesh or a Clip
             usd_source                           its file, written back with the points moved
             usd_write, usd_material              a file for a Mesh or Clip from elsewhere
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
    """All meshes that a stage shows, joined, in world coordinates, at the default time (see `usd_read.read_mesh`).

    Raises:
        InputError: usd-core is not installed, the file is damaged, or it shows no meshes.
    """
    _need_library(path, "read")
    from .read import read_mesh

    with _reading(path):
        return read_mesh(path)


def read_usd_clip(path: Path, fps: float | None = None, progress: Progress | None = None) -> Clip:
    """The same in motion: one frame a time code, or sampled at `fps` (see `usd_read.read_clip`).

    Raises:
        InputError: as `read_usd`, or faces that change over time.
    """
    _need_library(path, "read")
    from .read import read_clip

    with _reading(path):
        return read_clip(path, fps, progress)


def write_usd(mesh: Mesh, path: Path) -> None:
    """Write a mesh as USD: the file it came from, points moved, if that was USD; else a new one (see `usd_write`)."""
    _need_library(path, "write")
    from .source import UsdSource
    from .write import write_new

    with whole_file(path) as temporary, _writing(path):
        if isinstance(mesh.source, UsdSource):
            mesh.source.write(mesh, temporary)
        else:
            write_new(Clip.still(mesh), temporary, path)


def write_usd_clip(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write a clip as a new USD file, time code k is frame k (see `usd_write`)."""
    _need_library(path, "write")
    from .write import write_new

    with whole_file(path) as temporary, _writing(path):
        write_new(clip, temporary, path, progress)


def stage_axes(mesh: Mesh) -> tuple[bool, float]:
    """Whether z is up where a mesh comes from, and its unit in metres, if that was a stage; else y is, and a metre."""
    return getattr(mesh.source, "up_axis", "Y") == "Z", getattr(mesh.source, "meters_per_unit", 1.0)


def _need_library(path: Path, verb: str) -> None:
    # Else the library maps files, and what has been read of a long clip stays in memory.
    os.environ.setdefault("USDC_USE_PREAD", "1")
    if importlib.util.find_spec("pxr") is None:
        raise InputError(f"{path}: expected usd-core to {verb} USD, found it not installed; pip install 'mimesh[usd]'")


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Say in one line what the library cannot read: values are read when they are wanted, so it may say so late."""
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
    """Say in one line that the library could not save; it does not say why."""
    from pxr import Tf  # pyright: ignore[reportAttributeAccessIssue]

    try:
        yield
    except Tf.ErrorException as error:
        raise InputError(
            f"{path}: expected a place with room for the file, found that it could not be saved; choose another output"
        ) from error
