"""A clip as a few blend shapes with weights over time: principal components of how it departs from its first frame.

Of all ways to show T frames with K shapes and an exact frame 0 this has the least squared error. Weights reach from 0
to 1, because clients cut off others; so the shapes are added to a base that is not itself a frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from ...core.errors import InputError
from ...core.frame_buffer import Progress, release_pages
from ...core.mesh import Clip

BLOCK_BYTES = 32 * 2**20
"""Bytes of differences that are held at once."""
MIN_RELATIVE_POWER = 1e-14
"""Of the power of the largest component: smaller ones are rounding."""


@dataclass(frozen=True, eq=False)
class BlendShapes:
    """A base and the weights of K shapes on top of it in every frame."""

    base: Float[np.ndarray, "V 3"]
    weights: Float32[np.ndarray, "T K"]
    error: float
    """Farthest that any vertex is from where it should be, in the mesh's unit."""

    def frame_coefficients(self) -> Float[np.ndarray, "K T"]:
        """What makes the shapes of how all frames differ from the base, in whatever is linear in the vertices."""
        weights = self.weights.astype(np.float64)
        frame_coefficients = np.linalg.pinv(weights - weights[0])
        frame_coefficients[:, 0] -= frame_coefficients.sum(axis=1)
        return frame_coefficients


def fit_blend_shapes(clip: Clip, count: int, progress: Progress | None = None) -> BlendShapes:
    """The `count` shapes that show a clip best, or as many as it needs; takes T x T numbers and blocks of vertices.

    Raises:
        InputError: fewer than one shape is wanted, or nothing moves.
    """
    if count < 1:
        raise InputError(f"--blendshapes: expected 1 or more, found {count}; try 30")
    frames = len(clip)
    gram = np.zeros((frames, frames))
    blocks = _vertex_blocks(clip)
    for done, block in enumerate(blocks):
        differences = _differences(clip, block)
        gram += differences @ differences.T
        _report_progress(progress, done, 2 * len(blocks))
    signed = _component_weights(gram, min(count, frames - 1))
    if not signed.size:
        raise InputError(f"{clip.mesh.name}: expected a clip that moves for --blendshapes, found none; leave it out")
    low, span = signed.min(axis=0), np.ptp(signed, axis=0)
    to_base, weights = low @ np.linalg.pinv(signed), ((signed - low) / span).astype(np.float32)
    base = clip.vertices[0].astype(np.float64)
    blend, error = BlendShapes(base, weights, 0.0), 0.0
    frame_coefficients = blend.frame_coefficients()
    for done, block in enumerate(blocks, len(blocks)):
        differences = _differences(clip, block)
        offset = to_base @ differences
        base[block] += offset.reshape(-1, 3)
        shapes = (frame_coefficients @ differences).astype(np.float32)
        off = (differences - offset - weights @ shapes).reshape(frames, -1, 3)
        error = max(error, float(np.linalg.norm(off, axis=-1).max()))
        _report_progress(progress, done, 2 * len(blocks))
    return BlendShapes(base, weights, error)


def _component_weights(gram: Float[np.ndarray, "T T"], count: int) -> Float[np.ndarray, "T K"]:
    """Weights of the largest components, the strongest first; those of frame 0 are zero."""
    from scipy.linalg import eigh

    if count < 1:
        return np.zeros((len(gram), 0))
    power, direction = eigh(gram, subset_by_index=[len(gram) - count, len(gram) - 1])
    kept = np.flatnonzero(power > MIN_RELATIVE_POWER * max(power[-1], np.finfo(float).tiny))[::-1]
    return direction[:, kept] * np.sqrt(power[kept])


def _vertex_blocks(clip: Clip) -> list[slice]:
    """Runs of vertices whose differences fit into a block."""
    step = max(BLOCK_BYTES // (24 * len(clip)), 1)
    return [slice(start, start + step) for start in range(0, clip.vertices.shape[1], step)]


def _differences(clip: Clip, block: slice) -> Float[np.ndarray, "T C"]:
    """How every frame differs from the first in some vertices, flattened."""
    points = clip.vertices[:, block].astype(np.float64)
    release_pages(clip.vertices)
    return (points - points[0]).reshape(len(points), -1)


def _report_progress(progress: Progress | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done + 1, total)
