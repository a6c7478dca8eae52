"""Frames of a clip that need no memory: long clips lie in a temporary file, which the system pages in and out."""

from __future__ import annotations

import mmap
import tempfile

import numpy as np
from jaxtyping import Float

LARGE = 64 * 2**20
"""Bytes from which on frames lie on disk."""

PAGED = 32
"""Frames that are worked on between two calls of `let_go`."""


def new_frames(count: int, vertices: int, dtype: type[np.floating] | np.dtype) -> Float[np.ndarray, "T V 3"]:
    """An array for so many frames, in memory or, for a long clip, in a file that is gone when the array is."""
    shape = (count, vertices, 3)
    if count * vertices * 3 * np.dtype(dtype).itemsize < LARGE:
        return np.empty(shape, dtype)
    with tempfile.TemporaryFile() as file:
        return np.memmap(file, dtype, "w+", shape=shape)


def let_go(frames: Float[np.ndarray, "T V 3"]) -> None:
    """Give back the memory that pages of such a file have taken; the values stay."""
    pages = getattr(frames, "_mmap", None)
    if pages is not None and hasattr(pages, "madvise"):
        pages.madvise(mmap.MADV_DONTNEED)
