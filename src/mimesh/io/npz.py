"""NumPy archives: a mesh (vertices, faces) or a clip (vertices of every frame, faces, fps). Never unpickles."""

from __future__ import annotations

import io
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int

from ..mesh import Clip, InputError, Mesh
from ..paging import Progress
from .atomic import whole_file
from .polygons import fan_corners

_VERTICES = ("vertices", "v", "verts", "points")
_FACES = ("faces", "f", "triangles")
# What opening a damaged, encrypted or pickled archive raises, as NumPy and zipfile have it.
_DAMAGE = (ValueError, TypeError, OSError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True, eq=False)
class NpzSource:
    """An archive kept whole, and which of its arrays holds the points. Satisfies `mesh.Source`."""

    data: bytes
    key: str
    points: np.ndarray
    """The points as stored: shape and type are kept."""
    suffix = ".npz"

    def write(self, mesh: Mesh, path: Path) -> None:
        """Write the archive with the points replaced; every other entry is copied unopened."""
        if len(mesh.vertices) != self.points.shape[-2]:
            raise ValueError(f"the file has {self.points.shape[-2]} vertices, the mesh {len(mesh.vertices)}")
        points = io.BytesIO()
        np.save(points, mesh.vertices.reshape(self.points.shape).astype(self.points.dtype), allow_pickle=False)
        with zipfile.ZipFile(io.BytesIO(self.data)) as old, zipfile.ZipFile(path, "w") as new:
            for entry in old.infolist():
                is_points = entry.filename == f"{self.key}.npy"
                new.writestr(entry, points.getvalue() if is_points else old.read(entry))


def read_npz(path: Path) -> Mesh:
    """Read one mesh from an archive: `vertices` (V, 3) and, for a surface, `faces` (F, 3) or (F, 4), from 0.

    The arrays may also be called v, verts or points, and f or triangles. One frame (1, V, 3) is a mesh too.

    Raises:
        InputError: no such arrays, wrong shapes or types, several frames, or a damaged archive.
    """
    data = path.read_bytes()
    key, points, faces, _ = _read_arrays(data, path)
    if points.ndim == 3 and len(points) != 1:
        raise InputError(
            f"{path}: expected one mesh, found a clip of {len(points)} frames; "
            "give it as the driving clip or save one frame"
        )
    vertices = points.reshape(points.shape[-2:]).astype(np.float64)
    return Mesh(vertices, faces, name=path.stem, source=NpzSource(data, key, points))


def read_npz_clip(path: Path, fps: float | None, progress: Progress | None = None) -> Clip:
    """Read a clip from an archive: `vertices` (T, V, 3), `faces` and `fps`; a mesh is a clip of one frame.

    `fps` overrides the file's frame rate; without either it is 30 per second.

    Raises:
        InputError: as `read_npz`.
    """
    _, points, faces, own_fps = _read_arrays(path.read_bytes(), path)
    frames = points.reshape(-1, *points.shape[-2:])
    frames = frames if frames.dtype.kind == "f" else frames.astype(np.float64)
    first = frames[0] if len(frames) else np.zeros(frames.shape[1:])
    mesh = Mesh(first.astype(np.float64), faces, name=path.stem)
    return Clip(mesh, frames, float(fps if fps is not None else own_fps))


def write_npz(mesh: Mesh, path: Path) -> None:
    """Write a mesh as an archive of `vertices` and `faces`; looks are not written."""
    with whole_file(path) as temporary:
        np.savez_compressed(temporary, vertices=mesh.vertices, faces=mesh.faces)


def write_npz_clip(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write a clip as an archive of `vertices` (T, V, 3), `faces` and `fps`."""
    with whole_file(path) as temporary:
        np.savez_compressed(temporary, vertices=clip.vertices, faces=clip.mesh.faces, fps=clip.fps)


def _read_arrays(data: bytes, path: Path) -> tuple[str, np.ndarray, Int[np.ndarray, "F 3"], float]:
    """Key and array of the points, triangles, and frame rate (30 if the archive has none)."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:  # np.load takes anything else for a pickle and says so
            if broken := archive.testzip():
                raise zipfile.BadZipFile(f"bad checksum of {broken!r}")
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            key = _find(_VERTICES, arrays.files, path)
            points = arrays[key]
            faces_key = next((name for name in _FACES if name in arrays.files), None)
            faces = np.zeros((0, 3), np.int64) if faces_key is None else arrays[faces_key]
            fps = float(arrays["fps"]) if "fps" in arrays.files else 30.0
    except InputError:
        raise
    except _DAMAGE as error:
        raise InputError(
            f"{path}: expected a NumPy archive of plain arrays, found {error!r:.80}; save it again"
        ) from error
    if points.ndim not in (2, 3) or points.shape[-1] != 3 or points.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: expected '{key}' to be numbers of shape (V, 3) or (T, V, 3), "
            f"found {points.dtype} {points.shape}; save it in that shape"
        )
    return key, points, _triangles(faces, path), fps


def _find(names: tuple[str, ...], found: list[str], path: Path) -> str:
    for name in names:
        if name in found:
            return name
    raise InputError(
        f"{path}: expected an array called {', '.join(names)}, found {', '.join(map(repr, found)) or 'none'}; "
        "save it under one of these names"
    )


def _triangles(faces: np.ndarray, path: Path) -> Int[np.ndarray, "F 3"]:
    if faces.size == 0:
        return np.zeros((0, 3), np.int64)
    if faces.ndim != 2 or faces.shape[1] < 3 or faces.dtype.kind not in "iu":
        raise InputError(
            f"{path}: expected faces to be whole numbers of shape (F, 3), found {faces.dtype} {faces.shape}; "
            "save it in that shape"
        )
    triangles, _ = fan_corners(np.full(len(faces), faces.shape[1]))
    return faces.astype(np.int64).reshape(-1)[triangles]
