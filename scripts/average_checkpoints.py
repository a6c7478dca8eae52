"""Average the networks of several checkpoints or files of `mimesh export`, the first of which gives all else.

python scripts/average_checkpoints.py runs/a/last.safetensors runs/b/last.safetensors -o average.safetensors
python scripts/average_checkpoints.py A B C --shares 0.35 0.35 0.3 -o average.safetensors
mimesh export average.safetensors -o mime.onnx
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

from mimesh.core.errors import InputError
from mimesh.learn import checkpoint
from mimesh.learn.checkpoint import Checkpoint
from mimesh.learn.config import config_differences
from mimesh.learn.export import load_start


def main() -> None:
    """Read the checkpoints and write their average."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoints", type=Path, nargs="+")
    parser.add_argument("--shares", type=float, nargs="+", help="share of each; equal ones unless given")
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args()
    shares = args.shares or [1.0] * len(args.checkpoints)
    if len(shares) != len(args.checkpoints):
        parser.error(f"--shares: expected {len(args.checkpoints)}, one for each checkpoint, found {len(shares)}")
    averaged = average([load_start(path)[1] for path in args.checkpoints], shares)
    args.output.parent.mkdir(parents=True, exist_ok=True)
    checkpoint.save(args.output, averaged)
    print(f"{args.output}: average of {len(shares)} checkpoints; next: mimesh export {args.output} -o NAME.onnx")


def average(checkpoints: Sequence[Checkpoint], shares: Sequence[float]) -> Checkpoint:
    """Average the networks of trainings that began with one another, in proportion to `shares`.

    What they learned in different ways cancels less than their errors do (Wortsman et al. 2022, "Model soups" and
    "Robust fine-tuning"). Everything else is that of the first; the result has no optimizer state.
    """
    first, weights = checkpoints[0], [each.weights() for each in checkpoints]
    for number, other in enumerate(checkpoints, start=1):
        if other.config.model != first.config.model:
            differing = config_differences(other.config, first.config, ("network", "model"))
            raise InputError(
                f"average: expected checkpoints of one network, found another in number {number} than in number 1 "
                f"({differing}); leave out those that differ"
            )
    total = sum(shares)
    tensors = {
        f"model.{name}": sum(share / total * w[name] for share, w in zip(shares, weights, strict=True))
        for name in weights[0]
    }
    averaged = [
        {"share": round(share / total, 4), **each.spent()} for share, each in zip(shares, checkpoints, strict=True)
    ]
    change = {"after_pairs": first.spent()["pairs"], "averaged": averaged}
    return dataclasses.replace(first, tensors=tensors, metrics={}, changes=(*first.changes, change))


if __name__ == "__main__":
    main()
