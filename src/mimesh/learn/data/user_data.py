"""What the user brings to a training: rigged characters, clips of motions, or registered meshes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from ...bodies import load_body
from ...core.errors import InputError
from ...core.frame_buffer import Progress
from ...core.options import TrainingFiles
from ..task import DataConfig, TrainConfig, UserData
from .characters import CharacterOptions, TrainingCharacters
from .clips import TrainingClips
from .registered import MeshOptions, RegisteredMeshes

ProgressBar = Callable[[str], AbstractContextManager[Progress | None]]
"""Makes a progress bar with a title."""


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


def refuse_other_data(brought: UserData | None, recorded: dict[str, dict[str, Any]], folder: Path) -> None:
    """Check that the training in a folder goes on with the data that it had so far.

    Args:
        recorded: facts of a checkpoint by the part that they belong to, `characters` and `meshes`.
    """
    for part, facts in recorded.items():
        if not facts or (brought and brought.part == part and brought.continues(facts)):
            continue
        what = "characters and clips" if "clips" in facts else part
        names = [maker for whose in (facts, facts.get("clips", {})) for maker in whose.get("makers", ())]
        if part == RegisteredMeshes.part:
            names = [f"{facts['layout']}, {facts['meshes']:,} of {facts['people']} people"]
        raise InputError(
            f"{folder}: expected the {what} of the training so far ({', '.join(names)}), found others; "
            f"begin a new training with --weights {folder / 'last.safetensors'}"
        )
