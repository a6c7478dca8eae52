"""Studio light: a bright sky, a soft key light, a rim light, and the shadows they leave on the subject and the floor.

Shadows come from small depth maps, one per direction of light, seen from far away. The share of directions from which
a point is visible is its light: the same few maps give creases, soft shadows and the contact with the floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from .camera import Camera
from .zbuffer import zbuffer

BACKGROUND = (0.955, 0.95, 0.94)
"""Off-white paper, sRGB; floor and background are one sheet."""
SKY = np.array([1.0, 1.005, 1.02]) * 0.62
BOUNCE = np.array([1.0, 0.97, 0.93]) * 0.34
KEY = np.array([1.0, 0.975, 0.94]) * 0.78
RIM = np.array([0.95, 0.98, 1.0]) * 0.22
GLOSS = 0.05
FLOOR_SHADOW = 0.62
"""How dark the floor gets where no light reaches it: 0 leaves it white, 1 turns it black."""
MAP = 96
"""Side of a depth map in texels; enough for soft light, small enough for a hundred frames."""


@dataclass(frozen=True, eq=False)
class Shadows:
    """Depth maps of one frame: what the sky and the key light can see of it."""

    directions: Float[np.ndarray, "D 3"]
    """Unit vectors towards the lights: `sky` of them over the hemisphere, then those of the key light."""
    sky: int
    cameras: tuple[Camera, ...]
    maps: Float[np.ndarray, "D M M"]
    """Distance of the nearest surface from each camera, infinite where there is none."""
    texel: float
    """Side of a texel in world units."""


def cast(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], camera: Camera) -> Shadows:
    """Look at the subject from every direction that light comes from."""
    directions, sky = _directions(camera)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2 + 1e-12
    cameras = tuple(_from(direction, centre, radius * 1.04) for direction in directions)
    maps = np.full((len(directions), MAP * MAP), np.inf)
    for depth, view in zip(maps, cameras, strict=True):
        hits = zbuffer(view.project(vertices, (MAP, MAP)), faces, MAP, MAP)
        depth[hits.sample] = hits.rank
    return Shadows(directions, sky, cameras, maps.reshape(-1, MAP, MAP), 2 * 1.04 * radius / MAP)


def visible_light(
    shadows: Shadows, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Share of the sky (weighted by the cosine) and of the key light that reaches each point, both in 0..1."""
    lifted = points + normals * (1.5 * shadows.texel)
    cosine = np.clip(normals @ shadows.directions.T, 0.0, None)
    seen = np.empty_like(cosine)
    for k, (view, depth) in enumerate(zip(shadows.cameras, shadows.maps, strict=True)):
        seen[:, k] = _seen(view, depth, lifted, shadows.texel)
    weight = cosine[:, : shadows.sky]
    sky = (seen[:, : shadows.sky] * weight).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
    return sky, seen[:, shadows.sky :].mean(axis=1)


def shade(
    albedo: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    sky: Float[np.ndarray, " N"],
    key: Float[np.ndarray, " N"],
    camera: Camera,
) -> Float[np.ndarray, "N 3"]:
    """Linear colour of surface points under the studio lights; `sky` and `key` say how much light gets through."""
    toward_key = key_direction(camera)
    viewer = camera.rotmat_camera_world[2]
    up = normals @ camera.up
    dome = (0.5 + 0.5 * up)[:, None]
    ambient = (SKY * dome + BOUNCE * (1 - dome)) * sky[:, None]
    # Wrapped a little past the terminator: clay and skin scatter light, and the form stays readable in the shade.
    lambert = np.clip((normals @ toward_key + 0.15) / 1.15, 0.0, None) * key
    facing = np.clip(normals @ viewer, 0.0, 1.0)
    rim = (1 - facing) ** 3 * np.clip(0.5 + 0.5 * up, 0.0, 1.0) * sky
    half = toward_key + viewer
    gloss = np.clip(normals @ (half / np.linalg.norm(half)), 0.0, 1.0) ** 24 * key * GLOSS
    light = ambient + lambert[:, None] * KEY + rim[:, None] * RIM
    return albedo * light + gloss[:, None]


def floor_shadow(shadows: Shadows, camera: Camera, count: int = 112) -> tuple[Float[np.ndarray, "N N"], float]:
    """How dark the floor is, 0..1, on a square grid around the subject's foot point, and the grid's half side."""
    from scipy.ndimage import gaussian_filter

    half = 1.7 * camera.radius
    right, front = floor_axes(camera)
    step = (np.arange(count) + 0.5) / count * 2 - 1
    x, z = np.meshgrid(step * half, step * half)
    points = foot(camera) + x.reshape(-1, 1) * right + z.reshape(-1, 1) * front
    sky, key = visible_light(shadows, points, np.broadcast_to(camera.up, points.shape))
    dark = (1 - (0.55 * sky + 0.45 * key)).reshape(count, count)
    fade = np.clip(1.6 * (1 - np.hypot(x, z) / half), 0.0, 1.0)
    return gaussian_filter(dark, 1.1) * fade, half


def foot(camera: Camera) -> Float[np.ndarray, 3]:
    """The point of the floor below the middle of the subject."""
    return camera.centre + (camera.floor - camera.centre @ camera.up) * camera.up


def floor_axes(camera: Camera) -> tuple[Float[np.ndarray, 3], Float[np.ndarray, 3]]:
    """Two unit vectors along the floor: the picture's right, and towards the viewer."""
    right = camera.rotmat_camera_world[0]
    return right, np.cross(right, camera.up)


def key_direction(camera: Camera) -> Float[np.ndarray, 3]:
    """Unit vector towards the key light: over the viewer's left shoulder, whatever the view."""
    right, front = floor_axes(camera)
    return _unit(-0.62 * right + 0.95 * camera.up + 0.72 * front)


def to_linear(color: Float[np.ndarray, "*N C"]) -> Float[np.ndarray, "*N C"]:
    """sRGB in 0..1 to linear light."""
    return np.where(color <= 0.04045, color / 12.92, ((np.maximum(color, 0.04045) + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: Float[np.ndarray, "*N C"]) -> Float[np.ndarray, "*N C"]:
    """Linear light to sRGB in 0..1 (values above 1 are clipped)."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def to_pixels(linear: Float[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W 3"]:
    """Linear light to 8-bit sRGB, rounded."""
    return (to_srgb(linear) * 255 + 0.5).astype(np.uint8)


def _directions(camera: Camera) -> tuple[np.ndarray, int]:
    """A spiral over the upper hemisphere, denser where the cosine counts, and a small disc around the key light."""
    right, front = floor_axes(camera)
    basis = np.stack([right, camera.up, front])
    sky = _spiral(20, 0.94) @ basis
    key = key_direction(camera)
    side = _unit(np.cross(key, camera.up))
    around = _spiral(7, 0.16) @ np.stack([side, key, np.cross(side, key)])
    return np.concatenate([sky, around]), len(sky)


def _spiral(count: int, spread: float) -> Float[np.ndarray, "N 3"]:
    """Unit vectors around +y, uniform over a disc of radius `spread` below the sphere: cosine-weighted."""
    k = np.arange(count) + 0.5
    r, angle = spread * np.sqrt(k / count), k * np.pi * (3 - np.sqrt(5))
    return np.stack([r * np.cos(angle), np.sqrt(1 - r * r), r * np.sin(angle)], axis=1)


def _from(direction, centre, radius) -> Camera:
    """A square, parallel view of the bounding sphere from a direction of light."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    right = _unit(np.cross(helper, direction))
    rotmat = np.stack([right, np.cross(direction, right), direction])
    eye = centre + 2 * radius * direction
    return Camera(rotmat, eye, radius, rotmat[1], 0.0, centre, radius, perspective=False)


def _seen(view, depth, points, texel):
    """How visible each point is from a light, 0..1, ramping over one texel of depth; points off the map are lit."""
    x, y, distance = view.project(points, (MAP, MAP)).T
    column, row = np.clip(x, 0, MAP - 1).astype(np.int64), np.clip(y, 0, MAP - 1).astype(np.int64)
    lit = np.clip((depth[row, column] - distance) / texel + 1.0, 0.0, 1.0)
    return np.where((x < 0) | (x >= MAP) | (y < 0) | (y >= MAP), 1.0, lit)


def _unit(vector):
    return vector / np.linalg.norm(vector)
