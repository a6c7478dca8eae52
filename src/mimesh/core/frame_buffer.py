"""Frames of a clip that need no memory: long clips lie in a temporary file, which the system pages in and out."""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

import numpy as np
from jaxtyping import Float

T = TypeVar("T")
LARGE = 64 * 2**20
"""Bytes from which on frames lie on disk."""

PAGED = 32
"""Frames that are worked on between two calls of `release_pages`."""

Progress = Callable[[int, int], None]
"""Called as frames get done with (frames done, frames in all)."""


def allocate_frames(count: int, vertices: int, dtype: type[np.floating] | np.dtype) -> Float[np.ndarray, "T V 3"]:
    """An array for so many frames, in memory or, for a long clip, in a file that is gone when the array is.

    Raises:
        InputError: the temporary folder has no room for them.
    """
    shape = (count, vertices, 3)
    if count * vertices * 3 * np.dtype(dtype).itemsize < LARGE:
        return np.empty(shape, dtype)
    with tempfile.TemporaryFile() as file:
        _reserve(file.fileno(), count * vertices * 3 * np.dtype(dtype).itemsize)
        return np.memmap(file, dtype, "w+", shape=shape)


def _reserve(descriptor: int, size: int) -> None:
    """Take the room now: a page that finds none later kills the process."""
    from .errors import InputError

    if not hasattr(os, "posix_fallocate"):
        return
    try:
        os.posix_fallocate(descriptor, 0, size)
    except OSError as error:
        raise InputError(
            f"{tempfile.gettempdir()}: expected room for {size / 2**20:,.0f} MiB of frames, found '{error.strerror}'; "
            "free some, take fewer frames, or set TMPDIR to another folder"
        ) from error


def release_pages(frames: Float[np.ndarray, "T V 3"]) -> None:
    """Give back the memory that pages of such a file have taken; the values stay."""
    pages = getattr(frames, "_mmap", None)
    if pages is not None and hasattr(pages, "madvise"):
        pages.madvise(mmap.MADV_DONTNEED)


def store_frames(
    frames: Iterable[Float[np.ndarray, "V 3"]],
    count: int,
    vertices: int,
    dtype: type[np.floating] | np.dtype = np.float64,
    progress: Progress | None = None,
) -> Float[np.ndarray, "T V 3"]:
    """Take in `count` frames of so many vertices, one by one, into `allocate_frames`."""
    kept = allocate_frames(count, vertices, dtype)
    done = 0
    for points in frames:
        kept[done] = points
        done += 1
        if done % PAGED == 0:
            release_pages(kept)
        if progress is not None:
            progress(done, count)
    assert done == count, f"{done} frames came, {count} were said to"
    return kept


def each_frame(
    vertices: Float[np.ndarray, "T V 3"], progress: Progress | None = None
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """The frames of a clip one by one in double precision, without keeping what was read."""
    for t, points in enumerate(vertices):
        yield np.asarray(points, np.float64)
        if t % PAGED == 0:
            release_pages(vertices)
        if progress is not None:
            progress(t + 1, len(vertices))


def counted(items: Iterable[T], count: int, progress: Progress | None) -> Iterator[T]:
    """The items, each told to `progress` once it has been taken care of."""
    for done, item in enumerate(items, 1):
        yield item
        if progress is not None:
            progress(done, count)
