"""Folders of registered meshes and clips: people of the shipped body after decimation, in poses of Table 6."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from people import person

from mimesh.core.mesh import Clip, Mesh
from mimesh.io import save_clip, save_mesh

FACES = 300
"""Triangles of the meshes."""
FILE = "id{person}_{pose}.ply"


def write_meshes(folder: Path, people: int = 4, poses: int = 5, name: str = FILE, leave_out=()) -> dict[str, Mesh]:
    """Write people in poses, but for those in `leave_out`, and return the meshes by the names of their files."""
    written = {}
    for i in range(people):
        for b in range(poses):
            if (i, b) not in leave_out:
                path = folder / name.format(person=i, pose=b)
                path.parent.mkdir(parents=True, exist_ok=True)
                written[str(path.relative_to(folder))] = person(i, b, FACES)
                save_mesh(person(i, b, FACES), path)
    return written


def moving(shape: int, motion: int, frames: int) -> Clip:
    """Make a clip of a person who goes straight from one pose to another, frame by frame the same for all people."""
    start, stop = (person(shape, 2 * motion + k, FACES) for k in (0, 1))
    share = np.linspace(0, 1, 20)[:frames, None, None]
    return Clip(start, (1 - share) * start.vertices + share * stop.vertices)


def write_clips(folder: Path, people: int = 4, motions: int = 4, frames=lambda person, motion: 6) -> dict[str, Clip]:
    """Write a clip of each person and motion, `{person}/{motion}.npz`, and return them by these names."""
    written = {}
    for i in range(people):
        (folder / f"p{i}").mkdir(parents=True, exist_ok=True)
        for m in range(motions):
            written[f"p{i}/walk{m}.npz"] = moving(i, m, frames(i, m))
            save_clip(written[f"p{i}/walk{m}.npz"], folder / f"p{i}" / f"walk{m}.npz")
    return written
