"""Sheets of captioned pictures as Pillow images: contact sheet, transfer and strip."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from ..core.errors import InputError
from ..core.mesh import Clip, Mesh
from .camera import fit, follow
from .raster import render_mesh
from .shading import BACKGROUND

if TYPE_CHECKING:
    from PIL import Image

TILE = (400, 480)
"""Width and height of one picture in pixels."""
INK = (74, 70, 66)
"""Captions on a light background, 8-bit sRGB; see `ink`."""
LIGHT_INK = (214, 210, 204)
"""Captions on a dark background, 8-bit sRGB."""
FAINT = (146, 140, 134)
"""Ticks, plus and equals signs, and captions on no background, 8-bit sRGB."""
DRIVING_TINT = (0.60, 0.68, 0.76)
"""sRGB slate blue of the driving mesh, wherever it is shown beside an identity in clay."""

Color = tuple[float, float, float] | None
"""sRGB in 0..1 of a background; None is transparent."""


def contact_sheet(
    items: Sequence[tuple[str, Mesh]],
    columns: int | None = None,
    tile: tuple[int, int] = TILE,
    *,
    view: str | tuple[float, float] = "three-quarter",
    clay: bool = False,
    up: str = "y",
    front: str | None = None,
    labels: bool = True,
    background: Color = BACKGROUND,
) -> Image.Image:
    """Draw meshes in rows, each as large as its tile allows, with its label below it.

    Args:
        columns: by default as many as make a nearly square sheet.
        clay: leave materials and textures out.
    """
    if not items:
        raise InputError("contact sheet: expected at least one mesh, found none; name a file")
    # Tiles are higher than wide, so that a nearly square sheet has more columns than rows.
    columns = columns or min(len(items), int(np.ceil(np.sqrt(1.6 * len(items)))))
    tiles = []
    for label, mesh in items:
        camera = fit(mesh.vertices, tile, view, up=up, front=front)
        picture = render_mesh(mesh, tile, camera, clay=clay, background=background)
        tiles.append(captioned(picture, label if labels else None))
    return page(tiles, columns)


def transfer_sheet(
    identity: Mesh, driving: Mesh, result: Mesh, truth: Mesh | None = None, tile: tuple[int, int] = TILE
) -> Image.Image:
    """Draw identity + driving = result, and the truth, if any, beside it from the same camera."""
    outputs = np.concatenate([m.vertices for m in (result, truth) if m is not None])
    identity_camera, driving_camera, camera = (
        fit(points, tile) for points in (identity.vertices, driving.vertices, outputs)
    )
    tiles = [
        captioned(render_mesh(identity, tile, identity_camera), "identity"),
        captioned(render_mesh(driving, tile, driving_camera, tint=DRIVING_TINT), "driving"),
        captioned(render_mesh(result, tile, camera), "result"),
    ]
    if truth is not None:
        tiles.append(captioned(render_mesh(truth, tile, camera), "truth"))
    sheet = page(tiles, len(tiles))
    _draw_signs(sheet, tile)
    return sheet


def strip(
    clip: Clip,
    frames: int = 8,
    tile: tuple[int, int] = (260, 340),
    *,
    view: str | tuple[float, float] = "three-quarter",
    tint: tuple[float, float, float] | None = None,
    clay: bool = False,
    up: str = "y",
    front: str | None = None,
    labels: bool = True,
    background: Color = BACKGROUND,
    times: Sequence[float] | None = None,
) -> Image.Image:
    """Draw frames of a clip side by side, first to last, with their times; the camera follows at one distance.

    Args:
        times: in seconds, of each frame; None: as the clip's rate has them.
    """
    chosen = np.unique(np.linspace(0, len(clip) - 1, frames).round().astype(int))
    points = np.asarray(clip.vertices[chosen], np.float64)
    tiles = []
    for k, camera, vertices in zip(chosen, follow(points, tile, view, up=up, front=front), points, strict=True):
        mesh = clip.mesh.with_vertices(vertices)
        picture = render_mesh(mesh, tile, camera, clay=clay, tint=tint, background=background)
        tiles.append(captioned(picture, f"{k / clip.fps if times is None else times[k]:.2f} s" if labels else None))
    return page(tiles, len(tiles))


def captioned(picture: UInt8[np.ndarray, "h w C"], label: str | None) -> Image.Image:
    """Add a line of text centred below a picture, shortened to fit; without a label, return the picture alone.

    The background of the caption has the colour of the picture's corner.
    """
    from PIL import Image, ImageDraw

    if label is None:
        return Image.fromarray(picture)
    height, width = picture.shape[:2]
    background = tuple(picture[0, 0].tolist())
    size = 6 + round(min(width, height) / 36)
    image = Image.new("RGB" if len(background) == 3 else "RGBA", (width, height + round(2.1 * size)), background)
    image.paste(Image.fromarray(picture))
    draw, typeface = ImageDraw.Draw(image), font(size)
    # Two characters are dropped per step: one for the ellipsis, one to get shorter.
    while draw.textlength(label, typeface) > 0.94 * width and len(label) > 2:
        label = label[:-2].rstrip() + "…"
    draw.text((width / 2, height + 0.35 * size), label, ink(background), typeface, anchor="ma")
    return image


def page(tiles: Sequence[Image.Image], columns: int) -> Image.Image:
    """Arrange equal tiles on one sheet, row by row; a short last row is centred."""
    from PIL import Image

    width, height = tiles[0].size
    rows = -(-len(tiles) // columns)
    sheet = Image.new(tiles[0].mode, (width * columns, height * rows), tiles[0].getpixel((0, 0)))
    for k, tile in enumerate(tiles):
        row, column = divmod(k, columns)
        missing = columns - min(columns, len(tiles) - row * columns)
        sheet.paste(tile, (column * width + missing * width // 2, row * height))
    return sheet


def stack(rows: Sequence[Image.Image]) -> Image.Image:
    """Stack sheets, such as the strips of a driving clip and of its result, centred on the widest."""
    from PIL import Image

    width = max(row.width for row in rows)
    sheet = Image.new(rows[0].mode, (width, sum(row.height for row in rows)), rows[0].getpixel((0, 0)))
    top = 0
    for row in rows:
        sheet.paste(row, ((width - row.width) // 2, top))
        top += row.height
    return sheet


def _draw_signs(sheet: Image.Image, tile: tuple[int, int]) -> None:
    from PIL import ImageDraw

    draw = ImageDraw.Draw(sheet)
    arm, line, y = tile[0] / 40, max(2, tile[0] // 130), tile[1] / 2
    draw.line([(tile[0] - arm, y), (tile[0] + arm, y)], FAINT, line)
    draw.line([(tile[0], y - arm), (tile[0], y + arm)], FAINT, line)
    for offset in (-0.45 * arm, 0.45 * arm):
        draw.line([(2 * tile[0] - arm, y + offset), (2 * tile[0] + arm, y + offset)], FAINT, line)


def font(size: int):
    """Load the font of all captions, at a height in pixels."""
    from PIL import ImageFont

    return ImageFont.load_default(size)


def ink(background: tuple[int, ...]) -> tuple[int, int, int]:
    """Choose a legible text colour for a background (8-bit RGB or RGBA); if transparent, legible on white and black."""
    if len(background) == 4 and background[3] == 0:
        return FAINT
    return INK if sum(background[:3]) > 3 * 110 else LIGHT_INK
