"""Train the networks that stand in the papers' tables: the recipe of every row, so that each can be made again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from ..core.errors import InputError
from ..evaluate.tables import find_table, methods_in
from ..methods.find import REDUCED_MODELS, check_weights
from . import checkpoint
from .config import config_differences, load_config
from .export import export_command
from .loop import train
from .task import TrainConfig

BITS = 8
"""Bits that a weight of these networks is stored in."""


class TrainedRow(NamedTuple):
    """How a network of a table is trained."""

    network: str
    changes: tuple[str, ...] = ()
    """Settings that differ from its configuration."""
    config: str = "table"
    equal_time: bool = True
    """Whether it is trained as long as the other rows, so that they can be compared."""
    long: bool = False
    """Whether it takes hours, or is for a GPU (`config` gpu): trained only where that is asked for."""


ON_CLIPS = (
    *("model.encoder=[64,128,384]", "model.decoder=[387,256,128]", "data.kind=clips80"),
    *("weight_decay=0", "warmup=2000", "decay=0.4"),
)
"""NPT on AniFormer's data: frames of its motions as pairs, as many vertices; three eighths of the paper's width."""
ORDERED = "data.pairing=order"
"""One vertex order for all meshes, as in the public code."""
ORDERED_CLIPS = ("data.kind=clips80", ORDERED, "data.reflect=0")
"""NPT on AniFormer's data, all meshes in one order."""
MIXED = ("data.mix_people=0.8", "data.recombine=0.5")
"""More than 16 people and their poses: mixtures of the people, and limbs of other poses or motions."""
VANILLA = ("model.head=regression", "losses.motion=off", "losses.appearance=off")
"""AniFormer's Table 1 begins with a head for one frame, trained without the two constraints."""
ROWS = {
    "npt-equal": TrainedRow("npt"),
    "npt-no-edge": TrainedRow("npt", ("edge=off",)),
    "npt-no-spadain": TrainedRow("npt", ("model.blocks=resblock",)),
    "npt-concat1": TrainedRow("npt", ("model.blocks=conv",)),
    "npt-maxpool-equal": TrainedRow("npt", ("model.pose_code=global_max",)),
    "aniformer-equal": TrainedRow("aniformer"),
    "aniformer-motion": TrainedRow("aniformer", ("losses.appearance=off",)),
    "aniformer-appearance": TrainedRow("aniformer", ("losses.motion=off",)),
    "aniformer-plain": TrainedRow("aniformer", ("losses.motion=off", "losses.appearance=off")),
    "aniformer-regression": TrainedRow("aniformer", VANILLA),
    "aniformer-ordered-equal": TrainedRow("aniformer", (ORDERED,)),
    "aniformer-ordered-motion": TrainedRow("aniformer", ("losses.appearance=off", ORDERED)),
    "aniformer-ordered-appearance": TrainedRow("aniformer", ("losses.motion=off", ORDERED)),
    "aniformer-ordered-plain": TrainedRow("aniformer", ("losses.motion=off", "losses.appearance=off", ORDERED)),
    "aniformer-ordered-vanilla": TrainedRow("aniformer", (*VANILLA, ORDERED)),
    "aniformer-ordered-attention-vertices": TrainedRow("aniformer", ("model.attention=vertices", ORDERED)),
    "aniformer-ordered-vertices": TrainedRow("aniformer", ("model.vertices=6890", ORDERED)),
    "npt-ordered-equal": TrainedRow("npt", (*ON_CLIPS, ORDERED)),
    "npt-maxpool-ordered-equal": TrainedRow("npt", ("model.pose_code=global_max", *ON_CLIPS, ORDERED)),
    "npt-frames": TrainedRow("npt", ON_CLIPS),
    "npt-maxpool-frames": TrainedRow("npt", ("model.pose_code=global_max", *ON_CLIPS)),
    "npt-full": TrainedRow("npt", config="gpu", equal_time=False, long=True),
    "npt-full-mixed": TrainedRow("npt", MIXED, config="gpu", equal_time=False, long=True),
    "npt-ordered": TrainedRow("npt", ORDERED_CLIPS, config="gpu", equal_time=False, long=True),
    "npt-ordered-mixed": TrainedRow("npt", (*ORDERED_CLIPS, *MIXED), config="gpu", equal_time=False, long=True),
    "aniformer-ordered": TrainedRow("aniformer", config="gpu", equal_time=False, long=True),
    "aniformer-ordered-mixed": TrainedRow("aniformer", MIXED, config="gpu", equal_time=False, long=True),
    "mime-table": TrainedRow("mime", equal_time=False),
}
"""Name of a row's network -> how it is trained."""


def row_config(row: str, seed: int, minutes: float) -> TrainConfig:
    """Load the configuration of a row.

    Args:
        minutes: training time of rows that are compared at equal time (CPU minutes of one core, or of a GPU).
    """
    recipe = ROWS[row]
    time = (f"minutes={minutes}",) if recipe.equal_time else ()
    return load_config(recipe.config, recipe.network, (*time, *recipe.changes, f"seed={seed}"))


def rows_of(table: str, long: bool, without: Sequence[str] = ()) -> list[str]:
    """List the networks of a table that can be trained.

    Args:
        long: whether those that take hours or a GPU are among them.
        without: methods whose rows are left out.
    """
    methods = [REDUCED_MODELS.get(row.method, row.method) for row in find_table(table, without).rows]
    return list(dict.fromkeys(name for name in methods if name in ROWS and (long or not ROWS[name].long)))


def train_table(
    table: str,
    folder: Path,
    minutes: float,
    seeds: int = 1,
    long: bool = False,
    say: Callable[[str], None] = print,
    without: Sequence[str] = (),
) -> dict[str, list[str]]:
    """Train the networks of a table with the seeds 0, 1 ...; give the methods to measure for each row (`methods_in`).

    Args:
        folder: gets a folder `seed0`, `seed1` ... for each seed.
        say: told what is trained before each network, and how long all take.
        without: methods whose rows are left out: they are not trained and need no weights.

    Raises:
        InputError: no such table or row, no time, a row that is not trained and has no weights, or a folder with
            trainings of another configuration.
    """
    if not 0 < minutes < float("inf"):  # 0 in a configuration means that its number of pairs counts: days
        raise InputError(f"--minutes: expected a positive number, found {minutes:g}; give another")
    rows = rows_of(table, long, without)
    methods = [row.method for row in find_table(table, without).rows]
    check_weights(*(method for method in methods if REDUCED_MODELS.get(method, method) not in rows))
    folders = [folder / f"seed{seed}" for seed in range(seeds)]
    work = [(row, seed) for seed in range(seeds) for row in rows]
    timed = [row_config(*one, minutes).minutes for one in work]
    untimed = "" if all(timed) else ", and those that end after a number of pairs"
    say(f"{len(work)} trainings: {sum(timed):.0f} CPU minutes{untimed}")
    for number, (row, seed) in enumerate(work, start=1):
        say(f"{number} of {len(work)}: {row}, seed {seed}")
        train_row(row, seed, minutes, folders[seed])
    return methods_in(table, rows, folders)


def train_row(row: str, seed: int, minutes: float, folder: Path) -> None:
    """Train a network of a table to `<folder>/<row>.onnx` with its card.

    What is finished is kept and what was interrupted goes on. The last weights are exported, not the best ones:
    rows that are compared have one training time and one schedule.
    """
    config, run = row_config(row, seed, minutes), folder / row
    last, onnx = run / "last.safetensors", folder / f"{row}.onnx"
    if last.exists() and (found := checkpoint.load(last).config) != config:
        raise InputError(
            f"{run}: expected no training, or one with this configuration, found another "
            f"({config_differences(config, found)}); choose another folder"
        )
    if not (onnx.exists() and onnx.with_suffix(".json").exists()):  # the card is written last
        train(config, run)
        export_command(last, onnx, BITS)
