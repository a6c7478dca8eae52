"""Read and write USD (.usd, .usda, .usdc, .usdz) with the library usd-core (the extra `usd`).

read      opens files of others, as a Mesh or frame by frame, in a child process
source    what a new file takes over: polygons, axis, unit
write     writes a new file for any Mesh or Clip

The library is imported only in the child, and when a new file is written.
"""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

from ...core.errors import InputError, NotInstalledError
from ...core.frame_buffer import Progress
from ...core.mesh import Clip, Mesh
from ..atomic import whole_file
from ..child_process import USE_PREAD
from ..guarded import guarded_clip, guarded_mesh
from .source import UsdSource, layer_bytes


def read_usd(path: Path) -> Mesh:
    """Read all visible meshes of a stage as one mesh in world coordinates, at the default time (see `read.read_mesh`).

    Raises:
        InputError: usd-core is not installed, the file is damaged, or it shows no meshes.
    """
    need_library(path, "read")
    return guarded_mesh("mimesh.io.usd.read:read_mesh", path, UsdSource, layer_bytes(path))


def read_usd_clip(path: Path, fps: float | None = None, progress: Progress | None = None) -> Clip:
    """Read all visible meshes of a stage as one clip: a frame per time code, or `fps` a second (see `read.read_clip`).

    Raises:
        InputError: as `read_usd`, or faces that change over time.
    """
    need_library(path, "read")
    reader = "mimesh.io.usd.read:read_clip"
    return guarded_clip(reader, path, UsdSource, layer_bytes(path), fps, progress)


def write_usd(mesh: Mesh, path: Path) -> None:
    """Write a mesh as a new USD file (see `write.write_new`)."""
    write_usd_clip(Clip.still(mesh), path)


def write_usd_clip(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write a clip as a new USD file in which time code k is frame k (see `write.write_new`)."""
    need_library(path, "write")
    from pxr import Tf  # pyright: ignore[reportAttributeAccessIssue]

    from .write import write_new

    with whole_file(path) as temporary:
        try:
            write_new(clip, temporary, path, progress)
        except Tf.ErrorException as error:  # it does not say why
            raise InputError(
                f"{path}: expected a place with room for the file, found that it could not be saved; choose another "
                "output"
            ) from error


TO_Y_UP = {"+y": ("x", 0.0), "+z": ("x", -90.0), "-y": ("x", 180.0), "-z": ("x", 90.0), "+x": ("z", 90.0)}
TO_Y_UP["-x"] = ("z", -90.0)
"""Up axis -> rotation that takes it to +y: its axis, and its angle in degrees."""


def stage_axes(mesh: Mesh) -> tuple[tuple[str, float], float]:
    """Return the rotation that makes a mesh y up (see TO_Y_UP), and the unit of its file in metres.

    Up is what the mesh says, or the file; nothing known is y up. Only USD sources know their unit.
    """
    up = mesh.up or f"+{getattr(mesh.source, 'up_axis', 'Y').lower()}"
    return TO_Y_UP[up], getattr(mesh.source, "meters_per_unit", 1.0)


def need_library(path: Path, verb: str) -> None:
    """Raise NotInstalledError where usd-core is not installed; `verb` is "read" or "write"."""
    os.environ.setdefault(*USE_PREAD)
    if importlib.util.find_spec("pxr") is None:
        raise NotInstalledError(
            f"{path}: expected usd-core to {verb} USD, found it not installed; pip install 'mimesh[usd]'"
        )
