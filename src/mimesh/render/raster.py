"""Pictures of meshes: a z-buffer, smooth shading and soft studio shadows in NumPy alone, the same on every machine."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..core.mesh import Mesh
from . import shading as light
from . import shadow
from . import textures as paint
from .camera import Camera, fit
from .shading import to_linear
from .textures import mixed, unit
from .zbuffer import Hits, visible_faces, weights_at

SMOOTH = 0.005
"""Blur of shadows on the subject, as a share of the picture's longer side."""
LIGHTS = 256
"""Places along the longer side at which light is asked for: it is blurred anyway."""


def render(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    camera: Camera,
    size: tuple[int, int] = (512, 512),
    colors: Float[np.ndarray, "V 3"] | Float[np.ndarray, " 3"] | None = None,
    *,
    supersample: int = 2,
    corner_normals: Float[np.ndarray, "F 3 3"] | None = None,
    surface: paint.Paint | None = None,
    shadows: bool = True,
    background: tuple[float, float, float] | None = light.BACKGROUND,
) -> UInt8[np.ndarray, "h w C"]:
    """A picture of a mesh, or of a point cloud (no faces) as small discs; sRGB, 8 bit, rows from the top.

    Both sides of a face are drawn alike. A face that reaches behind the camera's eye is left out, not clipped.

    Args:
        size: width and height in pixels.
        colors: sRGB in 0..1, one or one per vertex; a warm grey clay by default.
        supersample: s gives s * s samples per pixel, no two of them in one row or column.
        corner_normals: shading normals; smooth with creases by default.
        surface: base colours as `paint.materials` gives them, instead of `colors`.
        shadows: soft shadows on the subject and on the floor (about a third of the time).
        background: sRGB in 0..1; None gives RGBA with nothing behind the subject and its shadow.
    """
    if len(faces) == 0:
        vertices, faces, corner_normals, colors = paint.discs(vertices, camera, colors)
    if corner_normals is None:
        corner_normals = paint.creased_normals(vertices, faces)
    hits, count, normals = _fragments(vertices, faces, corner_normals, camera, size, supersample)
    dark, sky, key = np.zeros(size[::-1], np.float32), np.ones(size[::-1]), np.ones(size[::-1])
    if shadows:
        cast, block = shadow.cast(vertices, faces, camera), max(1, round(max(size) / LIGHTS))
        sky, key = _light_per_pixel(cast, vertices, faces, hits, normals, size, block)
        dark = shadow.floor_shadow(cast, camera, size, block)
    albedo = (surface or paint.plain(colors, faces))(hits)
    color = light.shade(albedo, normals, sky.ravel()[hits.pixel], key.ravel()[hits.pixel], camera)
    total, covered = _resolve(color, hits, count, size, supersample)
    if background is None:
        return _transparent(total, covered, dark)
    return _over_paper(total, covered, dark, background)


def render_mesh(
    mesh: Mesh,
    size: tuple[int, int] = (512, 512),
    camera: Camera | None = None,
    *,
    view: str | tuple[float, float] = "three-quarter",
    clay: bool = False,
    tint: tuple[float, float, float] | None = None,
    supersample: int = 2,
    shadows: bool = True,
    background: tuple[float, float, float] | None = light.BACKGROUND,
) -> UInt8[np.ndarray, "h w C"]:
    """A picture of a mesh with its own materials, textures, vertex colours and hard edges.

    `clay` leaves the colours out; so does `tint`, an sRGB colour in 0..1 instead of them.
    """
    own = not clay and tint is None
    if own and mesh.vertex_colors is not None and len(mesh.faces) == 0:
        colors = light.to_srgb(mesh.vertex_colors[:, :3] * paint.WHITE)
    else:
        colors = None if tint is None else np.asarray(tint, np.float64)
    return render(
        mesh.vertices,
        mesh.faces,
        camera or fit(mesh.vertices, size, view),
        size,
        colors,
        supersample=supersample,
        corner_normals=mesh.corner_normals,
        surface=paint.materials(mesh) if own and len(mesh.faces) else None,
        shadows=shadows,
        background=background,
    )


def _fragments(vertices, faces, corner_normals, camera, size, supersample) -> tuple[Hits, np.ndarray, np.ndarray]:
    """What each pixel sees, once per triangle in it: hits, how many samples each has, and unit normals towards us."""
    width, height = size
    rows = supersample**2
    # One sample per pixel in each of s * s sub-rows: sub-row a s + b takes column b s + a, so that edges at any
    # angle pass s * s steps from empty to full.
    shifts = (np.arange(rows).reshape(supersample, supersample).T.ravel() + 0.5) / rows
    projected = camera.project(vertices, size)
    seen = visible_faces(projected * [1, rows, 1], faces, width, height * rows, shifts)
    pixel, face, x, y, count = _merged(seen.reshape(height, rows, width), shifts)
    weight, area = weights_at(projected, faces, face, pixel % width + x, pixel // width + y)
    corner = 3 * face[:, None] + np.arange(3)
    if camera.perspective:
        weight *= np.take(projected[:, 2][faces], face, axis=0)
        weight /= (weight[:, 0] + weight[:, 1] + weight[:, 2])[:, None]
    normals = mixed(np.take(corner_normals, face, axis=0), weight)
    normals *= np.where(area > 0, -1.0, 1.0)[:, None]  # y counts down: the back of a face turns clockwise
    return Hits(pixel, corner, weight, np.abs(area)), count, unit(normals)


def _merged(seen, shifts):
    """Samples (h, s * s, w) of one triangle in one pixel as one: pixel, face, middle of them in the pixel, and number.

    What is shaded once is a triangle's share of a pixel, not each sample: a smooth surface costs little more with many.
    """
    rows, width = seen.shape[1:]
    covered = np.flatnonzero(seen.max(axis=1) >= 0)
    row, column = np.divmod(covered, width)
    packed = np.sort(seen[row, :, column].astype(np.int64) * rows + np.arange(rows), axis=1)
    face, sub = np.divmod(packed, rows)  # an empty sample has face -1
    first = np.ones(face.shape, bool)
    first[:, 1:] = face[:, 1:] != face[:, :-1]
    start = np.flatnonzero(first)
    x, y = (np.add.reduceat(places[sub].ravel(), start) for places in (shifts, (np.arange(rows) + 0.5) / rows))
    count = np.diff(start, append=first.size)
    pixel, lead, face = covered[start // rows], sub.ravel()[start], face.ravel()[start]
    some = np.flatnonzero(face >= 0)
    some = some[np.argsort(pixel[some] * rows + lead[some], kind="stable")]  # so that numbers of faces do not matter
    return pixel[some], face[some], x[some] / count[some], y[some] / count[some], count[some]


def _light_per_pixel(cast, vertices, faces, hits, normals, size, block):
    """Sky and key light (h, w), asked for once in a block of pixels and smoothed over the subject."""
    columns, rows = (-(-side // block) for side in size)
    cell = hits.pixel // size[0] // block * columns + hits.pixel % size[0] // block
    one = np.full(columns * rows, -1)
    one[cell[::-1]] = np.arange(len(cell))[::-1]
    covered = np.flatnonzero(one >= 0)
    one = one[covered]
    points = mixed(vertices[faces.ravel()[hits.corner[one]]], hits.weight[one])
    values = shadow.visible_light(cast, points, normals[one])
    sigma = SMOOTH * max(size) / block
    return [shadow.enlarged(light, block, size) for light in _smooth(values, covered, (rows, columns), sigma)]


def _smooth(values, covered, shape, sigma):
    """Images of values blurred over what is covered alone, 1 elsewhere: hides the grain of the few, coarse maps."""
    from scipy.ndimage import gaussian_filter

    images = np.zeros((3, shape[0] * shape[1]), np.float32)
    images[:, covered] = *values, np.ones(len(covered))
    *totals, weight = gaussian_filter(images.reshape(3, *shape), (0, sigma, sigma), mode="constant", truncate=2.5)
    return [np.where(weight > 0, total / np.maximum(weight, 1e-12), 1.0) for total in totals]


def _resolve(color, hits, count, size, supersample):
    """Square roots of linear light summed over a pixel's samples (3, h, w), and the share of them that are covered.

    Square roots are averaged, not linear light: with few samples that is what makes edges look even to the eye.
    """
    share = count / supersample**2
    shape, cells = size[::-1], size[0] * size[1]
    total = [np.bincount(hits.pixel, channel * share, minlength=cells) for channel in np.sqrt(color).T]
    covered = np.bincount(hits.pixel, share, minlength=cells)
    return np.stack(total, dtype=np.float32, casting="same_kind").reshape(3, *shape), covered.reshape(shape)


def _over_paper(total, covered, dark, background):
    paper = np.sqrt(to_linear(np.asarray(background, np.float64))).astype(np.float32)
    bare = np.sqrt(1 - dark) * (1 - covered).astype(np.float32)
    return np.stack([light.to_pixels(own + bare * tone) for own, tone in zip(total, paper, strict=True)], axis=2)


def _transparent(total, covered, dark):
    """RGBA, not premultiplied: the subject over a black veil that darkens what lies below as the shadow would."""
    veil = 1 - light.to_srgb(1 - dark)
    alpha = covered + veil * (1 - covered)
    colors = [light.to_pixels(np.minimum(own / np.maximum(alpha, 1e-6), 1)) for own in total]
    return np.stack([*colors, (alpha * 255 + 0.5).astype(np.uint8)], axis=2)
