"""Heat maps: how far a mesh or clip is from the truth, or how much its edges are stretched, as colours with a scale."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..core.errors import InputError
from ..core.frame_buffer import each_frame
from ..core.geometry import edges
from ..core.mesh import Clip, Mesh
from .movie import clip_cameras, posing
from .raster import render
from .shading import BACKGROUND
from .sheet import FAINT, Color, captioned, font, ink

if TYPE_CHECKING:
    from PIL import Image

HEAT = ((0.80, 0.79, 0.77), (0.95, 0.80, 0.52), (0.93, 0.55, 0.27), (0.78, 0.23, 0.24), (0.45, 0.07, 0.28))
"""From no error to the limit; lightness falls all the way, so the order survives grey printing and colour blindness."""
TILE = (520, 620)
SAMPLED = 24
"""Frames of a clip that decide the deepest colour of its heat map."""

Measure = Callable[[int, np.ndarray], np.ndarray]
"""Of a frame's number and its vertices (V, 3): a figure for every vertex (V,), in the unit that is shown."""


def heat_map(
    result: Mesh,
    truth: Mesh | Float[np.ndarray, "V 3"],
    limit: float | None = None,
    unit: str = "mm",
    per_unit: float = 1000.0,
    tile: tuple[int, int] = TILE,
    *,
    view: str | tuple[float, float] = "three-quarter",
    up: str = "y",
    front: str | None = None,
) -> Image.Image:
    """The result coloured by each vertex's distance to the truth, with a colour bar in units.

    Args:
        limit: distance (of the mesh's own unit) at the deepest colour; by default the 99th percentile.
        unit: what the bar's numbers are called.
        per_unit: how many of it make one unit of the mesh; metres to millimetres by default.

    Raises:
        InputError: another number of vertices.
    """
    measure = distance_to(Clip.still(result), truth if isinstance(truth, np.ndarray) else truth.vertices, per_unit)
    shown = None if limit is None else limit * per_unit
    return next(heat_frames(Clip.still(result), measure, unit, tile, limit=shown, view=view, up=up, front=front))


def heat_frames(
    clip: Clip,
    measure: Measure,
    unit: str,
    tile: tuple[int, int] = TILE,
    *,
    limit: float | None = None,
    view: str | tuple[float, float] = "three-quarter",
    up: str = "y",
    front: str | None = None,
    track: bool = False,
    labels: bool = True,
    background: Color = BACKGROUND,
) -> Iterator[Image.Image]:
    """Yield a clip's pictures coloured by a figure per vertex, with one scale for all of them.

    Args:
        limit: figure at the deepest colour; by default the 99th percentile over some frames, evenly spread.
        track: the camera goes along the floor with the subject.
    """
    from PIL import Image

    limit = limit or _limit(clip, measure)
    cameras = clip_cameras(clip, tile, view, track, up, front)
    bar, pose = None, posing(clip.mesh)
    for t, (points, camera) in enumerate(zip(each_frame(clip.vertices), cameras, strict=True)):
        mesh, figure = pose(points), measure(t, points)
        colors = heat_colors(figure / limit)
        picture = render(
            points, mesh.faces, camera, tile, colors, corner_normals=mesh.corner_normals, background=background
        )
        if bar is None:
            bar = color_bar(picture, limit, unit, clipped=bool(figure.max() > limit * 1.0001) or len(clip) > 1)
        picture = np.concatenate([picture, bar], axis=1)
        label = f"mean {figure.mean():.3g} {unit}, largest {figure.max():.3g} {unit}"
        yield captioned(picture, label) if labels else Image.fromarray(picture)


def distance_to(clip: Clip, truth: Float[np.ndarray, "... V 3"], per_unit: float = 1000.0) -> Measure:
    """Distance of every vertex to its place in the truth: a mesh, or a clip of as many frames.

    Raises:
        InputError: another number of vertices or frames.
    """
    _same_vertices(clip, truth.shape[-2], "the truth")
    if truth.ndim == 3 and len(truth) not in (1, len(clip)):
        raise InputError(
            f"{clip.mesh.name}: expected the truth to have {len(clip)} frames, found {len(truth)}; "
            "compare clips of one length"
        )
    frames = truth.reshape(-1, *truth.shape[-2:])
    return lambda t, points: np.linalg.norm(points - frames[t % len(frames)], axis=1) * per_unit


def stretch_of(clip: Clip, reference: Float[np.ndarray, "V 3"]) -> Measure:
    """Change in length of the edges at every vertex, the mean of their absolute values, in percent of the reference.

    Edges of no length in the reference are left out.

    Raises:
        InputError: another number of vertices, or no edges.
    """
    _same_vertices(clip, len(reference), "the reference")
    if len(clip.mesh.faces) == 0:
        raise InputError(f"{clip.mesh.name}: expected faces to measure stretch, found points alone; give a mesh")
    pairs, lengths = _edges_with_length(clip.mesh.faces, reference)
    degree = np.maximum(np.bincount(pairs.ravel(), minlength=len(reference)), 1)

    def measure(t: int, points: np.ndarray) -> np.ndarray:
        change = np.abs(_lengths(points, pairs) / lengths - 1) * 100
        return np.bincount(pairs.ravel(), np.repeat(change, 2), minlength=len(points)) / degree

    return measure


def heat_colors(share: Float[np.ndarray, " V"]) -> Float[np.ndarray, "V 3"]:
    """Colour (sRGB in 0..1) of an error given as a share of the limit; below 0 and above 1 are clipped."""
    stops = np.linspace(0, 1, len(HEAT))
    return np.stack([np.interp(share, stops, channel) for channel in zip(*HEAT, strict=True)], axis=1)


def color_bar(picture: np.ndarray, limit: float, unit: str, clipped: bool) -> np.ndarray:
    """A vertical scale from 0 to the limit with five ticks, on the paper of the picture that it stands beside."""
    from PIL import Image, ImageDraw

    height, paper = len(picture), tuple(picture[0, 0].tolist())
    size = max(11, height // 40)
    image = Image.new("RGB" if len(paper) == 3 else "RGBA", (round(6.5 * size), height), paper)
    top, bottom, left, right = round(0.2 * height), round(0.8 * height), size, round(2.1 * size)
    share = np.linspace(1, 0, bottom - top)
    bar = (np.repeat(heat_colors(share)[:, None], right - left, axis=1) * 255).round().astype(np.uint8)
    image.paste(Image.fromarray(bar), (left, top))
    draw = ImageDraw.Draw(image)
    for k in range(5):
        y = bottom - (bottom - top) * k / 4
        more = "+" if clipped and k == 4 else ""
        draw.line([(right, y), (right + 0.35 * size, y)], FAINT, 1)
        draw.text((right + 0.7 * size, y), f"{limit * k / 4:.3g}{more}", ink(paper), font(size), anchor="lm")
    draw.text((left, top - 1.1 * size), unit, FAINT, font(size), anchor="ls")
    return np.asarray(image)


def _limit(clip: Clip, measure: Measure) -> float:
    chosen = np.unique(np.linspace(0, len(clip) - 1, SAMPLED).round().astype(int)).tolist()
    figures = [measure(t, np.asarray(clip.vertices[t], np.float64)) for t in chosen]
    return float(np.percentile(figures, 99)) or 1.0


def _same_vertices(clip: Clip, count: int, what: str) -> None:
    expected = clip.vertices.shape[1]
    if count != expected:
        raise InputError(
            f"{clip.mesh.name}: expected {what} to have {expected} vertices, found {count}; "
            "compare meshes of one topology"
        )


def _edges_with_length(faces: Int[np.ndarray, "F 3"], points: Float[np.ndarray, "V 3"]):
    pairs = edges(faces)
    lengths = _lengths(points, pairs)
    return pairs[lengths > 0], lengths[lengths > 0]


def _lengths(points, pairs):
    return np.linalg.norm(points[pairs[:, 1]] - points[pairs[:, 0]], axis=1)
