"""How a training is started: new, resumed, or with the network of another."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from ..bodies import load_body
from ..core.errors import InputError
from ..core.frame_buffer import Progress
from ..core.options import TrainingFiles
from . import checkpoint
from .config import changed_config, config_differences, load_config, options_of
from .data.characters import CharacterOptions, TrainingCharacters, TrainingClips
from .data.registered import MeshOptions, RegisteredMeshes
from .export import load_start
from .loop import TrainingRun, train
from .models import find_task, operations_of
from .task import DataConfig, TrainConfig, UserData

ProgressBar = Callable[[str], AbstractContextManager[Progress | None]]
"""Makes a progress bar with a title."""
NOTHING = TrainingFiles()
CHARACTER_SHARE = 0.5
"""Share of every batch that characters of a folder have, unless the configuration says otherwise."""


def train_command(
    model: str,
    config: str,
    out: Path | None,
    resume: Path | None,
    max_minutes: float | None,
    changes: Sequence[str] = (),
    weights: Path | None = None,
    brought: TrainingFiles = NOTHING,
    bar: ProgressBar = lambda title: nullcontext(),
) -> Path:
    """Do what `mimesh train` does, and give the folder with checkpoints and logs.

    Args:
        changes: "key=value" on top of the configuration, such as "seed=1" or "model.blocks=conv".
        weights: checkpoint, or `.onnx` file with its card, whose network a new training begins with.
        brought: what the user brings: characters and motions, or registered meshes.
        bar: makes a progress bar with a title.
    """
    find_task(model)  # which refuses unknown ones
    if resume is not None:
        fixed = [f"--weights {weights}"] * bool(weights)
        fixed += [f"--leave-out {pack}" for pack in brought.leave_out or ()]
        fixed += [f"--pattern {brought.pattern}"] * bool(brought.pattern)
        settings, folder = resumed_config(model, resume, changes, fixed), resume
    else:
        settings, folder = new_config(model, config, out, changes, brought)
    user_data = read_user_data(settings, brought, bar)
    if weights is not None:
        begin_with(settings, weights, folder, user_data)
    return train(settings, folder, max_minutes, user_data)


def new_config(
    model: str, config: str, out: Path | None, changes: Sequence[str], brought: TrainingFiles = NOTHING
) -> tuple[TrainConfig, Path]:
    """Read the configuration of a new training, and name its folder, which must hold none."""
    check_files(brought, model, options_of(model))
    settings = load_config(config, model, [*mesh_settings(brought), *changes])
    leave_out = brought.leave_out or []
    more = [f"data.leave_out={json.dumps(leave_out)}"] if leave_out else []
    if brought.characters and isinstance(settings.data, CharacterOptions) and not settings.data.characters:
        more.append(f"data.characters={CHARACTER_SHARE}")
    settings = changed_config(settings, more) if more else settings
    words = [*(change.partition("=")[2] for change in changes), *(f"without-{pack}" for pack in leave_out)]
    words += ["meshes"] if brought.meshes else []
    folder = out or Path("runs") / "-".join([model, Path(config).stem, *words])
    if (folder / "last.safetensors").exists():
        raise InputError(
            f"{folder}: expected a folder without a training, found one; continue it with --resume {folder}"
        )
    return settings, folder


def resumed_config(model: str, folder: Path, changes: Sequence[str], fixed: Sequence[str] = ()) -> TrainConfig:
    """Read the configuration of the training in a folder, and change keys that may change (`checkpoint.resumable`).

    Args:
        fixed: other options that were given, which cannot change.
    """
    last = folder / "last.safetensors"
    if not last.exists():
        raise InputError(f"{folder}: expected last.safetensors of an earlier training in it, found none")
    config = checkpoint.load(last).config
    if config.network != model:
        raise InputError(
            f"{folder}: expected a training of {model}, found one of {config.network}; train {config.network}"
        )
    keys = checkpoint.resumable(config)
    refused = [*(f"--set {change}" for change in changes if change.partition("=")[0] not in keys), *fixed]
    if refused:
        raise InputError(
            f"{refused[0]}: expected no changes with --resume but --set {', '.join(keys)} and --clips, found some; "
            "leave them out"
        )
    return changed_config(config, changes) if changes else config


def begin_with(config: TrainConfig, weights: Path, folder: Path, user_data: UserData | None = None) -> None:
    """Write the first checkpoint of a training whose network is that of another, from a checkpoint or `.onnx` file.

    All else is new.
    """
    model, trained = load_start(weights)
    if trained.config.model != config.model:
        raise InputError(
            f"{weights}: expected the network of the configuration, found another "
            f"({config_differences(config, trained.config, ('network', 'model'))}); change model.*"
        )
    folder.mkdir(parents=True, exist_ok=True)
    run = TrainingRun.start(config, folder, user_data)
    run.model.load_state_dict(model.state_dict())
    run.ema = {name: value.detach().clone() for name, value in model.state_dict().items()} if config.ema else {}
    spent = trained.spent()
    counted = operations_of(trained.config, int(spent["pairs"]))  # older checkpoints do not say
    run.before = (*trained.before, {"operations": counted, **spent})
    run.save(folder / "last.safetensors")


def mesh_settings(brought: TrainingFiles) -> list[str]:
    """Give the changes of a configuration that a folder of meshes stands for."""
    if brought.meshes is None:
        return []
    pattern = [f"data.pattern={brought.pattern}"] if brought.pattern else []
    return ["data.kind=meshes", "data.recombine=0", "data.mix_people=0", *pattern]


def check_files(brought: TrainingFiles, network: str, options: type[DataConfig]) -> None:
    """Check that a model, whose data have some options, takes what is brought, and that it goes together."""
    if brought.pattern and brought.meshes is None:
        raise InputError(f"--pattern {brought.pattern}: expected it with --meshes, found it without; name the folder")
    if brought.meshes is not None and (brought.characters or brought.clips):
        raise InputError("--meshes: expected it without --characters and --clips, found both; leave one out")
    of_characters = issubclass(options, CharacterOptions)
    takes = {
        "meshes": issubclass(options, MeshOptions),
        "characters": of_characters,
        "clips": of_characters and bool(options.clip_kinds),
    }
    for option, taken in takes.items():
        if getattr(brought, option) is not None and not taken:
            raise InputError(f"--{option}: expected a model that is trained on them, found {network}; leave it out")


def read_user_data(config: TrainConfig, brought: TrainingFiles, bar: ProgressBar) -> UserData | None:
    """Read the data that a configuration asks for; None for none.

    Raises:
        InputError: a folder is needed and not given, or given and not needed, or it has nothing to train on.
    """
    data = config.data
    check_files(brought, config.network, type(data))
    if isinstance(data, MeshOptions) and data.kind == "meshes":
        if brought.meshes is None:
            raise InputError(
                "--meshes: expected the folder of meshes that this training is on, found none; add --meshes FOLDER"
            )
        with bar("reading meshes") as progress:
            return RegisteredMeshes.read(brought.meshes, data, config.window, progress)
    if brought.meshes is not None:
        raise InputError(
            f"--meshes {brought.meshes}: expected a training on meshes, found one on {data.kind}; leave it out"
        )
    return read_characters(data, brought, bar) if isinstance(data, CharacterOptions) else None


def read_characters(data: CharacterOptions, brought: TrainingFiles, bar: ProgressBar) -> TrainingCharacters | None:
    """Read the characters that a configuration asks for, and the clips of a folder; None for neither."""
    folder, clips = brought.characters, brought.clips
    if clips is not None and data.kind not in data.clip_kinds:
        raise InputError(f"--clips: expected data.kind {', '.join(data.clip_kinds)}, found {data.kind}; leave it out")
    if data.leave_out and folder is None:
        raise InputError(f"--leave-out {data.leave_out[0]}: expected it with --characters, found it without")
    if bool(data.characters) != (folder is not None):
        needed, given = ("a folder", "none") if folder is None else ("none", str(folder))
        raise InputError(
            f"--characters: expected {needed} with data.characters {data.characters:g}, found {given}; "
            "it is the share of the training that characters of a folder have"
        )
    if folder is None and clips is None:
        return None
    body = load_body(data.body)
    found = TrainingCharacters.none(body)
    if folder is not None:
        with bar("reading characters") as progress:
            found = TrainingCharacters.read(
                folder, body, leave_out=data.leave_out, low_poly=data.with_low_poly, progress=progress
            )
    if clips is not None:
        with bar("reading clips") as progress:
            found = found.with_clips(TrainingClips.read(clips, body, progress))
    return found
