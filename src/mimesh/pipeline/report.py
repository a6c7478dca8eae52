"""What the user is told: how far edges stretched, what turned over, what jitters, which way was front."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from ..core.geometry import edges, face_vectors
from ..core.mesh import Clip, Mesh
from ..core.normalization import Normalization

MOST_FRAMES = 32
"""A clip is judged by this many of its frames, evenly spread."""
SHORT = 1e-3
"""Edges below this part of the mean length say nothing about stretch."""


def quality(identity: Mesh, vertices: Float[np.ndarray, "T V 3"]) -> dict[str, float]:
    """Worst edge stretch and share of flipped triangles over the frames of a result; empty for a point cloud."""
    if len(identity.faces) == 0:
        return {}
    pairs = edges(identity.faces)
    chosen = np.unique(np.linspace(0, len(vertices) - 1, min(MOST_FRAMES, len(vertices))).round().astype(int))
    stretches = [edge_stretch(identity.vertices, vertices[t], pairs) for t in chosen]
    flips = [flipped_share(identity.faces, identity.vertices, vertices[t]) for t in chosen]
    return {
        "edge_stretch_max": max(float(stretch.max(initial=1.0)) for stretch in stretches),
        "edge_stretch_p99": max(float(np.quantile(stretch, 0.99)) if stretch.size else 1.0 for stretch in stretches),
        "flipped_share": max(flips),
    }


def edge_stretch(
    before: Float[np.ndarray, "V 3"], after: Float[np.ndarray, "V 3"], pairs: Int[np.ndarray, "E 2"]
) -> Float[np.ndarray, " S"]:
    """How many times longer or shorter each edge became (1: unchanged); those of next to no length are left out."""
    old, new = (np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1) for points in (before, after))
    real = old > SHORT * (old.mean() if len(old) else 0.0)
    ratio = np.maximum(new[real] / old[real], 1e-6)
    return np.maximum(ratio, 1 / ratio)


def flipped_share(
    faces: Int[np.ndarray, "F 3"], before: Float[np.ndarray, "V 3"], after: Float[np.ndarray, "V 3"]
) -> float:
    """Share of triangles that came to face against the surface around them and did not before."""
    turned = _against_neighbours(faces, after) & ~_against_neighbours(faces, before)
    return float(turned.mean())


def facing(frame: Normalization) -> dict[str, str | bool | float]:
    """The axes that were used for one input."""
    return {"up": frame.up, "front": frame.front, "detected": frame.detected, "margin": round(frame.margin, 3)}


def facing_note(frame: Normalization, name: str, option: str) -> tuple[str, ...]:
    """A note for the user where the facing was guessed with little margin."""
    if not frame.unsure:
        return ()
    return (f"the facing of {name} is uncertain (taken: up {frame.up}, front {frame.front}); give {option}",)


def accelerations(driving: Clip, vertices: Float[np.ndarray, "T V 3"]) -> dict[str, dict[str, float]]:
    """Mean acceleration (sizes a second squared) of the result and of its driving; empty for fewer than three frames.

    A result that is much livelier than what it imitates jitters.
    """
    if len(vertices) < 3:
        return {}
    clips = {"result": vertices, "driving": driving.vertices}
    return {"acceleration": {name: acceleration(clip, driving.fps) for name, clip in clips.items()}}


def acceleration(frames: Float[np.ndarray, "T V 3"], fps: float) -> float:
    """Mean length of the second differences of vertices, in sizes of the first frame; of MOST_FRAMES places in time."""
    chosen = np.unique(np.linspace(1, len(frames) - 2, min(MOST_FRAMES, len(frames) - 2)).round().astype(int))
    second = [frames[t - 1].astype(np.float64) - 2.0 * frames[t] + frames[t + 1] for t in chosen]
    return float(np.linalg.norm(second, axis=-1).mean() * fps**2 / np.ptp(frames[0], axis=0).max())


def _against_neighbours(faces: Int[np.ndarray, "F 3"], vertices: Float[np.ndarray, "V 3"]) -> np.ndarray:
    vectors = face_vectors(np.asarray(vertices, np.float64), faces)
    corners, thrice = faces.ravel(), np.repeat(vectors, 3, axis=0)
    around = np.stack([np.bincount(corners, thrice[:, k], minlength=len(vertices)) for k in range(3)], axis=1)
    neighbours = around[faces].sum(axis=1) - 3 * vectors
    return (neighbours * vectors).sum(axis=1) < 0
