"""TrainingLog: what a training reports while it runs."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import torch
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from ..core.frame_buffer import Progress
from ..core.printable import say

if TYPE_CHECKING:
    from .loop import TrainingRun

LOG_SECONDS = 20.0
"""Wall-clock time between lines of the log."""
FIRST_SECONDS = 3.0
"""The same before the first line of figures."""
LONGEST_LEFT = 366 * 24 * 3600.0
"""Seconds from which on no date is told."""
PACE_STEPS = 2
"""Steps from which on the speed is told. The first is left out: it takes longer than the others."""


class TrainingLog:
    """Writes JSON lines, TensorBoard scalars and lines on the terminal; with several processes, the first one does."""

    def __init__(self, lines: TextIO, board: SummaryWriter | None, run: TrainingRun) -> None:
        self.lines, self.board, self.run = lines, board, run
        self.steps, self.told, self.start = 0, False, (0.0, 0.0)
        self._begin()

    @classmethod
    @contextlib.contextmanager
    def opened(cls, folder: Path, run: TrainingRun) -> Iterator[TrainingLog]:
        """Continue the log of a folder; outside the first process nothing is written."""
        if not run.processes.first:
            with open(os.devnull, "w") as nowhere:
                yield cls(nowhere, None, run)
            return
        with (folder / "log.jsonl").open("a") as lines, SummaryWriter(str(folder)) as board:
            yield cls(lines, board, run)

    def add(self, loss: Tensor) -> None:
        """Collect a loss; write a line now and then, and after some seconds what the training will reach."""
        self.losses.append(loss)
        self.steps += 1
        if self.steps == 1:
            self.start = (time.monotonic(), self.run.share())
        waited = time.monotonic() - (self.time if self.told else self.start[0])
        if not self.told and self.steps >= PACE_STEPS and waited > FIRST_SECONDS:
            self.told = True
            self.note("pace", expected_end(self.run, self.steps - 1, waited, self.run.share() - self.start[1]))
            self.flush()
        elif waited > LOG_SECONDS:
            self.flush()

    def flush(self) -> None:
        """Write what was collected: mean loss, pairs a second of `Processes.clock`, arithmetic achieved."""
        if not self.losses:
            return
        loss = torch.stack(self.losses).mean().item()
        seconds, operations = self.run.seconds - self.seconds, self.run.operations - self.operations
        rate = len(self.losses) * self.run.config.batch / seconds
        figures = {"loss": loss, "pairs_per_s": rate, "tflops": operations / seconds / 1e12}
        figures["learning_rate"] = self.run.optimizers[0].param_groups[0]["lr"]
        self._begin()
        self.write("training", figures)

    def _begin(self) -> None:
        """Begin to collect anew."""
        self.losses: list[Tensor] = []
        self.time, self.seconds, self.operations = time.monotonic(), self.run.seconds, self.run.operations

    def write(self, kind: str, figures: dict[str, float]) -> None:
        """Write one line of figures."""
        if self.board:
            for name, value in figures.items():
                self.board.add_scalar(f"{kind}/{name}", value, self.run.step * self.run.config.batch)
        self._line(kind, ", ".join(f"{k} {v:.4g}" for k, v in figures.items()), figures)

    def validating(self) -> Progress:
        """Begin a validation; give what tells now and then how many pairs are measured. Full meshes take minutes."""
        start = told = time.monotonic()

        def tell(done: int, pairs: int) -> None:
            nonlocal told
            now = time.monotonic()
            if now - told > LOG_SECONDS and done < pairs:
                told = now
                left = (now - start) / done * (pairs - done)
                self.note("validating", f"{done} of {pairs} pairs measured, about {left:,.0f} s more")

        return tell

    def note(self, kind: str, text: str, **facts: str) -> None:
        """Write one line of words."""
        self._line(kind, text, {"text": text, **facts})

    def _line(self, kind: str, text: str, facts: Mapping[str, float | str]) -> None:
        pairs = self.run.step * self.run.config.batch
        record = {"kind": kind, "step": self.run.step, "pairs": pairs, "seconds": round(self.run.seconds, 1), **facts}
        self.lines.write(json.dumps(record) + "\n")
        self.lines.flush()
        if self.board:
            say(f"{kind} {pairs:,} pairs: {text}", error=True)


def expected_end(run: TrainingRun, steps: int, seconds: float, share: float) -> str:
    """Say how fast a training is and when it ends, from steps of this process.

    Args:
        steps: number of them.
        seconds: wall-clock time that they took.
        share: of the whole training that they did.
    """
    hourly = steps * run.config.batch / seconds * 3600.0
    left = (1.0 - run.share()) / share * seconds if share > 0 else float("inf")
    end = datetime.now() + timedelta(seconds=left) if left < LONGEST_LEFT else None
    when = f"{end:%Y-%m-%d %H:%M}" if end else "in more than a year"
    reached = run.step * run.config.batch + hourly * left / 3600.0
    return (
        f"{hourly:,.0f} pairs an hour on this machine now; expected end {when}, after {left / 60.0:,.0f} minutes more "
        f"(validations not counted) and {reached:,.0f} pairs; a checkpoint every minute, --resume continues"
    )


def unfinished(run: TrainingRun) -> str:
    """Say what a training that ends so early lacks: its learning rate has not risen, or has not fallen."""
    pairs, share = run.step * run.config.batch, run.share()
    advice = "for a short training set minutes (its length), warmup (pairs) and validate_every with --set"
    if pairs < run.config.warmup:
        return f"; after {pairs:,} of {run.config.warmup:,} pairs the learning rate was still rising: {advice}"
    if run.config.decay and not run.rate_falls():
        return f"; after {share:.0%} of its length the learning rate had not begun to fall: {advice}"
    return ""
