"""Arrays and frames of clips as text for the browser: coded as differences, deflated, base64. `web/player/scene.js` reads
them back.

Same input, same bytes. Frames are taken one by one, so that clips that lie on disk stay there.
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, UInt16

from ..paging import PAGED, let_go

LEVEL = 6
"""Of zlib; 9 takes three times as long for one percent."""
STEPS = 65535
"""Positions are whole numbers of so many steps along the longest side of the box."""
SAMPLES = 6
"""Frames that `cost` looks at."""


@dataclass(frozen=True, eq=False)
class Box:
    """Where a clip's points are: `centre[t] + low + step * q`, with whole q in 0..STEPS."""

    centre: Float[np.ndarray, "T 3"]
    """Middle of the points of each frame: the way of the clip, which leaves the box small."""
    low: Float[np.ndarray, " 3"]
    step: float

    def quantised(self, t: int, points: Float[np.ndarray, "V 3"]) -> UInt16[np.ndarray, "V 3"]:
        """The points of frame t in steps; off by half a step at most."""
        return np.clip(np.rint((points - self.centre[t] - self.low) / self.step), 0, STEPS).astype(np.uint16)


def packed(array: np.ndarray) -> dict[str, Any]:
    """An array as JSON: its type, shape, and bytes. Whole numbers are coded as differences in C order (see `_coded`)."""
    kind = {"u": "u", "i": "u", "f": "f"}[array.dtype.kind]
    array = np.ascontiguousarray(array, "<f4" if kind == "f" else "<u4")
    flat = array.ravel()
    data = _planes(flat.view("<u4")) if kind == "f" else _coded(flat, np.zeros(1, "<u4"))
    return {"type": f"{kind}32", "shape": list(array.shape), "data": text(zlib.compress(data, LEVEL))}


def text(content: bytes) -> str:
    """Bytes as base64."""
    return base64.b64encode(content).decode("ascii")


def boxed(vertices: Float[np.ndarray, "T V 3"], step: int = 1) -> Box:
    """The box of every `step`-th frame, each about its own middle."""
    centre, low, high = [], np.full(3, np.inf), np.full(3, -np.inf)
    for points in _each(vertices, range(0, len(vertices), step)):
        middle = points.mean(axis=0)
        centre.append(middle)
        low, high = np.minimum(low, (points - middle).min(axis=0)), np.maximum(high, (points - middle).max(axis=0))
    size = float((high - low).max())
    return Box(np.array(centre), low, size / STEPS if size > 0 else 1.0)


def coded_frames(vertices: Float[np.ndarray, "T V 3"], box: Box, step: int = 1) -> str:
    """Every `step`-th frame, in steps of the box, as differences from the frame before it (the first: from 0)."""
    packer = zlib.compressobj(LEVEL)
    pieces, before = [], None
    for k, points in enumerate(_each(vertices, range(0, len(vertices), step))):
        after = box.quantised(k, points).T.ravel()
        pieces.append(packer.compress(_coded(after, before)))
        before = after
    return text(b"".join([*pieces, packer.flush()]))


def cost(vertices: Float[np.ndarray, "T V 3"], box: Box, step: int = 1) -> int:
    """About how many letters `coded_frames` will take, from a few of its frames; `box` is that of all frames."""
    shown = range(0, len(vertices), step)
    chosen = np.unique(np.linspace(1, len(shown) - 1, SAMPLES).round().astype(int)) if len(shown) > 1 else []
    size = len(zlib.compress(_coded(box.quantised(0, vertices[0]).T.ravel(), None), LEVEL))
    each = []
    for k in chosen:
        before, after = (box.quantised(t, vertices[t]).T.ravel() for t in (shown[k - 1], shown[k]))
        each.append(len(zlib.compress(_coded(after, before), LEVEL)))
    return round(4 / 3 * (size + (sum(each) / len(each) * (len(shown) - 1) if each else 0)))


def _each(vertices, frames: range):
    """Some frames in double precision, without keeping what was read."""
    for done, t in enumerate(frames):
        yield np.asarray(vertices[t], np.float64)
        if done % PAGED == 0:
            let_go(vertices)


def _coded(values: np.ndarray, before: np.ndarray | None) -> bytes:
    """Differences of whole numbers, small ones of either sign as small numbers, in planes of bytes.

    `before` are the same values a frame earlier; with None or one number, the difference is from the value before.
    """
    if before is None or len(before) != len(values):
        before = np.concatenate([np.zeros(1, values.dtype), values[:-1]])
    signed = (values - before).view(f"<i{values.itemsize}")
    bits = 8 * values.itemsize - 1
    return _planes(((signed << 1) ^ (signed >> bits)).view(values.dtype))


def _planes(values: np.ndarray) -> bytes:
    """All lowest bytes, then all second ones, and so on: alike stands by alike."""
    return np.ascontiguousarray(values.view(np.uint8).reshape(len(values), -1).T).tobytes()
