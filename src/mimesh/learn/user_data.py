"""What the user brings to a training: rigged characters, clips of motions, or registered meshes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..bodies import load_body
from ..core.errors import InputError
from ..core.frame_buffer import Progress
from .character_surfaces import TrainingCharacters
from .registered_meshes import RegisteredMeshes
from .tasks.base import TrainConfig, UserData, shipped_body
from .training_clips import TrainingClips

ProgressBar = Callable[[str], AbstractContextManager[Progress | None]]
"""Makes a progress bar with a title."""


@dataclass(frozen=True)
class Folders:
    """The folders that the options of `mimesh train` name."""

    characters: Path | None = None
    clips: Path | None = None
    meshes: Path | None = None
    pattern: str = ""
    """How the files of `meshes` are named."""

    def settings(self) -> list[str]:
        """Give the changes of a configuration that a folder of meshes stands for.

        Raises:
            InputError: a pattern without that folder.
        """
        if self.meshes is None:
            if self.pattern:
                raise InputError(
                    f"--pattern {self.pattern}: expected it with --meshes, found it without; name the folder"
                )
            return []
        pattern = [f"data.pattern={self.pattern}"] if self.pattern else []
        return ["data.kind=meshes", "data.between=0", "data.recombine=0", "data.mix_people=0", *pattern]


def read_user_data(config: TrainConfig, folders: Folders, bar: ProgressBar) -> UserData | None:
    """Read the data that a configuration asks for; None for none.

    Raises:
        InputError: a folder is needed and not given, or given and not needed, or it has nothing to train on.
    """
    if config.data.kind == "meshes" and folders.meshes is None:
        raise InputError(
            "--meshes: expected the folder of meshes that this training is on, found none; add --meshes FOLDER"
        )
    if config.data.kind != "meshes" and folders.meshes is not None:
        raise InputError(
            f"--meshes {folders.meshes}: expected a training of npt or aniformer on meshes, found one on "
            f"{config.data.kind}; leave it out"
        )
    if folders.meshes is None:
        return read_characters(config, folders, bar)
    if folders.characters or folders.clips:
        raise InputError("--meshes: expected it without --characters and --clips, found both; leave one out")
    frames = config.model.frames if config.network == "aniformer" else 1
    with bar("reading meshes") as progress:
        return RegisteredMeshes.read(folders.meshes, config.data, frames, progress)


def read_characters(config: TrainConfig, folders: Folders, bar: ProgressBar) -> TrainingCharacters | None:
    """Read the characters that a configuration asks for, and the clips of a folder; None for neither.

    Raises:
        InputError: a folder is needed and not given, or given and not needed, or it has nothing to train on.
    """
    folder, clips = folders.characters, folders.clips
    if clips is not None and (config.network, config.data.kind) != ("mime", "wide"):
        raise InputError(f"--clips: expected mime and data.kind wide, found {config.network}; leave it out")
    if config.data.leave_out and folder is None:
        raise InputError(f"--leave-out {config.data.leave_out[0]}: expected it with --characters, found it without")
    if bool(config.data.characters) != (folder is not None):
        needed, given = ("a folder", "none") if folder is None else ("none", str(folder))
        raise InputError(
            f"--characters: expected {needed} with data.characters {config.data.characters:g}, found {given}; "
            "it is the share of the training that characters of a folder have"
        )
    if folder is None and clips is None:
        return None
    body = load_body(config.data.body)
    found = TrainingCharacters.none(body)
    if folder is not None:
        with bar("reading characters") as progress:
            data = config.data
            found = TrainingCharacters.read(
                folder, body, leave_out=data.leave_out, low_poly=data.low_poly > 0, progress=progress
            )
    if clips is not None:
        with bar("reading clips") as progress:
            found = found.with_clips(TrainingClips.read(clips, body, progress))
    return found


def refuse_other_data(brought: UserData | None, recorded: dict[str, dict[str, Any]], folder: Path) -> None:
    """Check that a training goes on with the data that it had so far.

    Args:
        recorded: facts of a checkpoint by the part that they belong to, `characters` and `meshes`.
        folder: of the training.

    Raises:
        InputError: other data, or none.
    """
    brought = brought or TrainingCharacters.none(shipped_body())
    facts = recorded[brought.part]
    if brought.continues(facts):
        return
    if isinstance(brought, RegisteredMeshes):
        what, names = "meshes", [f"{facts['layout']}, {facts['meshes']:,} of {facts['people']} people"]
    else:
        what = "characters and clips" if "clips" in facts else "characters"
        names = [maker for part in (facts, facts.get("clips", {})) for maker in part.get("makers", ())]
    raise InputError(
        f"{folder}: expected the {what} of the training so far ({', '.join(names)}), found others; "
        f"begin a new training with --weights {folder / 'last.safetensors'}"
    )
