"""The processes of a training (one, or those of `torchrun`, which share every step's batch) and what ends it."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import timedelta
from typing import Any, TypeVar

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

    def clock(self) -> float:
        """Give the seconds that this process spent on all cores; with a GPU those of the wall clock.

        Other processes lengthen them by little: a training between busy ones does a tenth less in its time.
        """
        return time.process_time() if self.device.type == "cpu" else time.perf_counter()

    def refuse_batch(self, batch: int, most_parts: int) -> None:
        """Raise InputError for a batch that cannot be divided into so many parts in each process."""
        parts = most_parts * self.count
        if batch % parts:
            raise InputError(
                f"batch: expected a multiple of {parts} (most parts of a batch x processes), found {batch}; change one"
            )

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


class StopRequest:
    """Tells when a training has to end before its schedule does: after a time limit, or on SIGTERM or SIGINT.

    A signal is only recorded, so that the current step can be finished and saved; at the end of the block it becomes a
    KeyboardInterrupt. A second one acts at once. Outside the main thread, which alone may handle signals, only the
    time limit counts.
    """

    def __init__(self, max_minutes: float | None) -> None:
        self.deadline = time.monotonic() + 60 * max_minutes if max_minutes else float("inf")
        self.signal: signal.Signals | None = None
        self.handlers: dict[signal.Signals, Any] = {}

    def __call__(self) -> bool:
        return self.signal is not None or time.monotonic() >= self.deadline

    def reason(self) -> str:
        """Say what ended the training."""
        return "the time given is over" if self.signal is None else f"ended by {self.signal.name}"

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is threading.main_thread():
            self.handlers = {s: signal.signal(s, self._record) for s in (signal.SIGTERM, signal.SIGINT)}
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._restore()
        if kind is None and self.signal is not None:
            raise KeyboardInterrupt

    def _record(self, number: int, _: object) -> None:
        self.signal = signal.Signals(number)
        self._restore()

    def _restore(self) -> None:
        while self.handlers:
            signal.signal(*self.handlers.popitem())
