"""Read Alembic archives of others; runs in a child process (`child_process.child_result`).

The library ends the process at some damage, and raises any kind of exception at other.
"""

from __future__ import annotations

from pathlib import Path

from ...core.frame_buffer import Progress
from ...core.mesh import Mesh
from ..guarded import hand_over_clip, hand_over_mesh
from . import read
from .archive import reading
from .write import AlembicSource


def read_mesh(source: Path, target: Path, confined_to: str | None) -> None:
    """Read an archive as a mesh and hand it over (see `guarded.guarded_mesh`); it refers to no other files.

    Raises:
        InputError: the archive is stored as HDF5, damaged, or without visible meshes.
    """
    with reading(source):
        mesh = read.read_mesh(source)
    hand_over_mesh(target, mesh, _values(mesh))


def read_clip(source: Path, target: Path, confined_to: str | None, fps: float | None, progress: Progress) -> None:
    """Read an archive as a clip and hand it over (see `guarded.guarded_clip`).

    Raises:
        InputError: as `read_mesh`, or the topology changes over time.
    """
    with reading(source):
        stream = read.read_clip(source, fps)
        hand_over_clip(target, stream, _values(stream.mesh), progress)


def _values(mesh: Mesh) -> dict:
    assert isinstance(mesh.source, AlembicSource)
    return mesh.source.values()
