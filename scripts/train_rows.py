"""Train the learned rows of NPT's Tables 2 and 7: one configuration, one time for each, one change a row.

    python scripts/train_rows.py -o runs/rows [--minutes 20] [ROW ...]

Rows that are there are continued or left alone, so the command may be stopped and given again. Each ends as
`<folder>/<row>.onnx` with its card beside it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mimesh.learn import checkpoint
from mimesh.learn.config import load_config
from mimesh.learn.export import export_command
from mimesh.learn.train import train

ROWS = {
    "npt-equal": [],
    "npt-no-edge": ["edge=off"],
    "npt-no-spadain": ["model.blocks=resblock"],
    "npt-concat1": ["model.blocks=conv"],
    "npt-maxpool-equal": ["model.pose_code=global_max"],
}
"""What makes a row on top of configuration `table`."""


def main() -> None:
    """Train what was asked for, or all rows in turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="*", choices=[*ROWS, []], metavar="ROW", help=", ".join(ROWS))
    parser.add_argument("-o", "--output", type=Path, default=Path("runs/rows"))
    parser.add_argument("--minutes", type=float, default=20.0)
    args = parser.parse_args()
    for row in args.rows or ROWS:
        config = load_config("table", "npt", [f"minutes={args.minutes}", *ROWS[row]])
        folder = args.output / row
        last = folder / "last.safetensors"
        if last.exists() and checkpoint.load(last).config != config:
            parser.error(f"{folder}: holds a training of another configuration; choose another folder with -o")
        train(config, folder)
        # The last weights, not the best ones: every row has had the same time and the same schedule.
        export_command(last, args.output / f"{row}.onnx")


if __name__ == "__main__":
    main()
