"""Draws the pictures of the gallery: clips in panels side by side, or together in one scene."""

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
"""Base colours (linear RGB) of driving meshes and of meshes without materials, as in the studio."""
TILE = (270, 380)
"""Width and height (pixels) of one panel."""
FPS = 15.0
"""Frame rate of all clips; folders of frames do not store one."""


class Panel(NamedTuple):
    """A mesh or clip to draw."""

    file: str
    """Path below the gallery's folder."""
    label: str
    """Caption."""
    drives: bool = False
    """Whether it is a driving mesh, which is drawn in blue."""
    place: tuple[float, float] = (0.0, 0.0)
    """Position in a common scene: metres to the left of the centre, and metres towards the viewer."""


Movie = tuple[list[Image.Image], float]
"""Frames, and frames per second."""


def side_by_side(
    folder: Path,
    panels: Sequence[Panel],
    tile: tuple[int, int] = TILE,
    view: str | tuple[float, float] = "three-quarter",
) -> Movie:
    """Draw clips in separate panels with a camera that follows them; meshes are drawn as static clips."""
    clips = [load_clip(folder / panel.file, fps=FPS) for panel in panels]
    length = max(map(len, clips))
    clips = [_extended(clip, length) for clip in clips]
    tints = [sheet.DRIVING_TINT if panel.drives else None for panel in panels]
    named = [(panel.label, clip) for panel, clip in zip(panels, clips, strict=True)]
    return list(movie.clip_frames(named, tile, view=view, tints=tints, track=True)), FPS


def on_one_floor(
    folder: Path, panels: Sequence[Panel], size: tuple[int, int], view: tuple[float, float] = (0.0, 9.0)
) -> Movie:
    """Draw clips in one scene with one camera; `view` is azimuth and elevation in degrees."""
    scene = merge_clips([load_clip(folder / panel.file, fps=FPS) for panel in panels], panels)
    return list(movie.clip_frames(scene, size, view=view)), FPS


def merge_clips(clips: Sequence[Clip], panels: Sequence[Panel]) -> Clip:
    """Merge clips into one clip; each one begins at the place of its panel, with its lowest point on the floor."""
    length = max(len(clip) for clip in clips)
    vertices, faces, parts, count = [], [], [], 0
    for clip, panel in zip(clips, panels, strict=True):
        points = np.asarray(_extended(clip, length).vertices, np.float64)
        low, high = points[0].min(axis=0), points[0].max(axis=0)
        origin = np.array([(low[0] + high[0]) / 2, points[..., 1].min(), (low[2] + high[2]) / 2])
        x, z = panel.place
        parts += _parts(clip.mesh, sum(map(len, faces)), BLUE if panel.drives else None)
        faces.append(clip.mesh.faces + count)
        vertices.append(points - origin + [x, 0.0, z])
        count += points.shape[1]
    merged = np.concatenate(vertices, axis=1)
    return Clip(Mesh(merged[0], np.concatenate(faces), parts=tuple(parts)), merged, FPS)


def stills(folder: Path, panels: Sequence[Panel], tile: tuple[int, int] = TILE) -> Image.Image:
    """Draw meshes side by side, each scaled to its panel."""
    tiles = []
    for panel in panels:
        mesh = load_mesh(folder / panel.file)
        if panel.drives:
            mesh = dataclasses.replace(mesh, parts=tuple(_parts(mesh, 0, BLUE)))
        shot = camera.fit(mesh.vertices, tile)
        tiles.append(sheet.captioned(raster.render_mesh(mesh, tile, shot), panel.label))
    return sheet.page(tiles, len(tiles))


def heat(folder: Path, files: Sequence[tuple[str, str]], truth: str, limit: float) -> Image.Image:
    """Draw results coloured by their distance to the truth, with one colour scale and one camera.

    `files` are pairs of file and label; `limit` is the distance (metres) of the last colour.
    """
    true_mesh, tile, tiles = load_mesh(folder / truth), (250, 340), []
    meshes = [load_mesh(folder / file) for file, _ in files]
    points = [mesh.vertices - mesh.vertices.mean(axis=0) + true_mesh.vertices.mean(axis=0) for mesh in meshes]
    shot = camera.fit(np.stack(points), tile)
    for (_, label), mesh, vertices in zip(files, meshes, points, strict=True):
        distance = np.linalg.norm(vertices - true_mesh.vertices, axis=1)
        picture = raster.render(vertices, mesh.faces, shot, tile, heat_colors(distance / limit))
        tiles.append(sheet.captioned(picture, f"{label}: {1000 * distance.mean():.0f} mm"))
    return sheet.page(tiles, len(tiles))


def _extended(clip: Clip, length: int) -> Clip:
    """Extend a clip to `length` frames by repeating its last frame."""
    return dataclasses.replace(clip, vertices=clip.vertices[np.minimum(np.arange(length), len(clip) - 1)])


def _parts(mesh: Mesh, start: int, colour: Colour | None) -> list[Part]:
    """Return the parts of a mesh with their triangles numbered from `start`; one part if `colour` is given."""
    if colour is not None or not mesh.parts:
        material = Material("clay", (*(colour or CLAY), 1.0))
        return [Part(mesh.name, start, start + len(mesh.faces), material)]
    return [dataclasses.replace(part, start=part.start + start, stop=part.stop + start) for part in mesh.parts]
