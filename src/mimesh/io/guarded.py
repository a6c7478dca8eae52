"""Read meshes and clips with native libraries in a child process, which hands them over in files of arrays.

The child calls `hand_over_mesh` or `hand_over_clip`, the parent `guarded_mesh` or `guarded_clip`, with the name of the
function that the child runs. Frames go through a file of their own, one after another, so that neither process has all
of them in memory. What is kept of the file for writing it again (`mesh.Source`) is handed over as named values.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from jaxtyping import Float

from ..core.frame_buffer import LARGE, Progress, reserve_space, store_frames
from ..core.mesh import Clip, Material, Mesh, Part, Source
from .beside import confining_folder
from .child_process import Limits, child_result

Values = dict[str, Any]
"""Arrays, and values that JSON has, by name."""
ARRAYS = ("vertices", "faces", "corner_uv", "corner_normals", "vertex_colors")
"""Fields of a mesh that are arrays."""
FRAMES_FILE = "frames"
"""File beside the result with the positions of all frames, as numbers of type float64 in C order."""
LARGEST_CLIP = 24 * 10**9
"""Bytes of the frames that a child may write: 10,000 frames of 100,000 vertices."""
SMALL_SECONDS = 6
"""Processor time in which a small file must be read; one of 60 MB was seen to need 0.7 s, imports included."""


@dataclass(frozen=True, eq=False)
class ClipStream:
    """A clip whose frames are computed one by one, when they are asked for."""

    mesh: Mesh
    frames: Iterator[Float[np.ndarray, "V 3"]]
    count: int
    """Number of frames."""
    fps: float


def guarded_mesh(function: str, path: Path, source_of: Callable[[Values], Source], size: int) -> Mesh:
    """Read a mesh in a child process.

    Args:
        function: "package.module:function", called as function(source, target, confined_to): it reads the mesh of the
            file `source` and calls `hand_over_mesh`. References to other files are confined to `confined_to`.
        path: the file to read.
        source_of: makes the mesh's source of the values that were handed over.
        size: bytes of the file and of those it may refer to.

    Raises:
        InputError: as `child_result`.
    """
    limits = Limits.for_size(size, SMALL_SECONDS)
    with child_result(function, path, path, limits, confined_to=_confined_to()) as result:
        mesh, values = take_mesh(result)
        return dataclasses.replace(mesh, source=source_of(values))


def guarded_clip(
    function: str,
    path: Path,
    source_of: Callable[[Values], Source],
    size: int,
    fps: float | None,
    progress: Progress | None,
) -> Clip:
    """Read a clip in a child process; arguments as of `guarded_mesh`, and the function gets `fps` and `progress` too.

    Raises:
        InputError: as `child_result`.
    """
    limits = dataclasses.replace(Limits.for_size(size, SMALL_SECONDS), output=LARGEST_CLIP)
    report = progress or _ignore  # never None: the limits of time are for one frame
    with child_result(function, path, path, limits, report, confined_to=_confined_to(), fps=fps) as result:
        mesh, values = take_mesh(result)
        shape = (values.pop("count"), len(mesh.vertices), 3)
        rate = values.pop("fps")
        frames = _take_frames(result.with_name(FRAMES_FILE), shape)
        return Clip(dataclasses.replace(mesh, source=source_of(values)), frames, rate)


def hand_over_mesh(target: Path, mesh: Mesh, values: Values) -> None:
    """Write a mesh, and the values of its source, to the file that the parent reads; runs in the child."""
    materials = list(dict.fromkeys(part.material for part in mesh.parts if part.material is not None))
    number = {material: k for k, material in enumerate(materials)}
    parts = [[part.name, part.start, part.stop, part.material and number[part.material]] for part in mesh.parts]
    described = {"name": mesh.name, "up": mesh.up, "parts": parts}
    described |= {"materials": [[material.name, material.base_color] for material in materials]}
    described |= {name: getattr(mesh, name) for name in ARRAYS if getattr(mesh, name) is not None}
    for k, material in enumerate(materials):
        if material.texture is not None:
            described[f"texture {k}"] = np.frombuffer(material.texture, np.uint8)
    with target.open("wb") as file:
        write_values(file, described)
        write_values(file, values)


def hand_over_clip(target: Path, stream: ClipStream, values: Values, progress: Progress) -> None:
    """Write a clip as `hand_over_mesh` does, and its frames as they are computed; runs in the child.

    Raises:
        InputError: the disk has too little room for the frames.
    """
    with target.with_name(FRAMES_FILE).open("wb") as file:
        reserve_space(file.fileno(), stream.count * stream.mesh.vertices.size * 8)
        for done, vertices in enumerate(stream.frames, 1):
            file.write(vertices.astype(np.float64).tobytes())
            progress(done, stream.count)
    hand_over_mesh(target, stream.mesh, {"count": stream.count, "fps": stream.fps, **values})


def write_values(file: BinaryIO, values: Values) -> None:
    """Write named arrays and JSON values: a line of JSON that lists both, then the arrays."""
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    others = {name: value for name, value in values.items() if name not in arrays}
    file.write(json.dumps([others, list(arrays)]).encode() + b"\n")
    for array in arrays.values():
        np.save(file, array, allow_pickle=False)


def read_values(file: BinaryIO) -> Values:
    """Read what `write_values` wrote."""
    others, arrays = json.loads(file.readline())
    return others | {name: np.load(file, allow_pickle=False) for name in arrays}


def take_mesh(result: Path) -> tuple[Mesh, Values]:
    """Read what `hand_over_mesh` wrote; the mesh has no source."""
    with result.open("rb") as file:
        described, values = read_values(file), read_values(file)
    textures = {k: described.get(f"texture {k}") for k in range(len(described["materials"]))}
    materials = [
        Material(name, tuple(color), None if (image := textures[k]) is None else image.tobytes())
        for k, (name, color) in enumerate(described["materials"])
    ]
    parts = tuple(
        Part(name, start, stop, None if material is None else materials[material])
        for name, start, stop, material in described["parts"]
    )
    arrays = {name: described[name] for name in ARRAYS if name in described}
    return Mesh(**arrays, name=described["name"], up=described["up"], parts=parts), values


def _take_frames(path: Path, shape: tuple[int, int, int]) -> Float[np.ndarray, "T V 3"]:
    """Take over a file of frames, which is deleted soon: in memory, or mapped from LARGE bytes on.

    A mapped file stays until the array is gone, also without a name; Windows does not delete it then, so it is copied.
    """
    if path.stat().st_size < LARGE:
        return np.fromfile(path, np.float64).reshape(shape)
    mapped = np.memmap(path, np.float64, "r+", shape=shape)
    return store_frames(mapped, *shape[:2]) if os.name == "nt" else mapped


def _ignore(done: int, total: int) -> None:
    """Take no notice of progress."""


def _confined_to() -> str | None:
    folder = confining_folder()
    return None if folder is None else str(folder)
