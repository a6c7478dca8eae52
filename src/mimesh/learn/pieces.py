"""Describe the piece of a surface that each point belongs to: pieces are not connected to each other.

Hats, hair, swords, eyes and the blocks of block figures are pieces of their own. Where a piece lies, how large it is and
how much of the surface it has says more about its points than their own position.
"""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

PIECE_FEATURES = 5
"""Numbers that describe a piece: offset from the point to its centroid (3), root mean square size, share of points."""


def describe_pieces(
    points: Float[Tensor, "B N 3"], piece: Int[Tensor, "B N"], known: Bool[Tensor, " B"]
) -> Float[Tensor, "B N 5"]:
    """Describe the piece of each point, in the unit of the points; zeros for meshes whose pieces are not known."""
    size, total = len(points), points.shape[1]
    count = int(piece.max()) + 1
    number = points.new_zeros(size, count).scatter_add(1, piece, torch.ones_like(points[..., 0]))

    def mean_of(values: Float[Tensor, "B N C"]) -> Float[Tensor, "B N C"]:
        """Mean over the piece of each point."""
        index = piece[..., None].expand_as(values)
        summed = values.new_zeros(size, count, values.shape[-1]).scatter_add(1, index, values)
        return (summed / number.clamp_min(1)[..., None]).gather(1, index)

    offset = mean_of(points) - points
    extent = mean_of(offset.square().sum(-1, keepdim=True)).sqrt()
    share = number.gather(1, piece)[..., None] / total
    return torch.cat([offset, extent, share], -1) * known[:, None, None]
