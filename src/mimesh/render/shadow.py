"""Soft shadows on the subject and on the floor, from small depth maps seen from every direction that light comes from.

The share of directions from which a point is visible is its light: the same few maps give creases, soft shadows and the
contact with the floor. Maps are filled with points of the surface, not with triangles: they are so coarse that a point
or two per texel is all that can be told apart, and all maps are filled at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from .camera import Camera
from .shading import floor_axes, key_direction, unit

FLOOR_SHADOW = 0.62
"""How dark the floor gets where no light reaches it: 0 leaves it white, 1 turns it black."""
EDGE = 0.14
"""Share of the picture over which the floor's shadow fades out at the edge."""
MAP = 88
"""Side of a depth map in texels; enough for soft light, small enough for a hundred frames."""
LIFT = 1.7
"""Texels by which a point is lifted off its surface before asking what light it sees, so as not to shade itself."""
AMBIENT, KEYS = 14, 8
"""How many lines stand for the light from all around, which comes along them both ways, and how many for the key."""
TEXELS = MAP * MAP
GOLDEN = np.pi * (3 - np.sqrt(5))
DENSITY = 2.5
"""Points of the surface for every texel of area."""
TILT = np.array([0.7548, 0.5698, 0.3247])
"""In the camera's axes. No edge of a modelled mesh stands square to it, so it tells a triangle's corners apart."""
GRID = 80
"""Cells along a side of the floor's square."""


@dataclass(frozen=True, eq=False)
class Shadows:
    """Depth maps of one frame: what the sky, the floor's bounce and the key light can see of it."""

    directions: Float[np.ndarray, "D 3"]
    """Unit vectors towards the lights: AMBIENT of them above the floor, then KEYS at the key light."""
    to_map: Float[np.ndarray, "D 3 3"]
    """From the subject's middle, in texels, to column, row and distance from the middle of a map."""
    maps: Float[np.ndarray, "D both_texels"]
    """Distance of the nearest surface in texels, infinite where there is none and all along the map's edge; then the
    same from the opposite side, where the distance counts the other way (of AMBIENT directions alone)."""
    centre: Float[np.ndarray, " 3"]
    """Middle of the subject in the world."""
    texel: float
    """Side of a texel in world units."""
    points: Float[np.ndarray, "P 3"]
    """Points of the surface, from the middle, in texels."""


def cast(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], camera: Camera) -> Shadows:
    """Look at the subject from every direction that light comes from."""
    directions = _directions(camera)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, texel = (low + high) / 2, float(np.linalg.norm(high - low)) / (MAP - 4) + 1e-12
    to_map = np.stack([_view_from(direction) for direction in directions]).astype(np.float32)
    points = surface_points((vertices - centre) / texel, faces, TILT @ camera.rotmat_camera_world).astype(np.float32)
    maps = np.full((len(directions), 2 * TEXELS), np.inf, np.float32)
    columns = np.ascontiguousarray(points.T)
    for k, (view, depth) in enumerate(zip(to_map, maps, strict=True)):
        cell, distance = _in_map(view, columns)
        np.minimum.at(depth[:TEXELS], cell, distance)
        if k < AMBIENT:
            np.minimum.at(depth[TEXELS:], cell, -distance)
    return Shadows(directions, to_map, maps, centre, texel, points)


def surface_points(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], tilt: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "P 3"]:
    """Points spread evenly over a surface whose unit of length is a texel; each triangle has at least its middle.

    A triangle's points depend on where its corners lie along `tilt`, not on their order and not on other triangles.
    """
    ax, ay, az, bx, by, bz, cx, cy, cz = np.take(vertices, faces, axis=0).reshape(-1, 9).T
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    sides = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, (ux - vx) ** 2 + (uy - vy) ** 2 + (uz - vz) ** 2
    length = np.sqrt(np.maximum(np.maximum(sides[0], sides[1]), sides[2]))
    area = np.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2) / 2
    count = np.ceil(np.maximum(DENSITY * area, 1.5 * length - 1)).astype(np.int64)
    single = count <= 1
    few = np.flatnonzero(~single)
    corners = vertices[faces[few]]
    a, b, c = np.take_along_axis(corners, np.argsort(corners @ tilt, axis=1)[..., None], axis=1).swapaxes(0, 1)
    one = np.repeat(np.arange(len(few)), count[few])
    k = np.arange(len(one)) - np.repeat(np.cumsum(count[few]) - count[few], count[few])
    out = np.sqrt((k + 0.5) / count[few][one])[:, None]
    across = ((k + 0.5) * 0.6180339887498949 % 1.0)[:, None]
    spread = a[one] * (1 - out) + (b[one] * (1 - across) + c[one] * across) * out
    middle = np.stack([ax + bx + cx, ay + by + cy, az + bz + cz], axis=1)[single] / 3
    return np.concatenate([middle, spread])


def visible_light(
    shadows: Shadows, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Share of the ambient light (weighted by the cosine) and of the key light that reaches each point, in 0..1."""
    lifted = np.ascontiguousarray(((points - shadows.centre) / shadows.texel + normals * LIFT).T, np.float32)
    x, y, z = np.ascontiguousarray(normals.T, np.float32)
    sky, key, whole = (np.zeros(len(points), np.float32) for _ in range(3))
    for k, (view, depth) in enumerate(zip(shadows.to_map, shadows.maps, strict=True)):
        cell, distance = _in_map(view, lifted)
        if k >= AMBIENT:
            key += _share_lit(depth[cell] - distance)
            continue
        u, v, w = shadows.directions[k].astype(np.float32)
        cosine = u * x + v * y + w * z
        behind = cosine < 0
        np.negative(distance, out=distance, where=behind)
        cosine = np.abs(cosine)
        sky += _share_lit(depth[cell + behind * np.int32(TEXELS)] - distance) * cosine
        whole += cosine
    return sky / np.maximum(whole, 1e-9), key / KEYS


def _share_lit(free):
    """1 where the nearest surface is no nearer to the light than the point, 0 where it is by a texel or more."""
    return np.minimum(np.maximum(free + np.float32(1.0), 0.0), 1.0)


def floor_shadow(shadows: Shadows, camera: Camera, size: tuple[int, int], block: int = 1) -> Float[np.ndarray, "h w"]:
    """How dark the floor is, 0..1, at every pixel that looks down at it; worked out for blocks of pixels."""
    from scipy.ndimage import map_coordinates

    width, height = (-(-side // block) for side in size)
    dark, half = _floor_grid(shadows, camera)
    x, z, below = _floor_points(camera, size, (width, height), block)
    grid = [(v / half + 1) / 2 * GRID - 0.5 for v in (np.broadcast_to(z[below, None], x[below].shape), x[below])]
    shadow = np.zeros((height, width), np.float32)
    shadow[below] = map_coordinates(dark, grid, order=1, cval=0.0)
    return FLOOR_SHADOW * enlarged(shadow, block, size) * _vignette(*size)


def enlarged(image: Float[np.ndarray, "h w"], block: int, size: tuple[int, int]) -> Float[np.ndarray, "H W"]:
    """An image of blocks of pixels as one of pixels, linear between the middles of blocks."""
    if block == 1:
        return image
    for axis, side in ((0, size[1]), (1, size[0])):
        place = np.clip((np.arange(side) + 0.5) / block - 0.5, 0, image.shape[axis] - 1)
        low = np.minimum(place.astype(np.int64), max(image.shape[axis] - 2, 0))
        high = np.minimum(low + 1, image.shape[axis] - 1)
        share = (place - low).astype(image.dtype)[:, None] if axis == 0 else (place - low).astype(image.dtype)
        image = np.take(image, low, axis) * (1 - share) + np.take(image, high, axis) * share
    return image


def _in_map(view, points):
    """Texel of a map that each point (3, N) falls into, and its distance."""
    x, y, z = points
    column, row, distance = (a * x + b * y + c * z for a, b, c in view)
    column, row = (np.minimum(np.maximum(v + np.float32(MAP / 2), 0), MAP - 1).astype(np.int32) for v in (column, row))
    row *= MAP
    row += column
    return row, distance


def _vignette(width, height):
    """1 inside, falling to 0 at the picture's edge, so that pictures side by side share one sheet of paper."""
    margin = EDGE * min(width, height)
    across, down = (np.minimum(np.arange(n) + 0.5, n - np.arange(n) - 0.5) / margin for n in (width, height))
    across, down = (ramp * ramp * (3 - 2 * ramp) for ramp in (np.clip(v, 0.0, 1.0) for v in (across, down)))
    return np.minimum(across, down[:, None]).astype(np.float32)


def _floor_grid(shadows, camera):
    """How dark the floor is, 0..1, on a blurred square grid around the subject's foot, and the grid's half side."""
    from scipy.ndimage import gaussian_filter

    half = 1.7 * camera.radius
    step = (np.arange(GRID) + 0.5) / GRID * 2 - 1
    grid = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2) * half
    fade = np.clip(1.6 * (1 - np.linalg.norm(grid, axis=1) / half), 0.0, 1.0)
    some = np.flatnonzero(fade)
    points = _foot(camera) + grid[some] @ np.stack(floor_axes(camera))
    sky, key = np.ones(len(grid)), np.ones(len(grid))
    sky[some], key[some] = visible_light(shadows, points, np.broadcast_to(camera.up, points.shape))
    contact = _contact(shadows, camera, half)
    parts = [(0.45, 1 - sky, 2.9), (0.40, 1 - key, 0.95), (0.35, contact, 0.6)]
    layers = [share * gaussian_filter(dark.reshape(GRID, GRID), sigma) for share, dark, sigma in parts]
    return np.clip(sum(layers), 0.0, 1.0) * fade.reshape(GRID, GRID), half


def _contact(shadows, camera, half):
    """How closely something touches the floor, 0..1, on the same grid: the height above it, seen from below."""
    foot = (_foot(camera) - shadows.centre) / shadows.texel
    x, z, height = ((shadows.points - foot) @ np.stack([*floor_axes(camera), camera.up]).T).T * shadows.texel
    column, row = (np.clip((v / half + 1) / 2 * GRID, 0, GRID - 1).astype(np.int64) for v in (x, z))
    lowest = np.full(GRID * GRID, np.inf)
    np.minimum.at(lowest, row * GRID + column, height)
    return np.exp(-np.maximum(lowest, 0.0) / (0.035 * camera.radius))


def _floor_points(camera, size, blocks, block):
    """Where blocks of pixels see the floor, from the subject's foot: x (h, w), z (h,), and which rows look down at it.

    The picture's right is level, so how far a ray goes to the floor depends on its row alone.
    """
    unit_length = 2 * camera.half_height / size[1]
    across = ((np.arange(blocks[0]) + 0.5) * block - size[0] / 2) * unit_length
    climb = (size[1] / 2 - (np.arange(blocks[1]) + 0.5) * block) * unit_length
    _, top, back = camera.rotmat_camera_world
    right, front = floor_axes(camera)
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


def _directions(camera: Camera) -> Float[np.ndarray, "D 3"]:
    """AMBIENT directions evenly above the floor, turned with the camera, and a small disc of KEYS at the key light."""
    right, front = floor_axes(camera)
    k = np.arange(AMBIENT) + 0.5
    y, angle = 1 - k / AMBIENT, k * GOLDEN
    ring = np.sqrt(1 - y * y)
    ambient = np.stack([ring * np.cos(angle), y, ring * np.sin(angle)], axis=1) @ np.stack([right, camera.up, front])
    key = key_direction(camera)
    side = unit(np.cross(key, camera.up))
    k = np.arange(KEYS) + 0.5
    r, angle = 0.17 * np.sqrt(k / KEYS)[:, None], k[:, None] * GOLDEN
    disc = key + r * (np.cos(angle) * side + np.sin(angle) * np.cross(side, key))
    return np.concatenate([ambient, disc / np.linalg.norm(disc, axis=1, keepdims=True)])


def _view_from(direction) -> Float[np.ndarray, "3 3"]:
    """Rows right, down and away of a parallel view from a light."""
    right = unit(np.cross(np.eye(3)[np.argmin(np.abs(direction))], direction))
    return np.stack([right, np.cross(right, direction), -direction])
