"""Read and write USD (.usd, .usda, .usdc, .usdz) with the library usd-core (the extra `usd`).

read      opens files of others, as a Mesh or frame by frame, in a child process
write     writes a new file for any Mesh or Clip

The library is imported only in the child, and when a new file is written. The child hands meshes and clips over in
files of arrays (`hand_over_mesh`, `hand_over_clip`). Frames go through a file of their own, one after another, so that
neither process has all of them in memory.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import itertools
import json
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from ...core.errors import InputError, NotInstalledError
from ...core.frame_buffer import LARGE, Progress, reserve_space, store_frames
from ...core.mesh import Clip, Material, Mesh, Part
from ..atomic import whole_file
from ..child_process import USE_PREAD, Limits, child_result

MESH_READER, CLIP_READER = "mimesh.io.usd.read:read_mesh", "mimesh.io.usd.read:read_clip"
"""What the child runs."""
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MOST_LAYERS = 1000
"""Files of the folders around a layer that are looked at."""
ARRAYS = ("vertices", "faces", "corner_uv", "corner_normals", "vertex_colors")
"""Fields of a mesh that are arrays."""
FACTS, SIZES = "facts", "sizes"
"""Entries of the file that is handed over: all that is no array, as JSON, and the corners of polygons."""
FRAMES_FILE = "frames"
"""File beside it with the positions of all frames, as numbers of type float64 in C order."""
LARGEST_CLIP = 24 * 10**9
"""Bytes of the frames that a child may write: 10,000 frames of 100,000 vertices."""
SMALL_SECONDS = 6
"""Processor time in which a small file must be read; one of 60 MB was seen to need 0.7 s, imports included."""
TO_Y_UP = {"+y": ("x", 0.0), "+z": ("x", -90.0), "-y": ("x", 180.0), "-z": ("x", 90.0), "+x": ("z", 90.0)}
TO_Y_UP["-x"] = ("z", -90.0)
"""Up axis -> rotation that takes it to +y: its axis, and its angle in degrees."""


@dataclass(frozen=True, eq=False)
class UsdSource:
    """The polygons, axis and unit of the USD stage that a Mesh was read from. Satisfies `mesh.Source`."""

    suffix: str
    sizes: Int[np.ndarray, " P"] = field(repr=False)
    """Corners of each polygon; the faces are triangle fans of them."""
    up_axis: str
    """The token Y or Z."""
    meters_per_unit: float
    notes: tuple[str, ...]
    """One line for each thing of the stage that a new file lacks."""

    @property
    def details(self) -> tuple[tuple[str, str], ...]:
        """Rows of name and value for `mimesh look`: the stage's unit and up axis."""
        return (("unit", f"{self.meters_per_unit:g} m, {self.up_axis.lower()} up"),)


def read_usd(path: Path) -> Mesh:
    """Read all visible meshes of a stage as one mesh in world coordinates, at the default time (see `read.read_mesh`).

    Raises:
        InputError: usd-core is not installed, the file is damaged, or it shows no meshes.
    """
    need_library(path, "read")
    with child_result(MESH_READER, path, path, _limits(path)) as result:
        return take_mesh(result)[0]


def read_usd_clip(path: Path, fps: float | None = None, progress: Progress | None = None) -> Clip:
    """Read all visible meshes of a stage as a clip: a frame per time code, or `fps` a second (see `read.read_clip`)."""
    need_library(path, "read")
    limits = dataclasses.replace(_limits(path), output=LARGEST_CLIP)
    report = progress or (lambda done, total: None)  # never None: the limits of time are for one frame
    with child_result(CLIP_READER, path, path, limits, report, fps=fps) as result:
        mesh, facts = take_mesh(result)
        file, shape = result.with_name(FRAMES_FILE), (facts["count"], len(mesh.vertices), 3)
        if file.stat().st_size < LARGE:
            return Clip(mesh, np.fromfile(file, np.float64).reshape(shape), facts["fps"])
        # The file is deleted soon: mapped, it stays until the array is gone, but Windows does not delete it then.
        mapped = np.memmap(file, np.float64, "r+", shape=shape)
        return Clip(mesh, store_frames(mapped, *shape[:2]) if os.name == "nt" else mapped, facts["fps"])


def write_usd(mesh: Mesh, path: Path) -> None:
    """Write a mesh as a new USD file (see `write.write_new`)."""
    write_usd_clip(Clip.still(mesh), path)


def write_usd_clip(clip: Clip, path: Path, progress: Progress | None = None) -> None:
    """Write a clip as a new USD file in which time code k is frame k (see `write.write_new`)."""
    need_library(path, "write")
    from pxr import Tf  # pyright: ignore[reportAttributeAccessIssue]

    from .write import write_new

    with whole_file(path) as temporary:
        try:
            write_new(clip, temporary, path, progress)
        except Tf.ErrorException as error:  # it does not say why
            raise InputError(
                f"{path}: expected a place with room for the file, found that it could not be saved; choose another "
                "output"
            ) from error


def stage_axes(mesh: Mesh) -> tuple[tuple[str, float], float]:
    """Return the rotation that makes a mesh y up (see TO_Y_UP), and the unit of its file in metres.

    Up is what the mesh says, or the file; nothing known is y up. Only USD sources know their unit.
    """
    up = mesh.up or f"+{getattr(mesh.source, 'up_axis', 'Y').lower()}"
    return TO_Y_UP[up], getattr(mesh.source, "meters_per_unit", 1.0)


def need_library(path: Path, verb: str) -> None:
    """Raise NotInstalledError where usd-core is not installed; `verb` is "read" or "write"."""
    os.environ.setdefault(*USE_PREAD)
    if importlib.util.find_spec("pxr") is None:
        raise NotInstalledError(
            f"{path}: expected usd-core to {verb} USD, found it not installed; pip install 'mimesh[usd]'"
        )


def _limits(path: Path) -> Limits:
    """Return limits for a layer and those in its folder and the folders in that, which it may be composed of."""
    files = itertools.islice(itertools.chain(path.parent.glob("*"), path.parent.glob("*/*")), MOST_LAYERS)
    sizes = [file.stat().st_size for file in files if file.suffix.lower() in SUFFIXES and file.is_file()]
    return Limits.for_size(max(sum(sizes), path.stat().st_size), SMALL_SECONDS)


def hand_over_mesh(target: Path, mesh: Mesh, **more: int | float) -> None:
    """Write a mesh and further values to the file that the parent reads; runs in the child."""
    source, materials = mesh.source, list(dict.fromkeys(part.material for part in mesh.parts if part.material))
    assert isinstance(source, UsdSource)
    parts = [
        [part.name, part.start, part.stop, part.material and materials.index(part.material)] for part in mesh.parts
    ]
    facts: dict[str, Any] = {"name": mesh.name, "up": mesh.up, "parts": parts, **more}
    facts["materials"] = [[material.name, material.base_color] for material in materials]
    facts["source"] = [source.suffix, source.up_axis, source.meters_per_unit, source.notes]
    arrays = {name: getattr(mesh, name) for name in ARRAYS if getattr(mesh, name) is not None}
    for k, material in enumerate(materials):
        if material.texture is not None:
            arrays[f"texture {k}"] = np.frombuffer(material.texture, np.uint8)
    arrays |= {SIZES: source.sizes, FACTS: np.frombuffer(json.dumps(facts).encode(), np.uint8)}
    with target.open("wb") as file:
        np.savez(file, **arrays)


def hand_over_clip(
    target: Path, mesh: Mesh, frames: Iterable[Float[np.ndarray, "V 3"]], count: int, fps: float, progress: Progress
) -> None:
    """Write a clip as `hand_over_mesh` does, and its `count` frames as they are computed; runs in the child."""
    with target.with_name(FRAMES_FILE).open("wb") as file:
        reserve_space(file.fileno(), count * mesh.vertices.size * 8)
        for done, vertices in enumerate(frames, 1):
            file.write(vertices.astype(np.float64).tobytes())
            progress(done, count)
    hand_over_mesh(target, mesh, count=count, fps=fps)


def take_mesh(result: Path) -> tuple[Mesh, dict[str, Any]]:
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
    suffix, up_axis, unit, notes = facts["source"]
    source = UsdSource(suffix, arrays[SIZES], up_axis, unit, tuple(notes))
    of_mesh = {name: arrays[name] for name in ARRAYS if name in arrays}
    return Mesh(**of_mesh, name=facts["name"], up=facts["up"], parts=parts, source=source), facts
