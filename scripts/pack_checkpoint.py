"""Write a checkpoint in half its bytes, to be stored or sent: float16 weights, bfloat16 optimizer state.

python scripts/pack_checkpoint.py runs/npt-full/last.safetensors -o packed/last.safetensors
mimesh train npt --resume packed
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mimesh.learn import checkpoint


def main() -> None:
    """Read one checkpoint and write the other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument(
        "--weights-only",
        action="store_true",
        help="the average, or the weights where there is none, without optimizer state",
    )
    parser.add_argument("--no-average", action="store_true", help="without the average of the weights")
    args = parser.parse_args()
    args.output.parent.mkdir(parents=True, exist_ok=True)
    checkpoint.save_compact(args.checkpoint, args.output, args.weights_only, not args.no_average)
    before, after = (path.stat().st_size / 2**20 for path in (args.checkpoint, args.output))
    print(f"{args.output}: {after:.1f} MiB, {before:.1f} before")


if __name__ == "__main__":
    main()
