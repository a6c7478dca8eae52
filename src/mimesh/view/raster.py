"""Pictures of meshes: a z-buffer, smooth shading and soft studio shadows in NumPy alone, the same on every machine."""

from __future__ import annotations

import dataclasses

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..mesh import Mesh
from . import light, paint
from .camera import Camera, fit
from .zbuffer import Hits, zbuffer

SMOOTH = 0.005
"""Blur of shadows on the subject, as a share of the picture's longer side."""


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
    background: tuple[float, float, float] = light.BACKGROUND,
) -> UInt8[np.ndarray, "h w 3"]:
    """A picture of a mesh, or of a point cloud (no faces) as small discs; sRGB, 8 bit, rows from the top.

    Both sides of a face are drawn alike. A face that reaches behind the camera's eye is left out, not clipped.

    Args:
        size: width and height in pixels.
        colors: sRGB in 0..1, one or one per vertex; a warm grey clay by default.
        supersample: s gives s * s samples per pixel, no two of them in one row or column.
        corner_normals: shading normals; smooth with creases by default.
        surface: base colours as `paint.materials` gives them, instead of `colors`.
        shadows: soft shadows on the subject and on the floor (about half of the time).
        background: sRGB in 0..1.
    """
    if len(faces) == 0:
        vertices, faces, corner_normals, colors = paint.discs(vertices, camera, colors)
    if corner_normals is None:
        corner_normals = paint.creased_normals(vertices, faces)
    hits, normals = _see(vertices, faces, corner_normals, camera, size, supersample)
    pixel = _pixel_of(hits, size, supersample)
    cast = light.cast(vertices, faces, camera) if shadows else None
    sky, key = _light_per_pixel(cast, vertices, faces, hits, normals, pixel, size)
    albedo = (surface or paint.plain(colors, faces))(hits)
    color = light.shade(albedo, normals, sky[pixel], key[pixel], camera)
    backdrop = light.backdrop(cast, vertices, faces, camera, size, background)
    return light.to_pixels(_resolve(color, pixel, backdrop, supersample**2))


def render_mesh(
    mesh: Mesh,
    size: tuple[int, int] = (512, 512),
    camera: Camera | None = None,
    *,
    view: str | tuple[float, float] = "three-quarter",
    clay: bool = False,
    supersample: int = 2,
    shadows: bool = True,
) -> UInt8[np.ndarray, "h w 3"]:
    """A picture of a mesh with its own materials, textures and hard edges; `clay` leaves the colours out."""
    return render(
        mesh.vertices,
        mesh.faces,
        camera or fit(mesh.vertices, size, view),
        size,
        supersample=supersample,
        corner_normals=mesh.corner_normals,
        surface=None if clay else paint.materials(mesh),
        shadows=shadows,
    )


def _see(vertices, faces, corner_normals, camera, size, supersample) -> tuple[Hits, np.ndarray]:
    """What each sample sees, with weights linear on the surface, and the unit normal on the side it sees."""
    width, height = size
    rows = supersample**2
    # One sample per pixel in each of s * s sub-rows: sub-row a s + b takes column b s + a, so that edges at any
    # angle pass s * s steps from empty to full.
    columns = np.arange(rows).reshape(supersample, supersample).T.ravel()
    projected = camera.project(vertices, size)
    hits = zbuffer(projected * [1, rows, 1], faces, width, height * rows, (columns + 0.5) / rows)
    if camera.perspective:
        weight = hits.weight * projected[:, 2][faces.ravel()[hits.corner]]
        hits = dataclasses.replace(hits, weight=weight / weight.sum(axis=1, keepdims=True))
    normals = np.einsum("nk,nkc->nc", hits.weight, corner_normals.reshape(-1, 3)[hits.corner])
    normals *= _side(projected, faces)[hits.corner[:, 0] // 3][:, None]
    return hits, normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _side(projected, faces):
    """+1 for faces seen from the front (counter-clockwise), -1 from the back."""
    a, b, c = (projected[faces[:, k], :2] for k in range(3))
    (ux, uy), (vx, vy) = (b - a).T, (c - a).T
    return np.where(ux * vy - uy * vx > 0, -1.0, 1.0)  # y counts down, so counter-clockwise is negative


def _pixel_of(hits, size, supersample):
    row, column = np.divmod(hits.sample, size[0])
    return row // supersample**2 * size[0] + column


def _light_per_pixel(cast, vertices, faces, hits, normals, pixel, size):
    """Sky and key light at one sample of every pixel that sees the subject; its other samples share them."""
    sky, key = np.ones(size[0] * size[1]), np.ones(size[0] * size[1])
    if cast is None:
        return sky, key
    one = np.full(size[0] * size[1], -1)
    one[pixel[::-1]] = np.arange(len(pixel))[::-1]
    covered = np.flatnonzero(one >= 0)
    if len(covered) == 0:
        return sky, key
    one = one[covered]
    points = np.einsum("nk,nkc->nc", hits.weight[one], vertices[faces.ravel()[hits.corner[one]]])
    for image, values in zip((sky, key), light.visible_light(cast, points, normals[one]), strict=True):
        image[covered] = _smooth(values, covered, size)
    return sky, key


def _smooth(values, covered, size):
    """Blur values over the covered pixels only: hides the grain of the few, coarse depth maps."""
    from scipy.ndimage import gaussian_filter

    row, column = np.divmod(covered, size[0])
    row, column = row - row.min(), column - column.min()
    image = np.zeros((2, row.max() + 1, column.max() + 1), np.float32)
    image[:, row, column] = values, np.ones_like(values)
    sigma = SMOOTH * max(size)
    total, weight = gaussian_filter(image, (0, sigma, sigma), mode="constant", truncate=2.5)[:, row, column]
    return total / weight


def _resolve(color, pixel, backdrop, samples):
    """Average the samples of each pixel, over the backdrop where they see nothing.

    Square roots are averaged, not linear light: with few samples that is what makes edges look even to the eye.
    """
    count = np.bincount(pixel, minlength=backdrop.shape[0] * backdrop.shape[1])
    root = np.sqrt(color)
    total = np.stack([np.bincount(pixel, root[:, k], minlength=len(count)) for k in range(3)], axis=1)
    covered = (count / samples).reshape(*backdrop.shape[:2], 1)
    return np.square(total.reshape(backdrop.shape) / samples + np.sqrt(backdrop) * (1 - covered))
