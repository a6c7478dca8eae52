"""Encodes arrays and frames of clips as text for the browser: differences, in planes of bytes, deflated, base64.

`web/player/scene.js` decodes them. Same input, same bytes. Frames are read one by one, so that clips on disk need no
memory. People at 15 frames a second take about 4.5 characters per vertex and frame (docs/log/speed.md).
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt16

from ..core.frame_buffer import Frames, each_frame

LEVEL = 6
"""Compression level of zlib; 9 takes three times as long to save one percent."""
STEPS = 65535
"""Steps along the longest side of the bounding box into which positions are quantized: 16 bits."""
SAMPLES = 6
"""Frames that `estimate_size` encodes."""


@dataclass(frozen=True, eq=False)
class Quantization:
    """16-bit positions of a clip: points of frame t are `centre[t] + low + step * q`, with integers q in 0..STEPS."""

    centre: Float[np.ndarray, "T 3"]
    """Centroid of each frame: without the motion of the whole body the box, and so the step, is small."""
    low: Float[np.ndarray, " 3"]
    """Lower corner of the bounding box of all frames, relative to their centroids."""
    step: float
    """Length of a step in units of the mesh."""

    def quantize(self, t: int, points: Float[np.ndarray, "V 3"]) -> UInt16[np.ndarray, "V 3"]:
        """Quantize the points of frame t; the error is half a step at most."""
        return np.clip(np.rint((points - self.centre[t] - self.low) / self.step), 0, STEPS).astype(np.uint16)


def pack_array(array: np.ndarray) -> dict[str, Any]:
    """Encode an array as JSON: type, shape and bytes. Integers are coded as differences in C order."""
    kind = {"u": "u", "i": "u", "f": "f"}[array.dtype.kind]
    array = np.ascontiguousarray(array, "<f4" if kind == "f" else "<u4")
    flat = array.ravel()
    data = _byte_planes(flat.view("<u4")) if kind == "f" else _code_differences(flat, None)
    return {"type": f"{kind}32", "shape": list(array.shape), "data": to_base64(zlib.compress(data, LEVEL))}


def to_base64(content: bytes) -> str:
    """Encode bytes as base64."""
    return base64.b64encode(content).decode("ascii")


def fit_quantization(vertices: Float[np.ndarray, "T V 3"]) -> Quantization:
    """Fit the quantization to a clip: the bounding box of its frames, each relative to its centroid."""
    centre, low, high = [], np.full(3, np.inf), np.full(3, -np.inf)
    for points in each_frame(vertices):
        centroid = points.mean(axis=0)
        centre.append(centroid)
        low, high = np.minimum(low, (points - centroid).min(axis=0)), np.maximum(high, (points - centroid).max(axis=0))
    size = float((high - low).max())
    return Quantization(np.array(centre), low, size / STEPS if size > 0 else 1.0)


def encode_frames(vertices: Frames, quantization: Quantization) -> str:
    """Encode all frames as differences to the frame before; the first frame as differences to the value before."""
    compressor = zlib.compressobj(LEVEL)
    pieces, before = [], None
    for t, points in enumerate(each_frame(vertices)):
        # Per axis, not per vertex: neighbouring values are then of one kind and compress better.
        current = quantization.quantize(t, points).T.ravel()
        pieces.append(compressor.compress(_code_differences(current, before)))
        before = current
    return to_base64(b"".join([*pieces, compressor.flush()]))


def estimate_size(vertices: Float[np.ndarray, "T V 3"], quantization: Quantization) -> int:
    """Estimate how many characters `encode_frames` gives, from SAMPLES of the frames."""
    count = len(vertices)
    size = len(zlib.compress(_code_differences(quantization.quantize(0, vertices[0]).T.ravel(), None), LEVEL))
    if count == 1:
        return size * 4 // 3
    sizes = []
    for t in np.unique(np.linspace(1, count - 1, SAMPLES).round().astype(int)).tolist():
        before, current = (quantization.quantize(k, vertices[k]).T.ravel() for k in (t - 1, t))
        sizes.append(len(zlib.compress(_code_differences(current, before), LEVEL)))
    # Base64 takes 4 characters for 3 bytes.
    return round(4 / 3 * (size + sum(sizes) / len(sizes) * (count - 1)))


def _code_differences(values: np.ndarray, before: np.ndarray | None) -> bytes:
    """Code unsigned integers as zigzag differences in planes of bytes.

    Zigzag coding maps 0, -1, 1, -2, ... to 0, 1, 2, 3, ..., so that small differences of either sign have zero high
    bytes, which compress well. `before` are the values a frame earlier; with None, each value minus the one before it.
    """
    if before is None:
        before = np.concatenate([np.zeros(1, values.dtype), values[:-1]])
    # Unsigned differences wrap around; read as signed they are right, and the decoder wraps back.
    signed = (values - before).view(f"<i{values.itemsize}")
    bits = 8 * values.itemsize - 1
    return _byte_planes(((signed << 1) ^ (signed >> bits)).view(values.dtype))


def _byte_planes(values: np.ndarray) -> bytes:
    """Reorder bytes: all lowest ones, then all second ones, and so on, because similar neighbours compress better."""
    return np.ascontiguousarray(values.view(np.uint8).reshape(len(values), values.itemsize).T).tobytes()
