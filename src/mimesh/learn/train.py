"""The training loop: random pairs in, checkpoints out, the best of them by validation; resumable at any moment."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from ..core.errors import InputError
from . import checkpoint
from .character_surfaces import TrainingCharacters
from .config import changed_config, config_differences, load_config
from .cost import activation_bytes, operations_of, training_operations
from .optimizers import make_optimizers
from .precision import DTYPES, choose_precision
from .processes import Processes, joined_processes
from .stop_request import StopRequest
from .tasks.base import BatchSource, Task, TrainConfig, UserData
from .tasks.find import NETWORKS, find_task
from .training_log import TrainingLog
from .user_data import Folders, ProgressBar, read_user_data, refuse_other_data
from .validation import Validation

SCHEDULE = ("seed", "pairs", "minutes", "decay", "learning_rate", "accumulate")
MIXTURE = ("vertices", "characters", "contacts", "low_poly", "scans", "between")
RESUMABLE = (*SCHEDULE, *(f"data.{key}" for key in MIXTURE))
"""Keys that may change where a training is resumed: schedule and mixture of the data, not the network. Two trainings
that go on from one checkpoint with two seeds see other batches and can be averaged."""
CHARACTER_SHARE = 0.5
"""Share of every batch that characters of a folder have, unless the configuration says otherwise."""
SAVE_SECONDS = 60.0
"""Wall-clock time between checkpoints."""


@contextlib.contextmanager
def no_bar(title: str) -> Iterator[None]:
    """Show no progress."""
    yield None


def train_command(
    model: str,
    config: str,
    out: Path | None,
    resume: Path | None,
    max_minutes: float | None,
    changes: Sequence[str] = (),
    weights: Path | None = None,
    characters: Path | None = None,
    clips: Path | None = None,
    leave_out: Sequence[str] = (),
    bar: ProgressBar = no_bar,
    meshes: Path | None = None,
    pattern: str = "",
) -> Path:
    """Do what `mimesh train` does, and give the folder with checkpoints and logs.

    Args:
        changes: "key=value" on top of the configuration, such as "seed=1" or "model.blocks=conv".
        weights: checkpoint whose network a new training begins with.
        characters: folder of characters to train on, where the configuration asks for them.
        clips: folder of motions whose poses mime is trained on.
        leave_out: packs of the folder of characters that are not used.
        bar: makes a progress bar with a title.
        meshes: folder of registered meshes or clips to train on instead of the shipped body.
        pattern: how its files are named (`mesh_layouts`); empty: found.
    """
    if model not in NETWORKS:
        raise InputError(f"{model}: expected a model that can be trained ({', '.join(NETWORKS)}), found another")
    folders = Folders(characters, clips, meshes, pattern)
    with joined_processes() as processes:
        if resume is not None:
            fixed = [f"--set {change}" for change in changes if change.partition("=")[0] not in RESUMABLE]
            fixed += [f"--weights {weights}"] * bool(weights) + [f"--leave-out {pack}" for pack in leave_out]
            fixed += [f"--pattern {pattern}"] * bool(pattern)
            if fixed:
                raise InputError(
                    f"{fixed[0]}: expected no changes with --resume but --set {', '.join(RESUMABLE)} and --clips, "
                    "found some; leave them out"
                )
            settings, folder = resumed_config(resume, changes), resume
        else:
            settings, folder = new_config(model, config, out, changes, folders, leave_out)
        pool = read_user_data(settings, folders, bar)
        if weights is not None:
            processes.largest(0.0)  # all have seen that the folder is empty before the first one writes there
            processes.of_first(lambda: begin_with(settings, weights, folder, pool))
        return train(settings, folder, max_minutes, pool, processes)


def new_config(
    model: str, config: str, out: Path | None, changes: Sequence[str], folders: Folders, leave_out: Sequence[str]
) -> tuple[TrainConfig, Path]:
    """Read the configuration of a new training, and name its folder.

    Raises:
        InputError: the folder holds a training.
    """
    settings = load_config(config, model, [*folders.settings(), *changes])
    share = [f"data.characters={CHARACTER_SHARE}"] if folders.characters and not settings.data.characters else []
    packs = [f"data.leave_out={json.dumps(list(leave_out))}"] if leave_out else []
    settings = load_config(config, model, [*folders.settings(), *changes, *share, *packs])
    words = [*(change.partition("=")[2] for change in changes), *(f"without-{pack}" for pack in leave_out)]
    words += ["meshes"] if folders.meshes else []
    folder = out or Path("runs") / "-".join([model, Path(config).stem, *words])
    if (folder / "last.safetensors").exists():
        raise InputError(
            f"{folder}: expected a folder without a training, found one; continue it with --resume {folder}"
        )
    return settings, folder


def resumed_config(folder: Path, changes: Sequence[str]) -> TrainConfig:
    """Read the configuration of the training in a folder, and change keys of RESUMABLE.

    Raises:
        InputError: no training in the folder, or a value that does not belong.
    """
    last = folder / "last.safetensors"
    if not last.exists():
        raise InputError(f"{folder}: expected last.safetensors of an earlier training in it, found none")
    config = checkpoint.load(last).config
    return changed_config(config, changes) if changes else config


def begin_with(config: TrainConfig, weights: Path, folder: Path, pool: UserData | None = None) -> None:
    """Write the first checkpoint of a training whose network is that of another checkpoint; all else is new.

    Raises:
        InputError: the checkpoint holds another network.
    """
    model, trained = checkpoint.load_model(weights)
    if trained.config.model != config.model:
        raise InputError(
            f"{weights}: expected the network of the configuration, found another "
            f"({config_differences(config, trained.config, ('network', 'model'))}); change model.*"
        )
    folder.mkdir(parents=True, exist_ok=True)
    run = TrainingRun.start(config, folder, pool)
    run.model.load_state_dict(model.state_dict())
    run.ema = {name: value.detach().clone() for name, value in model.state_dict().items()} if config.ema else {}
    counted = {
        "operations": operations_of(trained.config, int(trained.spent()["pairs"]))
    }  # older checkpoints do not say
    run.before = (*trained.before, counted | trained.spent())
    run.save(folder / "last.safetensors")


def train(
    config: TrainConfig,
    folder: Path,
    max_minutes: float | None = None,
    pool: UserData | None = None,
    processes: Processes | None = None,
) -> Path:
    """Train to the end of the schedule, or until a time limit or a signal; continue the training in the folder if any.

    A checkpoint is written every minute, before every validation and at the end. At least one step is taken.

    Args:
        max_minutes: wall-clock time, counted from this call.
        pool: what the user brings, where the configuration asks for it.
        processes: those that share the training; None: this one alone, or those that `torchrun` started.

    Raises:
        InputError: the user's data are not those of the training so far, or the batch cannot be divided.
        KeyboardInterrupt: after the checkpoint, where SIGINT or SIGTERM ended the training.
    """
    if processes is None:
        with joined_processes() as processes:
            return train(config, folder, max_minutes, pool, processes)
    folder.mkdir(parents=True, exist_ok=True)
    with StopRequest(max_minutes) as stop:
        run = TrainingRun.start(config, folder, pool, processes)
        validation = Validation(run.task)
        with TrainingLog.opened(folder, run) as log:
            log.note("precision", run.reason, precision=run.task.precision)
            log.note("cost", run.cost())
            if pool:
                log.note(pool.part, pool.described())
            if run.changes:
                log.note("changes", json.dumps(run.changes[-1]))
            run_to_end(run, validation, folder, log, stop)
            if stop():
                rest = "; the validation that was due is left to it" if run.validation_due() else ""
                log.note("stopped", f"{stop.reason()}; --resume {folder} continues{rest}{run.unfinished()}")
    return folder


def run_to_end(run: TrainingRun, validation: Validation, folder: Path, log: TrainingLog, stop: StopRequest) -> None:
    """Take steps, validate and save until the schedule ends or `stop` says so in one of the processes."""
    last, first = folder / "last.safetensors", run.step
    while True:
        stopped, killed, run.seconds = run.processes.largest(stop(), stop.signal is not None, run.seconds)
        if stopped and (run.step > first or killed or run.share() >= 1.0):
            break
        if run.validation_due():
            log.flush()
            run.save(last)
            if figures := run.validate(validation, folder, stop):
                log.write("validation", figures)
        elif run.share() >= 1.0:
            break
        else:
            log.add(run.advance())
            if time.monotonic() - run.saved > SAVE_SECONDS:
                run.save(last)
    log.flush()
    run.save(last)


@dataclass
class TrainingRun:
    """The state of a running training."""

    config: TrainConfig
    task: Task
    model: nn.Module
    step_model: nn.Module
    """The model, or its compiled form; both share weights."""
    ema: dict[str, Tensor]
    """Moving average of the weights by name; empty if none is kept."""
    optimizers: list[torch.optim.Optimizer]
    source: BatchSource
    processes: Processes
    reason: str
    """Why `task.precision` was chosen, in words."""
    step: int = 0
    seconds: float = 0.0
    """Spent in steps, by `clock`."""
    best: float = float("inf")
    """Lowest validation figure so far."""
    saved: float = 0.0
    """Time of the last checkpoint (`time.monotonic`)."""
    metrics: dict[str, float] | None = None
    """Validation figures of the current weights; None once they have changed."""
    validated: int = 0
    """Step of the last validation."""
    before: tuple[dict[str, int | float], ...] = ()
    """Trainings whose network this one began with."""
    changes: tuple[dict[str, Any], ...] = ()
    """What was changed where the training was resumed, as in `Checkpoint`."""
    operations: float = 0.0
    """Floating-point operations so far, without those of the optimizer."""
    samples: int = 0
    """Parts of batches so far, over all processes: their number may change where a training is resumed."""

    @classmethod
    def start(
        cls,
        config: TrainConfig,
        folder: Path,
        pool: UserData | None = None,
        processes: Processes | None = None,
    ) -> TrainingRun:
        """Set up a new training, or the one whose checkpoint lies in the folder."""
        processes = processes or Processes(0, 1, torch.device("cuda" if torch.cuda.is_available() else "cpu"))
        device = processes.device
        parts = config.accumulate * processes.count
        if config.batch % parts:
            raise InputError(
                f"batch: expected a multiple of {parts} (accumulate x processes), found {config.batch}; change one"
            )
        last = folder / "last.safetensors"
        state = checkpoint.load(last) if last.exists() else None
        before = state.precision if state else ""
        precision, reason = processes.of_first(lambda: choose_precision(config.precision, device, before))
        torch.manual_seed(config.seed)
        task = find_task(config.network)(config, device, precision, pool)
        model = task.make_model().to(device)
        ema = {k: v.detach().clone() for k, v in model.state_dict().items()} if config.ema else {}
        optimizers = make_optimizers(model, config, device, DTYPES[precision])
        source = task.source(config.seed)
        step_model: Any = torch.compile(model) if config.compile else model
        if state:
            refuse_other_data(pool, {"characters": state.characters, "meshes": state.meshes}, folder)
        run = cls(config, task, model, step_model, ema, optimizers, source, processes, reason, saved=time.monotonic())
        if state:
            checkpoint.unpack(state, model, ema, optimizers)
            run.step, run.seconds, run.best, run.before = state.step, state.seconds, state.best, state.before
            run.metrics = state.metrics or None
            run.validated = state.step if state.validated is None else state.validated
            run.changes = (*state.changes, *changes_at_resume(state, config, pool))
            run.samples = state.step * state.config.accumulate if state.samples is None else state.samples
            spent = state.operations  # not in checkpoints of earlier versions
            run.operations = operations_of(state.config, state.step * config.batch) if spent is None else spent
        return run

    def clock(self) -> float:
        """Give the seconds that this process spent on all cores; with a GPU those of the wall clock.

        Other processes lengthen them by little: a training between busy ones does a tenth less in its time.
        """
        return time.process_time() if self.processes.device.type == "cpu" else time.perf_counter()

    def cost(self) -> str:
        """Say what the training takes: arithmetic of a step and of the whole, and memory."""
        config, weights = self.config, sum(parameter.numel() for parameter in self.model.parameters())
        step, part = (
            training_operations(self.task, self.model, config.batch),
            config.batch // config.accumulate // self.processes.count,
        )
        kept = activation_bytes(self.task, self.model, self.source) * part
        whole = f", {step * config.pairs / config.batch / 1e15:.3g} PFLOP in all" if not config.minutes else ""
        return (
            f"{weights / 1e6:.3g} M weights; a step of {config.batch} pairs is {step / 1e12:.3g} TFLOP{whole}; "
            f"a part of {part} pairs keeps {kept / 2**30:.3g} GiB for its gradient"
        )

    def share(self) -> float:
        """Give how much of the training is done: 0 at the start, 1 at its end."""
        if self.config.minutes:
            return self.seconds / (60.0 * self.config.minutes)
        return self.step * self.config.batch / self.config.pairs

    def unfinished(self) -> str:
        """Say what a training that ends so early lacks: its learning rate has not risen, or has not fallen."""
        pairs, share = self.step * self.config.batch, self.share()
        advice = "for a short training set minutes (its length), warmup (pairs) and validate_every with --set"
        if pairs < self.config.warmup:
            return f"; after {pairs:,} of {self.config.warmup:,} pairs the learning rate was still rising: {advice}"
        if self.config.decay and share < 1.0 - self.config.decay:
            return f"; after {share:.0%} of its length the learning rate had not begun to fall: {advice}"
        return ""

    def validation_due(self) -> bool:
        """Tell whether the steps since the last validation passed a multiple of `validate_every` pairs, or the end."""
        if self.share() >= 1.0:
            return not self.metrics
        now, before = (step * self.config.batch // self.config.validate_every for step in (self.step, self.validated))
        return now > before

    def advance(self) -> Tensor:
        """Take one optimizer step and give this process's mean loss, which stays on the device.

        The batch has `accumulate` parts in each process. Parts are the generator's next samples, in this order: which
        process computes one makes no difference. Random numbers of a loss are those of the sample, too.
        """
        started = self.clock()
        config, processes = self.config, self.processes
        parts = config.accumulate * processes.count
        for optimizer in self.optimizers:
            for group in optimizer.param_groups:
                group["lr"] = config.learning_rate * schedule(config, self.step * config.batch, self.share())
            optimizer.zero_grad(set_to_none=True)
        losses = []
        for part in range(processes.rank, parts, processes.count):
            sample = self.samples + part
            batch = self.source.batch(config.batch // parts, sample)
            loss = self.task.loss(self.step_model, batch, sample)
            (loss / config.accumulate).backward()
            losses.append(loss.detach())
        processes.average_gradients(self.model)
        if config.clip:
            nn.utils.clip_grad_norm_(self.model.parameters(), config.clip)
        for optimizer in self.optimizers:
            optimizer.step()
        if self.ema:
            current = self.model.state_dict()
            for name, average in self.ema.items():
                average.lerp_(current[name], 1.0 - config.ema)
        self.step += 1
        self.samples += parts
        self.operations += training_operations(self.task, self.model, config.batch)
        self.metrics = None
        self.seconds += self.clock() - started
        return torch.stack(losses).mean()

    def validate(
        self, validation: Validation, folder: Path, stop: Callable[[], bool] = lambda: False
    ) -> dict[str, float] | None:
        """Measure on `val`, and keep the checkpoint if it is the best so far; None if `stop` ended the measurement."""
        current = {k: v.clone() for k, v in self.model.state_dict().items()}
        if self.ema:
            self.model.load_state_dict(self.ema)
        metrics = self.processes.of_first(lambda: validation.measure(self.model, stop))
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
        """Write a checkpoint, in the first process alone."""
        self.saved = time.monotonic()
        if not self.processes.first:
            return
        tensors = checkpoint.pack(self.model, self.ema, self.optimizers)
        position = (self.step, self.seconds, self.best, self.metrics or {}, tensors, self.before, self.validated)
        brought = {self.task.brought.part: self.task.brought.facts} if self.task.brought else {}
        rest = {"changes": self.changes, "operations": self.operations, "samples": self.samples, **brought}
        state = checkpoint.Checkpoint(self.config, *position, self.task.precision, **rest)
        checkpoint.save(path, state)


def changes_at_resume(state: checkpoint.Checkpoint, config: TrainConfig, pool: UserData | None) -> list[dict[str, Any]]:
    """List what a resumed training changes: nothing, or one entry of `Checkpoint.changes`."""
    values = {key: (attrgetter(key)(config), attrgetter(key)(state.config)) for key in RESUMABLE}
    changed: dict[str, Any] = {key: new for key, (new, old) in values.items() if new != old}
    was = {key: old for key, (new, old) in values.items() if new != old}
    if isinstance(pool, TrainingCharacters) and pool.clips and "clips" not in state.characters:
        changed["clips"] = pool.clips.facts["makers"]
    return [{"after_pairs": state.step * config.batch, **changed, "was": was}] if changed else []


def schedule(config: TrainConfig, pairs: int, share: float) -> float:
    """Give the factor on the learning rate after so many pairs, a `share` of all: rise, constant, steps, fall."""
    rise = min(1.0, (pairs + config.batch) / config.warmup) if config.warmup else 1.0
    fall = min(1.0, max(0.0, 1.0 - share) / config.decay) if config.decay else 1.0
    return rise * fall * 0.1 ** sum(share >= milestone for milestone in config.milestones)
