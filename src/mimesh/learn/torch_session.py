"""Runs an exported network of the papers by PyTorch: on a GPU, or in bf16 on processors with units for it."""

from __future__ import annotations

import dataclasses
import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..core.errors import InputError
from ..methods.base import Method
from .export import load_exported
from .models import find_task
from .optimizers import choose_precision
from .task import OnnxInterface

NETWORKS = ("npt", "aniformer")
"""Networks whose exported weights are those of the training."""


def in_torch(method: Any, path: Path) -> Method:
    """Return a method whose network is run by PyTorch instead of onnxruntime.

    Results differ by the rounding of bf16 where that is used (`precision`), else by that of float32.

    Args:
        method: the method, a dataclass with the field `session`.
        path: its weights, an .onnx file with its card beside it.

    Raises:
        InputError: another method than `npt` or `aniformer`, or no card.
    """
    card = path.with_suffix(".json")
    if card.is_file() and json.loads(card.read_text(encoding="utf-8"))["config"]["network"] not in NETWORKS:
        raise InputError(f"--torch: expected networks of npt and aniformer, found {path.stem}; measure it without")
    return dataclasses.replace(method, session=_opened(path.resolve(), path.stat().st_mtime_ns))


def precision() -> str:
    """Name the device and the precision of `in_torch` for reports, such as "cpu, bf16"."""
    device = _device()
    return f"{device.type}, {choose_precision('auto', device)[0]}"


@dataclasses.dataclass(frozen=True, eq=False)
class TorchSession:
    """Takes the place of onnxruntime's session."""

    network: OnnxInterface
    device: torch.device
    dtype: torch.dtype
    """Of matrix products: float32 or bfloat16."""

    def run(self, names: list[str], inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
        """Compute the outputs of some names, in float32."""
        given = [torch.from_numpy(inputs[name]).to(self.device) for name in self.network.inputs]
        with torch.inference_mode(), torch.autocast(self.device.type, self.dtype, self.dtype != torch.float32):
            results = self.network.module(*given)
        results = results if isinstance(results, tuple) else (results,)
        found = dict(zip(self.network.outputs, results, strict=True))
        return [found[name].float().cpu().numpy() for name in names]


@lru_cache(maxsize=2)
def _opened(path: Path, modified: int) -> Any:
    """Open a file again only when it has changed."""
    model, trained = load_exported(path)
    device = _device()
    dtype = torch.bfloat16 if choose_precision("auto", device)[0] == "bf16" else torch.float32
    return TorchSession(find_task(trained.config.network).onnx_interface(model.to(device)), device, dtype)


def _device() -> torch.device:
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")
