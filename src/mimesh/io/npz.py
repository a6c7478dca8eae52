"""Read and write NumPy archives (.npz) of a mesh (vertices, faces) or a clip (vertices of all frames, faces, fps).

Pickled objects are never loaded.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from ..core.budgets import CORNERS, FACES, VERTICES, check_clip_size
from ..core.errors import InputError
from ..core.frame_buffer import Progress, each_frame, store_frames
from ..core.mesh import Clip, Mesh
from ..core.npz_archive import (
    POINTS,
    SEEN_POINTS,
    check_array_size,
    open_archive,
    rate_of,
    read_array,
    read_array_header,
)
from .atomic import whole_file
from .polygons import fan_corners
from .timing import DEFAULT_FPS

_FACES = ("faces", "f", "triangles")
"""Names of the array of faces, likeliest first."""
_CAMERA_OFFSET = "pred_cam_t"
"""Name of what is added to SEEN_POINTS, (3,) or (T, 3), for their positions in the axes of the camera: y down."""
_COMPRESSION_LEVEL = 1
"""zlib level, 1 to 9: higher ones take five times as long and save next to nothing on floating-point numbers."""


def read_npz(path: Path) -> Mesh:
    """Read one mesh from an archive: `vertices` (V, 3) and, for a surface, `faces` (F, 3) or (F, 4), from 0.

    The arrays may also be called v, verts, points or pred_vertices (see SEEN_POINTS), and f or triangles. One frame
    (1, V, 3) is a mesh too.

    Raises:
        InputError: no such arrays, wrong shapes or types, several frames, or the archive is damaged.
    """
    with path.open("rb") as file, open_archive(file, path) as (archive, names):
        if broken := archive.testzip():
            raise zipfile.BadZipFile(f"bad checksum of {broken!r}")
        key, faces = _find(POINTS, names, path), _read_faces(archive, names, path)
        points = read_array(archive, key)
        _check_points(key, points.dtype, points.shape, path)
        offset = _read_offset(archive, names, key, points.shape, path)
    VERTICES.check(points.shape[-2], path)
    if points.ndim == 3 and len(points) != 1:
        raise InputError(
            f"{path}: expected one mesh, found a clip of {len(points)} frames; "
            "give it as the driving clip or save one frame"
        )
    vertices = (points.astype(np.float64) + offset).reshape(points.shape[-2:])
    return Mesh(vertices, faces, name=path.stem, up=_up(key))


def read_npz_clip(path: Path, fps: float | None, progress: Progress | None = None) -> Clip:
    """Read a clip from an archive: `vertices` (T, V, 3), `faces` and `fps`; a mesh is a clip of one frame.

    `fps` overrides the file's frame rate; without either it is 30 per second. Frames are read one by one.
    """
    with path.open("rb") as file, open_archive(file, path) as (archive, names):
        key, faces = _find(POINTS, names, path), _read_faces(archive, names, path)
        if fps is None:
            fps = rate_of(read_array(archive, "fps"), "fps", path) if "fps" in names else DEFAULT_FPS
        with archive.open(f"{key}.npy") as member:
            header = read_array_header(member)
            shape, dtype = header.shape, header.dtype
            _check_points(key, dtype, shape, path)
            check_array_size(header, archive.getinfo(f"{key}.npy").file_size)
            count, vertices = math.prod(shape[:-2]), shape[-2]
            check_clip_size(count, vertices, path)
            offset = _read_offset(archive, names, key, shape, path)
            # In Fortran order the numbers of one frame are spread over the whole array, so it is read at once.
            if header.fortran:
                frames = each_frame(read_array(archive, key).reshape(count, vertices, 3))
            else:
                frames = _read_frames(member.read, count, vertices, dtype)
            if offset.any():
                frames = (points + moved for points, moved in zip(frames, offset.reshape(count, 1, 3), strict=True))
            stored = store_frames(frames, count, vertices, dtype if dtype.kind == "f" else np.float64, progress)
    first = stored[0].astype(np.float64) if count else np.zeros((vertices, 3))
    return Clip(Mesh(first, faces, name=path.stem, up=_up(key)), stored, fps)


def write_npz(mesh: Mesh, path: Path) -> None:
    """Write a mesh as an archive of `vertices` and `faces`; materials and texture coordinates are omitted."""
    with whole_file(path) as temporary, temporary.open("wb") as file:  # to a name with .NPZ NumPy would add .npz
        np.savez_compressed(file, vertices=mesh.vertices, faces=mesh.faces)


def write_npz_clip(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write a clip as an archive of `vertices` (T, V, 3), `faces` and `fps`, frame by frame."""
    header = {"descr": clip.vertices.dtype.str, "fortran_order": False, "shape": clip.vertices.shape}
    with whole_file(path) as temporary:
        # NumPy can only write whole arrays: the small ones first, then the frames are appended to the archive.
        with temporary.open("wb") as file:
            np.savez_compressed(file, faces=clip.mesh.faces, fps=clip.fps)
        with (
            zipfile.ZipFile(temporary, "a", zipfile.ZIP_DEFLATED, compresslevel=_COMPRESSION_LEVEL) as archive,
            archive.open("vertices.npy", "w", force_zip64=True) as member,
        ):
            np.lib.format.write_array_header_1_0(member, header)
            for points in each_frame(clip.vertices, progress):
                member.write(points.astype(clip.vertices.dtype).tobytes())


def _read_frames(
    read: Callable[[int], bytes], count: int, vertices: int, dtype: np.dtype
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield frames from a stream of numbers in C order; ValueError where it ends too early."""
    size = vertices * 3 * dtype.itemsize
    for _ in range(count):
        data = read(size)
        if len(data) < size:
            raise ValueError(f"{count} frames of {vertices} points do not fit")
        yield np.frombuffer(data, dtype).reshape(vertices, 3).astype(np.float64)


def _read_faces(archive: zipfile.ZipFile, names: list[str], path: Path) -> Int[np.ndarray, "F 3"]:
    """Read the faces (F, 3), or others of equal corner counts as fans; empty where there is no array of faces."""
    key = next((name for name in _FACES if name in names), None)
    faces = np.zeros((0, 3), np.int64) if key is None else read_array(archive, key)
    if faces.size == 0:
        return np.zeros((0, 3), np.int64)
    if faces.ndim != 2 or faces.shape[1] < 3 or faces.dtype.kind not in "iu":
        raise InputError(
            f"{path}: expected faces to be whole numbers of shape (F, 3), found {faces.dtype} {faces.shape}; "
            "save it in that shape"
        )
    CORNERS.check(faces.shape[1], path)
    FACES.check(len(faces) * (faces.shape[1] - 2), path)
    triangles, _ = fan_corners(np.full(len(faces), faces.shape[1]))
    return faces.astype(np.int64).reshape(-1)[triangles]


def _up(key: str) -> str | None:
    """Return the up axis that the name of the points tells: images are upright, and y points down in them."""
    return "-y" if key == SEEN_POINTS else None


def _read_offset(
    archive: zipfile.ZipFile, names: list[str], key: str, shape: tuple[int, ...], path: Path
) -> Float[np.ndarray, "*T 1 3"]:
    """Read what is added to points of a shape (see `_CAMERA_OFFSET`); nothing to other points than SEEN_POINTS."""
    expected = (*shape[:-2], 3)
    if key != SEEN_POINTS:
        return np.zeros((1, 3))
    if not any(name in names for name in _FACES):
        raise InputError(
            f"{path}: expected faces beside '{key}', found none; save them, too: "
            "numpy.savez(file, **output, faces=estimator.faces)"
        )
    if _CAMERA_OFFSET not in names:
        return np.zeros((1, 3))
    offset = read_array(archive, _CAMERA_OFFSET)
    if offset.shape != expected or offset.dtype.kind != "f":
        raise InputError(
            f"{path}: expected '{_CAMERA_OFFSET}' to be numbers of shape {expected}, found {offset.dtype} "
            f"{offset.shape}; save one for each frame"
        )
    return offset[..., None, :].astype(np.float64)


def _check_points(key: str, dtype: np.dtype, shape: tuple[int, ...], path: Path) -> None:
    if len(shape) not in (2, 3) or shape[-1] != 3 or dtype.kind not in "fiu":
        raise InputError(
            f"{path}: expected '{key}' to be numbers of shape (V, 3) or (T, V, 3), "
            f"found {dtype} {shape}; save it in that shape"
        )


def _find(names: tuple[str, ...], found: list[str], path: Path) -> str:
    """Return the first of `names` that is among the arrays found; raises InputError where none is."""
    for name in names:
        if name in found:
            return name
    raise InputError(
        f"{path}: expected an array called {', '.join(names)}, found {', '.join(map(repr, found)) or 'none'}; "
        "save it under one of these names"
    )
