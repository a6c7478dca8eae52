"""Optimizers: Adam for every parameter, as in the papers, or Muon for the hidden matrices and Adam for the rest.

And the precision of matrix products, chosen by a short measurement of the device.
"""

from __future__ import annotations

import functools
import math
import time
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torch.optim import Adam, Optimizer

from .task import TrainConfig

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
SIDE_OF_TILE = 8
"""Units for products in 16 bits take matrices whose sides are multiples of this; others are copied first."""
DTYPES = {"fp32": torch.float32, "bf16": torch.bfloat16}
SIDE = {"cpu": 256, "cuda": 4096}
"""Rows and columns of the matrices whose products are timed: one takes at most 0.1 s on a slow device of each kind."""
PRODUCTS = 20
"""Least number of products that are timed: at most 2 s on a slow device."""
COMPILE_OPTIONS: dict[str, Any] = {"triton.mix_order_reduction": False}
"""Of torch.compile: the fusion of sums along two axes in attention across frames fails with an assertion (2.11)."""
MIN_GAIN = {"": 1.25, "fp32": 1.6, "bf16": 0.9}
"""Speed of bf16 products over that of fp32 from which bf16 is taken, by what a resumed training used before: near the
limit, two measurements on one machine must not give two answers."""


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


def schedule(config: TrainConfig, pairs: int, share: float) -> float:
    """Give the factor on the learning rate after so many pairs, a `share` of all: rise, constant, steps, fall."""
    rise = min(1.0, (pairs + config.batch) / config.warmup) if config.warmup else 1.0
    fall = min(1.0, max(0.0, 1.0 - share) / config.decay) if config.decay else 1.0
    return rise * fall * 0.1 ** sum(share >= milestone for milestone in config.milestones)


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
        for group in self.param_groups:
            matrices = [matrix for matrix in group["params"] if matrix.grad is not None]
            for matrix in matrices:
                if "momentum_buffer" not in self.state[matrix]:
                    self.state[matrix]["momentum_buffer"] = torch.zeros_like(matrix.grad)
            averages = [self.state[matrix]["momentum_buffer"] for matrix in matrices]
            torch._foreach_lerp_(averages, [matrix.grad for matrix in matrices], 1 - MOMENTUM)  # pyright: ignore[reportPrivateImportUsage]
            updates = [matrix.grad.lerp(average, MOMENTUM) for matrix, average in zip(matrices, averages, strict=True)]
            if group["weight_decay"]:
                torch._foreach_mul_(matrices, 1 - group["lr"] * group["weight_decay"])  # pyright: ignore[reportPrivateImportUsage]
            for shape in dict.fromkeys(matrix.shape for matrix in matrices):
                alike = [i for i, matrix in enumerate(matrices) if matrix.shape == shape]
                moves = orthogonalize(torch.stack([updates[i] for i in alike]), self.dtype).unbind()
                # An orthogonal A x B matrix has entries of root mean square 1 / sqrt(max(A, B)).
                size = -group["lr"] * UPDATE_RMS * math.sqrt(max(shape))
                torch._foreach_add_([matrices[i] for i in alike], [move.float() for move in moves], alpha=size)  # pyright: ignore[reportPrivateImportUsage]


def orthogonalize(matrices: Float[Tensor, "N A B"], dtype: torch.dtype) -> Float[Tensor, "N A B"]:
    """Bring all singular values of matrices near 1 and keep their singular vectors, by Newton-Schulz iterations.

    Each iteration applies an odd polynomial to the singular values: with X = U S V^T, a X + b (X X^T) X + c (X X^T)^2 X
    is U (a S + b S^3 + c S^5) V^T. Only matrix products are needed, and of the shorter side's size. Matrices of one
    shape go together: a GPU would wait longer for the start of each product than for its end.
    """
    rows, columns = matrices.shape[1:]
    tall = rows > columns
    # Rows and columns of zeros stay zero. Without them products of 1,027 rows take three times as long on a GPU.
    x = F.pad(matrices.to(dtype), (0, -columns % SIDE_OF_TILE, 0, -rows % SIDE_OF_TILE))
    x = x.mT if tall else x
    # The Frobenius norm bounds the largest singular value, which must be at most 1.
    x = x / x.norm(dim=(1, 2), keepdim=True).clamp(min=1e-7)
    a, b, c = COEFFICIENTS
    for _ in range(ITERATIONS):
        gram = x @ x.mT
        x = torch.baddbmm(x, torch.baddbmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return (x.mT if tall else x)[:, :rows, :columns]


def choose_precision(asked: str, device: torch.device, before: str = "") -> tuple[str, str]:
    """Give the precision of matrix products, `fp32` or `bf16`, and the reason in words; measure where `auto` is asked.

    Processors without units for bf16 take a hundred times as long for such a product as for one in fp32.

    Args:
        before: precision that a resumed training used before, or empty.
    """
    if asked != "auto":
        return asked, f"matrix products in {asked}, as configured"
    rates = {name: product_rate(dtype, device) for name, dtype in DTYPES.items()}
    chosen = "bf16" if rates["bf16"] > MIN_GAIN[before] * rates["fp32"] else "fp32"
    measured = " and ".join(f"{rate / 1e9:.3g} in {name}" for name, rate in rates.items())
    return chosen, f"matrix products in {chosen}: GFLOP/s measured are {measured}"


@functools.cache
def product_rate(dtype: torch.dtype, device: torch.device, seconds: float = 0.05) -> float:
    """Measure floating-point operations a second of products of square matrices: the best of PRODUCTS and of a moment.

    Single ones take a hundred times as long where other programs are busy.
    """
    side = SIDE[device.type]
    a, b = torch.randn(2, side, side, generator=torch.Generator().manual_seed(0)).to(device, dtype)
    float((a @ b)[0, 0])  # the first product also loads the library, on a GPU for longer than the others take
    best, count, end = float("inf"), 0, time.perf_counter() + seconds
    while count < PRODUCTS or time.perf_counter() < end:
        count += 1
        started = time.perf_counter()
        float((a @ b)[0, 0])  # waits for the device
        best = min(best, time.perf_counter() - started)
    return 2.0 * side**3 / best
