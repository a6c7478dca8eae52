"""What the papers' models share: 1x1 convolution, InstanceNorm, SPAdaIN, the ResBlock made of them, terms of losses.

Inside a model features are (C, B, V), channels first: a 1x1 convolution is then one matrix product for the whole batch,
and InstanceNorm runs over contiguous rows. In place of B there may be more axes, and the identity's may be 1 where
those of the features are not. Losses are sums over vertices and coordinates, and means over the batch.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int, Shaped
from torch import Tensor, nn

EPSILON = 1e-5
"""Added to the variance (NPT Eq. 2)."""
COORDINATES = 3
"""Channels of a map of vertex positions."""


def instance_norm(h: Float[Tensor, "C *B V"]) -> Float[Tensor, "C *B V"]:
    """Normalise the vertices of each sample and channel to zero mean and unit variance (NPT Eq. 1 and 2), not affine.

    The only operation of NPT that mixes vertices.
    """
    return F.layer_norm(h, h.shape[-1:], eps=EPSILON)


class PointConv(nn.Module):
    """Map the channels of every vertex by one matrix: a 1x1 convolution, with PyTorch's default initialisation."""

    def __init__(self, channels_in: int, channels_out: int) -> None:
        super().__init__()
        bound = 1.0 / math.sqrt(channels_in)
        self.weight = nn.Parameter(torch.empty(channels_out, channels_in).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(channels_out).uniform_(-bound, bound))

    def forward(self, h: Float[Tensor, "C *B V"]) -> Float[Tensor, "D *B V"]:
        if COORDINATES in self.weight.shape and torch.compiler.is_dynamo_compiling():
            # A compiled step computes maps of coordinates where they are used, instead of writing them to memory, and
            # maps to coordinates in float32: bfloat16 would round them to 1 or 2 mm of a person.
            per_channel = [1] * (h.ndim - 1)
            bias, weight = self.bias.view(-1, *per_channel), self.weight.view(*self.weight.shape, *per_channel)
            if self.weight.shape[1] == COORDINATES:
                return sum((column * axis for column, axis in zip(weight.unbind(1), h, strict=True)), bias)
            return (weight * h).sum(1) + bias
        return torch.addmm(self.bias[:, None], self.weight, h.flatten(1)).unflatten(1, h.shape[1:])


class SPAdaIN(nn.Module):
    """Scale and shift each vertex's normalised features by maps of its identity position (NPT Eq. 3, Table 4).

    Spatially adaptive instance normalisation. `normalise=False` leaves the instance norm out, as the max-pool variant
    needs where its code is one vector: the norm over identical vertices would be zero.
    """

    def __init__(self, channels: int, normalise: bool = True) -> None:
        super().__init__()
        self.scale = PointConv(3, channels)
        self.shift = PointConv(3, channels)
        self.normalise = normalise

    def forward(self, h: Float[Tensor, "C *B V"], identity: Float[Tensor, "3 *I V"]) -> Float[Tensor, "C *B V"]:
        return self.scale(identity) * (instance_norm(h) if self.normalise else h) + self.shift(identity)


class Unit(nn.Module):
    """Apply norm, convolution and ReLU: a third of a ResBlock, in the order of NPT Table 3 or of the public code.

    The norm is SPAdaIN if `modulated`, else an InstanceNorm or, without `normalise`, nothing.
    """

    def __init__(self, channels: int, order: str, modulated: bool, normalise: bool) -> None:
        super().__init__()
        self.norm = SPAdaIN(channels, normalise) if modulated else None
        self.conv = PointConv(channels, channels)
        self.order = order
        self.normalise = normalise

    def forward(self, h: Float[Tensor, "C *B V"], identity: Float[Tensor, "3 *I V"]) -> Float[Tensor, "C *B V"]:
        if self.norm is not None:
            h = self.norm(h, identity)
        elif self.normalise:
            h = instance_norm(h)
        return self.conv(h).relu() if self.order == "norm-conv-relu" else self.conv(h.relu())


class ResBlock(nn.Module):
    """Apply two units, and add one unit on the shortcut (NPT Table 3; its row 9 adds rows 6 and 8).

    Args:
        modulated: whether SPAdaIN stands in front of each convolution (not so in Table 2's "w/o SPAdaIN").
        normalise: whether first unit, second unit and shortcut have their instance norm.
        plain_norm: whether an InstanceNorm stands where there is no SPAdaIN.
    """

    def __init__(
        self,
        channels: int,
        order: str,
        modulated: bool = True,
        normalise: tuple[bool, bool, bool] = (True, True, True),
        plain_norm: bool = True,
    ) -> None:
        super().__init__()
        keep = [there and (modulated or plain_norm) for there in normalise]
        first, second, shortcut = (Unit(channels, order, modulated, there) for there in keep)
        self.first, self.second, self.shortcut = first, second, shortcut

    def forward(self, h: Float[Tensor, "C *B V"], identity: Float[Tensor, "3 *I V"]) -> Float[Tensor, "C *B V"]:
        return self.second(self.first(h, identity), identity) + self.shortcut(h, identity)


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
