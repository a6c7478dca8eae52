"""What mime is trained on: the result itself, and what the generator knows of its joints and weights.

Errors count squared up to their knee and about as they are beyond it (`pseudo_huber`): with plain squares the few
people who lie or twist as nobody does would be most of the loss.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from .mime import Mime, Reading
from .mime_batches import MimeBatch
from .people import Surface

RECONSTRUCTION, ROTATION, JOINT = 5e-4, 0.02, 0.002
"""Knees: squared errors of a pair (PMD), of a joint's rotation matrix, of a joint in units of the points' spread."""


@dataclass(frozen=True)
class MimeLossConfig:
    """Weights of the terms beside the reconstruction, whose unit is PMD."""

    rotation: float = 0.1
    """Difference of rotation matrices, mean over joints and estimates."""
    joints: float = 0.5
    """Distance of joints, in units of the points' spread."""
    weights: float = 0.01
    """Cross-entropy of the skinning weights."""


def mime_loss(model: Mime, batch: MimeBatch, weights: MimeLossConfig) -> Float[Tensor, ""]:
    """Reconstruction (from PMD, Eq. 7 of the papers, root joints together) and the structural terms."""
    own, other, scores = model(*batch.given)
    few = slice(scores.shape[1])
    moved = model.moved(batch.identity.points[:, few], scores, own, other, batch.truth.joints[:, 0])
    loss = pseudo_huber(pmd(moved, batch), RECONSTRUCTION).mean()
    for reading, true in ((own, batch.identity), (other, batch.driving)):
        turned, away = _off(reading, true)
        loss = loss + weights.rotation * turned / 2 + weights.joints * away / 2
    entropy = -(batch.identity.weights[:, few] * scores.log_softmax(-1)).sum(-1).mean()
    return loss + weights.weights * entropy


def pseudo_huber(square: Float[Tensor, "*B"], knee: float) -> Float[Tensor, "*B"]:
    """The square itself where it is far below the knee, and its root beyond (Charbonnier et al., ICIP 1994)."""
    return 2 * knee * ((square / knee + 1).sqrt() - 1)


def pmd(result: Float[Tensor, "B N 3"], batch: MimeBatch) -> Float[Tensor, " B"]:
    """Eq. 7 of each pair, in the identity's radius."""
    centred = batch.identity.points - batch.identity.points.mean(1, keepdim=True)
    radius = centred.norm(dim=-1).amax(1)
    return (result - batch.truth.points[:, : result.shape[1]]).square().sum(-1).mean(1) / radius.square()


def _off(reading: Reading, true: Surface) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
    """How far rotations and joints are from the truth, mean over the estimates."""
    turned = [(found - true.rotation).square().sum((-1, -2)) for found in reading.rotations]
    away = [((found - true.joints) / reading.scale).square().sum(-1) for found in reading.joints]
    return pseudo_huber(torch.stack(turned), ROTATION).mean(), pseudo_huber(torch.stack(away), JOINT).mean()
