"""Surface appearance before lighting: shading normals, base colours, textures, and discs for points."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from ..core.geometry import face_vectors, weld
from ..core.mesh import Mesh
from ..io.colors import to_linear
from .camera import Camera
from .zbuffer import Hits

if TYPE_CHECKING:
    from PIL import Image as Pillow

CLAY = (0.80, 0.76, 0.715)
"""Warm light grey, sRGB: the colour of surfaces without a material."""
WHITE = 0.76
"""Linear albedo of what a file calls white: a little darker than the background, so that its shading is visible."""
CREASE = 50.0
"""Degrees between a face normal and the smooth normal at its corner, beyond which the corner is shaded flat."""

Paint = Callable[[Hits], np.ndarray]
"""A function of hits that returns the linear base colour (N, 3) of the surface at each."""


def creased_normals(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3 3"]:
    """Compute normals per corner: smooth, over split vertices too, but flat where a face differs by more than CREASE.

    Smooth normals are means of face normals weighted by the angle at the corner, so that the way a quad is cut into
    triangles does not show.
    """
    # Positions, not vertex indices, are shared: files split vertices at seams of their texture.
    merged, index = weld(vertices)
    flat = unit(face_vectors(vertices, faces))[:, None]
    weighted = (_corner_angles(vertices, faces)[..., None] * flat).reshape(-1, 3)
    position = index[faces].ravel()
    total = np.stack([np.bincount(position, weighted[:, k], minlength=len(merged)) for k in range(3)], axis=1)
    smooth = unit(total)[position].reshape(-1, 3, 3)
    x, y, z = np.moveaxis(smooth * flat, 2, 0)
    return np.where((x + y + z)[..., None] > np.cos(np.radians(CREASE)), smooth, flat)


def plain_colors(
    colors: Float[np.ndarray, "V 3"] | Float[np.ndarray, " 3"] | None, faces: Int[np.ndarray, "F 3"]
) -> Paint:
    """Return the paint of one sRGB colour for all (clay by default), or of one per vertex, interpolated."""
    linear = to_linear(np.asarray(CLAY if colors is None else colors, np.float64))
    if linear.ndim == 1:
        return lambda hits: np.broadcast_to(linear, (len(hits.pixel), 3))
    flat = faces.ravel()
    return lambda hits: interpolate(linear[flat[hits.corner]], hits.weight)


def materials(mesh: Mesh) -> Paint | None:
    """Return the paint of a mesh: base colours and textures of its parts times its vertex colours; None without any."""
    vertex_colors = mesh.vertex_colors
    if vertex_colors is None and not any(part.material for part in mesh.parts):
        return None
    # `paint` multiplies by WHITE at the end, so clay is divided by it here.
    default = to_linear(np.asarray(CLAY)) / WHITE if vertex_colors is None else np.ones(3)
    base = np.tile(default, (len(mesh.faces), 1))
    for part in mesh.parts:
        if part.material:
            base[part.start : part.stop] = part.material.base_color[:3]
    texture_layers = [(images, faces, uv.reshape(-1, 2)) for images, faces, uv in _textures(mesh)]

    def paint(hits: Hits) -> np.ndarray:
        face = hits.corner[:, 0] // 3
        color = base[face]
        if vertex_colors is not None:
            color *= interpolate(vertex_colors[mesh.faces.ravel()[hits.corner], :3], hits.weight)
        for images, textured, uv in texture_layers:
            inside = np.flatnonzero(textured[face])
            corners = uv[hits.corner[inside]]
            level = _mip_level(images, corners, hits.area[inside])
            position = interpolate(corners, hits.weight[inside])
            for k in np.unique(level):  # a few levels: one lookup each, instead of one per hit
                color[inside[level == k]] *= _sample(images[k], position[level == k])
        return color * WHITE

    return paint


def discs(
    points: Float[np.ndarray, "V 3"], camera: Camera, colors: Float[np.ndarray, "V 3"] | Float[np.ndarray, " 3"] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """Turn a point cloud into one small octagon per point that faces the camera and is shaded like a ball.

    Returns:
        Vertices (9 V, 3), faces (8 V, 3), corner normals, and the colours repeated for the new vertices.
    """
    radius = _point_radius(points, camera)
    right, top, back = camera.rotmat_camera_world
    angle = np.arange(8) * (np.pi / 4)
    outward = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * top
    # Normals at the rim are tilted 64 degrees outwards: interpolated, they shade the flat disc like a ball.
    normals = np.concatenate([back[None], outward * 0.9 + back * 0.436])
    offsets = np.concatenate([np.zeros((1, 3)), outward * radius])
    fan = np.stack([np.zeros(8, int), 1 + np.arange(8), 1 + (np.arange(8) + 1) % 8], axis=1)
    vertices = (points[:, None] + offsets).reshape(-1, 3)
    faces = (9 * np.arange(len(points))[:, None, None] + fan).reshape(-1, 3)
    if colors is not None and np.ndim(colors) == 2:
        colors = np.repeat(colors, 9, axis=0)
    return vertices, faces, np.tile(normals[fan], (len(points), 1, 1)), colors


def _corner_angles(vertices, faces):
    """Return the angle of each triangle (F) at each of its corners (3), in radians."""
    corners = vertices[faces]
    edge = unit(corners[:, [1, 2, 0]] - corners)  # from each corner to the next
    x, y, z = np.moveaxis(edge * edge[:, [2, 0, 1]], 2, 0)
    return np.arccos(np.clip(-(x + y + z), -1.0, 1.0))


def unit(vectors: Float[np.ndarray, "*N 3"]) -> Float[np.ndarray, "*N 3"]:
    """Normalize vectors to length 1; zero stays zero."""
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return vectors / np.maximum(np.sqrt(x * x + y * y + z * z), 1e-30)[..., None]


def _point_radius(points, camera) -> float:
    """Return the radius of a disc: 0.6 of the gap between neighbours, within 0.7 to 2 % of the subject's radius."""
    from scipy.spatial import KDTree

    if len(points) < 2:
        return 0.02 * camera.radius
    gap = np.percentile(KDTree(points).query(points, k=2)[0][:, 1], 80)
    return float(np.clip(0.6 * gap, 0.007 * camera.radius, 0.02 * camera.radius))


def _textures(mesh: Mesh) -> list[tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]]:
    """List each readable texture once: its mip maps (see `_mip_maps`), the faces (F,) that use it, and corner UVs."""
    if mesh.corner_uv is None:
        return []
    users: dict[bytes, np.ndarray] = {}
    for part in mesh.parts:
        if part.material and part.material.texture:
            faces = users.setdefault(part.material.texture, np.zeros(len(mesh.faces), bool))
            faces[part.start : part.stop] = True
    layers = [(_mip_maps(content), faces, mesh.corner_uv) for content, faces in users.items()]
    return [layer for layer in layers if layer[0]]


@functools.lru_cache(maxsize=8)  # the frames of a movie share their textures
def _mip_maps(content: bytes) -> tuple[np.ndarray, ...]:
    """Decode a texture to linear RGB (height, width, 3), then halve it again and again until a side is 1.

    Without smaller sizes, a texture finer than the pixels would flicker. Empty if the file is damaged.
    """
    image = decode_image(content)
    if image is None:
        return ()
    images: list[np.ndarray] = [to_linear(np.arange(256) / 255).astype(np.float32)[np.asarray(image)]]
    while min(images[-1].shape[:2]) > 1:
        # Means of 2 x 2 texels; an odd last row or column is dropped.
        even = images[-1][: images[-1].shape[0] // 2 * 2, : images[-1].shape[1] // 2 * 2]
        images.append((even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4)
    return tuple(images)


def _mip_level(images, corners, area) -> np.ndarray:
    """Choose the mip map with about one texel per pixel, for triangles of corner UVs (N, 3, 2) and areas in pixels."""
    # Texels per pixel is a ratio of areas; each level has a quarter of the texels, hence half of log2.
    (ux, uy), (vx, vy) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    texels = np.abs(ux * vy - uy * vx) / 2 * images[0].shape[0] * images[0].shape[1]
    # Half a level sharper than the mean over the triangle: a surface seen at an angle shrinks in one direction only.
    level = np.log2(np.maximum(texels, 1e-12) / np.maximum(area, 1e-12)) / 2 - 0.5
    return np.clip(np.rint(level), 0, len(images) - 1).astype(np.int64)


def _sample(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Look up colours (N, C) at UVs, bilinear and repeating beyond the edges; v counts from the lower edge."""
    height, width = image.shape[:2]
    # Texel centres are at half integers.
    x, y = uv[:, 0] * width - 0.5, (1 - uv[:, 1]) * height - 0.5
    column, row = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    u, v = (x - column)[:, None], (y - row)[:, None]
    left, right, top, bottom = column % width, (column + 1) % width, row % height, (row + 1) % height
    upper = image[top, left] * (1 - u) + image[top, right] * u
    lower = image[bottom, left] * (1 - u) + image[bottom, right] * u
    return upper * (1 - v) + lower * v


def interpolate(values: Float[np.ndarray, "N 3 C"], weight: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N C"]:
    """Interpolate values at the corners of triangles with barycentric weights."""
    return weight[:, 0, None] * values[:, 0] + weight[:, 1, None] * values[:, 1] + weight[:, 2, None] * values[:, 2]


def decode_image(content: bytes) -> Pillow.Image | None:
    """Decode a PNG or JPEG to 8-bit RGB without transparency; None if it is damaged or above Pillow's size limit."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content)) as image:
            image.load()
            if image.mode.startswith("I"):  # 16-bit grey, which Pillow's conversion would clip
                return Image.fromarray((np.asarray(image) // 257).astype(np.uint8)).convert("RGB")
            return (image.convert("RGBA") if "transparency" in image.info else image).convert("RGB")
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):  # what Pillow raises on such files
        return None
