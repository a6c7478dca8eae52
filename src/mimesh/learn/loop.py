"""The training loop: batches in, steps, validations, checkpoints and logs; any model, resumable at any moment."""

from __future__ import annotations

import contextlib
import json
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, TextIO

import torch
from torch import Tensor, nn
from torch.utils.tensorboard import SummaryWriter

from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.printable import say
from . import checkpoint
from .checkpoint import Checkpoint
from .models import find_task, operations_of
from .optimizers import COMPILE_OPTIONS, DTYPES, choose_precision, make_optimizers, schedule
from .task import BatchSource, Task, TrainConfig, UserData, batches_of, training_operations
from .validation import Validation

SAVE_SECONDS = 60.0
"""Wall-clock time between checkpoints."""
FULL_RATE = "full-rate.safetensors"
"""Checkpoint of the last step before the learning rate falls. A longer training goes on from there (`--weights`): a
rate that has fallen to zero and rises again undoes more than a short training brings back (docs/log/papers.md)."""
LOG_SECONDS = 20.0
"""Wall-clock time between lines of the log."""
FIRST_SECONDS = 3.0
"""The same before the first line of figures."""
LONGEST_LEFT = 366 * 24 * 3600.0
"""Seconds from which on no date is told."""
PACE_STEPS = 2
"""Steps from which on the speed is told. The first is left out: it takes longer than the others."""


def train(
    config: TrainConfig, folder: Path, max_minutes: float | None = None, user_data: UserData | None = None
) -> Path:
    """Train to the end of the schedule, or until a time limit or a signal; continue the training in the folder if any.

    A checkpoint is written every minute, before every validation and at the end. At least one step is taken.

    Args:
        max_minutes: wall-clock time, counted from this call.
        user_data: what the user brings, where the configuration asks for it.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with StopRequest(max_minutes) as stop:
        run = TrainingRun.start(config, folder, user_data)
        validation = Validation(run.task)
        with TrainingLog.opened(folder, run, stop.deadline) as log:
            log.note("precision", run.reason, precision=run.task.precision)
            log.note("cost", described_cost(run))
            if user_data:
                log.note(user_data.part, user_data.described())
            if run.changes:
                log.note("changes", json.dumps(run.changes[-1]))
            run_to_end(run, validation, folder, log, stop)
            if stop():
                rest = "; the validation that was due is left to it" if run.validation_due() else ""
                log.note("stopped", f"{stop.reason()}; --resume {folder} continues{rest}{unfinished(run)}")
    return folder


def run_to_end(run: TrainingRun, validation: Validation, folder: Path, log: TrainingLog, stop: StopRequest) -> None:
    """Take steps, validate and save until the schedule ends or `stop` says so."""
    last, first, falling = folder / "last.safetensors", run.step, run.rate_falls()
    while True:
        if stop() and (run.step > first or stop.signal is not None or run.share() >= 1.0):
            break
        if run.validation_due():
            log.flush()
            run.save(last)
            if figures := run.validate(validation, folder, stop, log.validating()):
                log.write("validation", figures)
        elif run.share() >= 1.0:
            break
        else:
            if not falling and run.rate_falls():
                falling = True
                run.save(folder / FULL_RATE)
            log.add(run.advance())
            stop.at_once = False
            if time.monotonic() - run.saved > SAVE_SECONDS:
                run.save(last)
    log.flush()
    run.save(last)


@dataclass(kw_only=True)
class TrainingRun(Checkpoint):
    """A running training, which is where its checkpoint would be; `tensors` are filled to save it."""

    task: Task
    model: nn.Module
    step_model: nn.Module
    """The model, or its compiled form; both share weights."""
    ema: dict[str, Tensor]
    """Moving average of the weights by name; empty if none is kept."""
    optimizers: list[torch.optim.Optimizer]
    source: BatchSource
    reason: str
    """Why `task.precision` was chosen, in words."""
    saved: float = field(default_factory=time.monotonic)
    """Time of the last checkpoint (`time.monotonic`)."""

    @classmethod
    def start(cls, config: TrainConfig, folder: Path, user_data: UserData | None = None) -> TrainingRun:
        """Set up a new training, or the one whose checkpoint lies in the folder."""
        config.check(str(folder))
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        last = folder / "last.safetensors"
        state = checkpoint.load(last) if last.exists() else Checkpoint(config, operations=0.0)
        for part, facts in {"characters": state.characters, "meshes": state.meshes}.items():
            if facts and not (user_data and user_data.part == part and user_data.continues(facts)):
                what = "characters and clips" if "clips" in facts else part
                names = [maker for whose in (facts, facts.get("clips", {})) for maker in whose.get("makers", ())]
                if part == "meshes":
                    names = [f"{facts['layout']}, {facts['meshes']:,} of {facts['people']} people"]
                raise InputError(
                    f"{folder}: expected the {what} of the training so far ({', '.join(names)}), found others; "
                    f"begin a new training with --weights {folder / 'last.safetensors'}"
                )
        precision, reason = choose_precision(config.precision, device, state.precision)
        torch.manual_seed(config.seed)
        task = find_task(config.network)(config, device, precision, user_data)
        model = task.make_model().to(device)
        ema = {k: v.detach().clone() for k, v in model.state_dict().items()} if config.ema else {}
        optimizers = make_optimizers(model, config, device, DTYPES[precision])
        source = batches_of(task, config.seed)
        step_model: Any = torch.compile(model, options=COMPILE_OPTIONS) if config.compile else model
        if config.compile:  # takes up to a minute, which is no training
            task.loss(step_model, source.batch(config.batch // config.accumulate, 0), 0).backward()
            model.zero_grad(set_to_none=True)
        if state.tensors:
            checkpoint.unpack(state, model, ema, optimizers)
        position = {of.name: getattr(state, of.name) for of in fields(Checkpoint)}
        position |= {"config": config, "tensors": {}, "precision": precision}
        position["changes"] += tuple(checkpoint.changes_at_resume(state, config, user_data))
        if state.operations is None:
            position["operations"] = operations_of(state.config, state.step * config.batch)
        if user_data:
            position[user_data.part] = user_data.facts
        parts = {"task": task, "model": model, "step_model": step_model, "ema": ema, "optimizers": optimizers}
        return cls(**position, **parts, source=source, reason=reason)

    def share(self) -> float:
        """Give how much of the training is done: 0 at the start, 1 at its end."""
        if self.config.minutes:
            return self.seconds / (60.0 * self.config.minutes)
        return self.step * self.config.batch / self.config.pairs

    def rate_falls(self) -> bool:
        """Tell whether the learning rate has begun to fall towards the end of the training."""
        return bool(self.config.decay) and self.share() >= 1.0 - self.config.decay

    def validation_due(self) -> bool:
        """Tell whether the steps since the last validation passed a multiple of `validate_every` pairs, or the end."""
        if self.share() >= 1.0:
            return not self.metrics
        now, before = (step * self.config.batch // self.config.validate_every for step in (self.step, self.validated))
        return now > before

    def advance(self) -> Tensor:
        """Take one optimizer step and give the mean loss, which stays on the device.

        Parts of the batch are the generator's next samples. Random numbers of a loss are those of the sample, too.
        """
        started = clock(self.task.device)
        config, parts = self.config, self.config.accumulate
        for optimizer in self.optimizers:
            for group in optimizer.param_groups:
                group["lr"] = config.learning_rate * schedule(config, self.step * config.batch, self.share())
            optimizer.zero_grad(set_to_none=True)
        losses = []
        for sample in range(self.samples, self.samples + parts):
            batch = self.source.batch(config.batch // parts, sample)
            loss = self.task.loss(self.step_model, batch, sample)
            (loss / parts).backward()
            losses.append(loss.detach())
        if config.clip:
            nn.utils.clip_grad_norm_(self.model.parameters(), config.clip)
        for optimizer in self.optimizers:
            optimizer.step()
        if self.ema:
            current = self.model.state_dict()
            torch._foreach_lerp_(list(self.ema.values()), [current[name] for name in self.ema], 1.0 - config.ema)  # pyright: ignore[reportPrivateImportUsage]
        self.step += 1
        self.samples += parts
        self.operations = (self.operations or 0.0) + training_operations(self.task, self.model, config.batch)
        self.metrics = {}
        self.seconds += clock(self.task.device) - started
        return torch.stack(losses).mean()

    def validate(
        self,
        validation: Validation,
        folder: Path,
        stop: Callable[[], bool] = lambda: False,
        progress: Progress | None = None,
    ) -> dict[str, float] | None:
        """Measure on `val`, and keep the checkpoint if it is the best so far; None if `stop` ended the measurement."""
        current = {k: v.clone() for k, v in self.model.state_dict().items()}
        if self.ema:
            self.model.load_state_dict(self.ema)
        metrics = validation.measure(self.model, stop, progress)
        self.model.load_state_dict(current)
        if metrics is None:
            return None
        self.metrics, self.validated = metrics, self.step
        if metrics["val"] < self.best:
            self.best = metrics["val"]
            self.save(folder / "best.safetensors")
        self.save(folder / "last.safetensors")
        return metrics

    def save(self, path: Path) -> None:
        """Write a checkpoint."""
        self.saved = time.monotonic()
        self.tensors = checkpoint.pack(self.model, self.ema, self.optimizers)
        checkpoint.save(path, self)
        self.tensors = {}


def described_cost(run: TrainingRun) -> str:
    """Say what the training takes: arithmetic of a step and of the whole, and memory."""
    config, weights = run.config, sum(parameter.numel() for parameter in run.model.parameters())
    step, whole = (training_operations(run.task, run.model, pairs) for pairs in (config.batch, config.pairs))
    part = config.batch // config.accumulate
    kept = activation_bytes(run.task, run.model, run.source) * part
    in_all = "" if config.minutes else f", {whole / 1e15:.3g} PFLOP in all"
    return (
        f"{weights / 1e6:.3g} M weights; a step of {config.batch} pairs is {step / 1e12:.3g} TFLOP{in_all}; "
        f"a part of {part} pairs keeps {kept / 2**30:.3g} GiB for its gradient"
    )


def activation_bytes(task: Task, model: nn.Module, source: BatchSource) -> int:
    """Count the bytes that the forward pass keeps of each pair for the backward pass: of two pairs, less those of one.

    A part of a batch needs as many times that as it has pairs. Weights, and the copies of them in 16 bits that matrix
    products of that precision keep once for all pairs, are not among them.
    """
    saved = []
    for size in (1, 2):
        kept: dict[int, int] = {}

        def keep(tensor: Tensor, kept: dict[int, int] = kept) -> Tensor:
            kept[tensor.untyped_storage().data_ptr()] = tensor.untyped_storage().nbytes()
            return tensor

        with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
            loss = task.loss(model, source.batch(size, 0), 0)
        del loss
        saved.append(sum(kept.values()))
    return saved[1] - saved[0]


def clock(device: torch.device) -> float:
    """Give the seconds that this process spent on all cores; with a GPU those of the wall clock.

    Other processes lengthen them by little: a training between busy ones does a tenth less in its time.
    """
    return time.process_time() if device.type == "cpu" else time.perf_counter()


class StopRequest:
    """Tells when a training has to end before its schedule does: after a time limit, or on SIGTERM or SIGINT.

    A signal is only recorded, so that the current step can be finished and saved; at the end of the block it becomes a
    KeyboardInterrupt. So does an exception after it: Ctrl-C interrupts the compiler of a first step, too, which fails.
    Before the first step there is nothing to save, and reading data and the first batch take minutes: a signal acts at
    once, as does a second one. Outside the main thread, which alone may handle signals, only the time limit counts.
    """

    def __init__(self, max_minutes: float | None) -> None:
        self.deadline = time.monotonic() + 60 * (float("inf") if max_minutes is None else max_minutes)
        self.signal: signal.Signals | None = None
        self.at_once = True
        """Whether no step has been taken yet."""
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

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        self._restore()
        if self.signal is not None and (kind is None or issubclass(kind, Exception)):
            raise KeyboardInterrupt from error

    def _record(self, number: int, _: object) -> None:
        self.signal = signal.Signals(number)
        self._restore()
        if self.at_once:
            raise KeyboardInterrupt

    def _restore(self) -> None:
        while self.handlers:
            signal.signal(*self.handlers.popitem())


class TrainingLog:
    """Writes JSON lines, TensorBoard scalars and lines on the terminal."""

    def __init__(self, lines: TextIO, board: SummaryWriter, run: TrainingRun, deadline: float = float("inf")) -> None:
        self.lines, self.board, self.run = lines, board, run
        self.deadline = deadline
        """Time (`time.monotonic`) at which the training has to end."""
        self.steps, self.told, self.start = 0, False, (0.0, 0.0)
        self._begin()

    @classmethod
    @contextlib.contextmanager
    def opened(cls, folder: Path, run: TrainingRun, deadline: float = float("inf")) -> Iterator[TrainingLog]:
        """Continue the log of a folder."""
        with (folder / "log.jsonl").open("a") as lines, SummaryWriter(str(folder)) as board:
            yield cls(lines, board, run, deadline)

    def add(self, loss: Tensor) -> None:
        """Collect a loss; write a line now and then, and after some seconds what the training will reach."""
        self.losses.append(loss)
        self.steps += 1
        if self.steps == 1:
            self.start = (time.monotonic(), self.run.share())
        waited = time.monotonic() - (self.time if self.told else self.start[0])
        if not self.told and self.steps >= PACE_STEPS and waited > FIRST_SECONDS:
            self.told = True
            given = self.deadline - time.monotonic()
            self.note("pace", expected_end(self.run, self.steps - 1, waited, self.run.share() - self.start[1], given))
            self.flush()
        elif waited > LOG_SECONDS:
            self.flush()

    def flush(self) -> None:
        """Write what was collected: mean loss, pairs a second of `clock`, arithmetic achieved."""
        if not self.losses:
            return
        loss = torch.stack(self.losses).mean().item()
        seconds, operations = self.run.seconds - self.seconds, (self.run.operations or 0.0) - self.operations
        rate = len(self.losses) * self.run.config.batch / seconds
        figures = {"loss": loss, "pairs_per_s": rate, "tflops": operations / seconds / 1e12}
        figures["learning_rate"] = self.run.optimizers[0].param_groups[0]["lr"]
        self._begin()
        self.write("training", figures)

    def _begin(self) -> None:
        self.losses: list[Tensor] = []
        self.time, self.seconds, self.operations = time.monotonic(), self.run.seconds, self.run.operations or 0.0

    def write(self, kind: str, figures: dict[str, float]) -> None:
        """Write one line of figures."""
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
        say(f"{kind} {pairs:,} pairs: {text}", error=True)


def expected_end(run: TrainingRun, steps: int, seconds: float, share: float, given: float = float("inf")) -> str:
    """Say how fast a training is and when it ends, from some steps.

    Args:
        steps: number of them.
        seconds: wall-clock time that they took.
        share: of the whole training that they did.
        given: seconds after which the training has to end.
    """
    hourly = steps * run.config.batch / seconds * 3600.0
    whole = (1.0 - run.share()) / share * seconds if share > 0 else float("inf")
    left = min(whole, given)
    end = datetime.now() + timedelta(seconds=left) if left < LONGEST_LEFT else None
    when = f"{end:%Y-%m-%d %H:%M}" if end else "in more than a year"
    if given < whole:
        when += f" with the time given, at {run.share() + share / seconds * given:.0%} of the training"
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
