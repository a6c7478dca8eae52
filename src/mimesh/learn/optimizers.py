"""Optimizers: Adam for every parameter, as in the papers, or Muon for the hidden matrices and Adam for the rest."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.optim import Adam, Optimizer

from .tasks.base import TrainConfig

MOMENTUM = 0.95
"""Share of the running average of gradients that stays in each step (Jordan et al. 2024)."""
UPDATE_RMS = 0.2
"""Root mean square of an update's entries over the learning rate: about Adam's ("Muon is Scalable for LLM Training",
2025)."""
COEFFICIENTS = (3.4445, -4.7750, 2.0315)
"""Of x, x^3 and x^5 in the Newton-Schulz polynomial (Jordan et al. 2024)."""
ITERATIONS = 5
"""Of Newton-Schulz: singular values end between about 0.7 and 1.2 (the same source)."""
SMALLEST_SIDE = 12
"""Matrices with a side of at most so many entries are maps from or to a few numbers and are left to Adam."""


def make_optimizers(model: nn.Module, config: TrainConfig, device: torch.device, dtype: torch.dtype) -> list[Optimizer]:
    """Make the optimizers that share a model's parameters; one learning rate is right for all of them.

    Args:
        dtype: of the matrix products inside Muon. Weights, gradients and momentum are float32 in any case.
    """
    betas = (0.9, config.beta2)
    fused = device.type == "cuda"
    parameters = list(model.parameters())
    if config.optimizer == "adam":
        return [Adam(parameters, lr=config.learning_rate, betas=betas, fused=fused)]
    hidden = [p for p in parameters if p.ndim == 2 and min(p.shape) > SMALLEST_SIDE]
    others = [p for p in parameters if p.ndim != 2 or min(p.shape) <= SMALLEST_SIDE]
    return [
        Muon(hidden, config.learning_rate, config.weight_decay, dtype),
        Adam(others, lr=config.learning_rate, betas=betas, fused=fused),
    ]


class Muon(Optimizer):
    """Muon (Jordan et al. 2024) with Nesterov momentum and decoupled weight decay, for matrices alone.

    The same as `torch.optim.Muon(adjust_lr_fn="match_rms_adamw")`, whose matrix products are always bfloat16: a hundred
    times slower than float32 on a CPU without instructions for it. State dictionaries of the two are alike.
    """

    def __init__(self, parameters: list[nn.Parameter], lr: float, weight_decay: float, dtype: torch.dtype) -> None:
        super().__init__(parameters, {"lr": lr, "weight_decay": weight_decay})
        self.dtype = dtype

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Move every matrix that has a gradient."""
        for group in self.param_groups:
            lr, decay = group["lr"], group["weight_decay"]
            for matrix in group["params"]:
                if matrix.grad is None:
                    continue
                state = self.state[matrix]
                if "momentum_buffer" not in state:
                    state["momentum_buffer"] = torch.zeros_like(matrix.grad)
                average = state["momentum_buffer"].lerp_(matrix.grad, 1 - MOMENTUM)
                update = orthogonalize(matrix.grad.lerp(average, MOMENTUM), self.dtype)
                matrix.mul_(1 - lr * decay)
                # An orthogonal A x B matrix has entries of root mean square 1 / sqrt(max(A, B)).
                matrix.add_(update, alpha=-lr * UPDATE_RMS * math.sqrt(max(matrix.shape)))


def orthogonalize(matrix: Float[Tensor, "A B"], dtype: torch.dtype) -> Float[Tensor, "A B"]:
    """Bring all singular values of a matrix near 1 and keep its singular vectors, by Newton-Schulz iterations.

    Each iteration applies an odd polynomial to the singular values: with X = U S V^T, a X + b (X X^T) X + c (X X^T)^2 X
    is U (a S + b S^3 + c S^5) V^T. Only matrix products are needed, and of the shorter side's size.
    """
    tall = matrix.shape[0] > matrix.shape[1]
    x = (matrix.T if tall else matrix).to(dtype)
    x = x / x.norm().clamp(min=1e-7)  # the Frobenius norm bounds the largest singular value, which must be at most 1
    a, b, c = COEFFICIENTS
    for _ in range(ITERATIONS):
        gram = x @ x.T
        x = torch.addmm(x, torch.addmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return x.T if tall else x
