"""A clip as a few blend shapes with weights over time: principal components of how it departs from its first frame.

Of all ways to show T frames with K shapes on top of frame 0 this has the least squared error. Frame 0 itself is exact,
its weights are all zero. Weights reach from -1 to 1 at most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from ..mesh import Clip, InputError
from ..paging import Progress, let_go

BLOCK = 32 * 2**20
"""Bytes of differences that are held at once."""
NOTHING = 1e-14
"""Of the power of the largest component: smaller ones are rounding."""


@dataclass(frozen=True, eq=False)
class Blend:
    """Weights of K shapes in every frame; the shapes follow from the frames (`shares`)."""

    weights: Float32[np.ndarray, "T K"]
    error: float
    """Farthest that any vertex is from where it should be, in the mesh's unit."""

    def shares(self) -> Float[np.ndarray, "K T"]:
        """What makes each shape out of the frames' differences from frame 0, whatever is linear in them."""
        return np.linalg.pinv(self.weights.astype(np.float64))


def fit_blend(clip: Clip, count: int, progress: Progress | None = None) -> Blend:
    """The `count` shapes that show a clip best, or as many as it needs; takes T x T numbers and blocks of vertices.

    Raises:
        InputError: fewer than one shape is wanted, or nothing moves.
    """
    if count < 1:
        raise InputError(f"--blendshapes: expected 1 or more, found {count}; try 30")
    frames = len(clip)
    gram = np.zeros((frames, frames))
    blocks = _blocks(clip)
    for done, block in enumerate(blocks):
        differences = _differences(clip, block)
        gram += differences @ differences.T
        _tell(progress, done, 2 * len(blocks))
    weights = _weights(gram, min(count, frames - 1))
    if not weights.size:
        raise InputError(f"{clip.mesh.name}: expected a clip that moves for --blendshapes, found none; leave it out")
    blend = Blend(weights, 0.0)
    shares, error = blend.shares(), 0.0
    for done, block in enumerate(blocks, len(blocks)):
        differences = _differences(clip, block)
        shapes = (shares @ differences).astype(np.float32)
        off = (differences - weights @ shapes).reshape(frames, -1, 3)
        error = max(error, float(np.linalg.norm(off, axis=-1).max()))
        _tell(progress, done, 2 * len(blocks))
    return Blend(weights, error)


def _weights(gram: Float[np.ndarray, "T T"], count: int) -> Float32[np.ndarray, "T K"]:
    """Weights of the largest components, the strongest first."""
    from scipy.linalg import eigh

    if count < 1:
        return np.zeros((len(gram), 0), np.float32)
    power, direction = eigh(gram, subset_by_index=[len(gram) - count, len(gram) - 1])
    kept = np.flatnonzero(power > NOTHING * max(power[-1], 0.0))[::-1]
    kept = kept[power[kept] > 0]
    weights = direction[:, kept] * np.sqrt(power[kept])
    return (weights / np.abs(weights).max(axis=0, initial=np.finfo(float).tiny)).astype(np.float32)


def _blocks(clip: Clip) -> list[slice]:
    """Runs of vertices whose differences fit into a block."""
    step = max(BLOCK // (24 * len(clip)), 1)
    return [slice(start, start + step) for start in range(0, clip.vertices.shape[1], step)]


def _differences(clip: Clip, block: slice) -> Float[np.ndarray, "T C"]:
    """How every frame differs from the first in some vertices, flattened."""
    points = clip.vertices[:, block].astype(np.float64)
    let_go(clip.vertices)
    return (points - points[0]).reshape(len(points), -1)


def _tell(progress: Progress | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done + 1, total)
