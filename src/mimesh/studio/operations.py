"""What the worker of a studio does: read, prepare, pose and play, by the same functions as `pipeline.animate`."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..bodies import load_body
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization
from ..io import load_clip, load_mesh
from ..io.beside import confined
from ..methods.find import find_method
from ..pipeline import driving_axes
from ..pipeline.report import facing
from ..pipeline.result import ClipResult, Timer
from ..pipeline.run import Axes, MotionOptions, Prepared, play, pose_frame, prepare
from ..tools.demo import driving_clip
from .options import Options

__all__ = [
    "animations",
    "demo_clip",
    "for_page",
    "pose_frame",
    "prepared",
    "read_clip",
    "read_mesh",
    "result",
    "stands",
]

OPTION_WORDS = {
    "give --driving-front": "choose its front",
    "give --front": "choose its front",
    "choose it with -m": "choose another model",
    "give one with --fps": "give a frame rate",
    "give another with --fps": "give another frame rate",
    "name another with -o": "choose another format",
}
"""What the command line calls by its options, and the page by its fields."""


def read_mesh(path: Path, folder: Path | None) -> Mesh:
    """A mesh to move; of an upload, what it names is read from its folder alone."""
    with _within(folder):
        return load_mesh(path)


def read_clip(path: Path, folder: Path | None, name: str, fps: float | None, animation: str | None) -> Clip:
    """What to imitate; a mesh is a clip of one frame, and a folder is called `name`. As for `read_mesh`."""
    with _within(folder):
        clip = load_clip(path, fps, animation)
    return dataclasses.replace(clip, mesh=dataclasses.replace(clip.mesh, name=name)) if path.is_dir() else clip


def demo_clip(motion: str) -> Clip:
    """The shipped person in a shipped motion."""
    return driving_clip(load_body(), motion)


def stands(content: Mesh | Clip, axes: tuple[str | None, str | None]) -> dict[str, Any]:
    """How a mesh, or a clip in its first frame, is found to stand (see `report.facing`), and whether that is unsure."""
    if isinstance(content, Clip):
        first = dataclasses.replace(content.mesh, vertices=content.vertices[0].astype(np.float64))
        frame = Normalization.fit(first, *driving_axes(content, *axes))
    else:
        frame = Normalization.fit(content, *axes)
    return {**facing(frame), "unsure": frame.unsure}


def animations(content: Mesh | Clip) -> tuple[str, ...]:
    """Names of a glTF file's animations."""
    mesh = content.mesh if isinstance(content, Clip) else content
    return tuple(getattr(mesh.source, "animations", ()))


def prepared(identity: Mesh, clip: Clip, model: str, axes: Axes) -> Prepared:
    """Both read by the model, nothing refined yet."""
    theirs = driving_axes(clip, *axes[2:])
    return prepare(identity, clip, lambda frame: find_method(model), (*axes[:2], *theirs), False, MotionOptions())


def result(ready: Prepared, options: Options, progress: Progress) -> ClipResult:
    """The whole clip, as `pipeline.animate` gives it, or the one pose, as `pipeline.transfer` does."""
    seconds, clip = Timer(), ready.clip
    dtype = np.float64 if len(clip) == 1 else np.float32
    moved = play(ready, seconds, options.motion(ready.method), progress, dtype)
    first: Float[np.ndarray, "V 3"] = moved.vertices[0].astype(np.float64)
    shown = Clip(ready.identity.with_vertices(first), moved.vertices, clip.fps)
    return ClipResult(shown, ready.method.name, seconds, moved.report, moved.notes, moved.skeleton)


def _within(folder: Path | None) -> contextlib.AbstractContextManager[None]:
    return contextlib.nullcontext() if folder is None else confined(folder)


def for_page(text: str, folder: Path) -> str:
    """Words of an error or a note that fit the page: files by the names they were given, fields instead of options."""
    text = re.sub(rf"{re.escape(str(folder))}[/\\](uploads|exports)[/\\]\d+[/\\]?", "", text)
    for ours, theirs in OPTION_WORDS.items():
        text = text.replace(ours, theirs)
    return text
