"""Which triangle is seen at which sample of the picture: a scan-line z-buffer in whole-array NumPy operations.

Every triangle is cut into its rows and every row into its samples, so the work is proportional to what is covered and
triangles of any mix of sizes cost the same per sample. Rows and columns are half open and the two triangles at an edge
evaluate it from the same lower end by the same formula: closed meshes have no holes and no sample is drawn twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

BLOCK = 1 << 18
"""Samples tested at a time: large enough to hide NumPy's overhead, small enough to stay in the cache."""


@dataclass(frozen=True, eq=False)
class Hits:
    """The samples that see a surface, one row each."""

    sample: Int[np.ndarray, " N"]
    """Index into the (rows * width) samples."""
    corner: Int[np.ndarray, "N 3"]
    """The triangle's corners as indices into faces.ravel(); `corner[:, 0] // 3` is the face."""
    weight: Float[np.ndarray, "N 3"]
    """How much each of those corners counts, linear across the picture; they sum to 1."""
    rank: Float[np.ndarray, " N"]
    """The rank of the nearest surface, as `Camera.project` defines it."""


def zbuffer(
    points: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    width: int,
    rows: int,
    shifts: Float[np.ndarray, " S"] | None = None,
) -> Hits:
    """The nearest triangle at each sample; of equally near ones, the first in `faces`.

    Args:
        points: x in columns, y in rows, and the rank (smaller is nearer, linear across the picture).
        faces: either orientation is drawn; a triangle with a NaN corner is left out.
        shifts: row r has its samples at columns c + shifts[r % S] and height r + 0.5; one half by default.
    """
    shifts = np.array([0.5]) if shifts is None else shifts
    spans = _spans(points, faces, width, rows, shifts)
    nearest = np.full(rows * width, np.inf)
    owner = np.full(rows * width, -1, np.int64)
    stops = np.concatenate([[0], np.cumsum(spans.stop - spans.start)])
    for begin, end in _blocks(stops):
        _draw(spans, stops, begin, end, width, nearest, owner)
    sample = np.flatnonzero(owner >= 0)
    return _hits(spans, sample, owner[sample], nearest[sample], width)


@dataclass(frozen=True, eq=False)
class _Spans:
    """One row of one triangle each: samples start..stop-1 of a row, between a left and a right edge."""

    row: np.ndarray
    start: np.ndarray
    stop: np.ndarray
    shift: np.ndarray
    left: np.ndarray
    right: np.ndarray
    rank: np.ndarray
    """Rank at the first sample."""
    slope: np.ndarray
    """Change of rank per column."""
    corner: np.ndarray
    """The triangle's corners from top to bottom."""
    left_weight: np.ndarray
    right_weight: np.ndarray


def _spans(points, faces, width, rows, shifts) -> _Spans:
    corner, x, y, rank = _sorted_triangles(points, faces, width, rows)
    first, last = _clipped(y[:, 0] - 0.5, rows), _clipped(y[:, 2] - 0.5, rows)
    face, row = _expand(first, last)
    x_long, long = _edge(x, y, face, row, np.zeros_like(face), np.full_like(face, 2))
    lower = (row + 0.5 >= y[face, 1]).astype(np.int64)
    x_short, short = _edge(x, y, face, row, lower, lower + 1)
    shift = shifts[row % len(shifts)]
    start = _clipped(np.minimum(x_long, x_short) - shift, width)
    stop = _clipped(np.maximum(x_long, x_short) - shift, width)
    some = np.flatnonzero(stop > start)
    face, swap = face[some], (x_short < x_long)[some, None]
    left_weight, right_weight = np.where(swap, short[some], long[some]), np.where(swap, long[some], short[some])
    left, right = np.minimum(x_long, x_short)[some], np.maximum(x_long, x_short)[some]
    left_rank, right_rank = (left_weight * rank[face]).sum(axis=1), (right_weight * rank[face]).sum(axis=1)
    slope = (right_rank - left_rank) / (right - left)
    start, shift = start[some], shift[some]
    return _Spans(
        row=row[some],
        start=start,
        stop=stop[some],
        shift=shift,
        left=left,
        right=right,
        rank=left_rank + (start + shift - left) * slope,
        slope=slope,
        corner=corner[face],
        left_weight=left_weight,
        right_weight=right_weight,
    )


def _sorted_triangles(points, faces, width, rows):
    """The triangles that can be seen, corners from top to bottom: corner index, x, y and rank, each (F, 3)."""
    faces = np.asarray(faces, np.int64)
    corner = 3 * np.arange(len(faces))[:, None] + np.argsort(points[:, 1][faces], axis=1, kind="stable")
    x, y, rank = (points[:, k][faces.ravel()][corner] for k in range(3))
    inside = (x.max(axis=1) > 0) & (x.min(axis=1) < width) & (y[:, 2] > 0) & (y[:, 0] < rows)  # NaN compares false
    kept = np.flatnonzero(inside & (np.ceil(y[:, 2] - 0.5) > np.ceil(y[:, 0] - 0.5)))
    return corner[kept], x[kept], y[kept], rank[kept]


def _clipped(position, limit):
    """Index of the first sample at or after a position, within 0..limit."""
    return np.clip(np.ceil(position), 0, limit).astype(np.int64)


def _edge(x, y, face, row, low, high):
    """Column where the edge between corners `low` and `high` crosses each row, and the corners' weights there."""
    x_low, y_low = x[face, low], y[face, low]
    rise = y[face, high] - y_low
    down = row + 0.5 - y_low
    column = x_low + down * ((x[face, high] - x_low) / rise)
    t = np.clip(down / rise, 0.0, 1.0)
    weight = np.zeros((len(face), 3))
    index = np.arange(len(face))
    weight[index, low], weight[index, high] = 1.0 - t, t
    return column, weight


def _expand(start, stop):
    """All integers of all ranges start..stop-1, and the index of the range each came from."""
    count = stop - start
    index = np.repeat(np.arange(len(count)), count)
    before = np.cumsum(count) - count
    return index, np.arange(len(index)) - (before - start)[index]


def _blocks(stops):
    """Consecutive runs of spans that hold about BLOCK samples each."""
    begin = 0
    while begin < len(stops) - 1:
        end = max(int(np.searchsorted(stops, stops[begin] + BLOCK, side="right")) - 1, begin + 1)
        yield begin, end
        begin = end


def _draw(spans, stops, begin, end, width, nearest, owner) -> None:
    """Put one block of spans into the buffers (both are written to)."""
    count = stops[begin + 1 : end + 1] - stops[begin:end]
    span = np.repeat(np.arange(begin, end), count)
    step = np.arange(len(span)) + np.repeat(stops[begin] - stops[begin:end], count)
    rank = np.repeat(spans.rank[begin:end], count) + step * np.repeat(spans.slope[begin:end], count)
    sample = np.repeat((spans.start + spans.row * width)[begin:end], count) + step
    better = np.flatnonzero(rank < nearest[sample])
    rank, sample, span = rank[better], sample[better], span[better]
    np.minimum.at(nearest, sample, rank)
    won = np.flatnonzero(rank == nearest[sample])[::-1]
    owner[sample[won]] = span[won]  # reversed: of equal ranks the first triangle is written last and stays


def _hits(spans, sample, span, rank, width) -> Hits:
    left = spans.left[span]
    u = np.clip((sample % width + spans.shift[span] - left) / (spans.right[span] - left), 0.0, 1.0)[:, None]
    weight = (1 - u) * spans.left_weight[span] + u * spans.right_weight[span]
    return Hits(sample=sample, corner=spans.corner[span], weight=weight, rank=rank)
