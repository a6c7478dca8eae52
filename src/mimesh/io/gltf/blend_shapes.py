"""Fits a few blend shapes with weights over time to a clip: principal components of its differences from frame 0.

Of all ways to show T frames with K shapes and an exact frame 0, this has the least squared error. Weights lie in 0..1,
because clients (Blender) clamp them to that range; the shapes are therefore added to a base that is not itself a frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from ...core.errors import InputError
from ...core.frame_buffer import Progress, release_pages
from ...core.mesh import Clip

BLOCK_BYTES = 32 * 2**20
"""Bytes of float64 differences, over all frames, that are in memory at once."""
MIN_RELATIVE_POWER = 1e-14
"""Eigenvalues below this fraction of the largest are rounding errors, and their components are dropped."""


@dataclass(frozen=True, eq=False)
class BlendShapes:
    """A base mesh and the weights of K shapes in every frame; the shapes follow from `frame_coefficients`."""

    base: Float[np.ndarray, "V 3"]
    """Positions without any shape."""
    weights: Float32[np.ndarray, "T K"]
    """Weights of the shapes in every frame, 0..1."""
    max_error: float
    """Largest distance of a vertex from its position in the clip, over all frames, in the mesh's unit."""

    def frame_coefficients(self) -> Float[np.ndarray, "K T"]:
        """Return the coefficients that mix the frames into shapes: shape k is the sum over t of [k, t] * frame t.

        Rows sum to 0, so they may be applied to differences from any base, and to any quantity that is linear in the
        vertices, such as positions in a node's frame.
        """
        weights = self.weights.astype(np.float64)
        coefficients = np.linalg.pinv(weights - weights[0])
        coefficients[:, 0] -= coefficients.sum(axis=1)
        return coefficients


def fit_blend_shapes(clip: Clip, count: int, progress: Progress | None = None) -> BlendShapes:
    """Fit `count` shapes to a clip, or fewer where fewer are exact.

    With D (T, 3 V) the differences of all frames from frame 0, the best K shapes are the first right singular vectors
    of D. They are found from the eigenvectors of D D^T, which is only (T, T), so that D is read block by block.

    Raises:
        InputError: `count` is below 1, or the clip does not move.
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
    # Shift and scale the weights to 0..1. The shift is made up for by the base: frame 0 plus `to_base` @ differences.
    low, extent = signed.min(axis=0), np.ptp(signed, axis=0)
    to_base, weights = low @ np.linalg.pinv(signed), ((signed - low) / extent).astype(np.float32)
    base = clip.vertices[0].astype(np.float64)
    coefficients = BlendShapes(base, weights, 0.0).frame_coefficients()
    max_error = 0.0
    # Second pass: the base, and the error that remains with the shapes rounded to float32 as in the file.
    for done, block in enumerate(blocks, len(blocks)):
        differences = _differences(clip, block)
        offset = to_base @ differences
        base[block] += offset.reshape(-1, 3)
        shapes = (coefficients @ differences).astype(np.float32)
        residual = (differences - offset - weights @ shapes).reshape(frames, -1, 3)
        max_error = max(max_error, float(np.linalg.norm(residual, axis=-1).max()))
        _report_progress(progress, done, 2 * len(blocks))
    return BlendShapes(base, weights, max_error)


def _component_weights(gram: Float[np.ndarray, "T T"], count: int) -> Float[np.ndarray, "T K"]:
    """Return the weights of the largest principal components in all frames, the largest first; those of frame 0 are 0.

    Row 0 of the Gram matrix is zero, and so is row 0 of every eigenvector of a positive eigenvalue.
    """
    from scipy.linalg import eigh

    if count < 1:
        return np.zeros((len(gram), 0))
    power, direction = eigh(gram, subset_by_index=[len(gram) - count, len(gram) - 1])
    kept = np.flatnonzero(power > MIN_RELATIVE_POWER * max(power[-1], np.finfo(float).tiny))[::-1]
    return direction[:, kept] * np.sqrt(power[kept])


def _vertex_blocks(clip: Clip) -> list[slice]:
    """Split the vertices into slices whose differences over all frames fit into BLOCK_BYTES."""
    step = max(BLOCK_BYTES // (24 * len(clip)), 1)
    return [slice(start, start + step) for start in range(0, clip.vertices.shape[1], step)]


def _differences(clip: Clip, block: slice) -> Float[np.ndarray, "T C"]:
    """Return the differences of every frame from frame 0 for some vertices, flattened to C = 3 * vertices."""
    points = clip.vertices[:, block].astype(np.float64)
    release_pages(clip.vertices)
    return (points - points[0]).reshape(len(points), -1)


def _report_progress(progress: Progress | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done + 1, total)
