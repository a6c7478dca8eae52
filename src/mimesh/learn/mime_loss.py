"""What mime is trained on: the result itself, and what the generator knows of its joints and weights."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from .mime import Mime, Reading
from .mime_batches import MimeBatch
from .people import Surface


@dataclass(frozen=True)
class MimeLossConfig:
    """Weights of the terms beside the reconstruction, whose unit is PMD."""

    rotation: float = 0.05
    """Squared difference of rotation matrices, mean over joints and estimates."""
    joints: float = 0.3
    """Squared distance of joints, in units of the points' spread."""
    weights: float = 0.01
    """Cross-entropy of the skinning weights."""


def mime_loss(model: Mime, batch: MimeBatch, weights: MimeLossConfig) -> Float[Tensor, ""]:
    """Reconstruction (PMD, Eq. 7 of the papers, root joints together) and the structural terms."""
    own, other, scores = model(*batch.given)
    few = slice(scores.shape[1])
    loss = pmd(model.moved(batch.identity.points[:, few], scores, own, other, batch.truth.joints[:, 0]), batch)
    for reading, true in ((own, batch.identity), (other, batch.driving)):
        turned, moved = _off(reading, true)
        loss = loss + weights.rotation * turned / 2 + weights.joints * moved / 2
    entropy = -(batch.identity.weights[:, few] * scores.log_softmax(-1)).sum(-1).mean()
    return loss + weights.weights * entropy


def pmd(result: Float[Tensor, "B N 3"], batch: MimeBatch) -> Float[Tensor, ""]:
    """Eq. 7 in the identity's radius."""
    centred = batch.identity.points - batch.identity.points.mean(1, keepdim=True)
    radius = centred.norm(dim=-1).amax(1)
    return ((result - batch.truth.points[:, : result.shape[1]]).square().sum(-1).mean(1) / radius.square()).mean()


def _off(reading: Reading, true: Surface) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """How far rotations and joints are from the truth, mean over the estimates."""
    turned = torch.stack([(found - true.rotation).square().sum((-1, -2)).mean() for found in reading.rotations])
    moved = [((found - true.joints) / reading.scale).square().sum(-1).mean() for found in reading.joints]
    return turned.mean(), torch.stack(moved).mean()
