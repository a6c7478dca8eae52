"""Read the meshes and clips that the public functions are given, or check those in memory."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from ..core.arguments import described
from ..core.errors import InputError, OtherTopologyError
from ..core.frame_buffer import Progress
from ..core.mesh import UNNAMED, Clip, Mesh, check_clip, check_mesh, cut_clip
from ..core.options import FrameRange
from ..io import load_driving, load_mesh

if TYPE_CHECKING:
    from .scans import Told


def read_mesh(mesh: Mesh | str | Path, role: str) -> Mesh:
    """Read a mesh, or check one in memory; see `_named`."""
    if isinstance(mesh, Mesh):
        # A result is saved later: what the caller does with the array until then must not change it.
        mesh = _named(mesh.with_vertices(mesh.vertices.copy()), role)
        return check_mesh(mesh, mesh.name)
    return load_mesh(Path(mesh))


def _named(mesh: Mesh, role: str) -> Mesh:
    """Name a mesh of arrays that has no name by what it is for, in messages and in files that are written."""
    return dataclasses.replace(mesh, name=role) if mesh.name == UNNAMED and mesh.source is None else mesh


def read_clip(clip: Clip | str | Path, fps: float | None, animation: str | int | None, role: str = "driving") -> Clip:
    """Read a clip, or check one in memory; see `_named`."""
    if isinstance(clip, Clip):
        clip = dataclasses.replace(clip, mesh=_named(clip.mesh, role))
        if animation is not None:
            raise InputError(
                f"animation: expected the path of a file with it, found {described(clip)}; give the path, or the "
                "animation to load_clip"
            )
        return check_clip(clip if fps is None else dataclasses.replace(clip, fps=fps), clip.mesh.name)
    return load_driving(Path(clip), fps=fps, animation=animation)


def read_frames(
    clip: Clip | str | Path,
    frames: FrameRange,
    animation: str | int | None,
    whole: bool,
    told: Told,
    role: str = "driving",
) -> tuple[Clip, Clip]:
    """Read some frames of a clip; returns these, and the clip that they are of: the whole one if it is asked for."""
    if not whole and not isinstance(clip, Clip):
        taken = load_moving(Path(clip), frames.slice, told, frames.fps, animation)
        return taken, taken
    if isinstance(clip, Clip):
        read = read_clip(clip, frames.fps, animation, role)
    else:
        read = load_moving(Path(clip), slice(None), told, frames.fps, animation)
    return cut_clip(read, frames.start, frames.stop, frames.step), read


def load_moving(
    path: Path,
    frames: slice,
    told: Told,
    fps: float | None = None,
    animation: str | int | None = None,
    progress: Progress | None = None,
    scans: slice | None = None,
) -> Clip:
    """Read frames of a clip as `load_driving` does; meshes of different topologies are scans (`scans`).

    Args:
        scans: those to take of scans; None: `frames`.
    """
    try:
        return load_driving(path, fps=fps, animation=animation, progress=progress, frames=frames)
    except OtherTopologyError:
        from .scans import scanned_clip

        return scanned_clip(path, frames if scans is None else scans, told, fps, progress)
