"""Soft shadows on the subject and on the floor, from small shadow maps in every direction that light comes from.

The share of directions from which a point is visible is its light: the same few maps give dark creases (ambient
occlusion), soft shadows of the key light and the contact with the floor. Maps are filled with points sampled from the
surface, not with triangles: a map is so coarse that a point or two per texel resolve all it can show, and points cost a
third of the time of triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from ..core.geometry import smooth_step
from .camera import Camera
from .shading import floor_axes, key_direction, unit

FLOOR_SHADOW = 0.62
"""How dark the floor gets where no light reaches it: 0 leaves it white, 1 turns it black."""
EDGE = 0.14
"""Width of the border in which the floor's shadow fades out, as a share of the picture's shorter side."""
MAP = 88
"""Side of a shadow map in texels; enough for soft light, small enough for a hundred frames."""
BIAS = 1.7
"""Texels by which a point is lifted off its surface before the lookup, so that it does not shade itself."""
AMBIENT, KEYS = 14, 8
"""Number of lines that sample the ambient light, which comes along them from both ends, and of the key light's."""
TEXELS = MAP * MAP
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
"""Radians; successive points of a spiral that turns by it cover a disc or sphere evenly."""
DENSITY = 2.5
"""Points of the surface for every texel of area."""
TILT = np.array([0.7548, 0.5698, 0.3247])
"""Direction that orders a triangle's corners, in the camera's axes. Edges of modelled meshes are hardly ever at a right
angle to it, so that no two corners are equal."""
GRID = 80
"""Cells along a side of the square of floor that can be in shadow."""


@dataclass(frozen=True, eq=False)
class Shadows:
    """Shadow maps of one frame, orthographic, one per direction of light."""

    directions: Float[np.ndarray, "D 3"]
    """Unit vectors towards the lights: AMBIENT of them above the floor, then KEYS around the key light."""
    to_map: Float[np.ndarray, "D 3 3"]
    """From the subject's centre, in texels, to column, row and distance from the centre of a map."""
    maps: Float[np.ndarray, "D both_texels"]
    """Distance of the nearest surface in texels, infinite where there is none and along the map's border; then the
    same from the opposite side, with distances negated (filled for AMBIENT directions alone)."""
    centre: Float[np.ndarray, " 3"]
    """Middle of the subject's bounding box in the world."""
    texel: float
    """Side of a texel in world units."""
    points: Float[np.ndarray, "P 3"]
    """Points of the surface, from the centre, in texels."""


def cast_shadows(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], camera: Camera) -> Shadows:
    """Compute the shadow maps of a mesh from every direction that light comes from."""
    directions = _light_directions(camera)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    # The box's diagonal fits into a map in any direction; 4 texels remain as an empty border.
    centre, texel = (low + high) / 2, float(np.linalg.norm(high - low)) / (MAP - 4) + 1e-12
    to_map = np.stack([_view_from(direction) for direction in directions]).astype(np.float32)
    points = surface_points((vertices - centre) / texel, faces, TILT @ camera.rotmat_camera_world).astype(np.float32)
    maps = np.full((len(directions), 2 * TEXELS), np.inf, np.float32)
    columns = np.ascontiguousarray(points.T)
    for k, (view, depth) in enumerate(zip(to_map, maps, strict=True)):
        cell, distance = _to_texel(view, columns)
        np.minimum.at(depth[:TEXELS], cell, distance)
        if k < AMBIENT:  # the same projection gives the map from below at the cost of one more minimum
            np.minimum.at(depth[TEXELS:], cell, -distance)
    return Shadows(directions, to_map, maps, centre, texel, points)


def surface_points(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], tilt: Float[np.ndarray, " 3"]
) -> Float[np.ndarray, "P 3"]:
    """Sample points evenly over a surface whose unit of length is a texel; each triangle has at least its centroid.

    Deterministic: a triangle's points depend on the order of its corners along `tilt`, not on their order in `faces`
    and not on other triangles, so pictures do not depend on the numbering of faces.
    """
    ax, ay, az, bx, by, bz, cx, cy, cz = np.take(vertices, faces, axis=0).reshape(-1, 9).T
    ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    sides = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, (ux - vx) ** 2 + (uy - vy) ** 2 + (uz - vz) ** 2
    length = np.sqrt(np.maximum(np.maximum(sides[0], sides[1]), sides[2]))
    area = np.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2) / 2
    # By area; slivers get enough points for their longest side, or gaps would let light through.
    count = np.ceil(np.maximum(DENSITY * area, 1.5 * length - 1)).astype(np.int64)
    single = count <= 1  # nearly all triangles of a dense mesh: their centroids need no sorting
    several = np.flatnonzero(~single)
    corners = vertices[faces[several]]
    a, b, c = np.take_along_axis(corners, np.argsort(corners @ tilt, axis=1)[..., None], axis=1).swapaxes(0, 1)
    triangle = np.repeat(np.arange(len(several)), count[several])
    k = np.arange(len(triangle)) - np.repeat(np.cumsum(count[several]) - count[several], count[several])
    # Point k of n goes sqrt((k + 1/2) / n) of the way from corner a to the opposite side (equal areas), and along that
    # side by multiples of the golden ratio modulo 1, which stay evenly spread for every n.
    outward = np.sqrt((k + 0.5) / count[several][triangle])[:, None]
    across = ((k + 0.5) * 0.6180339887498949 % 1.0)[:, None]
    spread = a[triangle] * (1 - outward) + (b[triangle] * (1 - across) + c[triangle] * across) * outward
    centroids = np.stack([ax + bx + cx, ay + by + cy, az + bz + cz], axis=1)[single] / 3
    return np.concatenate([centroids, spread])


def visible_light(
    shadows: Shadows, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]
) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, " N"]]:
    """Compute the share of the ambient light (cosine-weighted) and of the key light that reaches each point, in 0..1.

    Each of the AMBIENT lines stands for two lights, one at each end; a surface is lit by the end it faces. So 14
    lookups sample the whole sphere, half as many as with a map per light.
    """
    lifted = np.ascontiguousarray(((points - shadows.centre) / shadows.texel + normals * BIAS).T, np.float32)
    x, y, z = np.ascontiguousarray(normals.T, np.float32)
    sky, key, cosine_sum = (np.zeros(len(points), np.float32) for _ in range(3))
    for k, (view, depth) in enumerate(zip(shadows.to_map, shadows.maps, strict=True)):
        cell, distance = _to_texel(view, lifted)
        if k >= AMBIENT:
            key += _share_lit(depth[cell] - distance)
            continue
        u, v, w = shadows.directions[k].astype(np.float32)
        cosine = u * x + v * y + w * z
        behind = cosine < 0  # faces the other end: the second half of the map, with distances negated
        np.negative(distance, out=distance, where=behind)
        cosine = np.abs(cosine)
        sky += _share_lit(depth[cell + behind * np.int32(TEXELS)] - distance) * cosine
        cosine_sum += cosine
    return sky / np.maximum(cosine_sum, 1e-9), key / KEYS


def _share_lit(clearance):
    """Return 1 where the nearest surface is no nearer to the light than the point, falling to 0 one texel nearer."""
    return np.minimum(np.maximum(clearance + np.float32(1.0), 0.0), 1.0)


def floor_shadow(shadows: Shadows, camera: Camera, size: tuple[int, int], block: int = 1) -> Float[np.ndarray, "h w"]:
    """Compute how dark the floor is, 0..1, at every pixel that shows it; evaluated once per block of pixels."""
    from scipy.ndimage import map_coordinates

    width, height = (-(-side // block) for side in size)
    dark, half = _floor_grid(shadows, camera)
    x, z, below = _floor_points(camera, size, (width, height), block)
    grid = [(v / half + 1) / 2 * GRID - 0.5 for v in (np.broadcast_to(z[below, None], x[below].shape), x[below])]
    shadow = np.zeros((height, width), np.float32)
    shadow[below] = map_coordinates(dark, grid, order=1, cval=0.0)
    return FLOOR_SHADOW * upsample(shadow, block, size) * _vignette(*size)


def upsample(image: Float[np.ndarray, "h w"], block: int, size: tuple[int, int]) -> Float[np.ndarray, "H W"]:
    """Enlarge an image of blocks of pixels to one of pixels, linear between the centres of blocks."""
    if block == 1:
        return image
    for axis, side in ((0, size[1]), (1, size[0])):
        position = np.clip((np.arange(side) + 0.5) / block - 0.5, 0, image.shape[axis] - 1)
        low = np.minimum(position.astype(np.int64), max(image.shape[axis] - 2, 0))
        high = np.minimum(low + 1, image.shape[axis] - 1)
        share = (position - low).astype(image.dtype)[:, None] if axis == 0 else (position - low).astype(image.dtype)
        image = np.take(image, low, axis) * (1 - share) + np.take(image, high, axis) * share
    return image


def _to_texel(view, points):
    """Return the index of the texel that each point (3, N) falls into, and its distance; outside, the border texel."""
    x, y, z = points
    column, row, distance = (a * x + b * y + c * z for a, b, c in view)
    column, row = (np.minimum(np.maximum(v + np.float32(MAP / 2), 0), MAP - 1).astype(np.int32) for v in (column, row))
    row *= MAP
    row += column
    return row, distance


def _vignette(width, height):
    """Return 1 inside, falling to 0 at the picture's edge, so that pictures side by side look like one background."""
    margin = EDGE * min(width, height)
    across, down = (np.minimum(np.arange(n) + 0.5, n - np.arange(n) - 0.5) / margin for n in (width, height))
    across, down = (smooth_step(ramp, (0.0, 1.0)) for ramp in (across, down))
    return np.minimum(across, down[:, None]).astype(np.float32)


def _floor_grid(shadows, camera):
    """Compute how dark the floor is, 0..1, on a blurred square grid around the subject, and the grid's half side.

    Three layers, by what casts them: the sky's wide soft shadow, the key light's, and contact. The coarser the shadow,
    the wider the blur.
    """
    from scipy.ndimage import gaussian_filter

    half = 1.7 * camera.radius
    step = (np.arange(GRID) + 0.5) / GRID * 2 - 1
    grid = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2) * half
    fade = np.clip(1.6 * (1 - np.linalg.norm(grid, axis=1) / half), 0.0, 1.0)
    inside = np.flatnonzero(fade)
    points = _floor_centre(camera) + grid[inside] @ np.stack(floor_axes(camera))
    sky, key = np.ones(len(grid)), np.ones(len(grid))
    sky[inside], key[inside] = visible_light(shadows, points, np.broadcast_to(camera.up, points.shape))
    contact = _contact(shadows, camera, half)
    layers = [(0.45, 1 - sky, 2.9), (0.40, 1 - key, 0.95), (0.35, contact, 0.6)]  # weight, darkness, blur in cells
    blurred = [weight * gaussian_filter(dark.reshape(GRID, GRID), sigma) for weight, dark, sigma in layers]
    return np.clip(sum(blurred), 0.0, 1.0) * fade.reshape(GRID, GRID), half


def _contact(shadows, camera, half):
    """Compute how near the surface is to the floor below it, 1 at contact and 0 far above, on the floor grid."""
    offset = (_floor_centre(camera) - shadows.centre) / shadows.texel
    x, z, height = ((shadows.points - offset) @ np.stack([*floor_axes(camera), camera.up]).T).T * shadows.texel
    column, row = (np.clip((v / half + 1) / 2 * GRID, 0, GRID - 1).astype(np.int64) for v in (x, z))
    lowest = np.full(GRID * GRID, np.inf)
    np.minimum.at(lowest, row * GRID + column, height)
    return np.exp(-np.maximum(lowest, 0.0) / (0.035 * camera.radius))


def _floor_points(camera, size, blocks, block):
    """Intersect the rays through blocks of pixels with the floor.

    The picture's right is level, so the distance along a ray to the floor depends on its row alone.

    Returns:
        Positions on the floor, from the point below the subject: x (h, w) and z (h,); the rows that show the floor.
    """
    unit_length = 2 * camera.half_height / size[1]
    across = ((np.arange(blocks[0]) + 0.5) * block - size[0] / 2) * unit_length
    climb = (size[1] / 2 - (np.arange(blocks[1]) + 0.5) * block) * unit_length
    _, top, back = camera.rotmat_camera_world
    right, front = floor_axes(camera)
    perspective = float(camera.perspective)
    start = camera.eye - _floor_centre(camera) + (1 - perspective) * climb[:, None] * top
    ray = perspective * climb[:, None] * top - back
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = -(start @ camera.up) / (ray @ camera.up)
        z = start @ front + distance * (ray @ front)
    x = (start @ right)[:, None] + across * np.where(camera.perspective, distance, 1.0)[:, None]
    return x, z, np.flatnonzero((ray @ camera.up < -1e-6) & (distance > 0))


def _floor_centre(camera: Camera) -> Float[np.ndarray, 3]:
    """Return the point of the floor below the middle of the subject."""
    return camera.centre + (camera.floor - camera.centre @ camera.up) * camera.up


def _light_directions(camera: Camera) -> Float[np.ndarray, "D 3"]:
    """Return AMBIENT directions evenly above the floor, then KEYS directions in a small disc at the key light.

    Both are golden-angle spirals. They turn with the camera, so that every view of a subject is lit alike.
    """
    right, front = floor_axes(camera)
    k = np.arange(AMBIENT) + 0.5
    y, angle = 1 - k / AMBIENT, k * GOLDEN_ANGLE  # equal steps in height have equal areas on a sphere
    ring = np.sqrt(1 - y * y)
    ambient = np.stack([ring * np.cos(angle), y, ring * np.sin(angle)], axis=1) @ np.stack([right, camera.up, front])
    key = key_direction(camera)
    side = unit(np.cross(key, camera.up))
    k = np.arange(KEYS) + 0.5
    # A disc of 0.17 radians (10 degrees) makes the key light's shadow soft.
    r, angle = 0.17 * np.sqrt(k / KEYS)[:, None], k[:, None] * GOLDEN_ANGLE
    disc = key + r * (np.cos(angle) * side + np.sin(angle) * np.cross(side, key))
    return np.concatenate([ambient, disc / np.linalg.norm(disc, axis=1, keepdims=True)])


def _view_from(direction) -> Float[np.ndarray, "3 3"]:
    """Return the rows right, down and away of an orthographic view from a light."""
    right = unit(np.cross(np.eye(3)[np.argmin(np.abs(direction))], direction))
    return np.stack([right, np.cross(right, direction), -direction])
