"""Train the learned rows of the papers' tables: in one table one time and the same people and motions for each.

    python scripts/train_ablations.py -o runs/ablations [--minutes 20] [ROW ...]

Rows that are there are continued or left alone, so the command may be stopped and given again. Each ends as
`<folder>/<row>.onnx` with its card beside it; those measured in docs/results lie in `ablations/`. Two of these were not made
here but with `mimesh train`: `npt-table` (npt, configuration `table`, minutes=42) and `mime-table` (mime, `table`).
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

from mimesh.learn import checkpoint
from mimesh.learn.config import load_config
from mimesh.learn.export import export_command
from mimesh.learn.train import train


class Row(NamedTuple):
    """A network, and what is changed in its configuration `table`."""

    network: str
    changes: tuple[str, ...] = ()


ON_CLIPS = ("data.kind=clips80", "data.vertices=128", "batch=32")
"""NPT on AniFormer's data: frames of its motions as pairs, with as many vertices."""
ROWS = {
    "npt-equal": Row("npt"),
    "npt-no-edge": Row("npt", ("edge=off",)),
    "npt-no-spadain": Row("npt", ("model.blocks=resblock",)),
    "npt-concat1": Row("npt", ("model.blocks=conv",)),
    "npt-maxpool-equal": Row("npt", ("model.pose_code=global_max",)),
    "aniformer-equal": Row("aniformer"),
    "aniformer-motion": Row("aniformer", ("losses.appearance=off",)),
    "aniformer-appearance": Row("aniformer", ("losses.motion=off",)),
    "aniformer-plain": Row("aniformer", ("losses.motion=off", "losses.appearance=off")),
    "aniformer-regression": Row("aniformer", ("model.head=regression", "losses.motion=off", "losses.appearance=off")),
    "npt-frames": Row("npt", ON_CLIPS),
    "npt-maxpool-frames": Row("npt", ("model.pose_code=global_max", *ON_CLIPS)),
    "limp": Row("limp"),
}


def main() -> None:
    """Train what was asked for, or all rows in turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="*", choices=[*ROWS, []], metavar="ROW", help=", ".join(ROWS))
    parser.add_argument("-o", "--output", type=Path, default=Path("runs/ablations"))
    parser.add_argument("--minutes", type=float, default=20.0)
    parser.add_argument("--bits", type=int, default=8, help="that a weight is stored in")
    args = parser.parse_args()
    for row in args.rows or ROWS:
        network, changes = ROWS[row]
        config = load_config("table", network, [f"minutes={args.minutes}", *changes])
        folder = args.output / row
        last = folder / "last.safetensors"
        if last.exists() and checkpoint.load(last).config != config:
            parser.error(f"{folder}: holds a training of another configuration; choose another folder with -o")
        train(config, folder)
        # The last weights, not the best ones: every row has had the same time and the same schedule.
        export_command(last, args.output / f"{row}.onnx", args.bits)


if __name__ == "__main__":
    main()
