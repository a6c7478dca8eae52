"""Choose the precision of matrix products on a device, by a short measurement."""

from __future__ import annotations

import functools
import time

import torch

DTYPES = {"fp32": torch.float32, "bf16": torch.bfloat16}
SIDE = {"cpu": 256, "cuda": 4096}
"""Rows and columns of the matrices whose products are timed: one takes at most 0.1 s on a slow device of each kind."""
MIN_GAIN = {"": 1.25, "fp32": 1.6, "bf16": 0.9}
"""Speed of bf16 products over that of fp32 from which bf16 is taken, by what a resumed training used before: near the
limit, two measurements on one machine must not give two answers."""


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
    """Measure floating-point operations a second of products of square matrices: the best within a moment."""
    side = SIDE[device.type]
    a, b = torch.randn(2, side, side, generator=torch.Generator().manual_seed(0)).to(device, dtype)
    float((a @ b)[0, 0])  # the first product also loads the library, on a GPU for longer than the others take
    best, end = float("inf"), time.perf_counter() + seconds
    while best == float("inf") or time.perf_counter() < end:
        started = time.perf_counter()
        float((a @ b)[0, 0])  # waits for the device
        best = min(best, time.perf_counter() - started)
    return 2.0 * side**3 / best
