"""What is left out of a page so that it stays small: frames of long clips, vertices of dense driving ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..core.frame_buffer import each_frame, store_frames
from ..core.mesh import Clip, Mesh
from .encoding import Quantization, boxed, cost

DENSE = 20_000
"""Vertices that are left of a driving clip with more, where it is too large."""
HASTE = 8
"""Times by which the number of frames may fall between two looks at what they cost."""
BYTES = 5
"""Letters that a vertex takes in a frame, at least and before it is measured."""


def thinned(clips: Sequence[Clip], room: int, left_out: list[str]) -> tuple[list[Clip], list[Quantization]]:
    """Every n-th frame of all clips, with the smallest n that lets them fit, and where the points of those frames are.

    They play as fast as before. Words about it go to `left_out`; a single frame is never left out.
    """
    longest, step = max(map(len, clips)), 1
    while True:
        kept = [dataclasses.replace(clip, vertices=clip.vertices[::step], fps=clip.fps / step) for clip in clips]
        boxes = [boxed(clip.vertices) for clip in kept]
        need = sum(cost(clip.vertices, box) for clip, box in zip(kept, boxes, strict=True))
        if need <= room or step >= longest:
            break
        step = min(longest, max(step + 1, int(step * min(need / max(room, 1), HASTE))))
    if step > 1:
        left_out.append(f"every {_ordinal(step)} of {longest:,} frames is shown, to keep this page small")
    return kept, boxes


def too_dense(clip: Clip, room: int) -> bool:
    """Whether a clip has more than DENSE vertices and is sure to need more letters than there is room for."""
    many = len(clip.mesh.vertices) > DENSE and len(clip.mesh.faces) > 0
    return many and len(clip) * len(clip.mesh.vertices) * BYTES > room


def simplified(clip: Clip, count: int) -> Clip:
    """The clip with about so many of its vertices, and clay for its looks.

    Its first frame is decimated; each vertex that is left is stood for by the nearest of the clip's own, in all frames.
    """
    import fast_simplification
    from scipy.spatial import KDTree

    first = np.asarray(clip.vertices[0], np.float64)
    points, faces = fast_simplification.simplify(first, clip.mesh.faces.astype(np.int32), target_count=2 * count)[:2]
    nearest = KDTree(first).query(np.asarray(points))[1]
    chosen, renamed = np.unique(nearest, return_inverse=True)
    faces = renamed[np.asarray(faces, np.int64)]
    whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    frames = (points[chosen] for points in each_frame(clip.vertices))
    vertices = store_frames(frames, len(clip), len(chosen), np.float32)
    mesh = Mesh(vertices[0].astype(np.float64), faces[whole], name=clip.mesh.name)
    return dataclasses.replace(clip, mesh=mesh, vertices=vertices)


def _ordinal(number: int) -> str:
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"
