"""Processes: a training in one process, or in the several that `torchrun` starts, which share every step's batch."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from typing import TypeVar

import torch
import torch.distributed as dist
from torch import nn
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from ..core.errors import InputError

WAIT = timedelta(hours=2)
"""Longest time that processes wait for each other: the first one validates alone."""
Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Processes:
    """The processes of a training. The first one alone validates, writes checkpoints and logs."""

    rank: int
    """Number of this process, from 0."""
    count: int
    device: torch.device

    @property
    def first(self) -> bool:
        """Tell whether this is the process that writes."""
        return self.rank == 0

    def average_gradients(self, model: nn.Module) -> None:
        """Replace every gradient by its mean over the processes, all in one exchange.

        Processes compute the same losses, so the same parameters have gradients.
        """
        if self.count == 1:
            return
        gradients = [p.grad for p in model.parameters() if p.grad is not None]
        together = parameters_to_vector(gradients)
        dist.all_reduce(together)  # the sum: gloo has no mean
        vector_to_parameters(together / self.count, gradients)

    def largest(self, *numbers: float | bool) -> tuple[float, ...]:
        """Give the largest of each number over the processes, so that all decide alike."""
        if self.count == 1:
            return tuple(map(float, numbers))
        tensor = torch.tensor(numbers, dtype=torch.float64, device=self.device)
        dist.all_reduce(tensor, op=dist.ReduceOp.MAX)
        return tuple(tensor.tolist())

    def of_first(self, compute: Callable[[], Answer]) -> Answer:
        """Compute something in the first process and give its answer in all; the others wait."""
        if self.count == 1:
            return compute()
        answer = [compute() if self.first else None]
        dist.broadcast_object_list(answer, device=self.device)
        return answer[0]  # type: ignore[return-value]


@contextlib.contextmanager
def joined_processes() -> Iterator[Processes]:
    """Join the processes that `torchrun` started, which says so in the environment; without it there is one.

    Each process has a CUDA device of its own, or the CPU.

    Raises:
        InputError: this machine has fewer CUDA devices than processes.
    """
    rank, count = _rank_and_count()
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if count == 1:
        yield Processes(0, 1, device)
        return
    if device.type == "cuda":
        number, devices = int(os.environ["LOCAL_RANK"]), torch.cuda.device_count()
        if number >= devices:
            raise InputError(
                f"--nproc-per-node: expected at most {devices} processes, one for each CUDA device, found more; "
                "start fewer, or let parts of a batch follow one another with --set accumulate"
            )
        device = torch.device("cuda", number)
        torch.cuda.set_device(device)
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo", timeout=WAIT)
    try:
        yield Processes(rank, count, device)
        dist.barrier()  # nobody leaves while another still waits for an answer
    finally:
        dist.destroy_process_group()


def is_first_process() -> bool:
    """Tell whether this process is the only one, or the first of those that `torchrun` started."""
    return _rank_and_count()[0] == 0


def _rank_and_count() -> tuple[int, int]:
    """Read what `torchrun` says; a rank without a number of processes is left from something else."""
    count = int(os.environ.get("WORLD_SIZE", "1"))
    return (int(os.environ["RANK"]) if count > 1 else 0), count
