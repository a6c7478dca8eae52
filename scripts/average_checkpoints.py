"""Average the networks of several checkpoints or files of `mimesh export`, the first of which gives all else.

python scripts/average_checkpoints.py runs/a/last.safetensors runs/b/last.safetensors -o average.safetensors
python scripts/average_checkpoints.py A B C --shares 0.35 0.35 0.3 -o average.safetensors
mimesh export average.safetensors -o mime.onnx
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mimesh.learn import checkpoint
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
    average = checkpoint.average([load_start(path)[1] for path in args.checkpoints], shares)
    args.output.parent.mkdir(parents=True, exist_ok=True)
    checkpoint.save(args.output, average)
    print(f"{args.output}: average of {len(shares)} checkpoints; next: mimesh export {args.output} -o NAME.onnx")


if __name__ == "__main__":
    main()
