"""Read and write PC2 point caches (.pc2): a header of 32 bytes, then all frames as little-endian float32.

Faces come from a mesh file of the same name beside the cache, walk.obj for walk.pc2; without one the clip is a moving
point cloud. The format has no frame rate: its samples are a number of frames apart, and frames are taken to last
1 / DEFAULT_FPS seconds.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ..core.budgets import check_clip_size
from ..core.errors import InputError, damaged
from ..core.frame_buffer import Progress, each_frame, store_frames
from ..core.mesh import Clip, Mesh
from .atomic import whole_file
from .timing import DEFAULT_FPS

_HEADER = struct.Struct("<12siiffi")
"""Signature, version, point count, start frame, frames per sample, sample count."""
_SIGNATURE = b"POINTCACHE2\0"


def read_cache(
    path: Path,
    fps: float | None,
    suffixes: Sequence[str],
    read: Callable[[Path], Mesh],
    progress: Progress | None = None,
) -> Clip:
    """Read a .pc2 file as a clip of the mesh beside it, or as a moving point cloud.

    Args:
        fps: samples per second; None: 30 over the frames from one sample to the next, which are 1 in most files.
        suffixes: formats of meshes that `read` reads, likeliest first.

    Raises:
        InputError: the file is damaged or truncated, or the mesh beside it has another number of vertices.
    """
    frames, step = _mapped_frames(path)
    fps = fps or DEFAULT_FPS / step
    count, vertices = frames.shape[:2]
    mesh = _mesh_beside(path, vertices, suffixes, read)
    stored = store_frames(each_frame(frames), count, vertices, np.float32, progress)
    first = stored[0].astype(np.float64)
    if mesh is None:
        return Clip(Mesh(first, np.zeros((0, 3), np.int64), name=path.stem), stored, fps)
    # The points may have been written with other axes than those of the mesh file.
    return Clip(dataclasses.replace(mesh.with_vertices(first), up=None), stored, fps)


def write_pc2(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write the points of a clip, one sample per frame from frame 0 on."""
    count, vertices = clip.vertices.shape[:2]
    with whole_file(path) as temporary, temporary.open("wb") as file:
        file.write(_HEADER.pack(_SIGNATURE, 1, vertices, 0.0, 1.0, count))
        for points in each_frame(clip.vertices, progress):
            file.write(points.astype("<f4").tobytes())


def _mapped_frames(path: Path) -> tuple[Float[np.ndarray, "T V 3"], float]:
    """Map the samples of a file into memory; returns them, and how many frames they are apart.

    Raises:
        InputError: the header is wrong or promises more than there is.
    """
    with path.open("rb") as file:
        start = file.read(_HEADER.size)
    signature, version, points, _, step, count = _HEADER.unpack(start.ljust(_HEADER.size, b"\0"))
    if signature != _SIGNATURE or version != 1:
        raise InputError(
            f"{path}: expected a PC2 file ('POINTCACHE2', version 1), found {signature[:11]!r} {version}; "
            "export it again"
        )
    if not step > 0:
        raise InputError(f"{path}: expected a positive sample rate, found {step:g}; export it again")
    size, needed = path.stat().st_size, _HEADER.size + 12 * max(count, 0) * max(points, 0)
    if count < 0 or points < 0 or size < needed:
        raise damaged(path, f"{needed} bytes for {count} frames of {points} points", size)
    if not count or not points:
        raise InputError(
            f"{path}: expected at least one frame with points, found {count} frames of {points}; export it again"
        )
    check_clip_size(count, points, path)
    return np.memmap(path, "<f4", "r", _HEADER.size, (count, points, 3)), step


def _mesh_beside(path: Path, vertices: int, suffixes: Sequence[str], read: Callable[[Path], Mesh]) -> Mesh | None:
    """Find and read the mesh of the same name and vertex count in the folder of a cache; None without such a name."""
    mismatches = []
    for suffix in suffixes:
        for file in sorted(path.parent.glob("*")):
            if file.stem == path.stem and file.suffix.lower() == suffix:
                mesh = read(file)
                if len(mesh.vertices) == vertices:
                    return mesh
                mismatches.append((file.name, len(mesh.vertices)))
    if mismatches:
        name, count = mismatches[0]
        raise InputError(
            f"{path}: expected as many points as {name} has vertices, {count}, found {vertices}; "
            "put the mesh it was made from beside it, or rename one of them"
        )
    return None
