"""Which triangle is seen at which sample of the picture: a scan-line z-buffer in whole-array NumPy operations.

Every triangle is cut into its rows and every row into its samples, so the work is proportional to what is covered and
triangles of any mix of sizes cost the same per sample. Rows and columns are half open and the two triangles at an edge
evaluate it from the same upper end by the same formula: closed meshes have no holes and no sample is drawn twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

BLOCK = 1 << 17
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
    spans = _spans(points, faces, width, rows, np.array([0.5]) if shifts is None else shifts)
    nearest = np.full(rows * width, np.inf)
    owner = np.full(rows * width, -1, np.int64)
    for sample, rank, span in _samples(spans, width):
        better = np.flatnonzero(rank < nearest[sample])
        sample, rank, span = sample[better], rank[better], span[better]
        np.minimum.at(nearest, sample, rank)
        won = np.flatnonzero(rank == nearest[sample])[::-1]
        owner[sample[won]] = span[won]  # reversed: of equal ranks the first triangle is written last and stays
    sample = np.flatnonzero(owner >= 0)
    return _hits(spans, sample, owner[sample], width)


def depth_map(
    points: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], width: int, rows: int
) -> Float[np.ndarray, "rows width"]:
    """The rank of the nearest surface at the middle of each cell, infinite where there is none (see `zbuffer`)."""
    nearest = np.full(rows * width, np.inf)
    for sample, rank, _ in _samples(_spans(points, faces, width, rows, np.array([0.5])), width):
        np.minimum.at(nearest, sample, rank)
    return nearest.reshape(rows, width)


@dataclass(frozen=True, eq=False)
class _Spans:
    """One row of one triangle each: samples start..stop-1, between a crossing of its long edge and one of a short."""

    row: np.ndarray
    start: np.ndarray
    stop: np.ndarray
    rank: np.ndarray
    """Rank at the first sample."""
    slope: np.ndarray
    """Change of rank per column."""
    corner: np.ndarray
    """The triangle's corners from top to bottom; the long edge joins the first and the last."""
    lower: np.ndarray
    """1 where the short edge is the lower one (corners 1 and 2), 0 where it is the upper one."""
    t_long: np.ndarray
    """How far down the long edge the row crosses it, 0..1."""
    t_short: np.ndarray
    u: np.ndarray
    """How far the first sample is from the long edge (0) to the short one (1)."""
    u_step: np.ndarray


def _spans(points, faces, width, rows, shifts) -> _Spans:
    corner, x, y, rank = _sorted_triangles(points, faces, width, rows)
    face, row = _expand(_clipped(y[0] - 0.5, rows), _clipped(y[2] - 0.5, rows))
    height = row + 0.5
    x_long, t_long = _crossing(x[0][face], y[0][face], x[2][face], y[2][face], height)
    lower = (height >= y[1][face]).astype(np.int64)
    low, high = lower * len(corner) + face, (lower + 1) * len(corner) + face
    x_short, t_short = _crossing(x.ravel()[low], y.ravel()[low], x.ravel()[high], y.ravel()[high], height)
    shift = shifts[row % len(shifts)]
    start = _clipped(np.minimum(x_long, x_short) - shift, width)
    stop = _clipped(np.maximum(x_long, x_short) - shift, width)
    some = np.flatnonzero(stop > start)
    face, low, high, start, t_long, t_short = (a[some] for a in (face, low, high, start, t_long, t_short))
    rank_long = (1 - t_long) * rank[0][face] + t_long * rank[2][face]
    rank_short = (1 - t_short) * rank.ravel()[low] + t_short * rank.ravel()[high]
    across = x_short[some] - x_long[some]
    u = (start + shift[some] - x_long[some]) / across
    return _Spans(
        row=row[some],
        start=start,
        stop=stop[some],
        rank=rank_long + u * (rank_short - rank_long),
        slope=(rank_short - rank_long) / across,
        corner=corner[face],
        lower=lower[some],
        t_long=t_long,
        t_short=t_short,
        u=u,
        u_step=1 / across,
    )


def _sorted_triangles(points, faces, width, rows):
    """The triangles that can be seen, corners from top to bottom: corner (F, 3), then x, y and rank, each (3, F)."""
    x, y = points[:, 0][faces.T], points[:, 1][faces.T]
    top, bottom = np.minimum(np.minimum(y[0], y[1]), y[2]), np.maximum(np.maximum(y[0], y[1]), y[2])
    left, right = np.minimum(np.minimum(x[0], x[1]), x[2]), np.maximum(np.maximum(x[0], x[1]), x[2])
    inside = (right > 0) & (left < width) & (bottom > 0) & (top < rows)  # NaN compares false
    kept = np.flatnonzero(inside & (np.ceil(bottom - 0.5) > np.ceil(top - 0.5)))
    order = np.argsort(y[:, kept], axis=0, kind="stable")
    corner = 3 * kept[:, None] + order.T
    index = order * len(faces) + kept
    rank = points[:, 2][faces.T.ravel()[index]]
    return corner, x.ravel()[index], y.ravel()[index], rank


def _clipped(position, limit):
    """Index of the first sample at or after a position, within 0..limit."""
    return np.clip(np.ceil(position), 0, limit).astype(np.int64)


def _crossing(x_low, y_low, x_high, y_high, height):
    """Column where an edge (of growing y) crosses a height, and how far along the edge that is, 0..1."""
    rise, down = y_high - y_low, height - y_low
    return x_low + down * ((x_high - x_low) / rise), np.clip(down / rise, 0.0, 1.0)


def _expand(start, stop):
    """All integers of all ranges start..stop-1, and the index of the range each came from, as (index, integer)."""
    count = stop - start
    index = np.repeat(np.arange(len(count)), count)
    return index, np.arange(len(index)) + np.repeat(start - np.cumsum(count) + count, count)


def _samples(spans, width):
    """Yield blocks of (sample, rank, span) that cover all spans in order, about BLOCK samples at a time."""
    stops = np.concatenate([[0], np.cumsum(spans.stop - spans.start)])
    first = spans.start + spans.row * width
    begin = 0
    while begin < len(stops) - 1:
        end = max(int(np.searchsorted(stops, stops[begin] + BLOCK, side="right")) - 1, begin + 1)
        count = np.diff(stops[begin : end + 1])
        span = np.repeat(np.arange(begin, end), count)
        step = np.arange(len(span)) + np.repeat(stops[begin] - stops[begin:end], count)
        yield first[span] + step, spans.rank[span] + step * spans.slope[span], span
        begin = end


def _hits(spans, sample, span, width) -> Hits:
    step = sample % width - spans.start[span]
    u = np.clip(spans.u[span] + step * spans.u_step[span], 0.0, 1.0)
    lower, t_long, t_short = spans.lower[span], spans.t_long[span], spans.t_short[span]
    top = (1 - u) * (1 - t_long) + u * (1 - t_short) * (1 - lower)
    bottom = (1 - u) * t_long + u * t_short * lower
    return Hits(sample, spans.corner[span], np.stack([top, 1 - top - bottom, bottom], axis=1))
