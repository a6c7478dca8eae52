"""The training loop: random pairs in, checkpoints out, the best of them by validation; resumable at any moment."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..core.errors import InputError, did_you_mean
from . import checkpoint
from .config import changed_config, config_differences, load_config
from .cost import operations_of
from .exported_weights import load_start
from .processes import Processes, joined_processes
from .stop_request import StopRequest
from .tasks.base import TrainConfig, UserData
from .tasks.find import NETWORKS
from .training_log import TrainingLog
from .training_run import RESUMABLE, TrainingRun
from .user_data import Folders, ProgressBar, read_user_data
from .validation import Validation

CHARACTER_SHARE = 0.5
"""Share of every batch that characters of a folder have, unless the configuration says otherwise."""
SAVE_SECONDS = 60.0
"""Wall-clock time between checkpoints."""
FULL_RATE = "full-rate.safetensors"
"""Checkpoint of the last step before the learning rate falls. A longer training goes on from there (`--weights`): a
rate that has fallen to zero and rises again undoes more than a short training brings back (docs/LOG.md)."""


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
        weights: checkpoint, or `.onnx` file with its card, whose network a new training begins with.
        characters: folder of characters to train on, where the configuration asks for them.
        clips: folder of motions whose poses mime is trained on.
        leave_out: packs of the folder of characters that are not used.
        bar: makes a progress bar with a title.
        meshes: folder of registered meshes or clips to train on instead of the shipped body.
        pattern: how its files are named (`mesh_layouts`); empty: found.
    """
    if model not in NETWORKS:
        raise InputError(
            f"{model}: expected a model that can be trained ({', '.join(NETWORKS)}), found another"
            + did_you_mean(model, NETWORKS)
        )
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
    """Write the first checkpoint of a training whose network is that of another, from a checkpoint or `.onnx` file.

    All else is new.

    Raises:
        InputError: the checkpoint holds another network.
    """
    model, trained = load_start(weights)
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
    last, first, falling = folder / "last.safetensors", run.step, run.rate_falls()
    while True:
        stopped, killed, run.seconds = run.processes.largest(stop(), stop.signal is not None, run.seconds)
        if stopped and (run.step > first or killed or run.share() >= 1.0):
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
            if time.monotonic() - run.saved > SAVE_SECONDS:
                run.save(last)
    log.flush()
    run.save(last)
