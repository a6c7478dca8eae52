"""LIMP (Cosmo et al., ECCV 2020), a row of AniFormer's Table 2: a mesh as a code of two parts, style and pose.

A PointNet pools the vertices of a mesh, in any order, to a code. Its intrinsic part (style) stands for the person, its
extrinsic part (pose) for the rest. Fully connected layers turn a code into the vertices of one template, always the
same ones in the same order. A pose is transferred by decoding the identity's style with the driving's pose.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from .layers import PointConv, instance_norm


@dataclass(frozen=True)
class LIMPConfig:
    """Options of the network; the vertices are those of `evaluate.remesh.template`."""

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


class LIMP(nn.Module):
    """Map identity and driving vertices, each centred, to the template's vertices, in the unit of the identity."""

    def __init__(self, config: LIMPConfig) -> None:
        super().__init__()
        self.config = config
        code = config.style + config.pose
        self.points = _layers(3, *config.encoder)
        self.to_code = PointConv(config.encoder[-1], code)
        self.hidden = _layers(code, *config.decoder)
        self.head = PointConv(config.decoder[-1], 3 * config.vertices)

    def encode(self, mesh: Float[Tensor, "B U 3"]) -> tuple[Float[Tensor, "S B"], Float[Tensor, "P B"]]:
        """Compute style and pose of a mesh with any vertices in any order."""
        h = mesh.permute(2, 0, 1)
        for conv in self.points:
            h = instance_norm(conv(h)).relu()
        code = self.to_code(h.max(dim=2).values)  # the gradient of amax costs twenty times as much
        return code[: self.config.style], code[self.config.style :]

    def decode(self, style: Float[Tensor, "S B"], pose: Float[Tensor, "P B"]) -> Float[Tensor, "B V 3"]:
        """Compute the template's vertices from a style and a pose."""
        h = torch.cat([style, pose])
        for conv in self.hidden:
            h = conv(h).mT
            h = F.layer_norm(h, h.shape[-1:]).mT.relu()
        return self.head(h).float().unflatten(0, (-1, 3)).permute(2, 0, 1)

    def forward(self, identity: Float[Tensor, "B V 3"], driving: Float[Tensor, "B U 3"]) -> Float[Tensor, "B W 3"]:
        """Compute the identity in the driving pose, as the template's W vertices."""
        return self.decode(self.encode(identity)[0], self.encode(driving)[1])

    def estimate_flops(self, *vertices: int, decodings: int = 1) -> float:
        """Count floating-point operations of coding meshes of so many vertices and decoding: two for each weight."""
        each, hidden = (sum(p.numel() for p in part.parameters() if p.ndim == 2) for part in (self.points, self.hidden))
        whole = len(vertices) * self.to_code.weight.numel() + decodings * (hidden + self.head.weight.numel())
        return 2.0 * (each * sum(vertices) + whole)


def _layers(*channels: int) -> nn.ModuleList:
    return nn.ModuleList(PointConv(i, o) for i, o in itertools.pairwise(channels))
