"""Turn weights that NPT's public code (jiashunwang/Neural-Pose-Transfer) saved into an .onnx file that `-m` takes.

The public code saves the tensors of a network by name. Those of NPT and of its max-pool variant have the same names and
shapes. Nothing of that code is used here, and nothing of a file is run: it is read with `weights_only`, which refuses
every pickle that holds more than tensors. Weights of AniFormer are not published.

    python scripts/import_npt_weights.py original_169.model -o authors.onnx [--maxpool] [--bits 32]
"""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import sys
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from mimesh.core.errors import InputError
from mimesh.core.printable import listed
from mimesh.io.atomic import together
from mimesh.learn.export import FULL_BITS, STORED_BITS, check_output, save_card, save_network
from mimesh.learn.npt import NPT, NPTConfig, NPTTask
from mimesh.methods.npt import METRES

WRAPPERS = ("model_state_dict", "state_dict")
"""Keys under which training scripts keep the network beside their optimizer."""
PARALLEL = "module."
"""Put before every name by `torch.nn.DataParallel`, which training scripts use on several GPUs."""
SHOWN = 3
"""Names of tensors that an error lists."""
UNITS = {"first": ("spadain1", "conv1"), "second": ("spadain2", "conv2"), "shortcut": ("spadain_res", "conv_res")}
"""Unit of our ResBlock -> published names of its SPAdaIN and convolution."""


def main() -> None:
    """Write the network and its card."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("weights", type=Path, help="Weights that NPT's public code saved: .model, .pt.")
    parser.add_argument("-o", "--output", type=Path, required=True, help="The .onnx file to write.")
    parser.add_argument("--maxpool", action="store_true", help="They are of NPT's max-pool variant.")
    parser.add_argument("--bits", type=int, default=FULL_BITS, help="Bits a weight is stored in: 32, 16 or 8.")
    args = parser.parse_args()
    check_output(args.output, args.bits, (FULL_BITS, *STORED_BITS))
    model = load_published(args.weights, args.maxpool)
    config = dataclasses.asdict(model.config)
    facts = NPTTask.onnx_facts(model) | {"target_scale": METRES, "config": config}
    checksum = hashlib.sha256(args.weights.read_bytes()).hexdigest()
    kind = "npt-maxpool" if args.maxpool else "npt"
    card = {
        "name": args.output.stem,
        "file": args.output.name,
        "license": "that of the imported file",
        "imported": {"kind": kind, "file": args.weights.name, "sha256": checksum},
        "config": {"network": "npt", "model": config},
        "parameters": sum(p.numel() for p in model.parameters()),
        "bits": args.bits,
    }
    with together():
        save_network(NPTTask.onnx_interface(model), facts, args.output, args.bits)
        save_card(card, args.output)
    print(f"{args.output}: {kind}, {card['parameters']:,} numbers")


def load_published(path: Path, maxpool: bool = False) -> NPT:
    """Load a published network into our layout.

    Raises:
        InputError: the file is none of tensors by name, or has not exactly the tensors of NPT in their shapes.
    """
    state = _read_tensors(path)
    names = published_names()
    model = NPT(published_config(maxpool))
    own = {name: tuple(tensor.shape) for name, tensor in model.state_dict().items()}
    tensors: dict[str, Tensor] = {}
    for name, tensor in state.items():
        ours = names.get(name.removeprefix(PARALLEL), name)
        # Published kernels have length 1.
        tensors[ours] = tensor[..., 0] if tuple(tensor.shape) == (*own.get(ours, ()), 1) else tensor
    theirs = {ours: name for name, ours in names.items()}
    faults = {
        "none of the name": [theirs.get(name, name) for name in own if name not in tensors],
        "others": [name for name in tensors if name not in own],
        "another shape of": [
            theirs.get(name, name) for name, shape in own.items() if name in tensors and tensors[name].shape != shape
        ],
    }
    if any(faults.values()):
        found = "; ".join(f"{what} {listed(wrong, SHOWN)}" for what, wrong in faults.items() if wrong)
        raise InputError(f"{path}: expected the tensors of NPT's public code, found {found}; give a file that it saved")
    model.load_state_dict(tensors)
    return model.eval()


def _read_tensors(path: Path) -> dict[str, Tensor]:
    """Read the tensors of a network by name, and nothing else."""
    hint = "give what torch.save(model.state_dict(), ...) has written, not the whole module"
    try:
        loaded: Any = torch.load(path, map_location="cpu", weights_only=True)
    except OSError as error:
        raise InputError(
            f"{path}: expected a file that can be read, found '{error.strerror}'; check the path"
        ) from error
    except Exception as error:  # of pickles, archives and versions: PyTorch has no class for them
        raise InputError(f"{path}: expected tensors by name, found a file of something else; {hint}") from error
    state = next((loaded[key] for key in WRAPPERS if key in loaded), loaded) if isinstance(loaded, dict) else loaded
    if not isinstance(state, dict) or not state:
        raise InputError(f"{path}: expected tensors by name, found {type(state).__name__}; {hint}")
    for name, value in state.items():
        if not isinstance(value, Tensor) or not value.is_floating_point():
            found = value.dtype if isinstance(value, Tensor) else type(value).__name__
            raise InputError(f"{path}: expected a tensor of floats as {name}, found {found}; {hint}")
    return state


def published_config(maxpool: bool = False) -> NPTConfig:
    """Give the options of the published NPT, or of its max-pool variant."""
    pose_code = "global_max" if maxpool else "per_vertex"
    return NPTConfig(order="norm-relu-conv", output="2tanh", pose_code=pose_code, unnormalised="block")


def published_names() -> dict[str, str]:
    """Give our name of each published tensor."""
    parts = {f"encoder.conv{i + 1}": f"encoder.{i}" for i in range(3)}
    parts |= {f"decoder.conv{i + 1}": f"convs.{i}" for i in range(3)} | {"decoder.conv4": "head"}
    for i in range(3):
        block, ours = f"decoder.spadain_block{i + 1}", f"blocks.{i}"
        for unit, (spadain, conv) in UNITS.items():
            parts[f"{block}.{spadain}.conv_weight"] = f"{ours}.{unit}.norm.scale"
            parts[f"{block}.{spadain}.conv_bias"] = f"{ours}.{unit}.norm.shift"
            parts[f"{block}.{conv}"] = f"{ours}.{unit}.conv"
    return {f"{name}.{end}": f"{ours}.{end}" for name, ours in parts.items() for end in ("weight", "bias")}


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
