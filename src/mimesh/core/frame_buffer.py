"""Buffers for the frames of a clip. Those of long clips are memory maps of a temporary file, to bound the memory."""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
from jaxtyping import Float, Int
from numpy.lib.mixins import NDArrayOperatorsMixin

from .errors import InputError
from .skinning import SkinnedMesh

T = TypeVar("T")
LARGE = 64 * 2**20
"""Bytes from which on a buffer is a file on disk."""

PAGED = 32
"""Frames processed between two calls of `release_pages`."""

Progress = Callable[[int, int], None]
"""Callback for progress, called with (frames done, frames in all)."""


@dataclass(frozen=True, eq=False)
class PosedFrames(NDArrayOperatorsMixin):
    """Frames of a skinned mesh that are posed when they are read; else it behaves as an array (T, V, 3).

    Thousands of frames of a capture need no room, and those that nobody looks at no time. `np.asarray` makes all, and
    so does whatever else arrays can do.
    """

    skinned: SkinnedMesh
    rotation: Float[np.ndarray, "T J 3 3"]
    root: Float[np.ndarray, "T 3"]
    dtype: ClassVar[np.dtype] = np.dtype(np.float32)
    ndim: ClassVar[int] = 3

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of frames and of vertices, and 3."""
        return len(self.root), len(self.skinned.place), 3

    def __len__(self) -> int:
        """Return how many frames there are."""
        return len(self.root)

    def __iter__(self) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Pose one frame after the other."""
        return (self[t] for t in range(len(self)))

    def __getitem__(self, key: Any) -> Any:
        """Pose the frames of a key, as of an array; those of a slice or of numbers are posed when they are read."""
        first, rest = (key[0], key[1:]) if isinstance(key, tuple) else (key, ())
        if isinstance(first, int | np.integer):
            posed = self.skinned.posed(self.rotation[first], self.root[first]).astype(self.dtype)
            return posed[rest] if rest else posed
        chosen = replace(self, rotation=self.rotation[first], root=self.root[first])
        if not rest and (isinstance(first, slice) or np.ndim(first) == 1):
            return chosen
        return np.asarray(chosen)[(slice(None), *rest)]

    def __array__(self, dtype: np.dtype | None = None, copy: bool | None = None) -> Float[np.ndarray, "T V 3"]:
        """Pose all frames."""
        frames = np.empty(self.shape, self.dtype if dtype is None else dtype)
        for t, points in enumerate(self):
            frames[t] = points
        return frames

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Compute with all frames."""
        arrays = (np.asarray(given) if isinstance(given, PosedFrames) else given for given in inputs)
        return getattr(ufunc, method)(*arrays, **options)

    def __getattr__(self, name: str) -> Any:
        """Return a method or an attribute of an array of all frames."""
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(np.asarray(self), name)

    def of_vertices(self, vertices: Int[np.ndarray, " P"]) -> Float[np.ndarray, "T P 3"]:
        """Pose few vertices in all frames."""
        return self.skinned.part(vertices).posed_frames(self.rotation, self.root)


if TYPE_CHECKING:  # it behaves as an array, and programs of users know arrays alone
    Frames = Float[np.ndarray, "T V 3"]
else:
    Frames = Float[np.ndarray, "T V 3"] | PosedFrames


def allocate_frames(count: int, vertices: int, dtype: type[np.floating] | np.dtype) -> Float[np.ndarray, "T V 3"]:
    """Allocate an array for `count` frames: in memory, or from LARGE bytes on in a file that is deleted with it."""
    shape = (count, vertices, 3)
    if count * vertices * 3 * np.dtype(dtype).itemsize < LARGE:
        return np.empty(shape, dtype)
    with tempfile.TemporaryFile() as file:
        reserve_space(file.fileno(), count * vertices * 3 * np.dtype(dtype).itemsize)
        return np.memmap(file, dtype, "w+", shape=shape)


def reserve_space(descriptor: int, size: int) -> None:
    """Reserve disk space for a file of frames; a mapped page that cannot be written later kills the process (SIGBUS).

    Raises:
        InputError: there is too little.
    """
    if not hasattr(os, "posix_fallocate"):
        return
    try:
        os.posix_fallocate(descriptor, 0, size)
    except OSError as error:
        raise InputError(
            f"{tempfile.gettempdir()}: expected room for {size / 2**20:,.0f} MiB of frames, found '{error.strerror}'; "
            "free some, take fewer frames, or set TMPDIR to another folder"
        ) from error


def release_pages(frames: Frames) -> None:
    """Release the memory of a memory-mapped array; its values stay in the file. Other arrays are left alone."""
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
    """Store `count` frames that arrive one by one in an array of `allocate_frames`."""
    stored = allocate_frames(count, vertices, dtype)
    done = 0
    for points in frames:
        stored[done] = points
        done += 1
        if done % PAGED == 0:
            release_pages(stored)
        if progress is not None:
            progress(done, count)
    assert done == count, f"expected {count} frames, got {done}"
    return stored


@dataclass(frozen=True, eq=False)
class LazyFrames:
    """The frames of a moved mesh: stored, or made each time that they are asked for. A file of joints needs few."""

    shape: tuple[int, int]
    """Numbers of frames and of vertices."""
    make: Callable[[Int[np.ndarray, " N"]], Iterable[Float[np.ndarray, "V 3"]]]
    """Makes the frames of these numbers, in this order."""
    dtype: np.dtype
    array: Float[np.ndarray, "T V 3"] | None = None
    """Stored frames; None where they are made."""
    group: Int[np.ndarray, " V"] | None = None
    """Number of the position of each vertex, where some share one in all frames: then `make` makes these positions."""

    @classmethod
    def stored(cls, vertices: Frames) -> LazyFrames:
        """Give out the frames of a clip."""
        array = None if isinstance(vertices, PosedFrames) else vertices
        return cls(vertices.shape[:2], lambda chosen: (vertices[t] for t in chosen), vertices.dtype, array)

    def __reduce__(self) -> tuple[Callable[[Frames], LazyFrames], tuple[Frames]]:
        """Make all frames to be pickled: what makes them stays in its process."""
        return LazyFrames.stored, (self.every(1),)

    def __repr__(self) -> str:
        """Sum up the frames: arrays of thousands of numbers say nothing."""
        return f"LazyFrames({self.shape[0]} frames, {self.shape[1]} vertices)"

    def __len__(self) -> int:
        """Return how many there are."""
        return self.shape[0]

    def at(self, chosen: Int[np.ndarray, " N"] | Sequence[int]) -> Iterator[Float[np.ndarray, "V 3"]]:
        """Yield the frames of these numbers, in this order."""
        for points in self.make(np.asarray(chosen, np.int64)):
            points = points.astype(self.dtype, copy=False)
            yield points if self.group is None else points.take(self.group, axis=0)

    def every(self, step: int, progress: Progress | None = None) -> Float[np.ndarray, "T V 3"]:
        """Return every `step`-th frame in one array; stored ones are not copied."""
        if self.array is not None:
            return self.array[::step]
        chosen = range(0, len(self), step)
        return store_frames(self.at(chosen), len(chosen), self.shape[1], self.dtype, progress)

    @property
    def distinct(self) -> LazyFrames:
        """The same frames with one vertex for each position that vertices share in all of them (`merged_mesh`)."""
        if self.group is None:
            return self
        return LazyFrames((self.shape[0], int(self.group.max()) + 1), self.make, self.dtype)

    def kept(self) -> LazyFrames:
        """Return the same frames, made once."""
        stored = LazyFrames.stored(self.distinct.every(1))
        return stored if self.group is None else replace(stored, shape=self.shape, array=None, group=self.group)

    def first(self) -> Float[np.ndarray, "V 3"]:
        """Return the first frame in double precision."""
        return next(self.at([0])).astype(np.float64)


def evenly_spread(frames: int, most: int) -> Int[np.ndarray, " T"]:
    """Choose frames of a clip, evenly spread, the first and the last among them; all if there are no more than that."""
    return np.linspace(0, frames - 1, min(frames, most)).round().astype(int)


def spread_exactly(frames: int, count: int, name: str) -> Int[np.ndarray, " N"]:
    """Choose `count` frames of a clip as `evenly_spread` does; one frame is the first.

    Raises:
        InputError: the clip `name` has fewer.
    """
    if not 1 <= count <= frames:
        raise InputError(f"{name}: expected {count} frames or more, found {frames}; ask for fewer, or leave it out")
    return evenly_spread(frames, count)


def each_frame(
    vertices: Frames, progress: Progress | None = None, dtype: type[np.floating] | np.dtype = np.float64
) -> Iterator[Float[np.ndarray, "V 3"]]:
    """Iterate over the frames of a clip, in double precision by default, and release their pages when they are read."""
    for t, points in enumerate(vertices):
        yield np.asarray(points, dtype)
        if t % PAGED == 0:
            release_pages(vertices)
        if progress is not None:
            progress(t + 1, len(vertices))


def part(progress: Progress | None, number: int, parts: int) -> Progress | None:
    """Return a function that reports the progress of one of several equal parts as progress of the whole."""
    return progress and (lambda done, total: progress(number * total + done, parts * total))


def counted(items: Iterable[T], count: int, progress: Progress | None) -> Iterator[T]:
    """Iterate over items and report each to `progress` when the next one is requested."""
    for done, item in enumerate(items, 1):
        yield item
        if progress is not None:
            progress(done, count)


def vertices_of_all(
    frames: Frames, chosen: Int[np.ndarray, " P"], progress: Progress | None = None
) -> Float[np.ndarray, "T P 3"]:
    """Return few vertices in all frames; nothing else is read of stored frames, nor posed of others."""
    if not isinstance(frames, PosedFrames):
        return np.stack([points[chosen] for points in each_frame(frames, progress, frames.dtype)])
    if progress is not None:
        progress(len(frames), len(frames))
    return frames.of_vertices(chosen)
