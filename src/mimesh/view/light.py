"""Studio light: a bright sky, a soft key light, a rim light, and the shadows they leave on the subject and the floor.

Shadows come from small depth maps, one per direction of light, seen from far away. The share of directions from which
a point is visible is its light: the same few maps give creases, soft shadows and the contact with the floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from .camera import Camera
from .zbuffer import depth_map

BACKGROUND = (0.955, 0.95, 0.94)
"""Off-white paper, sRGB; floor and background are one sheet."""
SKY = np.array([0.97, 1.0, 1.05]) * 0.56
BOUNCE = np.array([1.05, 0.98, 0.90]) * 0.27
KEY = np.array([1.02, 0.975, 0.92]) * 0.95
RIM = np.array([0.95, 0.98, 1.0]) * 0.45
GLOSS = 0.06
FLOOR_SHADOW = 0.62
"""How dark the floor gets where no light reaches it: 0 leaves it white, 1 turns it black."""
EDGE = 0.14
"""Share of the picture over which the floor's shadow fades out at the edge."""
MAP = 88
"""Side of a depth map in texels; enough for soft light, small enough for a hundred frames."""
LIFT = 1.5
"""Texels by which a point is lifted off its surface before asking what light it sees, so as not to shade itself."""
AMBIENT, KEYS = 28, 8
"""How many directions stand for the light from all around, and for the key light."""
GOLDEN = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True, eq=False)
class Shadows:
    """Depth maps of one frame: what the sky, the floor's bounce and the key light can see of it."""

    directions: Float[np.ndarray, "D 3"]
    """Unit vectors towards the lights: AMBIENT of them all around, then KEYS at the key light."""
    to_map: Float[np.ndarray, "D 3 4"]
    """World point (and 1) to column, row and distance in texels."""
    maps: Float[np.ndarray, "D texels"]
    """Distance of the nearest surface in texels, infinite where there is none and all along the map's edge."""
    texel: float
    """Side of a texel in world units."""


def cast(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], camera: Camera) -> Shadows:
    """Look at the subject from every direction that light comes from."""
    directions = _directions(camera)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, texel = (low + high) / 2, float(np.linalg.norm(high - low)) / (MAP - 4) + 1e-12
    to_map = np.stack([_view_from(direction, centre, texel) for direction in directions])
    maps = [depth_map(vertices @ view[:, :3].T + view[:, 3], faces, MAP, MAP).ravel() for view in to_map]
    return Shadows(directions, to_map, np.stack(maps), texel)


def visible_light(
    shadows: Shadows, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Share of the ambient light (weighted by the cosine) and of the key light that reaches each point, in 0..1."""
    lifted = (points + normals * (LIFT * shadows.texel)).T
    cosine = np.clip(shadows.directions[:AMBIENT] @ normals.T, 0.0, None)
    sky, key = np.zeros(len(points)), np.zeros(len(points))
    for k, (view, depth) in enumerate(zip(shadows.to_map, shadows.maps, strict=True)):
        x, y, distance = np.clip(view[:, :3] @ lifted + view[:, 3:], 0, [[MAP - 1], [MAP - 1], [np.inf]])
        nearest = depth[y.astype(np.int64) * MAP + x.astype(np.int64)]
        lit = np.clip(nearest - distance + 1.0, 0.0, 1.0)
        if k < AMBIENT:
            sky += lit * cosine[k]
        else:
            key += lit
    return sky / np.maximum(cosine.sum(axis=0), 1e-9), key / KEYS


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
    return _shoulder(albedo * light + gloss[:, None])


def _shoulder(linear, knee=0.6):
    """Leave what is below the knee and bend what is above it towards 1, so that highlights keep their form."""
    rest = 1 - knee
    return np.where(linear > knee, 1 - rest * np.exp(-np.maximum(linear - knee, 0.0) / rest), linear)


def backdrop(
    shadows: Shadows | None,
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    camera: Camera,
    size: tuple[int, int],
    background: tuple[float, float, float],
) -> Float[np.ndarray, "h w 3"]:
    """The background in linear light, with the subject's shadow on the floor wherever a pixel looks down at it."""
    width, height = size
    paper = np.broadcast_to(to_linear(np.asarray(background)), (height, width, 3))
    if shadows is None:
        return paper
    from scipy.ndimage import map_coordinates

    dark, half = _floor_shadow(shadows, vertices, faces, camera)
    x, z, below = _floor_points(camera, size)
    grid = [(v / half + 1) / 2 * len(dark) - 0.5 for v in (np.broadcast_to(z[below, None], x[below].shape), x[below])]
    shadow = np.zeros((height, width, 1))
    shadow[below, :, 0] = map_coordinates(dark, grid, order=1, cval=0.0)
    return paper * (1 - FLOOR_SHADOW * shadow * _vignette(width, height))


def _vignette(width, height):
    """1 inside, falling to 0 at the picture's edge, so that pictures side by side share one sheet of paper."""
    margin = EDGE * min(width, height)
    across, down = (np.minimum(np.arange(n) + 0.5, n - np.arange(n) - 0.5) / margin for n in (width, height))
    ramp = np.clip(np.minimum(across, down[:, None]), 0.0, 1.0)[..., None]
    return ramp * ramp * (3 - 2 * ramp)


def _floor_shadow(shadows, vertices, faces, camera, count=112):
    """How dark the floor is, 0..1, on a blurred square grid around the subject's foot, and the grid's half side."""
    from scipy.ndimage import gaussian_filter

    half = 1.7 * camera.radius
    step = (np.arange(count) + 0.5) / count * 2 - 1
    grid = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2) * half
    points = _foot(camera) + grid @ np.stack(_floor_axes(camera))
    sky, key = visible_light(shadows, points, np.broadcast_to(camera.up, points.shape))
    contact = _contact(vertices, faces, camera, half, count)
    fade = np.clip(1.6 * (1 - np.linalg.norm(grid, axis=1) / half), 0.0, 1.0).reshape(count, count)
    parts = [(0.45, 1 - sky, 4.0), (0.40, 1 - key, 1.3), (0.35, contact, 0.8)]
    layers = [share * gaussian_filter(dark.reshape(count, count), sigma) for share, dark, sigma in parts]
    return np.clip(sum(layers), 0.0, 1.0) * fade, half


def _contact(vertices, faces, camera, half, count):
    """How closely something touches the floor, 0..1, on the same grid: the height above it, seen from below."""
    axes = np.stack([*_floor_axes(camera), camera.up])
    local = (vertices - _foot(camera)) @ axes.T
    cells = (local / half * [0.5, 0.5, 1.0] + [0.5, 0.5, 0.0]) * [count, count, half]
    height = depth_map(cells, faces, count, count)
    return np.exp(-np.maximum(height, 0.0) / (0.035 * camera.radius))


def _floor_points(camera, size):
    """Where pixels see the floor, from the subject's foot: x (h, w), z (h,), and which rows look down at it.

    The picture's right is level, so how far a ray goes to the floor depends on its row alone.
    """
    width, height = size
    unit = 2 * camera.half_height / height
    across, climb = (np.arange(width) + 0.5 - width / 2) * unit, (height / 2 - np.arange(height) - 0.5) * unit
    _, top, back = camera.rotmat_camera_world
    right, front = _floor_axes(camera)
    lens = float(camera.perspective)
    start = camera.eye - _foot(camera) + (1 - lens) * climb[:, None] * top
    ray = lens * climb[:, None] * top - back
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = -(start @ camera.up) / (ray @ camera.up)
        z = start @ front + reach * (ray @ front)
    x = (start @ right)[:, None] + across * np.where(camera.perspective, reach, 1.0)[:, None]
    return x, z, np.flatnonzero((ray @ camera.up < -1e-6) & (reach > 0))


def _foot(camera: Camera) -> Float[np.ndarray, 3]:
    """The point of the floor below the middle of the subject."""
    return camera.centre + (camera.floor - camera.centre @ camera.up) * camera.up


def _floor_axes(camera: Camera) -> tuple[Float[np.ndarray, 3], Float[np.ndarray, 3]]:
    """Two unit vectors along the floor: the picture's right, and towards the viewer."""
    right = camera.rotmat_camera_world[0]
    return right, np.cross(right, camera.up)


def key_direction(camera: Camera) -> Float[np.ndarray, 3]:
    """Unit vector towards the key light: over the viewer's right shoulder, where a subject in a named view looks."""
    right, front = _floor_axes(camera)
    return _unit(0.72 * right + 0.95 * camera.up + 0.62 * front)


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


def _directions(camera: Camera) -> Float[np.ndarray, "D 3"]:
    """AMBIENT directions evenly all around, turned with the camera, and a small disc of KEYS around the key light."""
    right, front = _floor_axes(camera)
    k = np.arange(AMBIENT) + 0.5
    y, angle = 1 - 2 * k / AMBIENT, k * GOLDEN
    ring = np.sqrt(1 - y * y)
    ambient = np.stack([ring * np.cos(angle), y, ring * np.sin(angle)], axis=1) @ np.stack([right, camera.up, front])
    key = key_direction(camera)
    side = _unit(np.cross(key, camera.up))
    k = np.arange(KEYS) + 0.5
    r, angle = 0.17 * np.sqrt(k / KEYS)[:, None], k[:, None] * GOLDEN
    disc = key + r * (np.cos(angle) * side + np.sin(angle) * np.cross(side, key))
    return np.concatenate([ambient, disc / np.linalg.norm(disc, axis=1, keepdims=True)])


def _view_from(direction, centre, texel) -> Float[np.ndarray, "3 4"]:
    """World to (column, row, distance) in texels, for a parallel view of the bounding sphere from a light."""
    right = _unit(np.cross(np.eye(3)[np.argmin(np.abs(direction))], direction))
    rotmat = np.stack([right, np.cross(right, direction), -direction]) / texel
    return np.concatenate([rotmat, (MAP / 2 - rotmat @ centre)[:, None]], axis=1)


def _unit(vector):
    return vector / np.linalg.norm(vector)
