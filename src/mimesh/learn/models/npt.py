"""Neural Pose Transfer (Wang et al., CVPR 2020): give an identity mesh the pose of a driving mesh.

Table 5: three 1x1 convolutions with InstanceNorm turn every driving vertex into features (the *pose code*). Each is
paired with one identity vertex, and three SPAdaIN ResBlocks turn the pair into that identity vertex's new position. The
pairing is random; the mean and variance of InstanceNorm are all that vertices share. Where the paper's tables and its
public code differ, the default is the paper, and a field of `NPTConfig` chooses the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from .layers import PointConv, ResBlock, instance_norm


@dataclass(frozen=True)
class NPTConfig:
    """Options of the network; the defaults are the paper's full model (6.05 M parameters)."""

    encoder: tuple[int, int, int] = (64, 128, 1024)
    """Channels of the pose feature extractor (Table 5, rows 3 to 8)."""
    decoder: tuple[int, int, int] = (1027, 513, 256)
    """Channels of the three ResBlocks (rows 10 to 15)."""
    blocks: Literal["spadain", "resblock", "conv"] = "spadain"
    """`resblock` is Table 2's "w/o SPAdaIN"; `conv` is its "concat1": 1x1 convolutions alone."""
    plain_norm: Literal["instance", "none"] = "instance"
    """In place of SPAdaIN where it is left out: InstanceNorm as in the encoder, or nothing. The paper does not say;
    with nothing there the decoder treats every vertex alone."""
    pose_code: Literal["per_vertex", "global_max"] = "per_vertex"
    """`global_max` pools the code over the driving vertices (Table 7), so the two meshes may differ in vertex count."""
    unnormalised: Literal["first", "block"] = "first"
    """With `global_max`, which norms of block 1 are left out: those whose input is the pooled code (first unit and
    shortcut), or all three, as in the public code. All vertices have that code, so an InstanceNorm would remove it."""
    order: Literal["norm-conv-relu", "norm-relu-conv"] = "norm-conv-relu"
    """Table 3, or the public code."""
    output: Literal["tanh", "2tanh"] = "tanh"
    """Row 17, or the public code's 2 tanh, whose results may leave the unit sphere."""


class NPT(nn.Module):
    """Map identity and driving vertices to the identity's vertices in the driving pose, all in a unit sphere."""

    def __init__(self, config: NPTConfig) -> None:
        super().__init__()
        self.config = config
        a, b, code = config.encoder
        self.encoder = nn.ModuleList([PointConv(3, a), PointConv(a, b), PointConv(b, code)])
        widths = config.decoder
        self.convs = nn.ModuleList(PointConv(i, o) for i, o in zip((code + 3, *widths[:2]), widths, strict=True))
        self.blocks = nn.ModuleList(self._block(i, c) for i, c in enumerate(widths) if config.blocks != "conv")
        self.head = PointConv(widths[2], 3)

    def _block(self, index: int, channels: int) -> ResBlock:
        config = self.config
        keep = (True, True, True)
        if index == 0 and config.pose_code == "global_max":
            keep = (False, True, False) if config.unnormalised == "first" else (False, False, False)
        return ResBlock(channels, config.order, config.blocks == "spadain", keep, config.plain_norm == "instance")

    def _plain(self, h: Float[Tensor, "C B V"], index: int) -> Float[Tensor, "C B V"]:
        """Normalise after convolution `index` where there are no ResBlocks, but not a pooled code: it would vanish."""
        pooled = index == 0 and self.config.pose_code == "global_max"
        return instance_norm(h) if self.config.plain_norm == "instance" and not pooled else h

    def encode(self, driving: Float[Tensor, "B U 3"]) -> Float[Tensor, "C B P"]:
        """Compute the pose code: one vector a driving vertex (P = U), or one for the whole mesh (P = 1)."""
        h = driving.permute(2, 0, 1)
        for conv in self.encoder:
            h = instance_norm(conv(h)).relu()
        return h.max(dim=2, keepdim=True).values if self.config.pose_code == "global_max" else h

    def forward(self, identity: Float[Tensor, "B V 3"], driving: Float[Tensor, "B U 3"]) -> Float[Tensor, "B V 3"]:
        """Compute identity vertices in the driving pose; vertex i is paired with driving vertex i, unless pooled."""
        code, points = self.encode(driving), identity.permute(2, 0, 1)
        if self.config.pose_code == "global_max":
            code = code.expand(-1, -1, points.shape[2])
        h = torch.cat([code, points.to(code.dtype)])
        for i, conv in enumerate(self.convs):
            h = conv(h)
            h = self.blocks[i](h, points) if len(self.blocks) else self._plain(h, i).relu()
        bound = 2.0 if self.config.output == "2tanh" else 1.0
        return bound * torch.tanh(self.head(h).float()).permute(1, 2, 0)

    def estimate_flops(self, identity_vertices: int, driving_vertices: int) -> float:
        """Count floating-point operations of a pair's forward pass: two for each weight of a linear layer and vertex.

        Norms, activations and the pooling are not counted; a training step costs three times as much.
        """
        encoder = sum(m.weight.numel() for m in self.encoder.modules() if isinstance(m, PointConv))
        total = sum(m.weight.numel() for m in self.modules() if isinstance(m, PointConv))
        return 2.0 * (encoder * driving_vertices + (total - encoder) * identity_vertices)
