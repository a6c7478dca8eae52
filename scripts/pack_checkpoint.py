"""Write a checkpoint in half its bytes, to be stored or sent: float16 weights, bfloat16 optimizer state.

python scripts/pack_checkpoint.py runs/npt-full/last.safetensors -o packed/last.safetensors
mimesh train npt --resume packed
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import save_file

from mimesh.io.atomic import whole_file
from mimesh.learn.checkpoint import load


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
    save_compact(args.checkpoint, args.output, args.weights_only, not args.no_average)
    before, after = (path.stat().st_size / 2**20 for path in (args.checkpoint, args.output))
    print(f"{args.output}: {after:.1f} MiB, {before:.1f} before")


def save_compact(path: Path, out: Path, weights_only: bool = False, average: bool = True) -> None:
    """Copy a checkpoint with weights and their average in float16 and optimizer state in bfloat16: half the bytes.

    Without the `average` a third less; a training that continues begins a new one. With `weights_only`, the
    average alone is kept, or the weights where there is none: a start for another training (`--weights`).

    `load` reads it as any other and a training continues from it, from rounded numbers. Adam's squares of small
    gradients would be zero in float16.
    """
    found = load(path)  # in float32, also where the file is compact already
    with safe_open(path, "pt") as file:
        metadata = file.metadata()
    tensors = {key: value for key, value in found.tensors.items() if average or not key.startswith("ema.")}
    if weights_only:
        tensors = {f"model.{name}": value for name, value in found.weights().items()}
    for key, value in list(tensors.items()):
        if value.dtype != torch.float32 or not value.ndim:
            continue
        tensors[key] = value.to(torch.bfloat16 if key.startswith("optimizer.") else torch.float16)
    with whole_file(out) as temporary:
        save_file(tensors, temporary, metadata=metadata)


if __name__ == "__main__":
    main()
