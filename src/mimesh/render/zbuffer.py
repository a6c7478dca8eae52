"""Which triangle is seen at which sample of the picture: a scan-line z-buffer in whole-array NumPy operations.

Every triangle is cut into its rows and every row into its samples, so the work is proportional to what is covered and
triangles of any mix of sizes cost the same per sample. Rows and columns are half open and the two triangles at an edge
evaluate it from the same upper end by the same formula: closed meshes have no holes and no sample is drawn twice.
Depth and triangle are packed into one integer, so that one minimum per sample finds the nearest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Int32

BLOCK = 1 << 17
"""Samples tested at a time: large enough to hide NumPy's overhead, small enough to stay in the cache."""
BLOCK_ROWS = 1 << 14
"""Rows of triangles that are worked on at a time."""
FAR = np.iinfo(np.int64).max
DEPTHS = 1 << 30
"""Steps of depth between the nearest and the farthest corner; they stand above the 32 bits of a face's number."""


@dataclass(frozen=True, eq=False)
class Hits:
    """Points of the surface that are seen, one row each."""

    pixel: Int[np.ndarray, " N"]
    """Index into the picture's pixels, row by row."""
    corner: Int[np.ndarray, "N 3"]
    """The triangle's corners as indices into faces.ravel(); `corner[:, 0] // 3` is the face."""
    weight: Float[np.ndarray, "N 3"]
    """How much each of those corners counts; they sum to 1."""
    area: Float[np.ndarray, " N"]
    """The triangle's area in the picture, in pixels."""


def visible_faces(
    points: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    width: int,
    rows: int,
    shifts: Float[np.ndarray, " S"] | None = None,
) -> Int32[np.ndarray, "rows width"]:
    """The nearest triangle at each sample, -1 where there is none; of equally near ones, the first in `faces`.

    Args:
        points: x in columns, y in rows, and the rank (smaller is nearer, linear across the picture).
        faces: either orientation is drawn; a triangle with a NaN corner is left out.
        shifts: row r has its samples at columns c + shifts[r % S] and height r + 0.5; one half by default.
    """
    shifts = np.array([0.5]) if shifts is None else shifts
    nearest = np.full(rows * width, FAR)
    for block in _blocks(*_sorted_triangles(points, faces, width, rows)):
        for sample, key in _samples(_spans(block, width, rows, shifts)):
            np.minimum.at(nearest, sample, key)
    return nearest.astype(np.int32).reshape(rows, width)  # the lower half: the face, and -1 of FAR


def weights_at(
    points: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    face: Int[np.ndarray, " N"],
    x: Float[np.ndarray, " N"],
    y: Float[np.ndarray, " N"],
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, " N"]]:
    """Weights of the corners of a triangle at places in it, linear across the picture, and its signed area (y down)."""
    x0, y0, _ = points[faces[:, 0]].T
    (ux, uy, _), (vx, vy, _) = points[faces[:, 1]].T - [x0, y0, 0 * x0], points[faces[:, 2]].T - [x0, y0, 0 * x0]
    double = ux * vy - uy * vx
    scale = 1 / np.where(double == 0, np.inf, double)
    planes = np.stack([x0, y0, vy * scale, -vx * scale, -uy * scale, ux * scale, double / 2], axis=1)
    x0, y0, second_x, second_y, third_x, third_y, area = np.take(planes, face, axis=0).T
    dx, dy = x - x0, y - y0
    weight = np.empty((len(face), 3))
    weight[:, 1] = np.clip(dx * second_x + dy * second_y, 0.0, 1.0)
    weight[:, 2] = np.clip(dx * third_x + dy * third_y, 0.0, 1.0 - weight[:, 1])
    weight[:, 0] = 1.0 - weight[:, 1] - weight[:, 2]
    return weight, area


@dataclass(frozen=True, eq=False)
class _Spans:
    """One row of one triangle each: `count` samples from `first` on."""

    face: np.ndarray
    first: np.ndarray
    count: np.ndarray
    depth: np.ndarray
    """Depth at the first sample, 0 at the nearest point of all triangles and 1 at the farthest."""
    slope: np.ndarray
    """Change of depth per column."""


def _blocks(kept, x, y, z):
    """Yield the sorted triangles some at a time, so that what is made of their rows stays in the cache."""
    block = np.cumsum(y[2] - y[0]) // BLOCK_ROWS
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    for begin, end in zip(starts, np.append(starts, len(kept))[1:], strict=True):
        some = slice(begin, end)
        yield kept[some], x[:, some], y[:, some], z[:, some]


def _spans(triangles, width, rows, shifts) -> _Spans:
    kept, x, y, z = triangles
    one, row = _expand(_clipped(y[0] - 0.5, rows), _clipped(y[2] - 0.5, rows))
    height = row + 0.5
    short = one + len(kept) * (height >= y[1][one])  # which of the two short edges the row crosses
    with np.errstate(divide="ignore", invalid="ignore"):  # level edges, which no row crosses
        long_slope, short_slope = (x[2] - x[0]) / (y[2] - y[0]), (np.diff(x, axis=0) / np.diff(y, axis=0)).ravel()
    long_x = x[0][one] + (height - y[0][one]) * long_slope[one]
    short_x = x.ravel()[short] + (height - y.ravel()[short]) * short_slope[short]
    shift = shifts[row % len(shifts)]
    start = _clipped(np.minimum(long_x, short_x) - shift, width)
    stop = _clipped(np.maximum(long_x, short_x) - shift, width)
    some = np.flatnonzero(stop > start)
    one, row, start, count = one[some], row[some], start[some], (stop - start)[some]
    across, down = _slopes(x, y, z)
    least, most = z.min(axis=0)[one], z.max(axis=0)[one]
    at_start = z[0][one] + down[one] * (row + 0.5 - y[0][one]) + across[one] * (start + shift[some] - x[0][one])
    at_stop = np.clip(at_start + across[one] * (count - 1), least, most)  # slivers have no plane to speak of
    at_start = np.clip(at_start, least, most)
    return _Spans(kept[one], start + row * width, count, at_start, (at_stop - at_start) / np.maximum(count - 1, 1))


def _sorted_triangles(points, faces, width, rows):
    """Indices of the triangles that can be seen, then x, y and depth of their corners from top to bottom, (3, F)."""
    x, y = points[:, 0][faces.T], points[:, 1][faces.T]
    top, bottom = np.minimum(np.minimum(y[0], y[1]), y[2]), np.maximum(np.maximum(y[0], y[1]), y[2])
    left, right = np.minimum(np.minimum(x[0], x[1]), x[2]), np.maximum(np.maximum(x[0], x[1]), x[2])
    inside = (right > 0) & (left < width) & (bottom > 0) & (top < rows)  # NaN compares false
    kept = np.flatnonzero(inside & (np.ceil(bottom - 0.5) > np.ceil(top - 0.5)))
    index = np.argsort(y[:, kept], axis=0, kind="stable") * len(faces) + kept
    rank = points[:, 2][faces.T.ravel()[index]]
    nearest, farthest = (rank.min(), rank.max()) if rank.size else (0.0, 0.0)
    return kept, x.ravel()[index], y.ravel()[index], (rank - nearest) / max(farthest - nearest, 1e-300)


def _slopes(x, y, z):
    """Change of depth per column and per row on each triangle's plane; none where it has no area."""
    (_, ux, vx), (_, uy, vy), (_, uz, vz) = x - x[0], y - y[0], z - z[0]
    double = ux * vy - uy * vx
    scale = 1 / np.where(double == 0, np.inf, double)
    return (uz * vy - uy * vz) * scale, (ux * vz - uz * vx) * scale


def _clipped(position, limit):
    """Index of the first sample at or after a position, within 0..limit."""
    return np.minimum(np.maximum(np.ceil(position), 0), limit).astype(np.int64)


def _expand(start, stop):
    """All integers of all ranges start..stop-1, and the index of the range each came from, as (index, integer)."""
    count = stop - start
    index = np.repeat(np.arange(len(count)), count)
    return index, np.arange(len(index)) + np.repeat(start - np.cumsum(count) + count, count)


def _samples(spans):
    """Yield blocks of (sample, depth and face) that cover all spans, about BLOCK samples at a time."""
    stops = np.concatenate([[0], np.cumsum(spans.count)])
    step = np.rint(spans.slope * DEPTHS).astype(np.int64) << 32
    key = (np.rint(spans.depth * DEPTHS).astype(np.int64) << 32) + spans.face
    begin = 0
    while begin < len(stops) - 1:
        end = max(int(np.searchsorted(stops, stops[begin] + BLOCK, side="right")) - 1, begin + 1)
        block = slice(begin, end)
        count, before = spans.count[block], stops[block] - stops[begin]
        k = np.arange(stops[end] - stops[begin])
        keys = np.repeat(step[block], count) * k
        keys += np.repeat(key[block] - step[block] * before, count)  # may wrap around on the way, and comes back
        yield np.repeat(spans.first[block] - before, count) + k, keys
        begin = end
