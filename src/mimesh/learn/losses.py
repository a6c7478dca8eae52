"""Terms that the losses of several models share. Sums over vertices and coordinates, mean over the batch."""

from __future__ import annotations

from jaxtyping import Float, Int, Shaped
from torch import Tensor


def reconstruction(result: Float[Tensor, "B V 3"], truth: Float[Tensor, "B V 3"]) -> Float[Tensor, ""]:
    """Compute NPT Eq. 5: squared distance to the truth, summed over vertices. (The public code: a mean over B V 3.)"""
    return (result - truth).square().sum(dim=(1, 2)).mean()


def edge_ratio(
    result: Float[Tensor, "B V 3"], reference: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, ""]:
    """Compute |length / reference length - 1|, mean over edges: a third of the edge term of the papers' public code.

    That code adds up the three edges of a face and takes the mean over faces.
    """
    old = edge_vectors(reference, edges).norm(dim=-1)
    return (edge_vectors(result, edges).norm(dim=-1) / old.clamp_min(1e-8) - 1.0).abs().mean()


def edge_vectors(points: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]) -> Float[Tensor, "B E 3"]:
    """Give the vector from the first to the second end of each edge."""
    ends = [points.gather(1, edges[..., k, None].expand(-1, -1, 3)) for k in range(2)]
    return ends[1] - ends[0]


def match_frames(truth: Shaped[Tensor, "B W ..."], frames: int) -> Shaped[Tensor, "B T ..."]:
    """Give the frames of a window that a result is compared with: all, or the middle one where a result has one."""
    return truth if frames == truth.shape[1] else truth[:, truth.shape[1] // 2, None]


def mean_squared_distance(
    result: Float[Tensor, "*B V 3"], truth: Float[Tensor, "*B V 3"], radius: Float[Tensor, "*B"] | float = 1.0
) -> Float[Tensor, ""]:
    """Compute the PMD (NPT and AniFormer Eq. 7): squared distance over squared radius, mean over vertices and batch.

    As `evaluate.metrics.pmd`, of some vertices of meshes whose whole radius is known.
    """
    return ((result - truth).square().sum(dim=-1).mean(dim=-1) / radius**2).mean()
