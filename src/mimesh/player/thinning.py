"""Limits the size of a page: drops frames of long clips and simplifies dense driving clips."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..core.frame_buffer import each_frame, store_frames
from ..core.mesh import Clip, Mesh
from .encoding import Quantization, estimate_size, fit_quantization

DENSE_VERTICES = 20_000
"""A driving clip with more vertices is simplified to this number if it is too large."""
MAX_STEP_RATIO = 8
"""Factor by which the frame step may grow between two estimates of the size, which are coarse."""
CHARACTERS = 5
"""Characters of a vertex in a frame, a first estimate of the encoded size."""


def drop_frames(clips: Sequence[Clip], budget: int, left_out: list[str]) -> tuple[list[Clip], list[Quantization]]:
    """Keep every n-th frame of all clips, with an n for which they fit into `budget` characters, and quantize them.

    n grows in proportion to the excess, by one at least, until the estimate fits: one or two rounds as a rule. Frame
    rates are divided by n, so that durations stay. A message about it is appended to `left_out`.
    """
    longest, step = max(map(len, clips)), 1
    while True:
        thinned = [dataclasses.replace(clip, vertices=clip.vertices[::step], fps=clip.fps / step) for clip in clips]
        quantizations = [fit_quantization(clip.vertices) for clip in thinned]
        size = sum(estimate_size(clip.vertices, q) for clip, q in zip(thinned, quantizations, strict=True))
        if size <= budget or step >= longest:
            break
        step = min(longest, max(step + 1, int(step * min(size / max(budget, 1), MAX_STEP_RATIO))))
    if step > 1:
        left_out.append(f"every {_ordinal(step)} of {longest:,} frames is shown, to keep this page small")
    return thinned, quantizations


def too_dense(clip: Clip, budget: int) -> bool:
    """Whether a clip has more than DENSE_VERTICES vertices and is estimated to exceed `budget` characters."""
    many = len(clip.mesh.vertices) > DENSE_VERTICES and len(clip.mesh.faces) > 0
    return many and len(clip) * len(clip.mesh.vertices) * CHARACTERS > budget


def simplify_clip(clip: Clip, count: int) -> Clip:
    """Reduce a clip to about `count` of its vertices, without materials.

    Its first frame is decimated. Decimation moves vertices, so each is replaced by the nearest vertex of the clip,
    whose positions are known in all frames.
    """
    import fast_simplification
    from scipy.spatial import KDTree

    first = np.asarray(clip.vertices[0], np.float64)
    points, faces = fast_simplification.simplify(first, clip.mesh.faces.astype(np.int32), target_count=2 * count)[:2]
    nearest = KDTree(first).query(np.asarray(points))[1]
    chosen, new_index = np.unique(nearest, return_inverse=True)
    faces = new_index[np.asarray(faces, np.int64)]
    distinct = (faces != np.roll(faces, 1, axis=1)).all(axis=1)  # not collapsed to an edge or a point
    frames = (points[chosen] for points in each_frame(clip.vertices))
    vertices = store_frames(frames, len(clip), len(chosen), np.float32)
    mesh = Mesh(vertices[0].astype(np.float64), faces[distinct], name=clip.mesh.name)
    return dataclasses.replace(clip, mesh=mesh, vertices=vertices)


def _ordinal(number: int) -> str:
    """Format 2 as "2nd"."""
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"
