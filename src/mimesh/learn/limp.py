"""LIMP (Cosmo et al., ECCV 2020), with which AniFormer's Table 2 compares: a code of a mesh, split into style and pose.

A PointNet pools the vertices of a mesh, in whatever order, to a code. Its intrinsic part (style) is who it is, its
extrinsic part (pose) what the rest is. Fully connected layers turn a code into the vertices of one template, always
the same ones in the same order. A pose is transferred by decoding the identity's style with the driving's pose.

Nobody tells the network what that should give. It is trained to give meshes back, and that metrics are preserved: a
pose, whoever's, must not change short distances over the identity's surface, whose sums its geodesics are; a style from
the same person in another pose must not change any distance through space; and between two codes lengths change
evenly. The original has geodesics by heat flow for short distances, and noise on the code (it is variational).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from .layers import PointConv, instance_norm
from .losses import edge_vectors

PAIRS = 2100
"""Random pairs of vertices whose distances through space are compared."""
NEAR_PAIRS = 8000
"""Random pairs of near vertices whose distances are compared."""


@dataclass(frozen=True)
class LIMPConfig:
    """Switches of the model; the vertices are those of `evaluate.remesh.template`."""

    vertices: int = 2100
    """Of the template."""
    encoder: tuple[int, int, int] = (64, 128, 512)
    """Channels of the PointNet."""
    style: int = 64
    """Numbers of the intrinsic code."""
    pose: int = 192
    """Numbers of the extrinsic code."""
    decoder: tuple[int, int] = (512, 512)
    """Channels of the hidden layers."""


@dataclass(frozen=True)
class LIMPLossConfig:
    """Weights of the metric terms beside the reconstruction, whose unit is PMD."""

    lengths: float = 5e-2
    """Of changes of short distances over their mean."""
    distances: float = 1.0
    """Of squared changes of distances through space."""


class LIMP(nn.Module):
    """The network. Positions in, positions out, each mesh centred; a result is in the unit of the identity."""

    def __init__(self, config: LIMPConfig) -> None:
        super().__init__()
        self.config = config
        code = config.style + config.pose
        self.points = _layers(3, *config.encoder)
        self.to_code = PointConv(config.encoder[-1], code)
        self.hidden = _layers(code, *config.decoder)
        self.head = PointConv(config.decoder[-1], 3 * config.vertices)

    def encode(self, mesh: Float[Tensor, "B U 3"]) -> tuple[Float[Tensor, "S B"], Float[Tensor, "P B"]]:
        """Style and pose of a mesh with any vertices in any order."""
        h = mesh.permute(2, 0, 1)
        for conv in self.points:
            h = instance_norm(conv(h)).relu()
        code = self.to_code(h.max(dim=2).values)  # the gradient of amax costs twenty times as much
        return code[: self.config.style], code[self.config.style :]

    def decode(self, style: Float[Tensor, "S B"], pose: Float[Tensor, "P B"]) -> Float[Tensor, "B V 3"]:
        """The template's vertices."""
        h = torch.cat([style, pose])
        for conv in self.hidden:
            h = conv(h).mT
            h = F.layer_norm(h, h.shape[-1:]).mT.relu()
        return self.head(h).float().unflatten(0, (-1, 3)).permute(2, 0, 1)

    def forward(self, identity: Float[Tensor, "B V 3"], driving: Float[Tensor, "B U 3"]) -> Float[Tensor, "B W 3"]:
        """The identity in the driving pose, as the template's W vertices."""
        return self.decode(self.encode(identity)[0], self.encode(driving)[1])

    def estimate_flops(self, *vertices: int, decodings: int = 1) -> float:
        """Floating-point operations of coding meshes of so many vertices and decoding: two for each use of a weight."""
        each, hidden = (sum(p.numel() for p in part.parameters() if p.ndim == 2) for part in (self.points, self.hidden))
        whole = len(vertices) * self.to_code.weight.numel() + decodings * (hidden + self.head.weight.numel())
        return 2.0 * (each * sum(vertices) + whole)


def limp_loss(
    model: LIMP,
    person: Float[Tensor, "B V 3"],
    moved: Float[Tensor, "B V 3"],
    other: Float[Tensor, "B V 3"],
    near: Int[Tensor, "E 2"],
    weights: LIMPLossConfig,
    rng: torch.Generator,
) -> Float[Tensor, ""]:
    """Reconstruction (PMD, Eq. 7 of AniFormer) and the metric terms.

    Args:
        person: somebody in some pose, on the template's vertices.
        moved: the same person in another pose, and in the same unit: lengths are what is to be kept.
        other: somebody else in some pose, in a unit of their own.
        near: vertices of the template that are near each other on its surface.
        rng: of the pairs whose distances are compared, and of the ways between codes.
    """
    meshes = (person, moved, other)
    codes = [model.encode(mesh) for mesh in meshes]
    loss = torch.stack([_pmd(model.decode(*code), mesh) for code, mesh in zip(codes, meshes, strict=True)]).mean()
    (style, pose), (style_again, pose_again), (style_other, pose_other) = codes
    near = near[torch.randint(len(near), (NEAR_PAIRS,), generator=rng, device=near.device)]
    lengths = [_lengths(mesh, near) for mesh in (person, other)]
    # Any pose keeps the lengths of the person.
    swapped = _lengths(model.decode(style, pose_other), near)
    # Half-way to somebody else lengths are half-way too, wherever on that way.
    share = torch.rand(len(person), generator=rng, device=person.device)
    between = model.decode(style + share * (style_other - style), pose + share * (pose_other - pose))
    wanted = torch.lerp(lengths[0], lengths[1], share[:, None])
    growth = _growth(swapped, lengths[0]) + _growth(_lengths(between, near), wanted)
    # The style of the same person in another pose is as good as their own, both ways.
    pairs = torch.randint(person.shape[1], (PAIRS, 2), generator=rng, device=person.device)
    swaps = ((style_again, pose, person), (style, pose_again, moved))
    apart = [_lengths(model.decode(*code), pairs) - _lengths(mesh, pairs) for *code, mesh in swaps]
    return loss + weights.lengths * growth + weights.distances * torch.stack(apart).square().mean()


def _layers(*channels: int) -> nn.ModuleList:
    return nn.ModuleList(PointConv(i, o) for i, o in itertools.pairwise(channels))


def _pmd(result: Float[Tensor, "B V 3"], truth: Float[Tensor, "B V 3"]) -> Float[Tensor, ""]:
    return (result - truth).square().sum(dim=2).mean()


def _growth(lengths: Float[Tensor, "B E"], wanted: Float[Tensor, "B E"]) -> Float[Tensor, ""]:
    return (lengths - wanted).abs().mean() / wanted.mean()


def _lengths(mesh: Float[Tensor, "B V 3"], pairs: Int[Tensor, "E 2"]) -> Float[Tensor, "B E"]:
    return edge_vectors(mesh, pairs.expand(len(mesh), -1, -1)).norm(dim=2).clamp_min(1e-6)
