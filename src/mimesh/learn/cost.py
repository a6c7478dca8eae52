"""Count the arithmetic and the memory of a training, before it has run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from .checkpoint import Checkpoint
from .models import find_task
from .task import BatchSource, Task, TrainConfig

if TYPE_CHECKING:
    from .loop import TrainingRun


def described_cost(run: TrainingRun) -> str:
    """Say what the training takes: arithmetic of a step and of the whole, and memory."""
    config, weights = run.config, sum(parameter.numel() for parameter in run.model.parameters())
    step = training_operations(run.task, run.model, config.batch)
    part = config.batch // config.accumulate
    kept = activation_bytes(run.task, run.model, run.source) * part
    whole = training_operations(run.task, run.model, config.pairs) / 1e15
    in_all = "" if config.minutes else f", {whole:.3g} PFLOP in all"
    return (
        f"{weights / 1e6:.3g} M weights; a step of {config.batch} pairs is {step / 1e12:.3g} TFLOP{in_all}; "
        f"a part of {part} pairs keeps {kept / 2**30:.3g} GiB for its gradient"
    )


def training_operations(task: Task, model: nn.Module, pairs: int) -> float:
    """Count floating-point operations of training on so many pairs: three times the forward pass.

    The optimizer's are not counted.
    """
    return 3.0 * pairs * task.flops_per_pair(model)


def operations_of(config: TrainConfig, pairs: int) -> float:
    """Count the operations of a training from its configuration alone."""
    task = find_task(config.network)(config, torch.device("cpu"))
    return training_operations(task, task.make_model(), pairs)


def operations_spent(trained: Checkpoint) -> float:
    """Sum the operations of a training and of those that it began with.

    Checkpoints that do not say theirs count with this configuration.
    """
    stages = (trained.spent(), *trained.before)
    return sum(
        stage["operations"] if "operations" in stage else operations_of(trained.config, int(stage["pairs"]))
        for stage in stages
    )


def activation_bytes(task: Task, model: nn.Module, source: BatchSource) -> int:
    """Count the bytes that the forward pass keeps of each pair for the backward pass: of two pairs, less those of one.

    A part of a batch needs as many times that as it has pairs. Weights, and the copies of them in 16 bits that matrix
    products of that precision keep once for all pairs, are not among them.
    """
    one, two = (_saved_bytes(task, model, source.batch(size, 0)) for size in (1, 2))
    return two - one


def _saved_bytes(task: Task, model: nn.Module, batch: Any) -> int:
    """Sum the storage of all tensors that the loss of a batch saves for its gradient."""
    kept: dict[int, int] = {}

    def keep(tensor: Tensor) -> Tensor:
        storage = tensor.untyped_storage()
        kept[storage.data_ptr()] = storage.nbytes()
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
        loss = task.loss(model, batch, 0)
    del loss
    return sum(kept.values())
