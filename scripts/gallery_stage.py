"""How the gallery is drawn: clips in panels side by side, or all together on one floor."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from mimesh.bodies.characters import Colour
from mimesh.core.mesh import Clip, Material, Mesh, Part
from mimesh.io import load_clip, load_mesh
from mimesh.render import camera, movie, raster, sheet
from mimesh.render.heat import heat_colors

BLUE: Colour = (0.418, 0.553, 0.709)
CLAY: Colour = (0.795, 0.709, 0.618)
"""The studio's tint of what drives, and its clay, as materials have them: linear, of white paint."""
TILE = (270, 380)
FPS = 15.0
"""Of all clips; folders do not say."""


class Panel(NamedTuple):
    """One thing to show: a file, what is written below it, and whether it drives."""

    file: str
    label: str
    drives: bool = False
    place: tuple[float, float] = (0.0, 0.0)
    """Metres to the left of the middle of the floor and towards the viewer, where all share one."""


Movie = tuple[list[Image.Image], float]
"""Frames and how many a second."""


def side_by_side(folder: Path, panels: Sequence[Panel], tile: tuple[int, int] = TILE) -> Movie:
    """Frames of clips in panels of their own, the camera going along, and their rate; meshes stand still."""
    clips = [load_clip(folder / panel.file, fps=FPS) for panel in panels]
    length = max(map(len, clips))
    clips = [_held(clip, length) for clip in clips]
    tints = [sheet.DRIVING_TINT if panel.drives else None for panel in panels]
    named = [(panel.label, clip) for panel, clip in zip(panels, clips, strict=True)]
    return list(movie.clip_frames(named, tile, tints=tints, track=True)), FPS


def on_one_floor(
    folder: Path, panels: Sequence[Panel], size: tuple[int, int], view: tuple[float, float] = (0.0, 9.0)
) -> Movie:
    """Frames of clips that share a floor and a camera, and their rate."""
    scene = together([load_clip(folder / panel.file, fps=FPS) for panel in panels], panels)
    return list(movie.clip_frames(scene, size, view=view)), FPS


def together(clips: Sequence[Clip], panels: Sequence[Panel]) -> Clip:
    """One clip of all: each begins at its place, on its lowest point."""
    length = max(len(clip) for clip in clips)
    vertices, faces, parts, count = [], [], [], 0
    for clip, panel in zip(clips, panels, strict=True):
        points = np.asarray(_held(clip, length).vertices, np.float64)
        low, high = points[0].min(axis=0), points[0].max(axis=0)
        stand = np.array([(low[0] + high[0]) / 2, points[..., 1].min(), (low[2] + high[2]) / 2])
        x, z = panel.place
        parts += _parts(clip.mesh, sum(map(len, faces)), BLUE if panel.drives else None)
        faces.append(clip.mesh.faces + count)
        vertices.append(points - stand + [x, 0.0, z])
        count += points.shape[1]
    merged = np.concatenate(vertices, axis=1)
    return Clip(Mesh(merged[0], np.concatenate(faces), parts=tuple(parts)), merged, FPS)


def stills(folder: Path, panels: Sequence[Panel], tile: tuple[int, int] = TILE) -> Image.Image:
    """Meshes side by side, each as large as its panel."""
    tiles = []
    for panel in panels:
        mesh = load_mesh(folder / panel.file)
        if panel.drives:
            mesh = dataclasses.replace(mesh, parts=tuple(_parts(mesh, 0, BLUE)))
        shot = camera.fit(mesh.vertices, tile)
        tiles.append(sheet.captioned(raster.render_mesh(mesh, tile, shot), panel.label))
    return sheet.page(tiles, len(tiles))


def heat(folder: Path, files: Sequence[tuple[str, str]], truth: str, limit: float) -> Image.Image:
    """Results coloured by their distance to the truth, all on one scale and from one camera: (file, label)."""
    true, tile, tiles = load_mesh(folder / truth), (250, 340), []
    meshes = [load_mesh(folder / file) for file, _ in files]
    points = [mesh.vertices - mesh.vertices.mean(axis=0) + true.vertices.mean(axis=0) for mesh in meshes]
    shot = camera.fit(np.stack(points), tile)
    for (_, label), mesh, vertices in zip(files, meshes, points, strict=True):
        off = np.linalg.norm(vertices - true.vertices, axis=1)
        picture = raster.render(vertices, mesh.faces, shot, tile, heat_colors(off / limit))
        tiles.append(sheet.captioned(picture, f"{label}: {1000 * off.mean():.0f} mm"))
    return sheet.page(tiles, len(tiles))


def _held(clip: Clip, length: int) -> Clip:
    """The clip, its last frame held until it is so long."""
    return dataclasses.replace(clip, vertices=clip.vertices[np.minimum(np.arange(length), len(clip) - 1)])


def _parts(mesh: Mesh, start: int, colour: Colour | None) -> list[Part]:
    """The parts of a mesh, its faces counted from `start`, each with a material."""
    if colour is not None or not mesh.parts:
        own = Material("clay", (*(colour or CLAY), 1.0))
        return [Part(mesh.name, start, start + len(mesh.faces), own)]
    return [dataclasses.replace(part, start=part.start + start, stop=part.stop + start) for part in mesh.parts]
