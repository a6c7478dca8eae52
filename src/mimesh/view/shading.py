"""Studio lighting of surface points (sky, floor bounce, key light, rim light) and conversions between linear and sRGB.

The lighting is a fixed artistic setup, relative to the camera; it is not physically based.
"""

from __future__ import annotations

import functools

import numpy as np
from jaxtyping import Float, UInt8

from ..io.colors import to_srgb
from .camera import Camera

BACKGROUND = (0.955, 0.95, 0.94)
"""Off-white paper, sRGB in 0..1; floor and background are one sheet."""
SKY = np.array([0.97, 1.0, 1.05], np.float32) * np.float32(0.56)
"""Linear RGB of the light from above, slightly blue."""
BOUNCE = np.array([1.05, 0.98, 0.90], np.float32) * np.float32(0.27)
"""Linear RGB of the light that the floor reflects, slightly warm."""
KEY = np.array([1.02, 0.975, 0.92], np.float32) * np.float32(0.95)
"""Linear RGB of the key light, which casts the visible shadow."""
RIM = np.array([0.95, 0.98, 1.0], np.float32) * np.float32(0.45)
"""Linear RGB of the light on surfaces seen edge-on, which separates the subject from the background."""
GLOSS = np.float32(0.06)
"""Strength of the highlight of the key light, as linear light."""
KNEE = 0.6
"""Linear light above which tone mapping compresses."""
CODES = 1 << 13
"""Steps of the table from the square root of linear light to 8-bit sRGB: exact to a fiftieth of a step."""


def shade(
    albedo: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"], camera: Camera
) -> Float[np.ndarray, "N 3"]:
    """Compute the linear colour of surface points under the studio lights; nothing casts a shadow on the subject.

    Args:
        albedo: linear base colour.
        normals: unit normals towards the viewer.
    """
    toward_key = key_direction(camera)
    viewer = camera.rotmat_camera_world[2]
    x, y, z = normals.T.astype(np.float32)
    # Cosines between the normal and up, viewer, key light, and the half vector of key light and viewer.
    up, front, lit, half = (
        a * x + b * y + c * z
        for a, b, c in np.stack([camera.up, viewer, toward_key, unit(toward_key + viewer)]).astype(np.float32)
    )
    dome = 0.5 + 0.5 * up  # share of the sky above a surface of this slope; the rest of what it faces is floor
    # Wrapped a little past the terminator: clay and skin scatter light, and the form stays readable in the shade.
    lambert = np.maximum((lit + np.float32(0.15)) / np.float32(1.15), 0)
    grazing = 1 - np.clip(front, 0, 1)
    rim = grazing * grazing * grazing * np.clip(dome, 0, 1)
    # Blinn-Phong with exponent 24; products are cheaper than a power.
    highlight = np.clip(half, 0, 1)
    highlight = highlight * highlight * highlight
    gloss = highlight**8 * GLOSS
    light = np.stack(
        [dome * SKY[k] + (1 - dome) * BOUNCE[k] + lambert * KEY[k] + rim * RIM[k] for k in range(3)], axis=1
    )
    return _shoulder(albedo.astype(np.float32) * light + gloss[:, None])


def _shoulder(linear):
    """Compress values above the knee towards 1 (tone mapping), so that highlights keep their form."""
    range_above = 1 - KNEE
    compressed = 1 - range_above * np.exp(-np.maximum(linear - KNEE, 0.0) / range_above)
    return np.where(linear > KNEE, compressed, linear)


def key_direction(camera: Camera) -> Float[np.ndarray, 3]:
    """Return the unit vector towards the key light: over the viewer's right shoulder.

    A subject in a named view looks to that side.
    """
    right = camera.rotmat_camera_world[0]
    front = np.cross(right, camera.up)  # along the floor, towards the viewer
    return unit(0.72 * right + 0.95 * camera.up + 0.62 * front)


def unit(vector: Float[np.ndarray, 3]) -> Float[np.ndarray, 3]:
    """Normalize a vector to length 1."""
    return vector / np.linalg.norm(vector)


def to_pixels(root: Float[np.ndarray, "*N"]) -> UInt8[np.ndarray, "*N"]:
    """Convert square roots of linear light, in 0..1, to 8-bit sRGB, rounded.

    A table lookup is cheaper than a power per channel. The table is over square roots because evenly spaced roots are
    nearly evenly spaced in sRGB.
    """
    return np.take(_srgb_table(), (root * np.float32(CODES) + np.float32(0.5)).astype(np.uint16))


@functools.cache
def _srgb_table() -> UInt8[np.ndarray, " N"]:
    """Compute 8-bit sRGB of evenly spaced square roots of linear light; a few entries longer for rounding above 1."""
    return (to_srgb(np.square(np.arange(CODES + 8) / CODES)) * 255 + 0.5).astype(np.uint8)
