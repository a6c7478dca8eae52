"""The contact sheet of a batch: a picture of each result, drawn from its file."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.errors import InputError
from ..io import load_clip
from ..render.camera import fit
from ..render.raster import render_mesh
from ..render.shading import BACKGROUND
from ..render.sheet import captioned, page
from ..tools.preview import save_picture
from .table import BatchJob, stem

if TYPE_CHECKING:
    from PIL import Image

TILE = (180, 220)
"""Width and height of a picture in pixels."""
MOST_TILES = 240
"""Largest number of results on a sheet; of more, as many evenly spread."""
MOST_COLUMNS = 16


def drawn_jobs(count: int) -> list[int]:
    """Return the numbers of the jobs that a sheet shows."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_TILES)).round().astype(int)).tolist()


def draw_tile(job: BatchJob) -> str | None:
    """Draw the middle frame of a result as a PNG in base64; None where its format cannot be read or drawn."""
    try:
        clip = load_clip(Path(job.output), fps=1.0 if Path(job.output).is_dir() else None)
        mesh = clip.mesh.with_vertices(clip.vertices[len(clip) // 2].astype(np.float64))
        picture = render_mesh(mesh, TILE, fit(mesh.vertices, TILE, "three-quarter"), background=BACKGROUND)
    except InputError:
        return None
    data = io.BytesIO()
    captioned(picture, job.name).save(data, "PNG")
    return base64.b64encode(data.getvalue()).decode()


def save_sheet(jobs: Sequence[BatchJob], states: Sequence[str], tiles: Sequence[str | None], path: Path) -> Path:
    """Write the sheet: a row for each identity if all have as many jobs, else rows of one length."""
    from PIL import Image

    pictures = [
        Image.open(io.BytesIO(base64.b64decode(tile))) if tile else _blank(f"{job.name}: {state}")
        for job, state, tile in zip(jobs, states, tiles, strict=True)
    ]
    return save_picture(page(pictures, _columns(jobs)), path)


def _columns(jobs: Sequence[BatchJob]) -> int:
    """Return the number of pictures in a row."""
    identities = [stem(job.identity) for job in jobs]
    row = next((k for k, name in enumerate(identities) if name != identities[0]), len(jobs))
    even = len(jobs) % row == 0 and all(len(set(identities[k : k + row])) == 1 for k in range(0, len(jobs), row))
    if even and row <= MOST_COLUMNS and len(jobs) > row:
        return row
    return min(len(jobs), MOST_COLUMNS, int(np.ceil(np.sqrt(1.6 * len(jobs)))))


def _blank(label: str) -> Image.Image:
    """Return a picture of the background with a label."""
    color = (np.array(BACKGROUND) * 255).round().astype(np.uint8)
    return captioned(np.broadcast_to(color, (TILE[1], TILE[0], 3)).copy(), label)
