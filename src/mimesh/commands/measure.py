"""The commands `mimesh evaluate`, `mimesh table` and `mimesh generate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..core.errors import InputError
from ..core.options import MeasureOptions
from ..core.printable import say
from .options import with_options
from .terminal import Json, Quiet, print_json, print_next, progress, require, say_tables

PROTOCOLS = (
    "human-npt, human-wide, cross-topology, noise, contact, cross-body, characters, clips-aniformer, "
    "clips-ordered, quadruped or rigs"
)
"""Names of the test sets, written out because importing these takes a second; a test compares them."""
Protocol = Annotated[str, typer.Argument(metavar="PROTOCOL", help=f"{PROTOCOLS}.")]
TestSet = Annotated[
    str,
    typer.Argument(
        metavar="PROTOCOL", help=f"{PROTOCOLS}; or the path of a list of your own files, or of a folder of lists."
    ),
]
Split = Annotated[str, typer.Option(help="test for figures to quote; val to choose by.")]
Pairs = Annotated[int, typer.Option(help="Pairs of each kind; 0 for all the protocol has.", min=0)]
Figures = Annotated[
    Path | None,
    typer.Option("--output", "-o", help="Keep the figures as JSON; stopped, the same command goes on where it was."),
]


@with_options
def evaluate(
    protocol: TestSet,
    model: Annotated[str, typer.Option("--model", "-m", help="Models to compare, with commas between.")] = "mime,copy",
    output: Figures = None,
    split: Split = "test",
    pairs: Pairs = 0,
    *,
    measuring: MeasureOptions,
    torch: Annotated[
        bool,
        typer.Option(
            "--torch",
            help="Run networks of npt and aniformer by PyTorch: on a GPU, or in bf16 on processors made for it.",
        ),
    ] = False,
    dump: Annotated[Path | None, typer.Option(help="Folder for pictures of the worst pairs.", metavar="DIR")] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            help="Folder: rigged characters for cross-body and rigs, a pool of them for characters; "
            "of a list, where its files lie.",
            metavar="DIR",
        ),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure models on a named test set, or on lists of your own files.

    A list has lines of three names: identity, driving, truth. PMD is Eq. 7 of the papers,
    x1e-4, with the truth in the unit sphere about its box.
    """
    from ..evaluate.markdown import markdown
    from ..evaluate.run import evaluate_command

    runtime: tuple = ()
    if torch:
        require("train", "torch", "yaml", "safetensors", "onnx")
        from ..learn.torch_session import in_torch, precision

        runtime = in_torch, f"torch, {precision()}"
    methods = [name.strip() for name in model.split(",") if name.strip()]
    with progress("pairs", quiet or json) as advance:
        figures = evaluate_command(protocol, methods, output, split, pairs, measuring, advance, dump, data, *runtime)
    if json:
        print_json(figures)
    elif not quiet:
        say_tables(markdown(figures))
        say("± is half of the 95 % interval of the mean; columns: docs/conventions.md")


def table(
    name: Annotated[
        str,
        typer.Argument(
            metavar="TABLE", help="npt-1, npt-2, npt-7, aniformer-1 or -2, aniformer-1-random or -2-random."
        ),
    ],
    output: Figures = None,
    pairs: Pairs = 0,
    train: Annotated[bool, typer.Option("--train", help="Train the networks of the rows first.")] = False,
    seeds: Annotated[int, typer.Option(help="Train each row so many times; prints mean and deviation.", min=1)] = 1,
    minutes: Annotated[
        float, typer.Option(help="Training time of rows that are compared, in CPU minutes.", min=0)
    ] = 15,
    long: Annotated[bool, typer.Option("--long", help="Train the rows that take hours or a GPU, too.")] = False,
    networks: Annotated[Path, typer.Option(help="Folder for the networks that are trained.", metavar="DIR")] = Path(
        "runs/tables"
    ),
    without: Annotated[
        list[str] | None,
        typer.Option(metavar="ROW", help="Leave a row out, by its model's name (column `weights`); several times."),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Print a table of a paper with its figures beside ours.

    Measures every row first: give -o to be able to stop and go on. Rows without weights
    here are left out, and a note says how to make them: --train trains those of a table,
    needs the [train] extra and goes on where it was stopped. Two of the papers' full width
    lie in the repository's folder ablations. Rows left out with --without are neither
    trained nor measured.
    """
    from ..evaluate.tables import find_table, rows_without_weights, table_command

    left_out = tuple(without or ())
    find_table(name, left_out)
    rows: list[str] = []
    if train:
        require("train", "torch", "yaml", "safetensors", "tensorboard", "onnx", "onnxscript")
        with progress("starting", quiet or json):  # PyTorch takes seconds to load
            from ..learn.table_rows import rows_of

            rows = rows_of(name, long, left_out)
    elif seeds > 1 or long:
        raise InputError("--seeds, --long: expected them with --train, found them without; add --train")
    missing, note = rows_without_weights(name, rows, left_out)
    if note and not quiet:
        say(f"note: {note}", error=True)
    left_out += missing
    trained = {}
    if train:
        from ..learn.table_rows import train_table

        trained = train_table(name, networks, minutes, seeds, long, lambda text: say(text, error=True), left_out)
    with progress("pairs", quiet or json) as advance:
        figures, text = table_command(name, output, pairs, advance, trained, left_out)
    if json:
        print_json({**figures, "left_out": list(missing)})
    elif not quiet:
        say_tables(text)
        print_next("evaluate", figures["protocol"], "-m", "mime,copy")


def generate(
    protocol: Protocol,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")],
    split: Annotated[
        str, typer.Option(help="test, val, or train (human-npt: 6,400 files, 4 GB; --pairs: poses).")
    ] = "test",
    pairs: Pairs = 0,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder: rigged characters for cross-body, a pool of them for characters.", metavar="DIR"),
    ] = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a test set as files of meshes or clips.

    Files are named id<person>_<pose>.obj (clips: .npz); lists of "identity pose truth"
    stand beside them, which `mimesh evaluate` takes. Files of train that exist are kept.
    """
    from ..evaluate.generate import generate_command

    with progress("meshes", quiet or json) as advance:
        written = generate_command(protocol, output, split, pairs, advance, data)
    if json:
        print_json({"output": str(output), "protocol": protocol, "split": split, **written})
    elif not quiet:
        kept = f", {written['kept']} of them there already" if written.get("kept") else ""
        say(f"{output}: {written['files']} files{kept}")
        print_next(*(("look", output) if split == "train" else ("evaluate", output, "-m", "mime,npt,copy")))
