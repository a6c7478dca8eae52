"""Arrays and frames of clips as text for the browser: coded as differences, deflated, base64.

`web/player/scene.js` reads them back. Same input, same bytes. Frames are taken one by one, so that clips that lie on
disk stay there.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt16

from ..core.frame_buffer import each_frame

LEVEL = 6
"""Of zlib; 9 takes three times as long for one percent."""
STEPS = 65535
"""Positions are whole numbers of so many steps along the longest side of the box."""
SAMPLES = 6
"""Frames that `cost` looks at."""


@dataclass(frozen=True, eq=False)
class Quantization:
    """Where a clip's points are: `centre[t] + low + step * q`, with whole q in 0..STEPS."""

    centre: Float[np.ndarray, "T 3"]
    """Middle of the points of each frame: the way of the clip, which leaves the box small."""
    low: Float[np.ndarray, " 3"]
    step: float

    def quantised(self, t: int, points: Float[np.ndarray, "V 3"]) -> UInt16[np.ndarray, "V 3"]:
        """The points of frame t in steps; off by half a step at most."""
        return np.clip(np.rint((points - self.centre[t] - self.low) / self.step), 0, STEPS).astype(np.uint16)


def packed(array: np.ndarray) -> dict[str, Any]:
    """An array as JSON: type, shape, and bytes. Whole numbers are coded as differences in C order (see `_coded`)."""
    kind = {"u": "u", "i": "u", "f": "f"}[array.dtype.kind]
    array = np.ascontiguousarray(array, "<f4" if kind == "f" else "<u4")
    flat = array.ravel()
    data = _planes(flat.view("<u4")) if kind == "f" else _coded(flat, None)
    return {"type": f"{kind}32", "shape": list(array.shape), "data": text(zlib.compress(data, LEVEL))}


def text(content: bytes) -> str:
    """Bytes as base64."""
    return base64.b64encode(content).decode("ascii")


def boxed(vertices: Float[np.ndarray, "T V 3"]) -> Quantization:
    """The box of a clip's frames, each about its own middle."""
    centre, low, high = [], np.full(3, np.inf), np.full(3, -np.inf)
    for points in each_frame(vertices):
        middle = points.mean(axis=0)
        centre.append(middle)
        low, high = np.minimum(low, (points - middle).min(axis=0)), np.maximum(high, (points - middle).max(axis=0))
    size = float((high - low).max())
    return Quantization(np.array(centre), low, size / STEPS if size > 0 else 1.0)


def coded_frames(vertices: Float[np.ndarray, "T V 3"], box: Quantization) -> str:
    """All frames in steps of the box, as differences from the frame before; in the first, from the number before."""
    packer = zlib.compressobj(LEVEL)
    pieces, before = [], None
    for t, points in enumerate(each_frame(vertices)):
        after = box.quantised(t, points).T.ravel()
        pieces.append(packer.compress(_coded(after, before)))
        before = after
    return text(b"".join([*pieces, packer.flush()]))


def cost(vertices: Float[np.ndarray, "T V 3"], box: Quantization) -> int:
    """About how many letters `coded_frames` will take, from a few of the frames."""
    count = len(vertices)
    size = len(zlib.compress(_coded(box.quantised(0, vertices[0]).T.ravel(), None), LEVEL))
    if count == 1:
        return size * 4 // 3
    each = []
    for t in np.unique(np.linspace(1, count - 1, SAMPLES).round().astype(int)).tolist():
        before, after = (box.quantised(k, vertices[k]).T.ravel() for k in (t - 1, t))
        each.append(len(zlib.compress(_coded(after, before), LEVEL)))
    return round(4 / 3 * (size + sum(each) / len(each) * (count - 1)))


def _coded(values: np.ndarray, before: np.ndarray | None) -> bytes:
    """Differences of whole numbers, small ones of either sign as small numbers, in planes of bytes.

    `before` are the same values a frame earlier; with None, each is taken from the value before it.
    """
    if before is None:
        before = np.concatenate([np.zeros(1, values.dtype), values[:-1]])
    signed = (values - before).view(f"<i{values.itemsize}")
    bits = 8 * values.itemsize - 1
    return _planes(((signed << 1) ^ (signed >> bits)).view(values.dtype))


def _planes(values: np.ndarray) -> bytes:
    """All lowest bytes, then all second ones, and so on: alike stands by alike."""
    return np.ascontiguousarray(values.view(np.uint8).reshape(len(values), values.itemsize).T).tobytes()
