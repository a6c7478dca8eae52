"""Convert vertex colours between linear RGB (in memory and in glTF) and sRGB encoding (in OBJ and PLY).

Values are clipped to 0..1, and NaN becomes 0.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def linear_rgba(srgb: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V 4"]:
    """Decode sRGB-encoded RGB or RGBA in 0..1 to linear RGBA (IEC 61966-2-1); a missing alpha becomes 1."""
    return np.concatenate([to_linear(_unit_range(srgb[:, :3])), _alpha(srgb)], axis=1)


def srgb_rgba(linear: Float[np.ndarray, "V 4"]) -> Float[np.ndarray, "V 4"]:
    """Encode linear RGBA as sRGB, the inverse of `linear_rgba`; alpha stays."""
    return np.concatenate([to_srgb(_unit_range(linear[:, :3])), _alpha(linear)], axis=1)


def to_linear(color: Float[np.ndarray, "*N C"]) -> Float[np.ndarray, "*N C"]:
    """Convert sRGB in 0..1 to linear light (IEC 61966-2-1)."""
    return np.where(color <= 0.04045, color / 12.92, ((np.maximum(color, 0.04045) + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: Float[np.ndarray, "*N"]) -> Float[np.ndarray, "*N"]:
    """Convert linear light to sRGB in 0..1 (IEC 61966-2-1); values above 1 are clipped."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def with_alpha(values: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V 4"]:
    """Add an alpha of 1 to linear RGB; RGBA stays."""
    return np.concatenate([_unit_range(values[:, :3]), _alpha(values)], axis=1)


def _alpha(values: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V 1"]:
    return _unit_range(values[:, 3:4]) if values.shape[1] > 3 else np.ones((len(values), 1))


def _unit_range(values: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V C"]:
    return np.clip(np.where(np.isnan(values), 0.0, values), 0.0, 1.0)
