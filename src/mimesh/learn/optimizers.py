"""Adam for everything, as the papers have it, or Muon for the matrices between features and Adam for the rest."""

from __future__ import annotations

import torch
from torch import nn
from torch.optim import Adam, Muon, Optimizer

from .config import TrainConfig


def make_optimizers(model: nn.Module, config: TrainConfig, device: torch.device) -> list[Optimizer]:
    """The optimizers that share a model's parameters; one learning rate is right for all of them.

    Muon (K. Jordan et al. 2024) makes every update of a matrix orthogonal before it takes it; scaled as in "Muon is
    Scalable for LLM Training" (2025) its steps are as large as Adam's. Biases and matrices from or to a few numbers
    are Adam's.
    """
    betas = (0.9, config.beta2)
    fused = device.type == "cuda"
    parameters = list(model.parameters())
    if config.optimizer == "adam":
        return [Adam(parameters, lr=config.learning_rate, betas=betas, fused=fused)]
    hidden = [p for p in parameters if p.ndim == 2 and min(p.shape) > 12]
    others = [p for p in parameters if p.ndim != 2 or min(p.shape) <= 12]
    return [
        Muon(hidden, lr=config.learning_rate, weight_decay=0.0, adjust_lr_fn="match_rms_adamw"),
        Adam(others, lr=config.learning_rate, betas=betas, fused=fused),
    ]
