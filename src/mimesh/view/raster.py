"""Pictures of meshes: a z-buffer, smooth shading and a shadow on the floor in NumPy alone, the same on every machine.

A picture takes five steps: find the visible triangle of each sample (`zbuffer`), merge samples of one triangle in one
pixel into one hit, look up base colours and normals at the hits (`textures`), light them (`shading`), and average a
pixel's hits over the background.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..core.geometry import smooth_step
from ..core.mesh import Mesh
from ..io.colors import to_linear, to_srgb
from . import shading, textures
from .camera import Camera, fit
from .shading import key_direction
from .textures import interpolate, unit
from .zbuffer import Hits, visible_faces, weights_at

KEY_SHADOW, CONTACT_SHADOW = (0.16, 0.012), (0.22, 0.02)
"""Darkness (0..1) of the floor's shadow under the key light and under light from straight above, and the standard
deviation of their blur as a share of the picture's longer side."""
SHADOW_PIXEL = 4
"""Side in pixels of the blocks in which the shadow is drawn; the blur hides them."""
EDGE = 0.14
"""Width of the border in which the shadow fades out, as a share of the picture's shorter side."""


def render(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    camera: Camera,
    size: tuple[int, int] = (512, 512),
    colors: Float[np.ndarray, "V 3"] | Float[np.ndarray, " 3"] | None = None,
    *,
    supersample: int = 2,
    corner_normals: Float[np.ndarray, "F 3 3"] | None = None,
    surface: textures.Paint | None = None,
    shadows: bool = True,
    background: tuple[float, float, float] | None = shading.BACKGROUND,
) -> UInt8[np.ndarray, "h w C"]:
    """Draw a mesh, or a point cloud (no faces) as small discs, as an sRGB picture of 8 bits, rows from the top.

    Both sides of a face are drawn alike. A face that reaches behind the camera's eye is left out, not clipped.

    Args:
        size: width and height in pixels.
        colors: sRGB in 0..1, one or one per vertex; a warm grey clay by default.
        supersample: s gives s * s samples per pixel, no two of them in one row or column.
        corner_normals: shading normals; smooth with creases by default.
        surface: base colours as `textures.materials` gives them, instead of `colors`.
        background: sRGB in 0..1; None gives RGBA with nothing behind the subject and its shadow.
    """
    if len(faces) == 0:
        vertices, faces, corner_normals, colors = textures.discs(vertices, camera, colors)
    if corner_normals is None:
        corner_normals = textures.creased_normals(vertices, faces)
    hits, count, normals = _fragments(vertices, faces, corner_normals, camera, size, supersample)
    floor_dark = _floor_shadow(vertices, faces, camera, size) if shadows else np.zeros(size[::-1], np.float32)
    albedo = (surface or textures.plain_colors(colors, faces))(hits)
    color = shading.shade(albedo, normals, camera)
    total, covered = _resolve(color, hits, count, size, supersample)
    if background is None:
        return _transparent(total, covered, floor_dark)
    return _over_background(total, covered, floor_dark, background)


def render_mesh(
    mesh: Mesh,
    size: tuple[int, int] = (512, 512),
    camera: Camera | None = None,
    *,
    clay: bool = False,
    tint: tuple[float, float, float] | None = None,
    shadows: bool = True,
    background: tuple[float, float, float] | None = shading.BACKGROUND,
) -> UInt8[np.ndarray, "h w C"]:
    """Draw a mesh with its own materials, textures, vertex colours and hard edges; see `render`.

    Args:
        camera: fitted to the mesh by default.
        clay: leave the colours out.
        tint: an sRGB colour in 0..1 instead of the colours.
    """
    use_materials = not clay and tint is None
    if use_materials and mesh.vertex_colors is not None and len(mesh.faces) == 0:
        colors = to_srgb(mesh.vertex_colors[:, :3] * textures.WHITE)
    else:
        colors = None if tint is None else np.asarray(tint, np.float64)
    return render(
        mesh.vertices,
        mesh.faces,
        camera or fit(mesh.vertices, size),
        size,
        colors,
        corner_normals=mesh.corner_normals,
        surface=textures.materials(mesh) if use_materials and len(mesh.faces) else None,
        shadows=shadows,
        background=background,
    )


def _fragments(vertices, faces, corner_normals, camera, size, supersample) -> tuple[Hits, np.ndarray, np.ndarray]:
    """Find the visible triangles of each pixel: hits, the samples of each (N,), and unit normals towards the viewer."""
    width, height = size
    rows = supersample**2
    # A rotated grid: one sample per pixel in each of s * s sub-rows, where sub-row a s + b takes column b s + a. Edges
    # at any angle then pass s * s steps from empty to full, where a regular grid has s steps along the axes.
    # The sub-rows are rows of a picture that is s * s times as high, so the z-buffer needs no other sampling pattern.
    shifts = (np.arange(rows).reshape(supersample, supersample).T.ravel() + 0.5) / rows
    projected = camera.project(vertices, size)
    visible = visible_faces(projected * [1, rows, 1], faces, width, height * rows, shifts)
    pixel, face, x, y, count = _merge_samples(visible.reshape(height, rows, width), shifts)
    weight, area = weights_at(projected, faces, face, pixel % width + x, pixel // width + y)
    corner = 3 * face[:, None] + np.arange(3)
    # Weights are linear across the picture. Divided by the corners' distances (the rank is -1 / distance) and
    # normalized again, they are linear on the surface.
    weight *= np.take(projected[:, 2][faces], face, axis=0)
    weight /= (weight[:, 0] + weight[:, 1] + weight[:, 2])[:, None]
    normals = interpolate(np.take(corner_normals, face, axis=0), weight)
    normals *= np.where(area > 0, -1.0, 1.0)[:, None]  # y points down: the back of a face is clockwise
    return Hits(pixel, corner, weight, np.abs(area)), count, unit(normals)


def _merge_samples(visible, shifts):
    """Merge the samples (h, s * s, w) of one triangle in one pixel into one hit.

    Shading is computed once per triangle and pixel, not per sample: inside a large triangle s * s samples cost as much
    as one.

    Returns:
        Pixel and face of each hit, x and y of the mean of its samples within the pixel (0..1), and their number.
    """
    rows, width = visible.shape[1:]
    covered = np.flatnonzero(visible.max(axis=1) >= 0)
    row, column = np.divmod(covered, width)
    # Face and sub-row in one integer: sorting it within each pixel puts samples of one face side by side.
    packed = np.sort(visible[row, :, column].astype(np.int64) * rows + np.arange(rows), axis=1)
    face, sub_row = np.divmod(packed, rows)  # an empty sample has face -1
    first = np.ones(face.shape, bool)
    first[:, 1:] = face[:, 1:] != face[:, :-1]
    start = np.flatnonzero(first)
    sub_row_middles = (np.arange(rows) + 0.5) / rows
    x, y = (np.add.reduceat(offsets[sub_row].ravel(), start) for offsets in (shifts, sub_row_middles))
    count = np.diff(start, append=first.size)
    pixel, lead, face = covered[start // rows], sub_row.ravel()[start], face.ravel()[start]
    hit = np.flatnonzero(face >= 0)
    # Within a pixel, ordered by first sub-row and not by face index: the order of faces must not change the sums.
    hit = hit[np.argsort(pixel[hit] * rows + lead[hit], kind="stable")]
    return pixel[hit], face[hit], x[hit] / count[hit], y[hit] / count[hit], count[hit]


def _floor_shadow(vertices, faces, camera, size) -> Float[np.ndarray, "h w"]:
    """Compute how dark the floor is at every pixel, 0..1: blurred pictures of the mesh, flattened along each light.

    It fades out at the picture's edge, so that pictures side by side look like one background. There is none where the
    camera looks up.
    """
    from scipy.ndimage import gaussian_filter

    dark = np.zeros(size[::-1], np.float32)
    if camera.rotmat_camera_world[2] @ camera.up <= 0:
        return dark
    small = tuple(-(-side // SHADOW_PIXEL) for side in size)
    height = (vertices @ camera.up - camera.floor)[:, None]
    for direction, weight, blur in ((key_direction(camera), *KEY_SHADOW), (camera.up, *CONTACT_SHADOW)):
        flat = camera.project(vertices - height * direction / (direction @ camera.up), size) / SHADOW_PIXEL
        covered = visible_faces(flat, faces, *small) >= 0
        pixels = covered.repeat(SHADOW_PIXEL, 0).repeat(SHADOW_PIXEL, 1)[: size[1], : size[0]].astype(np.float32)
        dark += weight * gaussian_filter(pixels, blur * max(size), truncate=2.5)
    ramps = [np.minimum(np.arange(side) + 0.5, side - np.arange(side) - 0.5) / (EDGE * min(size)) for side in size]
    across, down = (smooth_step(ramp, (0.0, 1.0)) for ramp in ramps)
    return dark * np.minimum(across, down[:, None]).astype(np.float32)


def _resolve(color, hits, count, size, supersample):
    """Average hits over their pixels: square roots of linear light (3, h, w), and the covered share of each pixel.

    Square roots are averaged, not linear light: with few samples that makes edges look even to the eye.
    """
    share = count / supersample**2
    shape, cells = size[::-1], size[0] * size[1]
    total = [np.bincount(hits.pixel, channel * share, minlength=cells) for channel in np.sqrt(color).T]
    covered = np.bincount(hits.pixel, share, minlength=cells)
    return np.stack(total, dtype=np.float32, casting="same_kind").reshape(3, *shape), covered.reshape(shape)


def _over_background(total, covered, floor_dark, background):
    """Compose the subject over a background that its shadow darkens, as 8-bit sRGB."""
    paper = np.sqrt(to_linear(np.asarray(background, np.float64))).astype(np.float32)
    behind = np.sqrt(1 - floor_dark) * (1 - covered).astype(np.float32)
    channels = [shading.to_pixels(subject + behind * tone) for subject, tone in zip(total, paper, strict=True)]
    return np.stack(channels, axis=2)


def _transparent(total, covered, floor_dark):
    """Compose RGBA, not premultiplied: the subject over black whose alpha darkens what is below as the shadow would."""
    shadow_alpha = 1 - to_srgb(1 - floor_dark)
    alpha = covered + shadow_alpha * (1 - covered)
    colors = [shading.to_pixels(np.minimum(subject / np.maximum(alpha, 1e-6), 1)) for subject in total]
    return np.stack([*colors, (alpha * 255 + 0.5).astype(np.uint8)], axis=2)
