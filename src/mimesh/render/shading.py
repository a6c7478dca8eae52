"""Studio light on a surface: a bright sky, a bounce from the floor, a soft key light and a rim; and sRGB."""

from __future__ import annotations

import functools

import numpy as np
from jaxtyping import Float, UInt8

from .camera import Camera

BACKGROUND = (0.955, 0.95, 0.94)
"""Off-white paper, sRGB; floor and background are one sheet."""
SKY = np.array([0.97, 1.0, 1.05], np.float32) * np.float32(0.56)
BOUNCE = np.array([1.05, 0.98, 0.90], np.float32) * np.float32(0.27)
KEY = np.array([1.02, 0.975, 0.92], np.float32) * np.float32(0.95)
RIM = np.array([0.95, 0.98, 1.0], np.float32) * np.float32(0.45)
GLOSS = np.float32(0.06)
CODES = 1 << 13
"""Steps of the table from the square root of linear light to 8-bit sRGB: exact to a fiftieth of a step."""


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
    x, y, z = normals.T.astype(np.float32)
    sky, key = sky.astype(np.float32), key.astype(np.float32)
    up, front, lit, half = (
        a * x + b * y + c * z
        for a, b, c in np.stack([camera.up, viewer, toward_key, unit(toward_key + viewer)]).astype(np.float32)
    )
    dome = 0.5 + 0.5 * up
    # Wrapped a little past the terminator: clay and skin scatter light, and the form stays readable in the shade.
    lambert = np.maximum((lit + np.float32(0.15)) / np.float32(1.15), 0) * key
    turned = 1 - np.clip(front, 0, 1)
    rim = turned * turned * turned * np.clip(dome, 0, 1) * sky
    shine = np.clip(half, 0, 1)
    shine = shine * shine * shine
    gloss = shine**8 * key * GLOSS
    low, high = (1 - dome) * sky, dome * sky
    light = np.stack([high * SKY[k] + low * BOUNCE[k] + lambert * KEY[k] + rim * RIM[k] for k in range(3)], axis=1)
    return _shoulder(albedo.astype(np.float32) * light + gloss[:, None])


def _shoulder(linear, knee=0.6):
    """Leave what is below the knee and bend what is above it towards 1, so that highlights keep their form."""
    rest = 1 - knee
    return np.where(linear > knee, 1 - rest * np.exp(-np.maximum(linear - knee, 0.0) / rest), linear)


def key_direction(camera: Camera) -> Float[np.ndarray, 3]:
    """Unit vector towards the key light: over the viewer's right shoulder, where a subject in a named view looks."""
    right, front = floor_axes(camera)
    return unit(0.72 * right + 0.95 * camera.up + 0.62 * front)


def floor_axes(camera: Camera) -> tuple[Float[np.ndarray, 3], Float[np.ndarray, 3]]:
    """Two unit vectors along the floor: the picture's right, and towards the viewer."""
    right = camera.rotmat_camera_world[0]
    return right, np.cross(right, camera.up)


def unit(vector: Float[np.ndarray, 3]) -> Float[np.ndarray, 3]:
    """The vector at length 1."""
    return vector / np.linalg.norm(vector)


def to_linear(color: Float[np.ndarray, "*N C"]) -> Float[np.ndarray, "*N C"]:
    """sRGB in 0..1 to linear light."""
    return np.where(color <= 0.04045, color / 12.92, ((np.maximum(color, 0.04045) + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
    """Linear light to sRGB in 0..1 (values above 1 are clipped)."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def to_pixels(root: Float[np.ndarray, "*N"]) -> UInt8[np.ndarray, "*N"]:
    """Square roots of linear light, in 0..1, to 8-bit sRGB, rounded."""
    return np.take(_table(), (root * np.float32(CODES) + np.float32(0.5)).astype(np.uint16))


@functools.cache
def _table() -> UInt8[np.ndarray, " N"]:
    """8-bit sRGB of evenly spaced square roots of linear light; a little longer, for what is rounded above 1."""
    return (to_srgb(np.square(np.arange(CODES + 8) / CODES)) * 255 + 0.5).astype(np.uint8)
