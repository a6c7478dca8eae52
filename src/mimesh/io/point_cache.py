"""Read and write point caches, files of the vertex positions of every frame: PC2, MDD and NumPy arrays (.npy).

Faces come from a mesh file of the same name beside the cache, walk.obj for walk.pc2; without one the clip is a moving
point cloud. PC2: a header of 32 bytes, then little-endian float32. MDD: two counts, a time in seconds per frame, then
the positions, all big-endian, float32. NPY: one array (T, V, 3), or (V, 3) for a mesh. PC2 and NPY have no frame rate.
"""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO, Literal

import numpy as np
from jaxtyping import Float

from ..core.budgets import check_clip_size
from ..core.errors import InputError
from ..core.frame_buffer import Progress, each_frame, store_frames
from ..core.mesh import Clip, Mesh
from ..core.npz_archive import DAMAGE, check_array_size, read_array_header
from .atomic import whole_file
from .timing import DEFAULT_FPS, frame_count, sample_rate, surrounding_samples

_PC2 = struct.Struct("<12siiffi")
"""PC2 header: signature, version, point count, start frame, frames per sample, sample count."""
_PC2_SIGNATURE = b"POINTCACHE2\0"
ARCHIVE = b"PK\3\4"
"""First bytes of a .npz archive."""


PointCache = tuple[Float[np.ndarray, "T V 3"], Float[np.ndarray, " T"] | None]
"""The frames of a point cache, mapped from the file, and their times in seconds; None where the format has no times."""


def read_cache(
    path: Path,
    fps: float | None,
    suffixes: Sequence[str],
    read: Callable[[Path], Mesh],
    progress: Progress | None = None,
) -> Clip:
    """Read a .pc2, .mdd or .npy file as a clip of the mesh beside it, or as a moving point cloud.

    Args:
        fps: frames per second. An MDD file has times: it is resampled at this rate, linearly between its frames. The
            others are played at it, and at 30 without it.
        suffixes: formats of meshes that `read` reads, likeliest first.
        read: reads the mesh file beside the cache.

    Raises:
        InputError: the file is damaged or truncated, or the mesh beside it has another number of vertices.
    """
    stored_frames, times = {".pc2": _open_pc2, ".mdd": _open_mdd, ".npy": _open_npy}[path.suffix.lower()](path)
    count, vertices = stored_frames.shape[:2]
    mesh = _mesh_beside(path, vertices, suffixes, read)
    dtype = stored_frames.dtype.newbyteorder("=")
    # Without times, or without a wanted rate, the stored frames are the clip's frames.
    if times is None or fps is None:
        frames, fps = each_frame(stored_frames), fps or (None if times is None else sample_rate(times)) or DEFAULT_FPS
    else:
        count = frame_count(float(times[-1] - times[0]), fps)
        check_clip_size(count, vertices, path)
        frames = _resample(stored_frames, times, times[0] + np.arange(count) / fps)
    stored = store_frames(frames, count, vertices, dtype, progress)
    first = stored[0].astype(np.float64)
    if mesh is None:
        return Clip(Mesh(first, np.zeros((0, 3), np.int64), name=path.stem), stored, fps)
    # The points may have been written with other axes than those of the mesh file.
    return Clip(dataclasses.replace(mesh.with_vertices(first), up=None), stored, fps)


def write_pc2(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write the points of a clip as PC2, one sample per frame from frame 0 on; the format has no frame rate."""
    count, vertices = clip.vertices.shape[:2]
    with whole_file(path) as temporary, temporary.open("wb") as file:
        file.write(_PC2.pack(_PC2_SIGNATURE, 1, vertices, 0.0, 1.0, count))
        _write_points(file, each_frame(clip.vertices, progress), "<f4")


def write_mdd(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write the points of a clip as MDD; frame k is at k / fps seconds."""
    count, vertices = clip.vertices.shape[:2]
    with whole_file(path) as temporary, temporary.open("wb") as file:
        file.write(struct.pack(">ii", count, vertices))
        file.write((np.arange(count) / clip.fps).astype(">f4").tobytes())
        _write_points(file, each_frame(clip.vertices, progress), ">f4")


def write_npy(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write the points of a clip as one NumPy array (T, V, 3) in the clip's own number type."""
    dtype = clip.vertices.dtype.newbyteorder("<")
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": clip.vertices.shape}
    with whole_file(path) as temporary, temporary.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        _write_points(file, each_frame(clip.vertices, progress), dtype)


def _write_points(file: BinaryIO, frames: Iterable[Float[np.ndarray, "V 3"]], dtype: str | np.dtype) -> None:
    for points in frames:
        file.write(points.astype(dtype).tobytes())


def _resample(
    frames: Float[np.ndarray, "T V 3"], times: Float[np.ndarray, " T"], wanted: Float[np.ndarray, " K"]
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield the points at each of the wanted times, interpolated linearly."""
    for before, after, weight in zip(*surrounding_samples(times, wanted), strict=True):
        a, b = (frames[t].astype(np.float64) for t in (before, after))
        yield a + weight * (b - a)


def _open_pc2(path: Path) -> PointCache:
    start = _read_start(path, _PC2.size)
    signature, version, points, _, step, count = _PC2.unpack(start.ljust(_PC2.size, b"\0"))
    if signature != _PC2_SIGNATURE or version != 1:
        raise InputError(
            f"{path}: expected a PC2 file ('POINTCACHE2', version 1), found {signature[:11]!r} {version}; "
            "export it again"
        )
    if not step > 0:
        raise InputError(f"{path}: expected a positive sample rate, found {step:g}; export it again")
    return (_map_frames(path, "<f4", _PC2.size, count, points), None)


def _open_mdd(path: Path) -> PointCache:
    count, points = struct.unpack(">ii", _read_start(path, 8).ljust(8, b"\0"))
    frames = _map_frames(path, ">f4", 8 + 4 * max(count, 0), count, points)
    times = np.fromfile(path, ">f4", max(count, 0), offset=8).astype(np.float64)
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise InputError(
            f"{path}: expected times that rise, found others; the file is damaged or no MDD, export it again"
        )
    return (frames, times)


def _open_npy(path: Path) -> PointCache:
    if _read_start(path, 4) == ARCHIVE:
        raise InputError(f"{path}: expected an array (T, V, 3) or (V, 3), found an archive; name it .npz")
    try:
        with path.open("rb") as file:
            header = read_array_header(file)
        check_array_size(header, path.stat().st_size)
    except DAMAGE as error:
        raise InputError(f"{path}: expected a plain NumPy array, found {error!r:.80}; save it again") from error
    shape, dtype = header.shape, header.dtype
    if len(shape) not in (2, 3) or shape[-1] != 3:
        raise InputError(f"{path}: expected an array (T, V, 3) or (V, 3), found {dtype} {shape}; save it in that shape")
    if dtype.kind != "f":
        raise InputError(f"{path}: expected floating-point numbers, found {dtype}; save it as float32")
    order = "F" if header.fortran else "C"
    frames = _mapped(path, dtype, header.size, (math.prod(shape[:-2]), shape[-2], 3), order)
    return (frames, None)


def _read_start(path: Path, size: int) -> bytes:
    with path.open("rb") as file:
        return file.read(size)


def _map_frames(path: Path, dtype: str, offset: int, count: int, points: int) -> Float[np.ndarray, "T V 3"]:
    """Map the frames of a file into memory; raises InputError where it is too short for the counts of its header."""
    size, needed = path.stat().st_size, offset + 12 * max(count, 0) * max(points, 0)
    if count < 0 or points < 0 or size < needed:
        raise InputError(
            f"{path}: expected {needed} bytes for {count} frames of {points} points, found {size}; "
            "the file is cut short or of another format, export it again"
        )
    return _mapped(path, np.dtype(dtype), offset, (count, points, 3))


def _mapped(
    path: Path, dtype: np.dtype, offset: int, shape: tuple[int, int, int], order: Literal["C", "F"] = "C"
) -> Float[np.ndarray, "T V 3"]:
    """Map the numbers of a file, which must be there, into memory; raises InputError for empty or too many frames."""
    count, points, _ = shape
    if not count or not points:
        raise InputError(
            f"{path}: expected at least one frame with points, found {count} frames of {points}; export it again"
        )
    check_clip_size(count, points, path)
    return np.memmap(path, dtype, "r", offset, shape, order)


def _mesh_beside(path: Path, vertices: int, suffixes: Sequence[str], read: Callable[[Path], Mesh]) -> Mesh | None:
    """Find and read the mesh of the same name and vertex count in the folder of a cache; None without such a name.

    Raises:
        InputError: there are meshes of that name, but all have another number of vertices.
    """
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
