"""The networks that can be trained, by name."""

from __future__ import annotations

import torch

from ..core.errors import InputError, did_you_mean
from .task import Task, TrainConfig, training_operations

NETWORKS = ("npt", "aniformer", "mime")
"""The networks that can be trained."""


def find_task(network: str) -> type[Task]:
    """Give the task of a network by its name."""
    match network:
        case "npt":
            from .npt import NPTTask as task
        case "aniformer":
            from .aniformer import AniFormerTask as task
        case "mime":
            from .mime import MimeTask as task
        case _:
            raise InputError(
                f"{network}: expected a model that can be trained ({', '.join(NETWORKS)}), found another"
                + did_you_mean(network, NETWORKS)
            )
    return task


def operations_of(config: TrainConfig, pairs: int) -> float:
    """Count the operations of a training from its configuration alone."""
    task = find_task(config.network)(config, torch.device("cpu"))
    return training_operations(task, task.make_model(), pairs)
