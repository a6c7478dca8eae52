"""Pictures of meshes: a z-buffer, smooth shading and soft studio shadows in NumPy alone, the same on every machine.

A picture takes five steps: find the visible triangle of each sample (`zbuffer`), merge samples of one triangle in one
pixel into one hit, look up base colours and normals at the hits (`textures`), light them (`shading`, `shadow`), and
average a pixel's hits over the background.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, UInt8

from ..core.mesh import Mesh
from . import shading, shadow, textures
from .camera import Camera, fit
from .shading import to_linear
from .textures import interpolate, unit
from .zbuffer import Hits, visible_faces, weights_at

SMOOTH = 0.005
"""Standard deviation of the blur of shadows on the subject, as a share of the picture's longer side."""
LIGHT_SAMPLES = 256
"""Points along the longer side at which incoming light is computed; more would be lost, since it is blurred."""


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
        shadows: soft shadows on the subject and on the floor (about a third of the time).
        background: sRGB in 0..1; None gives RGBA with nothing behind the subject and its shadow.
    """
    if len(faces) == 0:
        vertices, faces, corner_normals, colors = textures.discs(vertices, camera, colors)
    if corner_normals is None:
        corner_normals = textures.creased_normals(vertices, faces)
    hits, count, normals = _fragments(vertices, faces, corner_normals, camera, size, supersample)
    floor_dark, sky, key = np.zeros(size[::-1], np.float32), np.ones(size[::-1]), np.ones(size[::-1])
    if shadows:
        depth_maps, block = shadow.cast_shadows(vertices, faces, camera), max(1, round(max(size) / LIGHT_SAMPLES))
        sky, key = _light_per_pixel(depth_maps, vertices, faces, hits, normals, size, block)
        floor_dark = shadow.floor_shadow(depth_maps, camera, size, block)
    albedo = (surface or textures.plain_colors(colors, faces))(hits)
    color = shading.shade(albedo, normals, sky.ravel()[hits.pixel], key.ravel()[hits.pixel], camera)
    total, covered = _resolve(color, hits, count, size, supersample)
    if background is None:
        return _transparent(total, covered, floor_dark)
    return _over_background(total, covered, floor_dark, background)


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
    background: tuple[float, float, float] | None = shading.BACKGROUND,
) -> UInt8[np.ndarray, "h w C"]:
    """Draw a mesh with its own materials, textures, vertex colours and hard edges; see `render`.

    Args:
        camera: fitted to the mesh by default, from `view`.
        clay: leave the colours out.
        tint: an sRGB colour in 0..1 instead of the colours.
    """
    use_materials = not clay and tint is None
    if use_materials and mesh.vertex_colors is not None and len(mesh.faces) == 0:
        colors = shading.to_srgb(mesh.vertex_colors[:, :3] * textures.WHITE)
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
    if camera.perspective:
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


def _light_per_pixel(depth_maps, vertices, faces, hits, normals, size, block):
    """Compute sky and key light (h, w) once in each block of pixels, smoothed over the subject.

    The cost is that of one hit per covered block; `_smooth` hides the coarse grid.
    """
    columns, rows = (-(-side // block) for side in size)
    cell = hits.pixel // size[0] // block * columns + hits.pixel % size[0] // block
    representative = np.full(columns * rows, -1)
    representative[cell[::-1]] = np.arange(len(cell))[::-1]  # backwards, so that the first hit of a cell is kept
    covered = np.flatnonzero(representative >= 0)
    representative = representative[covered]
    points = interpolate(vertices[faces.ravel()[hits.corner[representative]]], hits.weight[representative])
    values = shadow.visible_light(depth_maps, points, normals[representative])
    sigma = SMOOTH * max(size) / block
    return [shadow.upsample(light, block, size) for light in _smooth(values, covered, (rows, columns), sigma)]


def _smooth(values, covered, shape, sigma):
    """Blur images over the covered cells alone, 1 elsewhere: hides the noise of few and coarse depth maps.

    A normalized convolution: the blurred values are divided by the blurred mask, so empty cells have no influence.
    """
    from scipy.ndimage import gaussian_filter

    images = np.zeros((3, shape[0] * shape[1]), np.float32)
    images[:, covered] = *values, np.ones(len(covered))
    *totals, weight = gaussian_filter(images.reshape(3, *shape), (0, sigma, sigma), mode="constant", truncate=2.5)
    return [np.where(weight > 0, total / np.maximum(weight, 1e-12), 1.0) for total in totals]


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
    shadow_alpha = 1 - shading.to_srgb(1 - floor_dark)
    alpha = covered + shadow_alpha * (1 - covered)
    colors = [shading.to_pixels(np.minimum(subject / np.maximum(alpha, 1e-6), 1)) for subject in total]
    return np.stack([*colors, (alpha * 255 + 0.5).astype(np.uint8)], axis=2)
