"""Neural Pose Transfer (Wang et al., CVPR 2020): give an identity mesh the pose of a driving mesh.

Table 5: three 1x1 convolutions with InstanceNorm turn every driving vertex into features (the *pose code*). Each is
paired with one identity vertex, and three SPAdaIN ResBlocks turn the pair into that identity vertex's new position. The
pairing is random; the mean and variance of InstanceNorm are all that vertices share. Where the paper's tables and its
public code differ, the default is the paper, and a field of `NPTConfig` chooses the other.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from .data.endless import PeopleOptions
from .data.people import PairBatch, PairSource
from .data.registered import MeshOptions, MeshPairSource
from .layers import PointConv, ResBlock, edge_ratio, edge_vectors, instance_norm, reconstruction
from .task import BatchSource, OnnxInterface, TrainConfig
from .validation import PaperTask


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


@dataclass(frozen=True)
class NPTData(PeopleOptions, MeshOptions):
    """What NPT is trained on: the paper's table, endless people, frames of clips, or registered meshes."""

    kind: Literal["table6", "wide", "clips80", "clips", "meshes"] = "table6"
    """`table6`: the 16 people x 400 poses of `evaluate.protocols.HUMAN_NPT`, whatever the seed. `wide`: endless people;
    rest, Table 6, joint limits, frames of motions. `clips80`: frames of AniFormer's 16 people x 80 motions. `clips`: as
    `wide`, validated on clips. `meshes`: registered meshes of a folder."""
    animal_kinds: ClassVar[tuple[str, ...]] = ("wide", "meshes")


@dataclass(frozen=True)
class NPTTrainConfig(TrainConfig):
    """The defaults are NPT 4.1."""

    network: Literal["npt"] = "npt"
    model: NPTConfig = field(default_factory=NPTConfig)
    data: NPTData = field(default_factory=NPTData)
    edge: Literal["paper", "ratio", "off"] = "paper"
    """The edge term: Eq. 6, one of the public code's kind (`layers.edge_ratio`), or none."""
    edge_weight: float = 5e-4
    """Lambda of Eq. 4. The public code sums the three edges of a face and takes its reconstruction as a mean over 3 V:
    its 5e-4 is 4.5e-3 of `ratio` here."""


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


def edge_paper(result: Float[Tensor, "B V 3"], edges: Int[Tensor, "B E 2"]) -> Float[Tensor, ""]:
    """Compute Eq. 6: squared edge lengths, summed over vertices and their neighbours, so each edge counts twice.

    `edges` lists every undirected edge once.
    """
    return 2.0 * (edge_vectors(result, edges).square().sum(dim=(1, 2))).mean()


def npt_loss(
    result: Float[Tensor, "B V 3"],
    truth: Float[Tensor, "B V 3"],
    edges: Int[Tensor, "B E 2"],
    edge: str = "paper",
    edge_weight: float = 5e-4,
    edges_of_mesh: float = 1.0,
) -> Float[Tensor, ""]:
    """Compute Eq. 4 divided by the number of vertices: the same optimum, and a size that does not depend on V.

    Args:
        edge: `paper` (Eq. 6), `ratio` (as the public code) or `off`. The public code compares edge lengths with those
            of the identity, in metres. Here they are compared with the truth's: its unit is not the identity's, and
            skinning keeps most lengths.
        edge_weight: lambda of Eq. 4.
        edges_of_mesh: edges per vertex of the whole mesh over those given here, where `edges` is a sample.
    """
    count = result.shape[1]
    loss = reconstruction(result, truth) / count
    if edge == "paper":
        loss = loss + edge_weight * edges_of_mesh * edge_paper(result, edges) / count
    elif edge == "ratio":
        loss = loss + edge_weight * edge_ratio(result, truth, edges)
    return loss


class NPTTask(PaperTask[NPTTrainConfig, NPT]):
    """Training, validation and export of NPT."""

    config_type = NPTTrainConfig
    test_set = "human-npt"

    def make_model(self) -> NPT:
        return NPT(self.config.model)

    def source(self, seed: int) -> BatchSource:
        if self.meshes:
            return MeshPairSource(self.config.data, self.meshes, self.device, seed)
        return PairSource(self.config.data, self.body, self.device, seed)

    def loss(self, model: NPT, batch: PairBatch, step: int) -> Tensor:
        with self.autocast():
            result = model(batch.identity, batch.driving)
        edge = (self.config.edge, self.config.edge_weight)
        return npt_loss(result, batch.truth, batch.edges, *edge, batch.edges_of_mesh)

    def flops_per_pair(self, model: NPT) -> float:
        return model.estimate_flops(self.vertices, self.vertices)

    @staticmethod
    def onnx_interface(model: NPT) -> OnnxInterface:
        """Map identity (B, V, 3) and driving (B, U, 3) to result (B, V, 3); U = V unless the pose code is pooled."""
        pooled = model.config.pose_code == "global_max"
        batch, v = torch.export.Dim("batch", min=1), torch.export.Dim("vertices", min=2)
        u = torch.export.Dim("driving_vertices", min=2) if pooled else v
        example = (torch.randn(2, 300, 3), torch.randn(2, 200 if pooled else 300, 3))
        return OnnxInterface(model, ("identity", "driving"), ("result",), example, ({0: batch, 1: v}, {0: batch, 1: u}))

    @staticmethod
    def onnx_facts(model: NPT) -> dict[str, Any]:
        """Give the kind of pose code, which decides whether the meshes may differ in vertex count."""
        return {"model": "npt", "pose_code": model.config.pose_code}
