"""Limits the size of a page: drops frames of long clips and simplifies dense driving clips."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from ..core.frame_buffer import each_frame, store_frames
from ..core.mesh import Clip, Mesh
from .encoding import Quantization, estimate_size, fit_quantization

DENSE_VERTICES = 20_000
"""A driving clip with more vertices is simplified to this number if it is too large."""
COMPARED_FRAMES = 3
"""Frames in which vertices must be equal to be compared in all others."""
MAX_STEP_RATIO = 8
"""Factor by which the frame step may grow between two estimates of the size, which are coarse."""
CHARACTERS = 5
"""Characters of a vertex in a frame, a first estimate of the encoded size."""


def drop_frames(
    clips: Sequence[Clip], budget: int, left_out: list[str], most: int | None = None
) -> tuple[list[Clip], list[Quantization], list[Int[np.ndarray, " V"] | None]]:
    """Keep every n-th frame of all clips, with an n for which they fit into `budget` characters, and quantize them.

    n grows in proportion to the excess, by one at least, until the estimate fits: one or two rounds as a rule. Frame
    rates are divided by n, so that durations stay. A message about it is appended to `left_out`.

    Args:
        most: largest number of frames; None allows any.

    Returns:
        The clips with the vertices that move differently, their quantizations, and for each vertex of a mesh its index
        among these (None: all of them do).
    """
    longest = max(map(len, clips))
    first = step = 1 if most is None else -(-longest // most)
    every = [dataclasses.replace(clip, vertices=clip.vertices[::step], fps=clip.fps / step) for clip in clips]
    merged, indices = zip(*map(merge_equal_vertices, every), strict=True)
    while True:
        more = step // first
        thinned = [dataclasses.replace(clip, vertices=clip.vertices[::more], fps=clip.fps / more) for clip in merged]
        quantizations = [fit_quantization(clip.vertices) for clip in thinned]
        size = sum(estimate_size(clip.vertices, q) for clip, q in zip(thinned, quantizations, strict=True))
        if size <= budget or step >= longest:
            break
        step = first * min(-(-longest // first), max(more + 1, int(more * min(size / max(budget, 1), MAX_STEP_RATIO))))
    if step > 1:
        left_out.append(f"every {_ordinal(step)} of {longest:,} frames is shown, to keep this page small")
    return thinned, quantizations, list(indices)


def merge_equal_vertices(clip: Clip) -> tuple[Clip, Int[np.ndarray, " V"] | None]:
    """Keep one of the vertices that are at one position in every frame, as files have them at seams.

    Returns:
        The clip with fewer vertices, and for each vertex of the mesh its index among them; None where all are kept.
    """
    chosen = np.unique(np.linspace(0, len(clip) - 1, COMPARED_FRAMES).round().astype(int))
    keys = np.concatenate([clip.vertices[t] for t in chosen], axis=1)
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    index = index.reshape(-1)
    apart = np.zeros(len(index), bool)
    for points in each_frame(clip.vertices):
        apart |= (points != points[first[index]]).any(axis=1)
    index[apart] = len(first) + np.arange(apart.sum())
    kept = np.concatenate([first, np.flatnonzero(apart)])
    if len(kept) == len(index):
        return clip, None
    order = np.argsort(kept)  # neighbours of the file stay neighbours, which compresses better
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    frames = (points[kept[order]] for points in each_frame(clip.vertices))
    dtype = clip.vertices.dtype
    vertices = store_frames(frames, len(clip), len(kept), dtype.type)
    return dataclasses.replace(clip, vertices=vertices), place[index]


def too_dense(clip: Clip, budget: int, count: int = DENSE_VERTICES) -> bool:
    """Whether a clip has more than `count` vertices and is estimated to exceed `budget` characters."""
    many = len(clip.mesh.vertices) > count and len(clip.mesh.faces) > 0
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
