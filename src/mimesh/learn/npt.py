"""Neural Pose Transfer (Wang et al., CVPR 2020): give an identity mesh the pose of a driving mesh.

Table 5: every driving vertex passes through three 1x1 convolutions with InstanceNorm (the *pose code*), is paired with
one identity vertex, and three SPAdaIN ResBlocks turn the pair into that identity vertex's new position. The pairing is
random; vertices meet only in the mean and variance of InstanceNorm. Where the paper's tables and its public code differ
the default is the paper, and a field of `NPTConfig` is the other reading.
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
    """Switches of the model; the defaults are the paper's full model (6.05 M parameters)."""

    encoder: tuple[int, int, int] = (64, 128, 1024)
    """Channels of the pose feature extractor (Table 5, rows 3 to 8)."""
    decoder: tuple[int, int, int] = (1027, 513, 256)
    """Channels of the three ResBlocks (rows 10 to 15)."""
    blocks: Literal["spadain", "resblock", "conv"] = "spadain"
    """`resblock` is Table 2's "w/o SPAdaIN"; `conv` is its "concat1": 1x1 convolutions alone."""
    plain_norm: Literal["instance", "none"] = "instance"
    """What stands where SPAdaIN is left out: InstanceNorm as in the encoder, or nothing. The paper does not say; with
    nothing there the vertices of the decoder never meet."""
    pose_code: Literal["per_vertex", "global_max"] = "per_vertex"
    """`global_max` pools the code over the driving vertices (Table 7), so the two meshes may differ in vertex count."""
    unnormalised: Literal["first", "block"] = "first"
    """With `global_max`, which norms of block 1 are left out: those that see the pooled code itself (first unit and
    shortcut), or all three, as the public code has it. An InstanceNorm there would whiten the code away."""
    order: Literal["norm-conv-relu", "norm-relu-conv"] = "norm-conv-relu"
    """Table 3, or the public code."""
    output: Literal["tanh", "2tanh"] = "tanh"
    """Row 17, or the public code's 2 tanh, whose results may leave the unit sphere."""


class NPT(nn.Module):
    """The network. Positions in, positions out, all centred and in units of a unit sphere."""

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
        """What follows convolution `index` where there are no ResBlocks; a pooled code would be whitened away."""
        pooled = index == 0 and self.config.pose_code == "global_max"
        return instance_norm(h) if self.config.plain_norm == "instance" and not pooled else h

    def encode(self, driving: Float[Tensor, "B U 3"]) -> Float[Tensor, "C B P"]:
        """Pose code: one vector a driving vertex (P = U), or one for the whole mesh (P = 1)."""
        h = driving.permute(2, 0, 1)
        for conv in self.encoder:
            h = instance_norm(conv(h)).relu()
        return h.max(dim=2, keepdim=True).values if self.config.pose_code == "global_max" else h

    def forward(self, identity: Float[Tensor, "B V 3"], driving: Float[Tensor, "B U 3"]) -> Float[Tensor, "B V 3"]:
        """Identity vertices in the driving pose, vertex i paired with driving vertex i (U = V unless pooled)."""
        code, points = self.encode(driving), identity.permute(2, 0, 1)
        if self.config.pose_code == "global_max":
            code = code.expand(-1, -1, points.shape[2])
        h = torch.cat([code, points.to(code.dtype)])
        for i, conv in enumerate(self.convs):
            h = conv(h)
            h = self.blocks[i](h, points) if len(self.blocks) else self._plain(h, i).relu()
        reach = 2.0 if self.config.output == "2tanh" else 1.0
        return reach * torch.tanh(self.head(h).float()).permute(1, 2, 0)

    def estimate_flops(self, identity_vertices: int, driving_vertices: int) -> float:
        """Floating-point operations of one pair's forward pass: two for each weight of each linear layer and vertex.

        Norms, activations and the pooling are not counted; training costs three times as much.
        """
        encoder = sum(m.weight.numel() for m in self.encoder.modules() if isinstance(m, PointConv))
        total = sum(m.weight.numel() for m in self.modules() if isinstance(m, PointConv))
        return 2.0 * (encoder * driving_vertices + (total - encoder) * identity_vertices)
