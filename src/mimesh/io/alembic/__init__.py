"""Read and write Alembic archives (.abc) with the library alembic3d (the extra `alembic`).

read     checks and reads an archive, in a child process
write    writes a new archive

The library cannot copy an archive with other points: an identity's own archive is written as a new one.
"""

from __future__ import annotations

from pathlib import Path

from ...core.frame_buffer import Progress
from ...core.mesh import Clip, Mesh
from ..guarded import guarded_clip, guarded_mesh
from .write import AlembicSource, need_library
from .write import write_alembic as write_alembic
from .write import write_alembic_clip as write_alembic_clip


def read_alembic(path: Path) -> Mesh:
    """Read all visible meshes of an archive as one mesh in world coordinates, in its first frame (`read.read_mesh`).

    Raises:
        InputError: alembic3d is missing; the archive is stored as HDF5, damaged, or without visible meshes.
    """
    need_library(path, "read")
    return guarded_mesh("mimesh.io.alembic.read:read_mesh", path, AlembicSource, path.stat().st_size)


def read_alembic_clip(path: Path, fps: float | None = None, progress: Progress | None = None) -> Clip:
    """Read all visible meshes of an archive as one clip: its samples, or `fps` frames a second (`read.read_clip`).

    Raises:
        InputError: as `read_alembic`, or the topology changes over time.
    """
    need_library(path, "read")
    reader, size = "mimesh.io.alembic.read:read_clip", path.stat().st_size
    return guarded_clip(reader, path, AlembicSource, size, fps, progress)
