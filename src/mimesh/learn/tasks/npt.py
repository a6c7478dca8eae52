"""NPT: pairs of meshes, the loss of Eq. 4, validation on pairs or frame by frame on clips."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from ...core.errors import InputError
from ...evaluate import protocols
from ...evaluate.clip_protocols import ClipPair
from ...evaluate.pairs import Pair
from ...evaluate.quadruped import QUADRUPED
from ..losses import edge_ratio, edge_vectors, mean_squared_distance, reconstruction
from ..mesh_pairs import HeldOutMeshes
from ..models.npt import NPT, NPTConfig
from ..validation import clip_error, clips_protocol, pair_error
from .base import OnnxInterface, Task, TrainConfig
from .npt_batches import POINTS, CharacterPairSource, MeshPairSource, PairBatch, PairSource


@dataclass(frozen=True)
class NPTTrainConfig(TrainConfig):
    """The defaults are NPT 4.1."""

    network: Literal["npt"] = "npt"
    model: NPTConfig = field(default_factory=NPTConfig)
    edge: Literal["paper", "ratio", "off"] = "paper"
    """The edge term: Eq. 6, one of the public code's kind (`losses.edge_ratio`), or none."""
    edge_weight: float = 5e-4
    """Lambda of Eq. 4. The public code sums the three edges of a face and takes its reconstruction as a mean over 3 V:
    its 5e-4 is 4.5e-3 of `ratio` here."""

    def check(self, where: str) -> None:
        """Raise InputError for characters with data that they cannot be a part of."""
        super().check(where)
        data = self.data
        fits = 0.0 < data.characters <= 1.0 and data.kind == "wide" and 0 < data.vertices <= POINTS
        if data.characters and not fits:
            raise InputError(
                f"{where}: expected data.characters from 0 to 1 with data.kind wide and up to {POINTS} data.vertices, "
                f"found {data.characters} with {data.kind} and {data.vertices or 'all'}; take the configuration small"
            )


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
        edge: `paper` (Eq. 6), `ratio` (as the public code) or `off`. That code compares lengths with the identity's, in
            metres; here the truth has another unit than the identity, and skinning keeps most lengths, so with its own.
        edge_weight: lambda of Eq. 4.
        edges_of_mesh: edges a vertex that the whole mesh has, over those given here, when `edges` is a sample.
    """
    count = result.shape[1]
    loss = reconstruction(result, truth) / count
    if edge == "paper":
        loss = loss + edge_weight * edges_of_mesh * edge_paper(result, edges) / count
    elif edge == "ratio":
        loss = loss + edge_weight * edge_ratio(result, truth, edges)
    return loss


class NPTTask(Task[NPTTrainConfig, NPT]):
    """Training, validation and export of NPT."""

    config_type = NPTTrainConfig
    test_set = "human-npt"

    @property
    def protocol(self) -> protocols.Protocol:
        """Pairs, or clips where the data are clips; those held out where the data are meshes of a folder."""
        if self.meshes and (held_out := HeldOutMeshes.of(self.meshes)):
            return held_out
        if self.config.data.body == "quadruped":
            return QUADRUPED
        if self.config.data.kind not in ("clips", "clips80"):
            return protocols.HUMAN_NPT
        return clips_protocol(self.config.data)

    def make_model(self) -> NPT:
        """Build the network with fresh weights."""
        return NPT(self.config.model)

    def source(self, seed: int) -> PairSource | MeshPairSource:
        """Build the generator of pairs."""
        if self.meshes:
            return MeshPairSource(self.config.data, self.meshes, self.device, seed)
        if self.characters:
            return CharacterPairSource(self.config.data, self.body, self.device, seed, self.characters)
        return PairSource(self.config.data, self.body, self.device, seed)

    def loss(self, model: NPT, batch: PairBatch, step: int) -> Tensor:
        """Compute Eq. 4 over V."""
        with self.autocast():
            result = model(batch.identity, batch.driving)
        edge = (self.config.edge, self.config.edge_weight)
        return npt_loss(result, batch.truth, batch.edges, *edge, batch.edges_of_mesh)

    def trial_error(self, model: NPT, trial: Pair | ClipPair) -> float:
        """Compute the PMD of a pair, or the mean over frames of a clip's window."""

        def infer(identity: Float[Tensor, "V 3"], driving: Float[Tensor, "T U 3"]) -> Float[Tensor, "T V 3"]:
            with self.autocast():
                return model(identity.expand(len(driving), -1, -1), driving)

        where = (self.config.data.target_scale, self.device)
        return clip_error(infer, trial, *where) if isinstance(trial, ClipPair) else pair_error(infer, trial, *where)

    def batch_error(self, model: NPT, batch: PairBatch) -> float:
        """Compute the mean PMD of a batch."""
        with self.autocast():
            result = model(batch.identity, batch.driving)
        return float(mean_squared_distance(result, batch.truth, batch.truth_radius))

    def flops_per_pair(self, model: NPT) -> float:
        """Count the floating-point operations of one training pair's forward pass."""
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
