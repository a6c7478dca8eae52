"""LIMP (Cosmo et al., ECCV 2020), a row of AniFormer's Table 2: a mesh as a code of two parts, style and pose.

A PointNet pools the vertices of a mesh, in any order, to a code. Its intrinsic part (style) stands for the person, its
extrinsic part (pose) for the rest. Fully connected layers turn a code into the vertices of one template, always the
same ones in the same order. A pose is transferred by decoding the identity's style with the driving's pose.

The network is not given the result of a transfer. It is trained to reproduce meshes, and to keep three metrics: a pose,
whoever's, must not change short distances over the identity's surface, whose sums its geodesics are; a style from the
same person in another pose must not change any distance through space; and between two codes lengths change evenly.
The original compares geodesics by heat flow in place of short distances, and its code is variational.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from ..bodies import RiggedBody
from ..core import geometry
from ..core.errors import InputError
from ..evaluate.clip_protocols import ClipPair, on_template
from ..evaluate.pairs import Pair
from ..evaluate.remesh import template
from .data.bodies import numbers_of_step
from .data.endless import PeopleOptions
from .data.people import PairBatch, PairSource
from .layers import PointConv, edge_vectors, instance_norm, mean_squared_distance
from .task import OnnxInterface, TrainConfig
from .validation import PaperTask

NEAR = 0.15
"""Metres along the surface up to which two vertices of the template count as near."""
NEAR_PAIRS = 8000
"""Random pairs of near vertices whose distances a step compares."""
FAR_PAIRS = 2100
"""Random pairs of any vertices whose distances through space a step compares."""
DECODINGS = 7
"""Codes that a training step decodes for each pair."""


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


@dataclass(frozen=True)
class LIMPData(PeopleOptions):
    """What LIMP is trained on: two frames of each pair of people, on the vertices of the template."""

    kind: Literal["clips80", "clips"] = "clips80"
    """`clips80`: AniFormer's 16 people x 80 motions. `clips`: endless people, validated on clips."""
    vertices: int = 2100
    """Those of `LIMPConfig.vertices`."""
    target_scale: Literal["identity"] = "identity"
    """Lengths are kept."""
    pairing: Literal["random"] = "random"
    body: Literal["human"] = "human"


@dataclass(frozen=True)
class LIMPLossConfig:
    """Weights of the metric terms beside the reconstruction, whose unit is PMD."""

    lengths: float = 5e-2
    """Of changes of short distances over their mean."""
    distances: float = 1.0
    """Of squared changes of distances through space."""


@dataclass(frozen=True)
class LIMPTrainConfig(TrainConfig):
    """The configuration of a LIMP training."""

    network: Literal["limp"] = "limp"
    model: LIMPConfig = field(default_factory=LIMPConfig)
    data: LIMPData = field(default_factory=LIMPData)
    metrics: LIMPLossConfig = field(default_factory=LIMPLossConfig)

    def check(self, where: str) -> None:
        """Raise InputError for meshes that are not the template's."""
        super().check(where)
        if self.data.vertices != self.model.vertices:
            raise InputError(
                f"{where}: expected data.vertices as model.vertices, the template's {self.model.vertices}, "
                f"found {self.data.vertices}; set one of them"
            )


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


class TemplateSource(PairSource):
    """Makes pairs whose meshes all have the template's vertices in its order."""

    def __init__(self, config: LIMPData, body: RiggedBody, device: torch.device, seed: int) -> None:
        super().__init__(config, body, device, seed)
        mesh = template(config.vertices)
        self.index = torch.from_numpy(mesh.corners[:, 0]).to(device)
        # Straight distances between vertices this near change little in any pose, as those along the surface do.
        points = body.vertices[mesh.corners[:, 0]]
        self.near = torch.from_numpy(geometry.near_pairs(points, mesh.faces, NEAR)).to(device)

    def _sample_vertices(self, size: int, rng: torch.Generator):
        index = self.index.expand(size, -1)
        return index, index, self.near.expand(size, -1, -1), 1.0


def limp_loss(
    model: LIMP,
    person: Float[Tensor, "B V 3"],
    moved: Float[Tensor, "B V 3"],
    other: Float[Tensor, "B V 3"],
    near: Int[Tensor, "E 2"],
    weights: LIMPLossConfig,
    rng: torch.Generator,
) -> Float[Tensor, ""]:
    """Compute the reconstruction (PMD, Eq. 7 of AniFormer) and the metric terms.

    Args:
        person: somebody in some pose, on the template's vertices.
        moved: the same person in another pose, and in the same unit: lengths are to be kept.
        other: somebody else in some pose, in a unit of their own.
        near: pairs of vertices of the template that are near each other on its surface.
        rng: of the pairs whose distances are compared, and of the points between two codes.
    """
    meshes = (person, moved, other)
    codes = [model.encode(mesh) for mesh in meshes]
    errors = [mean_squared_distance(model.decode(*code), mesh) for code, mesh in zip(codes, meshes, strict=True)]
    loss = torch.stack(errors).mean()
    (style, pose), (style_again, pose_again), (style_other, pose_other) = codes
    near = near[torch.randint(len(near), (NEAR_PAIRS,), generator=rng, device=near.device)]
    lengths = [_lengths(mesh, near) for mesh in (person, other)]
    # Any pose keeps the lengths of the person.
    swapped = _lengths(model.decode(style, pose_other), near)
    # A share of the way from one code to the other, lengths are as far on theirs.
    share = torch.rand(len(person), generator=rng, device=person.device)
    between = model.decode(style + share * (style_other - style), pose + share * (pose_other - pose))
    wanted = torch.lerp(lengths[0], lengths[1], share[:, None])
    change = relative_change(swapped, lengths[0]) + relative_change(_lengths(between, near), wanted)
    # The style of the same person in another pose is as good as their own, both ways.
    pairs = torch.randint(person.shape[1], (FAR_PAIRS, 2), generator=rng, device=person.device)
    swaps = ((style_again, pose, person), (style, pose_again, moved))
    apart = [_lengths(model.decode(*code), pairs) - _lengths(mesh, pairs) for *code, mesh in swaps]
    return loss + weights.lengths * change + weights.distances * torch.stack(apart).square().mean()


def relative_change(lengths: Float[Tensor, "B E"], wanted: Float[Tensor, "B E"]) -> Float[Tensor, ""]:
    """Compute the mean absolute change of lengths over their mean."""
    return (lengths - wanted).abs().mean() / wanted.mean()


def _lengths(mesh: Float[Tensor, "B V 3"], pairs: Int[Tensor, "E 2"]) -> Float[Tensor, "B E"]:
    return edge_vectors(mesh, pairs.expand(len(mesh), -1, -1)).norm(dim=2).clamp_min(1e-6)


class LIMPTask(PaperTask[LIMPTrainConfig, LIMP]):
    """Training, validation and export of LIMP."""

    config_type = LIMPTrainConfig
    test_set = "clips-aniformer"

    def make_model(self) -> LIMP:
        return LIMP(self.config.model)

    def source(self, seed: int) -> TemplateSource:
        return TemplateSource(self.config.data, self.body, self.device, seed)

    def loss(self, model: LIMP, batch: PairBatch, step: int) -> Tensor:
        """Compute the reconstruction and the metric terms; the truth is the same person in another pose."""
        rng = numbers_of_step(self.config.seed, step, self.device)
        meshes = (batch.identity, batch.truth, batch.driving)
        with self.autocast():
            return limp_loss(model, *meshes, batch.edges[0], self.config.metrics, rng)

    def trial_error(self, model: LIMP, trial: Pair | ClipPair) -> float:
        """Compute the mean PMD over frames of a clip's window on the template's vertices."""
        assert isinstance(trial, ClipPair), "of pairs of meshes there is no truth on the template"
        return super().trial_error(model, on_template(trial))

    def flops_per_pair(self, model: LIMP) -> float:
        """Count the floating-point operations of one training pair's forward pass: three codes, seven decodings."""
        return model.estimate_flops(self.vertices, self.vertices, self.vertices, decodings=DECODINGS)

    @staticmethod
    def onnx_interface(model: LIMP) -> OnnxInterface:
        """Map identity (B, V, 3) and driving (B, U, 3) to the W vertices of the template, (B, W, 3)."""
        batch, v = torch.export.Dim("batch", min=1), torch.export.Dim("vertices", min=2)
        u = torch.export.Dim("driving_vertices", min=2)
        example = (torch.randn(2, 300, 3), torch.randn(2, 200, 3))
        return OnnxInterface(model, ("identity", "driving"), ("result",), example, ({0: batch, 1: v}, {0: batch, 1: u}))

    @staticmethod
    def onnx_facts(model: LIMP) -> dict[str, Any]:
        """Give the vertex count of the template."""
        return {"model": "limp", "vertices": model.config.vertices}
