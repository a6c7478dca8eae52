"""Pictures of meshes: rays against triangles by z-buffer, smooth shading, soft shadows, no dependency but NumPy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int, UInt8

from . import light, paint
from .camera import Camera
from .zbuffer import Hits

Paint = Callable[[Hits], np.ndarray]
"""Linear base colour (N, 3) of the surface at each hit."""


def render(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    camera: Camera,
    size: tuple[int, int] = (512, 512),
    colors: Float[np.ndarray, "V 3"] | Float[np.ndarray, 3] | Paint | None = None,
    *,
    supersample: int = 2,
    corner_normals: Float[np.ndarray, "F 3 3"] | None = None,
    shadows: bool = True,
    floor: bool = True,
    background: tuple[float, float, float] = light.BACKGROUND,
) -> UInt8[np.ndarray, "h w 3"]:
    """A picture of a mesh, or of a point cloud (no faces) as small discs; sRGB, 8 bit.

    Both sides of a face are drawn alike. Anything behind the camera's eye is left out, not clipped.

    Args:
        size: width and height in pixels.
        colors: sRGB in 0..1, one or per vertex; a warm grey clay by default; or a function from hits to linear colour.
        supersample: s gives s * s samples per pixel, no two in one row or column.
        corner_normals: shading normals; smooth ones with creases kept by default.
        shadows: soft shadows and creases (about half of the time).
        floor: a shadow on the floor under the subject; needs `shadows`.
        background: sRGB in 0..1.
    """
    if len(faces) == 0:
        vertices, faces, corner_normals, colors = paint.discs(vertices, camera, colors)
    if corner_normals is None:
        corner_normals = paint.creased_normals(vertices, faces)
    hits, front = _see(vertices, faces, camera, size, supersample)
    surface = _Surface(vertices, faces, corner_normals, paint.as_paint(colors, faces))
    cast = light.cast(vertices, faces, camera) if shadows else None
    backdrop = _backdrop(cast if floor else None, camera, size, background)
    return light.to_pixels(_compose(hits, front, surface, cast, backdrop, camera, size, supersample))
