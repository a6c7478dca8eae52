"""Count the arithmetic and the memory of a training, before it has run."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from .checkpoint import Checkpoint
from .tasks.base import BatchSource, Task, TrainConfig
from .tasks.find import find_task


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
    """Count the bytes that the forward pass of one pair keeps for the backward pass.

    Weights are not among them. A part of a batch needs as many times that as it has pairs.
    """
    kept: dict[int, int] = {}
    weights = {parameter.untyped_storage().data_ptr() for parameter in model.parameters()}

    def keep(tensor: Tensor) -> Tensor:
        storage = tensor.untyped_storage()
        if storage.data_ptr() not in weights:
            kept[storage.data_ptr()] = storage.nbytes()
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
        loss = task.loss(model, source.batch(1, 0), 0)
    del loss
    return sum(kept.values())
