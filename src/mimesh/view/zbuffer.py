"""Which triangle is visible at which sample of the picture: a scan-line z-buffer in whole-array NumPy operations.

Every triangle is cut into its rows (spans) and every span into its samples, so the cost is proportional to the covered
samples, not to bounding boxes, and triangles of any mix of sizes cost the same per sample. Rows and columns are half
open, and the two triangles at an edge evaluate it from the same upper end by the same formula: closed meshes have no
holes and no sample is drawn twice. Depth and face index are packed into one integer, so that one minimum per sample
finds the nearest triangle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Int32

BLOCK = 1 << 17
"""Samples tested at a time: large enough to hide NumPy's overhead per call, small enough to stay in the cache."""
BLOCK_ROWS = 1 << 14
"""Rows of triangles that are processed at a time, for the same reason as BLOCK."""
FAR = np.iinfo(np.int64).max
"""Key of a sample that no triangle covers; its low 32 bits, read as int32, are -1."""
DEPTHS = 1 << 30
"""Steps of depth between the nearest and the farthest corner; they are stored above the 32 bits of a face index."""


@dataclass(frozen=True, eq=False)
class Hits:
    """Visible points of the surface, one row each."""

    pixel: Int[np.ndarray, " N"]
    """Index of the pixel, row by row from the top left."""
    corner: Int[np.ndarray, "N 3"]
    """Corners of the triangle as indices into faces.ravel(); `corner[:, 0] // 3` is the face."""
    weight: Float[np.ndarray, "N 3"]
    """Barycentric weights of those corners; they sum to 1."""
    area: Float[np.ndarray, " N"]
    """Area of the whole triangle in the picture, in square pixels."""


def visible_faces(
    points: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    width: int,
    rows: int,
    shifts: Float[np.ndarray, " S"] | None = None,
) -> Int32[np.ndarray, "rows width"]:
    """Return the index of the nearest triangle at each sample, -1 where there is none.

    Of equally near triangles the first in `faces` wins.

    Args:
        points: x in columns, y in rows, and the rank (smaller is nearer, linear across the picture).
        faces: either orientation is drawn; a triangle with a NaN corner is left out.
        shifts: row r has its samples at columns c + shifts[r % S] and height r + 0.5; one half by default.
    """
    shifts = np.array([0.5]) if shifts is None else shifts
    nearest = np.full(rows * width, FAR)
    for block in _triangle_blocks(*_sorted_triangles(points, faces, width, rows)):
        for sample, key in _samples(_spans(block, width, rows, shifts)):
            # The key has the depth in its high bits and the face in its low 32: the minimum is the nearest face.
            np.minimum.at(nearest, sample, key)
    return nearest.astype(np.int32).reshape(rows, width)  # keeps the low 32 bits: the face, or -1 of FAR


def weights_at(
    points: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    face: Int[np.ndarray, " N"],
    x: Float[np.ndarray, " N"],
    y: Float[np.ndarray, " N"],
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, " N"]]:
    """Return barycentric weights at positions in triangles, linear across the picture, and signed areas (y down).

    The weights are plane equations. Their coefficients are computed once per triangle and looked up per position.
    Positions slightly outside are clamped, so that weights stay in 0..1.
    """
    x0, y0, _ = points[faces[:, 0]].T
    (ux, uy, _), (vx, vy, _) = points[faces[:, 1]].T - [x0, y0, 0 * x0], points[faces[:, 2]].T - [x0, y0, 0 * x0]
    double = ux * vy - uy * vx  # twice the signed area
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
    """Spans: the `count` samples from `first` on that one triangle covers in one row."""

    face: np.ndarray
    first: np.ndarray
    """Index of the leftmost sample in the picture, row by row."""
    count: np.ndarray
    depth: np.ndarray
    """Depth at the first sample, 0 at the nearest corner of all triangles and 1 at the farthest."""
    slope: np.ndarray
    """Change of depth per column."""


def _triangle_blocks(face_index, x, y, z):
    """Yield the sorted triangles in blocks of about BLOCK_ROWS rows, so that arrays of their rows fit the cache."""
    number = np.cumsum(y[2] - y[0]) // BLOCK_ROWS
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    for begin, end in zip(starts, np.append(starts, len(face_index))[1:], strict=True):
        block = slice(begin, end)
        yield face_index[block], x[:, block], y[:, block], z[:, block]


def _spans(triangles, width, rows, shifts) -> _Spans:
    """Cut triangles, their corners sorted from top to bottom, into spans.

    In every row, a triangle lies between its long edge (top to bottom corner) and one of its two short ones (top to
    middle, middle to bottom); where the row crosses these two edges, the span starts and stops.
    """
    face_index, x, y, z = triangles
    triangle, row = _expand(_clipped(y[0] - 0.5, rows), _clipped(y[2] - 0.5, rows))
    height = row + 0.5
    # Short edges are numbered upper ones first: (2, F) arrays, raveled.
    short_edge = triangle + len(face_index) * (height >= y[1][triangle])
    with np.errstate(divide="ignore", invalid="ignore"):  # level edges, which no row crosses
        long_slope, short_slope = (x[2] - x[0]) / (y[2] - y[0]), (np.diff(x, axis=0) / np.diff(y, axis=0)).ravel()
    long_x = x[0][triangle] + (height - y[0][triangle]) * long_slope[triangle]
    short_x = x.ravel()[short_edge] + (height - y.ravel()[short_edge]) * short_slope[short_edge]
    shift = shifts[row % len(shifts)]
    start = _clipped(np.minimum(long_x, short_x) - shift, width)
    stop = _clipped(np.maximum(long_x, short_x) - shift, width)
    filled = np.flatnonzero(stop > start)
    triangle, row, start, count = triangle[filled], row[filled], start[filled], (stop - start)[filled]
    across, down = _depth_slopes(x, y, z)
    nearest, farthest = z.min(axis=0)[triangle], z.max(axis=0)[triangle]
    at_start = (
        z[0][triangle]
        + down[triangle] * (row + 0.5 - y[0][triangle])
        + across[triangle] * (start + shift[filled] - x[0][triangle])
    )
    # Planes of slivers are ill-conditioned: their depths are clamped to those of their corners.
    at_stop = np.clip(at_start + across[triangle] * (count - 1), nearest, farthest)
    at_start = np.clip(at_start, nearest, farthest)
    slope = (at_stop - at_start) / np.maximum(count - 1, 1)
    return _Spans(face_index[triangle], start + row * width, count, at_start, slope)


def _sorted_triangles(points, faces, width, rows):
    """Return the indices of triangles inside the picture, and x, y and depth (3, F) of their corners by rising y."""
    x, y = points[:, 0][faces.T], points[:, 1][faces.T]
    top, bottom = np.minimum(np.minimum(y[0], y[1]), y[2]), np.maximum(np.maximum(y[0], y[1]), y[2])
    left, right = np.minimum(np.minimum(x[0], x[1]), x[2]), np.maximum(np.maximum(x[0], x[1]), x[2])
    inside = (right > 0) & (left < width) & (bottom > 0) & (top < rows)  # NaN compares false
    face_index = np.flatnonzero(inside & (np.ceil(bottom - 0.5) > np.ceil(top - 0.5)))
    index = np.argsort(y[:, face_index], axis=0, kind="stable") * len(faces) + face_index
    rank = points[:, 2][faces.T.ravel()[index]]
    nearest, farthest = (rank.min(), rank.max()) if rank.size else (0.0, 0.0)
    return face_index, x.ravel()[index], y.ravel()[index], (rank - nearest) / max(farthest - nearest, 1e-300)


def _depth_slopes(x, y, z):
    """Return the change of depth per column and per row on each triangle's plane; 0 for triangles without area."""
    (_, ux, vx), (_, uy, vy), (_, uz, vz) = x - x[0], y - y[0], z - z[0]
    double = ux * vy - uy * vx
    scale = 1 / np.where(double == 0, np.inf, double)
    return (uz * vy - uy * vz) * scale, (ux * vz - uz * vx) * scale


def _clipped(position, limit):
    """Return the index of the first sample at or after a position, within 0..limit."""
    return np.minimum(np.maximum(np.ceil(position), 0), limit).astype(np.int64)


def _expand(start, stop):
    """Return all integers of all ranges start..stop-1 and the range each came from, as (range index, integer)."""
    count = stop - start
    index = np.repeat(np.arange(len(count)), count)
    return index, np.arange(len(index)) + np.repeat(start - np.cumsum(count) + count, count)


def _samples(spans):
    """Yield (sample index, packed depth and face) of all spans, about BLOCK samples at a time.

    Depth is linear along a span: the key of its sample k is `key + k * step`, where the step has zeros in its low 32
    bits, so that the face index stays intact. All samples of a block are written by two repeats and one multiplication.
    """
    stops = np.concatenate([[0], np.cumsum(spans.count)])
    step = np.rint(spans.slope * DEPTHS).astype(np.int64) << 32
    key = (np.rint(spans.depth * DEPTHS).astype(np.int64) << 32) + spans.face
    begin = 0
    while begin < len(stops) - 1:
        end = max(int(np.searchsorted(stops, stops[begin] + BLOCK, side="right")) - 1, begin + 1)
        block = slice(begin, end)
        count, before = spans.count[block], stops[block] - stops[begin]
        k = np.arange(stops[end] - stops[begin])  # counts through the block; a span starts at its `before`
        keys = np.repeat(step[block], count) * k
        # Products may overflow, but integers wrap around: the sum is right modulo 2^64, and it fits.
        keys += np.repeat(key[block] - step[block] * before, count)
        yield np.repeat(spans.first[block] - before, count) + k, keys
        begin = end
