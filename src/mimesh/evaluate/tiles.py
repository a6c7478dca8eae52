"""What figures are made of: meshes with a label, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.mesh import Mesh
from .cross_body import SUFFIXES

if TYPE_CHECKING:
    from PIL import Image

TILE = (300, 360)


class Tile(NamedTuple):
    """One mesh of a page; `colors` a vertex instead of its materials."""

    label: str
    mesh: Mesh
    colors: Float[np.ndarray, "V 3"] | None = None


def drawn(tiles: list[Tile]) -> Image.Image:
    """One row of a page."""
    from ..render.camera import fit
    from ..render.raster import render, render_mesh
    from ..render.sheet import captioned, page

    pictures = []
    for tile in tiles:
        camera = fit(tile.mesh.vertices, TILE, "three-quarter")
        if tile.colors is None:
            picture = render_mesh(tile.mesh, TILE, camera)
        else:
            picture = render(tile.mesh.vertices, tile.mesh.faces, camera, TILE, tile.colors)
        pictures.append(captioned(picture, tile.label))
    return page(pictures, len(pictures))


def folder_of_people(data: Path | None) -> list[Path]:
    """Mesh files of a folder.

    Raises:
        InputError: no folder given, or none with meshes.
    """
    if data is None or not data.is_dir():
        raise InputError(f"--data: expected a folder of people in {', '.join(SUFFIXES)} files, found {data}; give one")
    paths = sorted(path for path in data.iterdir() if path.suffix.lower() in (*SUFFIXES, ".obj", ".ply"))
    if not paths:
        raise InputError(f"{data}: expected meshes of people, found none; give another folder with --data")
    return paths
