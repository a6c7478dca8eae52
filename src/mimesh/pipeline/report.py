"""Measure results for the report: edge stretch, flipped triangles, acceleration, and the axes that were used."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from ..core.geometry import edges, face_vectors
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization

MOST_FRAMES = 32
"""Largest number of frames, evenly spread, by which a clip is measured."""
MIN_EDGE = 1e-3
"""Share of the mean edge length below which the stretch of an edge is not measured."""


def quality(identity: Mesh, vertices: Float[np.ndarray, "T V 3"]) -> dict[str, float]:
    """Measure the worst edge stretch and share of flipped triangles over all frames; empty for a point cloud."""
    if len(identity.faces) == 0:
        return {}
    pairs = edges(identity.faces)
    chosen = np.unique(np.linspace(0, len(vertices) - 1, min(MOST_FRAMES, len(vertices))).round().astype(int))
    # Frame by frame: the edges of a large mesh in all frames would take gigabytes.
    stretches = np.array([_largest_stretches(edge_stretch(identity.vertices, vertices[t], pairs)) for t in chosen])
    before = against_neighbours(identity.faces, identity.vertices)
    flips = [flipped_share(identity.faces, before, vertices[t]) for t in chosen]
    return {
        "edge_stretch_max": float(stretches[:, 0].max()),
        "edge_stretch_p99": float(stretches[:, 1].max()),
        "flipped_share": max(flips),
    }


def edge_stretch(
    before: Float[np.ndarray, "V 3"], after: Float[np.ndarray, "V 3"], pairs: Int[np.ndarray, "E 2"]
) -> Float[np.ndarray, " S"]:
    """Return the factor by which each edge became longer or shorter (1: unchanged), without the shortest edges."""
    old, new = (np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1) for points in (before, after))
    measured = old > MIN_EDGE * (old.mean() if len(old) else 0.0)
    # Twice as long and half as long are the same stretch; the bound keeps collapsed edges finite.
    ratio = np.maximum(new[measured] / old[measured], 1e-6)
    return np.maximum(ratio, 1 / ratio)


def _largest_stretches(stretch: Float[np.ndarray, " S"]) -> tuple[float, float]:
    """Return the largest stretch of a frame and its 99th percentile."""
    return float(stretch.max(initial=1.0)), float(np.quantile(stretch, 0.99)) if stretch.size else 1.0


def flipped_share(
    faces: Int[np.ndarray, "F 3"], before: Bool[np.ndarray, " F"], after: Float[np.ndarray, "V 3"]
) -> float:
    """Return the share of triangles that face against their neighbours and did not before (`against_neighbours`)."""
    return float((against_neighbours(faces, after) & ~before).mean())


def facing(norm: Normalization) -> dict[str, str | bool | float]:
    """Return the axes that were used for one input, as reports have them."""
    axes = {"up": norm.up, "front": norm.front, "up_from": norm.up_from}
    return axes | {"detected": norm.detected, "margin": round(norm.margin, 3)}


def facing_note(norm: Normalization, name: str, option: str) -> tuple[str, ...]:
    """Return notes for the user if the file's up contradicts the shape, or axes were detected with a small margin."""
    notes = ()
    if norm.shape_up is not None:
        notes += (
            f"the file of {name} defines up {norm.up}, its shape looks like up {norm.shape_up}; "
            f"give {option.replace('front', 'up')} {norm.shape_up} if the file is wrong",
        )
    if not norm.unsure:
        return notes
    return notes + (f"the facing of {name} is uncertain (taken: up {norm.up}, front {norm.front}); give {option}",)


def accelerations(driving: Clip, vertices: Float[np.ndarray, "T V 3"]) -> dict[str, dict[str, float]]:
    """Measure the mean acceleration (extents a second squared) of result and driving; empty below three frames.

    A result with a much larger acceleration than its driving jitters.
    """
    if len(vertices) < 3:
        return {}
    clips = {"result": vertices, "driving": driving.vertices}
    return {"acceleration": {name: acceleration(clip, driving.fps) for name, clip in clips.items()}}


def acceleration(frames: Float[np.ndarray, "T V 3"], fps: float) -> float:
    """Return the mean acceleration of vertices: second differences times fps^2, in extents of the first frame."""
    chosen = np.unique(np.linspace(1, len(frames) - 2, min(MOST_FRAMES, len(frames) - 2)).round().astype(int))
    second = (frames[t - 1].astype(np.float64) - 2.0 * frames[t] + frames[t + 1] for t in chosen)
    mean = np.mean([np.linalg.norm(of_frame, axis=-1).mean() for of_frame in second])
    return float(mean * fps**2 / np.ptp(frames[0], axis=0).max())


def against_neighbours(faces: Int[np.ndarray, "F 3"], vertices: Float[np.ndarray, "V 3"]) -> Bool[np.ndarray, " F"]:
    """Whether each face's normal points against the summed vectors of the faces at its corners."""
    vectors = face_vectors(np.asarray(vertices, np.float64), faces)
    corners, repeated = faces.ravel(), np.repeat(vectors, 3, axis=0)
    at_vertex = np.stack([np.bincount(corners, repeated[:, k], minlength=len(vertices)) for k in range(3)], axis=1)
    neighbours = at_vertex[faces].sum(axis=1) - 3 * vectors  # the face itself is in the sum at each of its corners
    return (neighbours * vectors).sum(axis=1) < 0
