"""The commands `mimesh train` and `mimesh export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..core.options import TrainingFiles
from ..core.printable import say
from .options import with_options
from .terminal import Json, print_json, print_next, progress, require


@with_options
def train(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="What to train: mime, npt or aniformer.")],
    config: Annotated[
        str, typer.Option(help="small, table, gpu or paper, if MODEL has it, or the path of a YAML file.")
    ] = "small",
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Folder for checkpoints and logs.")] = None,
    resume: Annotated[Path | None, typer.Option(help="Folder of a training to continue exactly.")] = None,
    max_minutes: Annotated[float | None, typer.Option(help="Stop after so long, ready to be resumed.", min=0)] = None,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Change the configuration: seed=1, model.blocks=conv."),
    ] = None,
    weights: Annotated[
        Path | None,
        typer.Option(help="Checkpoint or exported .onnx whose network a new training begins with.", metavar="FILE"),
    ] = None,
    *,
    brought: TrainingFiles,
    json: Json = False,
) -> None:
    """Train a network on data made as it goes, or on your own.

    Needs the [train] extra; uses CUDA where there is one. Ctrl-C and SIGTERM save first; --resume continues exactly.
    """
    require("train", "torch", "yaml", "safetensors", "tensorboard")
    with progress("starting", json):  # PyTorch takes seconds to load
        from ..learn.start import train_command

    folder = train_command(
        model, config, output, resume, max_minutes, change or [], weights, brought, lambda title: progress(title, json)
    )
    last, best = folder / "last.safetensors", folder / "best.safetensors"
    validated = best.exists()  # not where the time was over before the first validation
    if json:
        print_json({"output": str(folder), "last": str(last), "best": str(best) if validated else None})
    else:
        say(f"{folder}: {'best.safetensors, ' if validated else ''}last.safetensors, log.jsonl")
        print_next("export", best if validated else last, "-o", f"{folder.name}.onnx")


def export(
    checkpoint: Annotated[Path, typer.Argument(metavar="CHECKPOINT", help="A .safetensors file of `mimesh train`.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The .onnx file to write.")],
    bits: Annotated[int, typer.Option(help="Bits a weight is stored in: 16 or 8.")] = 16,
    json: Json = False,
) -> None:
    """Turn a checkpoint into an .onnx file that -m takes.

    Needs the [train] extra; writes a card (.json) beside it.
    """
    require("train", "torch", "onnx", "onnxscript")
    with progress("exporting", json):
        from ..learn.export import export_command, test_set

        card = export_command(checkpoint, output, bits)
    if json:
        print_json({"output": str(output), "checkpoint": str(checkpoint), "bytes": output.stat().st_size})
    else:
        say(f"{output}: {output.stat().st_size / 2**20:.1f} MiB")
        say(f"{output.with_suffix('.json')}: its card")
        print_next("evaluate", test_set(card), "-m", f"{output},copy")
