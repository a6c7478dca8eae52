"""Pages of pictures: contact sheet, transfer, strip, turntable and heat map, each with captions, as Pillow images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, UInt8

from ..mesh import Clip, InputError, Mesh
from .camera import Camera, fit, follow, orbit
from .light import BACKGROUND
from .raster import render, render_mesh

if TYPE_CHECKING:
    from PIL import Image

TILE = (400, 480)
"""Width and height of one picture in pixels."""
INK = (74, 70, 66)
"""Captions, sRGB 8 bit."""
FAINT = (146, 140, 134)
"""Ticks, signs and second lines."""
DRIVING_TINT = (0.60, 0.68, 0.76)
"""The driving mesh is slate blue wherever it stands beside an identity in clay."""
HEAT = ((0.80, 0.79, 0.77), (0.95, 0.80, 0.52), (0.93, 0.55, 0.27), (0.78, 0.23, 0.24), (0.45, 0.07, 0.28))
"""From no error to the limit; lightness falls all the way, so the order survives grey printing and colour blindness."""


def contact_sheet(
    items: Sequence[tuple[str, Mesh]],
    columns: int | None = None,
    tile: tuple[int, int] = TILE,
    *,
    view: str | tuple[float, float] = "three-quarter",
    clay: bool = False,
    up: str = "y",
    front: str | None = None,
) -> Image.Image:
    """Meshes in rows, each as large as its tile allows, with its label below it.

    Args:
        columns: a near-square page by default.
        clay: leave materials and textures out.
    """
    if not items:
        raise InputError("contact sheet: expected at least one mesh, found none; name a file")
    columns = columns or min(len(items), int(np.ceil(np.sqrt(1.6 * len(items)))))
    tiles = []
    for label, mesh in items:
        camera = fit(mesh.vertices, tile, view, up=up, front=front)
        tiles.append(captioned(render_mesh(mesh, tile, camera, clay=clay), label))
    return page(tiles, columns)


def transfer_sheet(
    identity: Mesh,
    driving: Mesh,
    result: Mesh,
    truth: Mesh | None = None,
    tile: tuple[int, int] = TILE,
    *,
    view: str | tuple[float, float] = "three-quarter",
    up: str = "y",
    front: str | None = None,
) -> Image.Image:
    """Identity + driving = result, and the truth beside it from the same camera if there is one."""
    shown = np.concatenate([m.vertices for m in (result, truth) if m is not None])
    before, source, camera = (
        fit(points, tile, view, up=up, front=front) for points in (identity.vertices, driving.vertices, shown)
    )
    tiles = [
        captioned(render_mesh(identity, tile, before), "identity"),
        captioned(_tinted(driving, tile, source), "driving"),
        captioned(render_mesh(result, tile, camera), "result"),
    ]
    if truth is not None:
        tiles.append(captioned(render_mesh(truth, tile, camera), "truth"))
    sheet = page(tiles, len(tiles))
    _signs(sheet, tile)
    return sheet


def strip(
    clip: Clip,
    frames: int = 8,
    tile: tuple[int, int] = (260, 340),
    *,
    view: str | tuple[float, float] = "three-quarter",
    tint: tuple[float, float, float] | None = None,
    up: str = "y",
    front: str | None = None,
) -> Image.Image:
    """Frames of a clip side by side, first to last, with their times; one distance, moving along with the subject."""
    chosen = np.unique(np.linspace(0, len(clip) - 1, frames).round().astype(int))
    points = np.asarray(clip.vertices[chosen], np.float64)
    tiles = []
    for k, camera, vertices in zip(chosen, follow(points, tile, view, up=up, front=front), points, strict=True):
        picture = _tinted(clip.mesh.with_vertices(vertices), tile, camera, tint)
        tiles.append(captioned(picture, f"{k / clip.fps:.2f} s"))
    return page(tiles, len(tiles))


def turntable(
    mesh: Mesh,
    count: int = 8,
    tile: tuple[int, int] = (340, 320),
    *,
    view: str | tuple[float, float] = "three-quarter",
    clay: bool = False,
    up: str = "y",
    front: str | None = None,
) -> Image.Image:
    """The mesh from evenly spaced sides at one distance, in two rows."""
    cameras = orbit(mesh.vertices, tile, count, view, up=up, front=front)
    tiles = [
        captioned(render_mesh(mesh, tile, camera, clay=clay), f"{round(360 * k / count)}°")
        for k, camera in enumerate(cameras)
    ]
    return page(tiles, max(1, (count + 1) // 2))


def heat_map(
    result: Mesh,
    truth: Mesh | Float[np.ndarray, "V 3"],
    limit: float | None = None,
    unit: str = "mm",
    per_unit: float = 1000.0,
    tile: tuple[int, int] = (520, 620),
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
    target = truth.vertices if isinstance(truth, Mesh) else truth
    if target.shape != result.vertices.shape:
        raise InputError(
            f"{result.name}: expected the truth to have {len(result.vertices)} vertices, found {len(target)}; "
            "compare meshes of one topology"
        )
    distance = np.linalg.norm(result.vertices - target, axis=1)
    limit = limit or float(np.percentile(distance, 99)) or 1.0 / per_unit
    camera = fit(result.vertices, tile, view, up=up, front=front)
    colors = heat_colors(distance / limit)
    picture = render(result.vertices, result.faces, camera, tile, colors, corner_normals=result.corner_normals)
    label = f"mean {distance.mean() * per_unit:.3g} {unit}, largest {distance.max() * per_unit:.3g} {unit}"
    bar = _color_bar(tile[1], limit * per_unit, unit, clipped=bool(distance.max() > limit * 1.0001))
    return captioned(np.concatenate([picture, bar], axis=1), label)


def heat_colors(share: Float[np.ndarray, " V"]) -> Float[np.ndarray, "V 3"]:
    """Colour (sRGB in 0..1) of an error given as a share of the limit; below 0 and above 1 are clipped."""
    stops = np.linspace(0, 1, len(HEAT))
    return np.stack([np.interp(share, stops, channel) for channel in zip(*HEAT, strict=True)], axis=1)


def captioned(picture: UInt8[np.ndarray, "h w 3"], label: str) -> Image.Image:
    """The picture with a line of text centred below it, shortened to fit."""
    from PIL import Image, ImageDraw

    height, width = picture.shape[:2]
    size = 6 + round(min(width, height) / 36)
    image = Image.new("RGB", (width, height + round(2.1 * size)), _paper())
    image.paste(Image.fromarray(picture))
    draw, font = ImageDraw.Draw(image), _font(size)
    while draw.textlength(label, font) > 0.94 * width and len(label) > 2:
        label = label[:-2].rstrip() + "…"
    draw.text((width / 2, height + 0.35 * size), label, INK, font, anchor="ma")
    return image


def page(tiles: Sequence[Image.Image], columns: int) -> Image.Image:
    """Equal tiles on one sheet of paper, row by row; a short last row is centred."""
    from PIL import Image

    width, height = tiles[0].size
    rows = -(-len(tiles) // columns)
    sheet = Image.new("RGB", (width * columns, height * rows), _paper())
    for k, tile in enumerate(tiles):
        row, column = divmod(k, columns)
        missing = columns - min(columns, len(tiles) - row * columns)
        sheet.paste(tile, (column * width + missing * width // 2, row * height))
    return sheet


def stack(rows: Sequence[Image.Image]) -> Image.Image:
    """Pages one below another, such as the strips of a driving clip and of its result, centred on the widest."""
    from PIL import Image

    width = max(row.width for row in rows)
    sheet = Image.new("RGB", (width, sum(row.height for row in rows)), _paper())
    top = 0
    for row in rows:
        sheet.paste(row, ((width - row.width) // 2, top))
        top += row.height
    return sheet


def _tinted(mesh: Mesh, tile: tuple[int, int], camera: Camera, tint=DRIVING_TINT) -> np.ndarray:
    if tint is None:
        return render_mesh(mesh, tile, camera)
    normals = mesh.corner_normals
    return render(mesh.vertices, mesh.faces, camera, tile, np.array(tint), corner_normals=normals)


def _signs(sheet: Image.Image, tile: tuple[int, int]) -> None:
    """Draw + and = between the first three tiles of a new sheet."""
    from PIL import ImageDraw

    draw = ImageDraw.Draw(sheet)
    arm, line, y = tile[0] / 40, max(2, tile[0] // 130), tile[1] / 2
    draw.line([(tile[0] - arm, y), (tile[0] + arm, y)], FAINT, line)
    draw.line([(tile[0], y - arm), (tile[0], y + arm)], FAINT, line)
    for offset in (-0.45 * arm, 0.45 * arm):
        draw.line([(2 * tile[0] - arm, y + offset), (2 * tile[0] + arm, y + offset)], FAINT, line)


def _color_bar(height: int, limit: float, unit: str, clipped: bool) -> np.ndarray:
    """A vertical scale from 0 to the limit with five ticks."""
    from PIL import Image, ImageDraw

    size = max(11, height // 40)
    image = Image.new("RGB", (round(6.5 * size), height), _paper())
    top, bottom, left, right = round(0.2 * height), round(0.8 * height), size, round(2.1 * size)
    share = np.linspace(1, 0, bottom - top)
    bar = (np.repeat(heat_colors(share)[:, None], right - left, axis=1) * 255).round().astype(np.uint8)
    image.paste(Image.fromarray(bar), (left, top))
    draw, font = ImageDraw.Draw(image), _font(size)
    for k in range(5):
        y = bottom - (bottom - top) * k / 4
        more = "+" if clipped and k == 4 else ""
        draw.line([(right, y), (right + 0.35 * size, y)], FAINT, 1)
        draw.text((right + 0.7 * size, y), f"{limit * k / 4:.3g}{more}", INK, font, anchor="lm")
    draw.text((left, top - 1.1 * size), unit, FAINT, font, anchor="ls")
    return np.asarray(image)


def _font(size: int):
    from PIL import ImageFont

    return ImageFont.load_default(size)


def _paper() -> tuple[int, int, int]:
    red, green, blue = (round(channel * 255) for channel in BACKGROUND)
    return red, green, blue
