"""Read meshes and clips with native libraries in a child process, which hands them over in files of arrays.

The child calls `hand_over_mesh` or `hand_over_clip`, the parent `guarded_mesh` or `guarded_clip`, with the name of the
function that the child runs. Frames go through a file of their own, one after another, so that neither process has all
of them in memory. The fields of the mesh's source (`mesh.Source`) are arrays and values that JSON has.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..core.frame_buffer import LARGE, Progress, reserve_space, store_frames
from ..core.mesh import Clip, Material, Mesh, Part, Source
from .child_process import Limits, child_result

ARRAYS = ("vertices", "faces", "corner_uv", "corner_normals", "vertex_colors")
"""Fields of a mesh that are arrays."""
FACTS = "facts"
"""Entry of the file with all that is no array, as JSON."""
SOURCE = "source "
"""What the names of the fields of the mesh's source begin with."""
FRAMES_FILE = "frames"
"""File beside the result with the positions of all frames, as numbers of type float64 in C order."""
LARGEST_CLIP = 24 * 10**9
"""Bytes of the frames that a child may write: 10,000 frames of 100,000 vertices."""
SMALL_SECONDS = 6
"""Processor time in which a small file must be read; one of 60 MB was seen to need 0.7 s, imports included."""


def guarded_mesh(function: str, path: Path, source: Callable[..., Source], size: int) -> Mesh:
    """Read a mesh in a child process.

    Args:
        function: "package.module:function", called as function(source, target): it reads the mesh of the file `source`
            and calls `hand_over_mesh`.
        path: the file to read.
        source: class of the mesh's source.
        size: bytes of the file and of those it may refer to.

    Raises:
        InputError: as `child_result`.
    """
    with child_result(function, path, path, Limits.for_size(size, SMALL_SECONDS)) as result:
        return take_mesh(result, source)[0]


def guarded_clip(
    function: str, path: Path, source: Callable[..., Source], size: int, fps: float | None, progress: Progress | None
) -> Clip:
    """Read a clip in a child process; arguments as of `guarded_mesh`, and the function gets `fps` and `progress` too.

    Raises:
        InputError: as `child_result`.
    """
    limits = dataclasses.replace(Limits.for_size(size, SMALL_SECONDS), output=LARGEST_CLIP)
    report = progress or (lambda done, total: None)  # never None: the limits of time are for one frame
    with child_result(function, path, path, limits, report, fps=fps) as result:
        mesh, facts = take_mesh(result, source)
        file, shape = result.with_name(FRAMES_FILE), (facts["count"], len(mesh.vertices), 3)
        if file.stat().st_size < LARGE:
            return Clip(mesh, np.fromfile(file, np.float64).reshape(shape), facts["fps"])
        # The file is deleted soon: mapped, it stays until the array is gone, but Windows does not delete it then.
        mapped = np.memmap(file, np.float64, "r+", shape=shape)
        return Clip(mesh, store_frames(mapped, *shape[:2]) if os.name == "nt" else mapped, facts["fps"])


def hand_over_mesh(target: Path, mesh: Mesh, **more: int | float) -> None:
    """Write a mesh and further values to the file that the parent reads; runs in the child."""
    materials = list(dict.fromkeys(part.material for part in mesh.parts if part.material is not None))
    number = {material: k for k, material in enumerate(materials)}
    parts = [[part.name, part.start, part.stop, part.material and number[part.material]] for part in mesh.parts]
    facts: dict[str, Any] = {"name": mesh.name, "up": mesh.up, "parts": parts, **more}
    facts["materials"] = [[material.name, material.base_color] for material in materials]
    arrays = {name: getattr(mesh, name) for name in ARRAYS if getattr(mesh, name) is not None}
    for k, material in enumerate(materials):
        if material.texture is not None:
            arrays[f"texture {k}"] = np.frombuffer(material.texture, np.uint8)
    for name, value in vars(mesh.source).items():
        (arrays if isinstance(value, np.ndarray) else facts)[SOURCE + name] = value
    arrays[FACTS] = np.frombuffer(json.dumps(facts).encode(), np.uint8)
    with target.open("wb") as file:
        np.savez(file, **arrays)


def hand_over_clip(
    target: Path, mesh: Mesh, frames: Iterable[Float[np.ndarray, "V 3"]], count: int, fps: float, progress: Progress
) -> None:
    """Write a clip as `hand_over_mesh` does, and its `count` frames as they are computed; runs in the child.

    Raises:
        InputError: the disk has too little room for the frames.
    """
    with target.with_name(FRAMES_FILE).open("wb") as file:
        reserve_space(file.fileno(), count * mesh.vertices.size * 8)
        for done, vertices in enumerate(frames, 1):
            file.write(vertices.astype(np.float64).tobytes())
            progress(done, count)
    hand_over_mesh(target, mesh, count=count, fps=fps)


def take_mesh(result: Path, source: Callable[..., Source]) -> tuple[Mesh, dict[str, Any]]:
    """Read what `hand_over_mesh` wrote: the mesh, and a dictionary with the further values."""
    with np.load(result, allow_pickle=False) as archive:
        arrays = dict(archive)
    facts = json.loads(arrays.pop(FACTS).tobytes())
    materials = [
        Material(name, tuple(color), None if (image := arrays.get(f"texture {k}")) is None else image.tobytes())
        for k, (name, color) in enumerate(facts["materials"])
    ]
    parts = tuple(
        Part(name, start, stop, None if material is None else materials[material])
        for name, start, stop, material in facts["parts"]
    )
    of_mesh = {name: arrays[name] for name in ARRAYS if name in arrays}
    of_source = {
        name.removeprefix(SOURCE): tuple(value) if isinstance(value, list) else value  # JSON has no tuples
        for name, value in (arrays | facts).items()
        if name.startswith(SOURCE)
    }
    return Mesh(**of_mesh, name=facts["name"], up=facts["up"], parts=parts, source=source(**of_source)), facts
