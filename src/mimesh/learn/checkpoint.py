"""Checkpoints: one safetensors file with weights, optimizer state, position and configuration. Never a pickle."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from ..core.errors import InputError
from ..evaluate.metrics import VERSION
from ..evaluate.provenance import commit
from ..io.atomic import whole_file
from .config import recorded_config
from .models import find_task, operations_of
from .task import TrainConfig, UserData

SCHEDULE = ("seed", "pairs", "minutes", "decay", "learning_rate", "accumulate")
"""Keys of the schedule, which may change where a training is resumed."""


@dataclass
class Checkpoint:
    """The state of a training; `tensors` holds `model.*`, `ema.*` and `optimizer.<which>.<parameter>.<field>`."""

    config: TrainConfig
    step: int = 0
    seconds: float = 0.0
    """Spent in steps: CPU time, or wall-clock time with a GPU (`loop.clock`)."""
    best: float = float("inf")
    """Lowest validation figure so far (PMD x1e4)."""
    metrics: dict[str, float] = field(default_factory=dict)
    """Validation figures of these weights, if they were validated."""
    tensors: dict[str, Tensor] = field(default_factory=dict)
    before: tuple[dict[str, int | float], ...] = ()
    """Trainings whose network this one began with, as `spent` gives them."""
    validated: int = 0
    """Step of the last validation."""
    precision: str = ""
    """Of matrix products, `fp32` or `bf16`; empty in checkpoints that do not say."""
    characters: dict[str, Any] = field(default_factory=dict)
    """Makers, numbers, licences and checksum of the characters trained on (`TrainingCharacters.facts`), if any."""
    changes: tuple[dict[str, Any], ...] = ()
    """What was changed where the training was resumed: `after_pairs`, the new values by their keys, and in `was` the
    values before. Where its network was averaged with others, `averaged` lists them."""
    operations: float | None = None
    """Floating-point operations of this training so far, without the optimizer's; None in old checkpoints."""
    meshes: dict[str, Any] = field(default_factory=dict)
    """Layout, numbers and checksum of the registered meshes trained on (`RegisteredMeshes.facts`), if any."""
    samples: int = 0
    """Parts of batches so far: their number may change where a training is resumed."""

    def spent(self) -> dict[str, int | float]:
        """Give the time, the pairs and, if known, the operations of this training so far."""
        spent: dict[str, int | float] = {"seconds_trained": round(self.seconds), "pairs": self.step * self.config.batch}
        return spent if self.operations is None else {**spent, "operations": self.operations}

    @property
    def pairs(self) -> int:
        """Pairs of this training so far and of those before it."""
        return int(sum(stage["pairs"] for stage in (self.spent(), *self.before)))

    def operations_spent(self) -> float:
        """Sum the operations of this training and of those before it; where not known, with this configuration."""
        stages = (self.spent(), *self.before)
        return sum(stage.get("operations") or operations_of(self.config, int(stage["pairs"])) for stage in stages)

    def weights(self) -> dict[str, Tensor]:
        """Give the weights to use: the moving average if there is one."""
        prefix = "ema." if any(k.startswith("ema.") for k in self.tensors) else "model."
        return {k.removeprefix(prefix): v for k, v in self.tensors.items() if k.startswith(prefix)}


def save(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint whole or not at all."""
    position = {f.name: getattr(checkpoint, f.name) for f in dataclasses.fields(Checkpoint)}
    del position["config"], position["tensors"]
    header = {
        "config": json.dumps(dataclasses.asdict(checkpoint.config)),
        "state": json.dumps(position | {"version": VERSION}),
        "commit": commit(),
        "hardware": hardware(),
    }
    tensors = {k: v.detach().contiguous().cpu() for k, v in checkpoint.tensors.items()}
    with whole_file(path) as temporary:
        save_file(tensors, temporary, metadata={"mimesh": json.dumps(header)})


def load(path: Path) -> Checkpoint:
    """Read a checkpoint, compact or not, with all numbers in float32.

    Without its validation figures if they are of another version of the metrics.
    """
    try:
        with safe_open(path, "pt") as file:
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
        header = read_header(path)
    except (OSError, SafetensorError, KeyError) as error:
        raise InputError(f"{path}: expected a checkpoint of `mimesh train`, found none ({error})") from error
    config, position = recorded_config(header["config"], str(path)), header["state"]
    if position.pop("version", 1) != VERSION:
        position |= {"best": float("inf"), "metrics": {}}
    position |= {key: tuple(position.get(key, ())) for key in ("before", "changes")}
    # Old checkpoints do not say these.
    position = {"validated": position["step"], "samples": position["step"] * config.accumulate} | position
    tensors = {key: value.float() if value.is_floating_point() else value for key, value in tensors.items()}
    return Checkpoint(config, tensors=tensors, **position)


def read_header(path: Path) -> dict[str, Any]:
    """Read the provenance of a checkpoint: config, state, commit, hardware."""
    with safe_open(path, "pt") as file:
        header = json.loads((file.metadata() or {})["mimesh"])
    return {k: json.loads(v) if k in ("config", "state") else v for k, v in header.items()}


def pack(model: nn.Module, ema: dict[str, Tensor], optimizers: list[torch.optim.Optimizer]) -> dict[str, Tensor]:
    """Copy all tensors of a training under flat names."""
    tensors = {f"model.{k}": v for k, v in model.state_dict().items()}
    tensors |= {f"ema.{k}": v for k, v in ema.items()}
    for which, optimizer in enumerate(optimizers):
        for index, fields in optimizer.state_dict()["state"].items():
            tensors |= {f"optimizer.{which}.{index}.{k}": torch.as_tensor(v) for k, v in fields.items()}
    return {k: v.clone() for k, v in tensors.items()}


def unpack(
    checkpoint: Checkpoint, model: nn.Module, ema: dict[str, Tensor], optimizers: list[torch.optim.Optimizer]
) -> None:
    """Put a checkpoint's tensors back where `pack` took them from."""
    with torch.no_grad():
        model.load_state_dict({k[6:]: v for k, v in checkpoint.tensors.items() if k.startswith("model.")})
        for name, value in ema.items():
            value.copy_(checkpoint.tensors.get(f"ema.{name}", checkpoint.tensors[f"model.{name}"]))
    for which, optimizer in enumerate(optimizers):
        fields: dict[int, dict[str, Tensor]] = {}
        prefix = f"optimizer.{which}."
        for key, value in checkpoint.tensors.items():
            if key.startswith(prefix):
                index, name = key.removeprefix(prefix).split(".")
                fields.setdefault(int(index), {})[name] = value
        groups = optimizer.state_dict()["param_groups"]
        optimizer.load_state_dict({"state": fields, "param_groups": groups})


def load_model(path: Path) -> tuple[nn.Module, Checkpoint]:
    """Load the network of a checkpoint in float32, ready to infer."""
    checkpoint = load(path)
    model = find_task(checkpoint.config.network)(checkpoint.config, torch.device("cpu")).make_model()
    model.load_state_dict(checkpoint.weights())
    return model.eval(), checkpoint


def hardware() -> str:
    """Say what this process computes on."""
    if torch.cuda.is_available():
        return torch.cuda.get_device_name()
    return f"CPU, {torch.get_num_threads()} threads"


def resumable(config: TrainConfig) -> list[str]:
    """List the keys that may change where a training is resumed: its schedule and the mixture of its data.

    The network may not. Two trainings that go on from one checkpoint with two seeds see other batches and can be
    averaged.
    """
    return [*SCHEDULE, *(f"data.{key}" for key in ("vertices", *config.data.shares()))]


def changes_at_resume(state: Checkpoint, config: TrainConfig, user_data: UserData | None) -> list[dict[str, Any]]:
    """List what a resumed training changes: nothing, or one entry of `Checkpoint.changes`."""
    values = [{key: attrgetter(key)(one) for key in resumable(config)} for one in (config, state.config)]
    changed, was = ({k: v for k, v in one.items() if values[0][k] != values[1][k]} for one in values)
    if user_data and "clips" in user_data.facts and "clips" not in state.characters:
        changed["clips"] = user_data.facts["clips"]["makers"]
    return [{"after_pairs": state.step * config.batch, **changed, "was": was}] if changed else []
