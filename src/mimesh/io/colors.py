"""Convert vertex colours between linear RGB (in memory and in glTF) and sRGB encoding (in OBJ and PLY).

Values are clipped to 0..1, and NaN becomes 0.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def linear_rgba(srgb: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V 4"]:
    """Decode sRGB-encoded RGB or RGBA in 0..1 to linear RGBA (IEC 61966-2-1); a missing alpha becomes 1."""
    encoded = _unit_range(srgb[:, :3])
    rgb = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return np.concatenate([rgb, _alpha(srgb)], axis=1)


def srgb_rgba(linear: Float[np.ndarray, "V 4"]) -> Float[np.ndarray, "V 4"]:
    """Encode linear RGBA as sRGB, the inverse of `linear_rgba`; alpha stays."""
    rgb = _unit_range(linear[:, :3])
    encoded = np.where(rgb <= 0.0031308, rgb * 12.92, 1.055 * rgb ** (1 / 2.4) - 0.055)
    return np.concatenate([encoded, _alpha(linear)], axis=1)


def with_alpha(values: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V 4"]:
    """Add an alpha of 1 to linear RGB; RGBA stays."""
    return np.concatenate([_unit_range(values[:, :3]), _alpha(values)], axis=1)


def _alpha(values: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V 1"]:
    return _unit_range(values[:, 3:4]) if values.shape[1] > 3 else np.ones((len(values), 1))


def _unit_range(values: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V C"]:
    return np.clip(np.where(np.isnan(values), 0.0, values), 0.0, 1.0)
