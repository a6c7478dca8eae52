"""The demo of `mimesh demo`: a generated person gets the captured motion of another one, or a cow a horse's gallop."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ..bodies import RiggedBody, load_body
from ..bodies.animals import animal
from ..core.errors import InputError, option
from ..core.frame_buffer import Progress
from ..core.mesh import Clip, Mesh
from ..io import save_clip, save_mesh
from ..io.atomic import together
from ..motions import DEMO, load_motion, motion_clip
from ..motions.animal_clips import gait_clip
from ..pipeline import animate
from ..view.sheet import DRIVING_TINT, page, stack, strip
from .preview import save_picture, still, written_beside

MOTION = DEMO
"""Name of a shipped motion."""
FRAMES = 36
RATE = 15.0
"""Frames a second. FRAMES of them last 2.4 s and take well under a minute on two cores."""
IDENTITY_SHAPE = (-1.2, 1.6, 0.8, -0.9)
DRIVING_SHAPE = (1.0, -1.0, -0.6, 0.7)
"""Shape coefficients of two clearly different people."""
GALLOP = 4
"""Number of the gallop: of those looked at, the one with the smallest drift to the side."""


def run_demo(folder: Path, progress: Progress | None = None, body: str = "human") -> dict[str, Any]:
    """Write the inputs, the result, its picture and its page into a folder, and return what `--json` prints.

    Args:
        body: `human` or `quadruped`.
    """
    identity, driving = inputs(body)
    result = animate(identity, driving, progress=progress)
    files = {name: folder / name for name in ("identity.obj", "driving.obj", "driving.glb", "result.glb")}
    with together():
        save_mesh(identity, files["identity.obj"])
        save_mesh(_frame(driving, len(driving) // 2), files["driving.obj"])
        save_clip(driving, files["driving.glb"])
        result.save(files["result.glb"])
    picture, page = folder / "preview.png", folder / "player.html"
    pictures, no_picture = written_beside(picture, lambda: draw(identity, driving, result.clip, picture))
    pages, no_page = written_beside(page, lambda: result.player(page, output=files["result.glb"], title="mimesh demo"))
    return {
        "output": str(files["result.glb"]),
        "motion": driving.mesh.name,
        "model": result.model,
        "vertices": len(identity.vertices),
        "frames": len(result.frames),
        "fps": result.fps,
        "seconds": {step: round(value, 4) for step, value in result.seconds.items()},
        "report": result.report,
        "notes": [*no_picture, *no_page],
        "files": [str(path) for path in (*files.values(), *pictures, *pages)],
        "player": str(page) if pages else None,
    }


def inputs(body: str) -> tuple[Mesh, Clip]:
    """Return two people, or a cow and a horse: the identity at rest, and the driving clip."""
    if body == "human":
        human = load_body()
        return person(human, IDENTITY_SHAPE), driving_clip(human)
    if body == "quadruped":
        fps = 2 * RATE  # a gallop has two cycles a second and more
        return animal("cow"), gait_clip("horse", "gallop", GALLOP, seconds=FRAMES / fps, fps=fps)
    raise InputError(f"{option('body')}: expected human or quadruped, found {body!r}; choose one of them")


def person(body: RiggedBody, shape: tuple[float, ...]) -> Mesh:
    """Return the mesh of a person at rest, from shape coefficients."""
    return dataclasses.replace(body.mesh(body.shaped(np.array(shape))[0]), name="person")


def driving_clip(body: RiggedBody, name: str = MOTION) -> Clip:
    """Return the clip of the driving person with a shipped motion, at about the demo's frame rate."""
    motion = load_motion(name)
    step = max(1, round(motion.fps / RATE))
    cut = slice(0, FRAMES * step, step)
    motion = dataclasses.replace(motion, rotmat=motion.rotmat[cut], root=motion.root[cut], fps=motion.fps / step)
    return motion_clip(body, np.array(DRIVING_SHAPE), motion)


def draw(identity: Mesh, driving: Clip, result: Clip, path: Path) -> Path:
    """Draw identity, driving and result side by side, and both clips as strips below."""
    middle = len(driving) // 2
    tiles = [
        still(identity, "identity"),
        still(_frame(driving, middle), "driving", tint=DRIVING_TINT),
        still(_frame(result, middle), "result"),
    ]
    strips = [strip(clip, 6, (220, 280), tint=tint) for clip, tint in ((driving, DRIVING_TINT), (result, None))]
    return save_picture(stack([page(tiles, 3), *strips]), path)


def _frame(clip: Clip, t: int) -> Mesh:
    return clip.mesh.with_vertices(clip.vertices[t].astype(np.float64))
