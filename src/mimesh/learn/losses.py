"""Losses of NPT, one function per equation. Sums over vertices and coordinates, mean over the batch."""

from __future__ import annotations

from jaxtyping import Float, Int
from torch import Tensor


def reconstruction(result: Float[Tensor, "B V 3"], truth: Float[Tensor, "B V 3"]) -> Float[Tensor, ""]:
    """NPT Eq. 5: squared distance to the truth, summed over vertices. (The public code takes a mean over B V 3.)"""
    return (result - truth).square().sum(dim=(1, 2)).mean()


def edge_paper(result: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]) -> Float[Tensor, ""]:
    """NPT Eq. 6: squared edge lengths, summed over vertices and their neighbours, so each edge counts twice.

    `edges` lists every undirected edge once.
    """
    return 2.0 * (edge_vectors(result, edges).square().sum(dim=(1, 2))).mean()


def edge_ratio(
    result: Float[Tensor, "B V 3"], identity: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]
) -> Float[Tensor, ""]:
    """The public code's edge term: |length / identity's length - 1|, mean over edges."""
    old = edge_vectors(identity, edges).norm(dim=-1)
    return (edge_vectors(result, edges).norm(dim=-1) / old.clamp_min(1e-8) - 1.0).abs().mean()


def npt_loss(
    result: Float[Tensor, "B V 3"],
    truth: Float[Tensor, "B V 3"],
    identity: Float[Tensor, "B V 3"],
    edges: Int[Tensor, "B E 2"],
    edge: str = "paper",
    edge_weight: float = 5e-4,
    edges_of_mesh: float = 1.0,
) -> Float[Tensor, ""]:
    """NPT Eq. 4 divided by the number of vertices, which leaves its optimum where it was and its size independent of V.

    Args:
        edge: `paper` (Eq. 6), `ratio` (public code) or `off`.
        edge_weight: lambda of Eq. 4.
        edges_of_mesh: edges a vertex that the whole mesh has, over those given here, when `edges` is a sample.
    """
    count = result.shape[1]
    loss = reconstruction(result, truth) / count
    if edge == "paper":
        loss = loss + edge_weight * edges_of_mesh * edge_paper(result, edges) / count
    elif edge == "ratio":
        loss = loss + edge_weight * edge_ratio(result, identity, edges)
    return loss


def edge_vectors(points: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]) -> Float[Tensor, "B E 3"]:
    """From one end of each edge to the other."""
    ends = [points.gather(1, edges[..., k, None].expand(-1, -1, 3)) for k in range(2)]
    return ends[1] - ends[0]
