"""Read clips of HDF5 files (.hdf5) in the layout of DFAUST's registrations: several clips of one topology in a file.

Each clip is a dataset (V, 3, T) called "subject_sequence"; `faces` (F, 3) belongs to all. Files have no frame rate: the
captures of DFAUST have 60 frames per second (Bogo, Romero, Pons-Moll and Black, Dynamic FAUST, CVPR 2017).
"""

from __future__ import annotations

import contextlib
import importlib.util
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ..core.budgets import check_clip_size
from ..core.errors import InputError, option
from ..core.frame_buffer import Progress, store_frames
from ..core.mesh import Clip, Mesh

DEFAULT_FPS = 60.0
"""Frames per second without `--fps`."""
FACES = "faces"
"""Name of the dataset of the triangles."""
BLOCK = 32
"""Frames read at once, or all that share a chunk: those of a dataset lie side by side in the file."""
LARGEST_RATIO = 2000
"""Largest ratio of a dataset's size to what it takes in the file; that of deflate is at most 1032."""
LARGEST_CHUNK = 1 << 28
"""Bytes up to which a compressed piece of a dataset is accepted, as it is unpacked whole, and that are read at once."""


def clip_lengths(path: Path) -> dict[str, int]:
    """List the clips of a file, in the order of their names, with the numbers of their frames.

    Raises:
        InputError: as `read_hdf5_clip`.
    """
    with _opened(path) as file:
        return {name: dataset.shape[2] for name, dataset in _clips(file, path).items()}


def read_hdf5_clip(
    path: Path, fps: float | None = None, progress: Progress | None = None, animation: str | None = None
) -> Clip:
    """Read one clip of a file; axes and unit are the file's.

    Args:
        fps: frame rate; 60 without.
        animation: name or number of the clip; may be left out if there is one.

    Raises:
        InputError: h5py is missing, the file is damaged or has another layout, or no such clip; the message lists all.
    """
    with _opened(path) as file:
        clips = _clips(file, path)
        name = _chosen(list(clips), animation, path)
        vertices, _, frames = clips[name].shape
        check_clip_size(frames, vertices, path)
        stored = store_frames(_frames(clips[name]), frames, vertices, np.float32, progress)
        faces = _faces(file, path)
    first = np.asarray(stored[0], np.float64) if frames else np.zeros((vertices, 3))
    return Clip(Mesh(first, faces, name), stored, fps or DEFAULT_FPS)


def _chosen(names: Sequence[str], animation: str | None, path: Path) -> str:
    """Return the name of the chosen clip, or of the only one."""
    if animation is not None:
        from .gltf.animation import find_animation

        return names[find_animation(names, animation, path)]
    if len(names) > 1:
        raise InputError(
            f"{path}: expected one of its {len(names)} clips, found none chosen; name one with "
            f"{option('animation', ...)}: " + ", ".join(names)
        )
    return names[0]


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file, and turn errors of the library into an InputError of one line."""
    if importlib.util.find_spec("h5py") is None:
        raise InputError(f"{path}: expected h5py to read HDF5, found it not installed; pip install 'mimesh[hdf5]'")
    import h5py

    try:
        with h5py.File(path, "r") as file:
            yield file
    except InputError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        if isinstance(error, PermissionError | FileNotFoundError):
            raise
        raise InputError(
            f"{path}: expected a sound HDF5 file, found '{' '.join(str(error).split())[:100]}'; "
            "copy or download it again"
        ) from error


def _clips(file: Any, path: Path) -> dict[str, Any]:
    """Find the datasets of clips; links to other files are not followed.

    Raises:
        InputError: there are none, or one claims more than its bytes can hold.
    """
    datasets = {name: file[name] for name in file if _is_own_dataset(file, name) and name != FACES}
    clips = {
        name: data
        for name, data in datasets.items()
        if data.ndim == 3 and data.shape[1] == 3 and data.dtype.kind == "f"
    }
    if not clips:
        found = ", ".join(f"{name} {data.shape}" for name, data in list(datasets.items())[:6]) or "none"
        raise InputError(
            f"{path}: expected datasets of shape (V, 3, T), as DFAUST's registrations have, found {found}; "
            "save the clips as .npz"
        )
    for name, data in clips.items():
        _check_stored(data, name, path)
    return clips


def _is_own_dataset(file: Any, name: str | bytes) -> bool:
    """Whether an entry is a dataset with a name that can be printed and values that lie in this file."""
    import h5py

    if not isinstance(name, str) or not name.isprintable():  # h5py gives a name that is no UTF-8 as bytes
        return False
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        return False
    entry = file[name]
    return isinstance(entry, h5py.Dataset) and not entry.is_virtual and not entry.external


def _check_stored(data: Any, name: str, path: Path) -> None:
    """Raise InputError for a dataset that claims far more than it stores, which would fill the disk with zeros."""
    if data.nbytes > LARGEST_RATIO * max(data.id.get_storage_size(), 1):
        raise InputError(
            f"{path}: expected the values of '{name}' in the file, found {data.id.get_storage_size()} bytes for "
            f"{data.shape}; copy or download it again"
        )
    chunk = math.prod(data.chunks or ()) * data.dtype.itemsize
    if chunk > LARGEST_CHUNK:
        raise InputError(
            f"{path}: expected chunks of at most {LARGEST_CHUNK >> 20} MiB in '{name}', found {chunk >> 20}; "
            "save it in smaller ones"
        )


def _frames(data: Any) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Yield the frames of a dataset (V, 3, T), so many at once that a chunk is unpacked once, unless they are large."""
    block, frame = BLOCK, data.shape[0] * 3 * data.dtype.itemsize
    if data.chunks is not None:
        block = max(BLOCK, min(data.chunks[2], LARGEST_CHUNK // max(frame, 1)))
    for t in range(0, data.shape[2], block):
        yield from np.moveaxis(data[:, :, t : t + block], 2, 0)


def _faces(file: Any, path: Path) -> Int[np.ndarray, "F 3"]:
    """Read the triangles."""
    if FACES not in file or not _is_own_dataset(file, FACES):
        raise InputError(f"{path}: expected a dataset '{FACES}' (F, 3), found none; save the clips with their faces")
    data = file[FACES]
    if data.ndim != 2 or data.shape[1] != 3 or data.dtype.kind not in "iu":
        raise InputError(
            f"{path}: expected '{FACES}' to be whole numbers of shape (F, 3), found {data.dtype} {data.shape}; "
            "save it in that shape"
        )
    _check_stored(data, FACES, path)
    return data[:].astype(np.int64)
