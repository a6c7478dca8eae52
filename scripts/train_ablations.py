"""Train the networks of the papers' tables. Those of one table have the same training time, people and motions.

    python scripts/train_ablations.py -o runs/ablations [--minutes 20] [ROW ...]

The command can be interrupted and repeated: finished trainings are kept, others are continued. Each training ends with
`<folder>/<row>.onnx` and its card; those measured in docs/results are in `ablations/`. Two of these are not trained
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


class Ablation(NamedTuple):
    """A network of a table."""

    network: str
    changes: tuple[str, ...] = ()
    """Settings that differ from its configuration `table`."""


ON_CLIPS = ("data.kind=clips80", "data.vertices=128", "batch=32")
"""NPT on AniFormer's data: frames of its motions as pairs, with as many vertices."""
ROWS = {
    "npt-equal": Ablation("npt"),
    "npt-no-edge": Ablation("npt", ("edge=off",)),
    "npt-no-spadain": Ablation("npt", ("model.blocks=resblock",)),
    "npt-concat1": Ablation("npt", ("model.blocks=conv",)),
    "npt-maxpool-equal": Ablation("npt", ("model.pose_code=global_max",)),
    "aniformer-equal": Ablation("aniformer"),
    "aniformer-motion": Ablation("aniformer", ("losses.appearance=off",)),
    "aniformer-appearance": Ablation("aniformer", ("losses.motion=off",)),
    "aniformer-plain": Ablation("aniformer", ("losses.motion=off", "losses.appearance=off")),
    "aniformer-regression": Ablation(
        "aniformer", ("model.head=regression", "losses.motion=off", "losses.appearance=off")
    ),
    "npt-frames": Ablation("npt", ON_CLIPS),
    "npt-maxpool-frames": Ablation("npt", ("model.pose_code=global_max", *ON_CLIPS)),
    "limp": Ablation("limp"),
}
"""Name of a row -> its network."""


def main() -> None:
    """Train the given rows, or all rows in turn."""
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
        # The last weights, not the best ones: every row has the same training time and the same learning rate schedule.
        export_command(last, args.output / f"{row}.onnx", args.bits)


if __name__ == "__main__":
    main()
