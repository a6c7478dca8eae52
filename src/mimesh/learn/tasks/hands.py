"""hands: the loss, validation and export of the network of fingers; its batches are of `hand_batches`."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from ...bodies import RiggedBody
from ...bodies.hands import left_hand_body
from ...bodies.joint_names import finger_joints
from ...core.errors import InputError
from ..hand_surfaces import HandSurface, training_hands
from ..models.hands import HAND_POINTS, HandNetwork
from ..models.mime import MimeConfig, Prediction
from .base import OnnxInterface, Task, TrainConfig, shipped_body
from .hand_batches import FINGERLESS_SHARE, QUERIES, HandBatch, HandSource
from .mime import joint_errors, masked_mean

UNSEEN_SEED, TRIAL_SEED, TRIAL_HANDS = 1, 77, 8
"""Seeds of the people and of the gestures of a validation, and number of hands in each of its trials."""


@dataclass(frozen=True)
class HandLossConfig:
    """Weights of the terms beside the rotations."""

    joints: float = 2.0
    """Of squared distances of joints, in units of the points' spread."""
    weights: float = 0.05
    """Of the cross-entropy of the skinning weights."""
    separate: float = 0.05
    """Of the cross-entropy of whether the hand shows separate fingers."""


@dataclass(frozen=True)
class HandsTrainConfig(TrainConfig):
    """The configuration of a training of hands."""

    network: Literal["hands"] = "hands"
    model: MimeConfig = field(default_factory=MimeConfig)
    structure: HandLossConfig = field(default_factory=HandLossConfig)

    def check(self, where: str) -> None:
        """Raise InputError for data that is not of hands, or a width that the heads do not divide."""
        super().check(where)
        if self.data.kind != "hands":
            raise InputError(f"{where}: expected data.kind hands with hands, found {self.data.kind}; set it")
        if not 0.0 <= self.data.characters <= 1 - FINGERLESS_SHARE:
            raise InputError(
                f"{where}: expected data.characters from 0 to {1 - FINGERLESS_SHARE}, found {self.data.characters}"
            )
        if self.model.heads < 1 or self.model.width % self.model.heads:
            raise InputError(f"{where}: expected heads that divide width {self.model.width}, found {self.model.heads}")


def hands_loss(model: nn.Module, batch: HandBatch, weights: HandLossConfig) -> Float[Tensor, ""]:
    """Compute the errors of rotations, joints and weights of hands with fingers, and of the logits of all."""
    prediction, logit, scores = model(batch.points, batch.normals, batch.queries, batch.query_normals)
    known = batch.separate[:, None]
    rotation, joints = joint_errors(prediction, (batch.rotation, known), (batch.joints, known))
    entropy = -masked_mean((batch.query_weights * scores.log_softmax(-1)).sum(-1), known)
    separate = F.binary_cross_entropy_with_logits(logit, batch.separate.float())
    terms = rotation, weights.joints * joints, weights.weights * entropy, weights.separate * separate
    return torch.stack(terms).sum()


def joint_error(prediction: Prediction, batch: HandBatch) -> Float[Tensor, " B"]:
    """Compute the mean squared distance of the finger joints in squared spreads of the given points."""
    return ((prediction.joints - batch.joints) / prediction.scale)[:, 1:].square().sum(-1).mean(1)


@cache
def unseen_hands() -> tuple[HandSurface, ...]:
    """Make hands of people of the shipped body that no training gets."""
    return tuple(training_hands(shipped_body(), (), UNSEEN_SEED))


class HandTrials:
    """Batches of unseen hands, in place of the pairs of a protocol."""

    validation_kinds = ("unseen",)

    def __init__(self, source: HandSource) -> None:
        self.source = source

    def count(self, kind: str, limit: int) -> int:
        """Give the number of trials: as many as are asked for."""
        return limit

    def pair(self, split: str, kind: str, index: int) -> HandBatch:
        """Make a trial; all are of one kind."""
        return self.source.batch(TRIAL_HANDS, index)


class HandsTask(Task[HandsTrainConfig, HandNetwork]):
    """Training, validation and export of hands."""

    config_type = HandsTrainConfig
    test_set = "fingers"

    @property
    def body(self) -> RiggedBody:
        """The left hand of the shipped body."""
        return left_hand_body()

    @property
    def protocol(self) -> Any:
        """Unseen hands, in place of a protocol of pairs."""
        return HandTrials(HandSource(list(unseen_hands()), self.device, TRIAL_SEED, 0.0))

    def make_model(self) -> HandNetwork:
        """Build the network with fresh weights."""
        return HandNetwork(self.config.model)

    def source(self, seed: int) -> HandSource:
        """Build the generator of hands."""
        characters = self.characters.characters if self.characters else ()
        return HandSource(training_hands(shipped_body(), characters), self.device, seed, self.config.data.characters)

    def loss(self, model: HandNetwork, batch: HandBatch, step: int) -> Tensor:
        """Compute the loss of a batch."""
        with self.autocast():
            return hands_loss(model, batch, self.config.structure)

    def trial_error(self, model: HandNetwork, trial: HandBatch) -> float:
        """Compute the error of a trial, as of any batch."""
        return self.batch_error(model, trial)

    def batch_error(self, model: HandNetwork, batch: HandBatch) -> float:
        """Compute `joint_error`, mean over the hands with fingers; 0 if there are none."""
        with self.autocast():
            prediction = model.predict_joints(batch.points, batch.normals)
        return float(joint_error(prediction, batch)[batch.separate].mean()) if batch.separate.any() else 0.0

    def flops_per_pair(self, model: HandNetwork) -> float:
        """Count the floating-point operations of the forward pass of one hand."""
        return model.estimate_flops(QUERIES, HAND_POINTS)

    @staticmethod
    def onnx_interface(model: HandNetwork) -> OnnxInterface:
        """Map points and queries of any number of hands, with normals, to joints, logits and scores."""
        b, v = torch.export.Dim("hands", min=1), torch.export.Dim("vertices", min=1)
        inputs = ("points", "normals", "vertices", "vertex_normals")
        example = (*torch.randn(2, 3, HAND_POINTS, 3), *torch.randn(2, 3, 300, 3))
        dynamic = ({0: b}, {0: b}, {0: b, 1: v}, {0: b, 1: v})
        return OnnxInterface(_Outputs(model), inputs, ("rotation", "joints", "scores", "separate"), example, dynamic)

    @staticmethod
    def onnx_facts(model: HandNetwork) -> dict[str, Any]:
        """Give the number of points and the names of the joints of a left hand."""
        return {"model": "hands", "points": HAND_POINTS, "joints": ("LeftHand", *finger_joints("Left"))}


class _Outputs(nn.Module):
    """All that the network computes, as tensors."""

    def __init__(self, model: HandNetwork) -> None:
        super().__init__()
        self.model = model

    def forward(self, points: Tensor, normals: Tensor, vertices: Tensor, vertex_normals: Tensor):
        prediction, logit, scores = self.model(points, normals, vertices, vertex_normals)
        return prediction.rotation, prediction.joints, scores, logit
