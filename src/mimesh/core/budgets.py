"""Budgets of untrusted files: how much of each thing is read from one file, checked before memory is allocated.

A few bytes can ask for any amount of memory or time. The budgets leave room for surfaces of 3 million vertices and for
10,000 frames of a character; `no_limits` lifts them for files that are known to be good.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from .errors import InputError, on_command_line

# A context variable belongs to its thread: what one caller lifts stays in place for all others.
_lifted: ContextVar[bool] = ContextVar("mimesh budgets lifted", default=False)
LARGEST_PRINTED = 10**18
"""Counts from here on are not printed: damaged ones may have thousands of digits."""


@dataclass(frozen=True)
class Budget:
    """The largest number of some things that is read from one file."""

    things: str
    """What is counted, in the plural."""
    largest: int
    per_byte: float | int = 0
    """Things for each byte of the file, where that is more than `largest`."""

    def check(self, count: int, path: str | Path, size: int = 0) -> None:
        """Raise InputError for a count above the budget, unless the budgets are lifted.

        Args:
            path: file, for the message.
            size: bytes of the file, or of the data that the things are made from.
        """
        largest = max(self.largest, int(self.per_byte * size))
        if count > largest and not _lifted.get():
            lifting = "add --no-limits" if on_command_line() else "call this inside `with mimesh.no_limits():`"
            found = f"{count:,}" if count < LARGEST_PRINTED else "far more"
            raise InputError(
                f"{path}: expected at most {largest:,} {self.things}, found {found}; the file is damaged, or "
                f"{lifting} if you trust it"
            )


VERTICES = Budget("vertices", 10_000_000)
"""Of one mesh, all its parts and instances together."""
FACES = Budget("triangles", 20_000_000)
CORNERS = Budget("corners of one polygon", 20_000)
FRAMES = Budget("frames", 1_000_000)
CLIP_POINTS = Budget("vertices in all frames together", 1_000_000_000)
"""Of up to 24 bytes each in the temporary file: 10,000 frames of 100,000 vertices."""
JOINTS = Budget("joints or nodes", 20_000)
DEPTH = Budget("joints or nodes one below the other", 1_000)
POSED_JOINTS = Budget("joints in all frames together", 4_000_000, 1 / 6)
"""A joint of a BVH has three numbers in each frame, of two characters or more."""
SHOWN = Budget("parts of meshes shown by nodes", 5_000)
"""A mesh that several nodes show counts once for each."""
MORPHED = Budget("vertices in all morph targets together", 100_000_000, 1)
KEYS = Budget("numbers in the keys of an animation", 20_000_000, 1)
"""Each channel counts; in the file several may share their keys."""
EMPTY = Budget("values without data in the file", 4_000_000)
"""Of one glTF accessor, which then stands for zeros."""
JOINED = Budget("bytes of joined buffers", 4 << 30)
ELEMENTS = Budget("elements and properties", 1_000)
"""Of the header of a PLY file."""
UNPACKED = Budget("bytes when it is unpacked", 128 << 20, 200)
"""Deflate, the compression of .npz, makes zeros 1030 times smaller."""


def check_clip_size(frames: int, vertices: int, path: str | Path) -> None:
    """Raise InputError for a clip of more frames or vertices than a file may have; frames without vertices count."""
    VERTICES.check(vertices, path)
    FRAMES.check(frames, path)
    CLIP_POINTS.check(frames * vertices, path)


def lift_limits() -> None:
    """Lift all budgets for the rest of the current context: a thread, or what `contextvars.Context.run` runs."""
    _lifted.set(True)


def limits_are_lifted() -> bool:
    """Whether the budgets are lifted for the caller; a child process must be told."""
    return _lifted.get()


@contextlib.contextmanager
def no_limits() -> Iterator[None]:
    """Lift all budgets inside a `with` block, for the calling thread: for large files that are known to be good.

    Example:
        >>> with mimesh.no_limits():
        ...     mesh = mimesh.load_mesh("hero.glb")
    """
    token = _lifted.set(True)
    try:
        yield
    finally:
        _lifted.reset(token)
