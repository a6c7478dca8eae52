"""Heat maps: the distance of a mesh or clip to the truth as colours with a colour bar."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..core.errors import InputError
from ..core.frame_buffer import each_frame
from ..core.mesh import Clip, Mesh
from .movie import clip_cameras, mesh_poser
from .raster import render
from .shading import BACKGROUND
from .sheet import FAINT, Color, captioned, font, ink

if TYPE_CHECKING:
    from PIL import Image

HEAT = ((0.80, 0.79, 0.77), (0.95, 0.80, 0.52), (0.93, 0.55, 0.27), (0.78, 0.23, 0.24), (0.45, 0.07, 0.28))
"""sRGB stops from no error to the limit; lightness falls all the way, so that the order is visible in grey, too."""
TILE = (520, 620)
"""Width and height of the picture in pixels, without the colour bar."""
SAMPLED = 24
"""Frames of a clip, evenly spaced, from which the limit of its heat map is computed."""
MILLIMETRES = 1000.0
"""In a metre, the unit of meshes."""


def heat_map(
    result: Mesh, truth: Mesh | Float[np.ndarray, "V 3"], limit: float | None = None, tile: tuple[int, int] = TILE
) -> Image.Image:
    """Draw the result (metres) coloured by each vertex's distance to the truth, with a colour bar in millimetres.

    Args:
        limit: distance in metres at the last colour; by default the 99th percentile.
    """
    points = truth if isinstance(truth, np.ndarray) else truth.vertices
    shown_limit = None if limit is None else limit * MILLIMETRES
    return next(heat_frames(Clip.still(result), points[None], tile, limit=shown_limit))


def heat_frames(
    clip: Clip,
    truth: Float[np.ndarray, "T V 3"],
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
    """Yield a clip's pictures coloured by each vertex's distance (mm) to the truth, with one scale for all of them.

    Args:
        truth: as many frames as the clip has, or one for all.
        limit: distance at the last colour; by default the 99th percentile over SAMPLED frames.
        track: the camera follows the subject along the floor.

    Raises:
        InputError: clip and truth have different numbers of vertices or frames.
    """
    from PIL import Image

    _check_shapes(clip, truth)
    limit = limit or _limit(clip, truth)
    cameras = clip_cameras(clip, tile, view, track, up, front)
    bar, pose_mesh = None, mesh_poser(clip.mesh)
    for t, (points, camera) in enumerate(zip(each_frame(clip.vertices), cameras, strict=True)):
        mesh, values = pose_mesh(points), _distances(points, truth, t)
        colors = heat_colors(values / limit)
        picture = render(
            points, mesh.faces, camera, tile, colors, corner_normals=mesh.corner_normals, background=background
        )
        if bar is None:
            # A later frame of a clip may exceed the limit: its bar always says so.
            bar = color_bar(picture, limit, "mm", clipped=bool(values.max() > limit * 1.0001) or len(clip) > 1)
        picture = np.concatenate([picture, bar], axis=1)
        label = f"mean {values.mean():.3g} mm, largest {values.max():.3g} mm"
        yield captioned(picture, label) if labels else Image.fromarray(picture)


def _distances(points: Float[np.ndarray, "V 3"], truth: Float[np.ndarray, "T V 3"], t: int) -> Float[np.ndarray, " V"]:
    return np.linalg.norm(points - truth[t % len(truth)], axis=1) * MILLIMETRES


def heat_colors(share: Float[np.ndarray, " V"]) -> Float[np.ndarray, "V 3"]:
    """Map errors, as shares of the limit, to colours (sRGB in 0..1); below 0 and above 1 are clipped."""
    stops = np.linspace(0, 1, len(HEAT))
    return np.stack([np.interp(share, stops, channel) for channel in zip(*HEAT, strict=True)], axis=1)


def color_bar(picture: np.ndarray, limit: float, unit: str, clipped: bool) -> np.ndarray:
    """Draw a vertical colour bar from 0 to the limit with five ticks, as high as a picture and on its background."""
    from PIL import Image, ImageDraw

    height, background = len(picture), tuple(picture[0, 0].tolist())
    size = max(11, height // 40)
    image = Image.new("RGB" if len(background) == 3 else "RGBA", (round(6.5 * size), height), background)
    top, bottom, left, right = round(0.2 * height), round(0.8 * height), size, round(2.1 * size)
    share = np.linspace(1, 0, bottom - top)
    bar = (np.repeat(heat_colors(share)[:, None], right - left, axis=1) * 255).round().astype(np.uint8)
    image.paste(Image.fromarray(bar), (left, top))
    draw = ImageDraw.Draw(image)
    for k in range(5):
        y = bottom - (bottom - top) * k / 4
        plus = "+" if clipped and k == 4 else ""
        draw.line([(right, y), (right + 0.35 * size, y)], FAINT, 1)
        draw.text((right + 0.7 * size, y), f"{limit * k / 4:.3g}{plus}", ink(background), font(size), anchor="lm")
    draw.text((left, top - 1.1 * size), unit, FAINT, font(size), anchor="ls")
    return np.asarray(image)


def _limit(clip: Clip, truth: Float[np.ndarray, "T V 3"]) -> float:
    # A percentile, since the maximum is often one broken vertex that would leave the rest without colour.
    chosen = np.unique(np.linspace(0, len(clip) - 1, SAMPLED).round().astype(int)).tolist()
    values = [_distances(np.asarray(clip.vertices[t], np.float64), truth, t) for t in chosen]
    return float(np.percentile(values, 99)) or 1.0


def _check_shapes(clip: Clip, truth: Float[np.ndarray, "T V 3"]) -> None:
    expected, found = clip.vertices.shape[1], truth.shape[1]
    if found != expected:
        raise InputError(
            f"{clip.mesh.name}: expected the truth to have {expected} vertices, found {found}; "
            "compare meshes of one topology"
        )
    if len(truth) not in (1, len(clip)):
        raise InputError(
            f"{clip.mesh.name}: expected the truth to have {len(clip)} frames, found {len(truth)}; "
            "compare clips of one length"
        )
