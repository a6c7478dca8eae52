"""Checkpoints: one safetensors file with weights, optimizer state, position and configuration. Never a pickle."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from ..bodies import load_body
from ..core.errors import InputError
from ..evaluate.provenance import commit
from ..io.atomic import whole_file
from .aniformer import AniFormer, AniFormerConfig
from .config import TrainConfig, config_from
from .limp import LIMP, LIMPConfig
from .mime import Mime, MimeConfig
from .npt import NPT

Network = NPT | AniFormer | LIMP | Mime
"""Whatever can be trained."""


POSITION = ("step", "seconds", "best", "metrics", "before")
"""Fields of a State that are neither configuration nor tensors."""


@dataclass(frozen=True)
class State:
    """Where a training stands; `tensors` holds `model.*`, `ema.*` and `optimizer.<which>.<parameter>.<field>`."""

    config: TrainConfig
    step: int
    seconds: float
    best: float
    """Lowest validation figure so far (PMD x1e4)."""
    metrics: dict[str, float]
    """Validation figures of these weights, if they were validated."""
    tensors: dict[str, Tensor]
    before: tuple[dict[str, int], ...] = ()
    """Trainings that this one went on from, as `spent` gives them."""

    def spent(self) -> dict[str, int]:
        """What this training took so far."""
        return {"seconds_trained": round(self.seconds), "pairs": self.step * self.config.batch}

    def weights(self) -> dict[str, Tensor]:
        """The weights to use: the running average if there is one."""
        prefix = "ema." if any(k.startswith("ema.") for k in self.tensors) else "model."
        return {k.removeprefix(prefix): v for k, v in self.tensors.items() if k.startswith(prefix)}


def save(path: Path, state: State) -> None:
    """Write a checkpoint whole or not at all."""
    header = {
        "config": json.dumps(dataclasses.asdict(state.config)),
        "state": json.dumps({key: getattr(state, key) for key in POSITION}),
        "commit": commit(),
        "hardware": hardware(),
    }
    tensors = {k: v.detach().contiguous().cpu() for k, v in state.tensors.items()}
    with whole_file(path) as temporary:
        save_file(tensors, temporary, metadata={"mimesh": json.dumps(header)})


def load(path: Path) -> State:
    """Read a checkpoint. Raises InputError where the file is not one of ours."""
    try:
        with safe_open(path, "pt") as file:
            header = json.loads((file.metadata() or {})["mimesh"])
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
    except (OSError, SafetensorError, KeyError) as error:
        raise InputError(f"{path}: expected a checkpoint of `mimesh train`, found none ({error})") from error
    position = json.loads(header["state"])
    position["before"] = tuple(position.get("before", ()))
    return State(config_from(json.loads(header["config"]), str(path)), tensors=tensors, **position)


def read_header(path: Path) -> dict[str, Any]:
    """Provenance of a checkpoint: config, state, commit, hardware."""
    with safe_open(path, "pt") as file:
        header = json.loads((file.metadata() or {})["mimesh"])
    return {k: json.loads(v) if k in ("config", "state") else v for k, v in header.items()}


def pack(model: nn.Module, ema: dict[str, Tensor], optimizers: list[torch.optim.Optimizer]) -> dict[str, Tensor]:
    """All tensors of a training under flat names."""
    tensors = {f"model.{k}": v for k, v in model.state_dict().items()}
    tensors |= {f"ema.{k}": v for k, v in ema.items()}
    for which, optimizer in enumerate(optimizers):
        for index, fields in optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{which}.{index}.{k}": torch.as_tensor(v) for k, v in fields.items()}
    return {k: v.clone() for k, v in tensors.items()}


def unpack(state: State, model: nn.Module, ema: dict[str, Tensor], optimizers: list[torch.optim.Optimizer]) -> None:
    """Put a checkpoint's tensors back where `pack` took them from."""
    with torch.no_grad():
        model.load_state_dict({k[6:]: v for k, v in state.tensors.items() if k.startswith("model.")})
        for name, value in ema.items():
            value.copy_(state.tensors[f"ema.{name}"])
    for which, optimizer in enumerate(optimizers):
        fields: dict[int, dict[str, Tensor]] = {}
        prefix = f"optimizer.{which}."
        for key, value in state.tensors.items():
            if key.startswith(prefix):
                index, name = key.removeprefix(prefix).split(".")
                fields.setdefault(int(index), {})[name] = value
        groups = optimizer.state_dict()["param_groups"]
        optimizer.load_state_dict({"state": fields, "param_groups": groups})


def make_model(config: TrainConfig) -> Network:
    """A fresh network of a configuration."""
    if isinstance(config.model, AniFormerConfig):
        return AniFormer(config.model)
    if isinstance(config.model, MimeConfig):
        return Mime(config.model, load_body())
    return LIMP(config.model) if isinstance(config.model, LIMPConfig) else NPT(config.model)


def load_model(path: Path) -> tuple[Network, State]:
    """The model of a checkpoint in float32, ready to infer."""
    state = load(path)
    model = make_model(state.config)
    model.load_state_dict(state.weights())
    return model.eval(), state


def hardware() -> str:
    """What this process computes on."""
    if torch.cuda.is_available():
        return torch.cuda.get_device_name()
    return f"CPU, {torch.get_num_threads()} threads"
