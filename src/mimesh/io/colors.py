"""Colours of vertices: linear in memory and in glTF, sRGB-encoded in OBJ and PLY; what is no number counts as 0."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def linear_rgba(srgb: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V 4"]:
    """Linear RGBA of sRGB-encoded RGB or RGBA in 0..1 (IEC 61966-2-1); alpha is 1 where there is none."""
    encoded = _share(srgb[:, :3])
    rgb = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return np.concatenate([rgb, _alpha(srgb)], axis=1)


def srgb_rgba(linear: Float[np.ndarray, "V 4"]) -> Float[np.ndarray, "V 4"]:
    """The inverse of `linear_rgba`; alpha is not encoded."""
    rgb = _share(linear[:, :3])
    encoded = np.where(rgb <= 0.0031308, rgb * 12.92, 1.055 * rgb ** (1 / 2.4) - 0.055)
    return np.concatenate([encoded, _alpha(linear)], axis=1)


def with_alpha(values: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V 4"]:
    """Linear RGB or RGBA, as it is, with an alpha of 1 where there is none."""
    return np.concatenate([_share(values[:, :3]), _alpha(values)], axis=1)


def _alpha(values: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V 1"]:
    return _share(values[:, 3:4]) if values.shape[1] > 3 else np.ones((len(values), 1))


def _share(values: Float[np.ndarray, "V C"]) -> Float[np.ndarray, "V C"]:
    return np.clip(np.where(np.isnan(values), 0.0, values), 0.0, 1.0)
