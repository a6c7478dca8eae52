"""Weights of NPT's public code in our layout; those of AniFormer's are not published.

The public code (jiashunwang/Neural-Pose-Transfer) saves the tensors of a network by name. Those of NPT and of its
max-pool variant have the same names and shapes. Nothing of that code is used here, and nothing of a file is run: it is
read with `weights_only`, which refuses every pickle that holds more than tensors.
"""

from __future__ import annotations

import dataclasses
import hashlib
import pickle
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..core.errors import InputError
from ..io.atomic import together
from ..methods.npt import METRES
from .export import FULL_BITS, STORED_BITS, check_output, save_card, save_network
from .npt import NPT, NPTConfig

WRAPPERS = ("model_state_dict", "state_dict")
"""Keys under which training scripts keep the network beside their optimizer."""
PARALLEL = "module."
"""Put before every name by `torch.nn.DataParallel`, which training scripts use on several GPUs."""
UNITS = {"first": ("spadain1", "conv1"), "second": ("spadain2", "conv2"), "shortcut": ("spadain_res", "conv_res")}
"""Unit of our ResBlock -> published names of its SPAdaIN and convolution."""
BROKEN = (
    *(pickle.UnpicklingError, OSError, EOFError, RuntimeError, ValueError, LookupError, TypeError, AttributeError),
    *(AssertionError, MemoryError, OverflowError, struct.error),
)
"""Raised by PyTorch for files that are damaged or something else, as found by changing random bytes of good ones."""
LISTED = 3
"""Names that a message lists at most."""


@dataclass(frozen=True)
class PublishedNetwork:
    """A published network: ours with the same arithmetic, and how its tensors are called."""

    kind: str
    """`npt` or `npt-maxpool`."""
    model: NPT
    names: dict[str, str]
    """Published name -> ours."""

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Give the shape of every tensor by its published name: kernels have length 1."""
        own = self.model.state_dict()
        shapes = {name: tuple(own[ours].shape) for name, ours in self.names.items()}
        return {name: (*shape, 1) if len(shape) == 2 else shape for name, shape in shapes.items()}


def import_command(path: Path, out: Path, maxpool: bool = False, bits: int = FULL_BITS) -> dict[str, Any]:
    """Do what `mimesh import-checkpoint` does: write the network and its card (`.json`), and give the card.

    Raises:
        InputError: the file is not that of the network, or `out` or `bits` are not possible.
    """
    check_output(out, bits, (FULL_BITS, *STORED_BITS))
    published = load_published(path, maxpool)
    model = published.model
    with path.open("rb") as file:
        checksum = hashlib.file_digest(file, "sha256").hexdigest()
    card = {
        "name": out.stem,
        "file": out.name,
        "license": "that of the imported file",
        "imported": {"kind": published.kind, "file": path.name, "sha256": checksum},
        "config": {"network": "npt", "model": dataclasses.asdict(model.config)},
        "parameters": sum(p.numel() for p in model.parameters()),
        "bits": bits,
    }
    with together():
        save_network(model, "npt", {"target_scale": METRES}, model.config, out, bits)
        save_card(card, out)
    return card


def load_published(path: Path, maxpool: bool = False) -> PublishedNetwork:
    """Load a published network into our layout; every tensor of the file must belong to it, with its shape."""
    state, network = read_state(path), published_npt(maxpool)
    check_state(state, network, path)
    own = network.model.state_dict()
    tensors = {ours: state[name].reshape(own[ours].shape).float() for name, ours in network.names.items()}
    network.model.load_state_dict(tensors, assign=True)  # refuses if one of ours is missing
    network.model.eval()
    return network


def read_state(path: Path) -> dict[str, Tensor]:
    """Read the tensors of a PyTorch file by name, without running anything that it may hold."""
    if not path.is_file():
        raise InputError(f"{path}: expected a PyTorch file of weights (.model, .pt, .pth), found no file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of versions of the format; the error below is enough
            state = torch.load(path, map_location="cpu", weights_only=True)
    except BROKEN:
        raise InputError(
            f"{path}: expected a PyTorch file of tensors alone, found more than tensors or a damaged file; nothing of "
            "it was run; save it again with torch.save(model.state_dict(), FILE)"
        ) from None
    for key in WRAPPERS:
        if isinstance(state, dict) and isinstance(state.get(key), dict):
            state = state[key]
    if not isinstance(state, dict) or not state:
        raise InputError(f"{path}: expected tensors by name, found {type(state).__name__}; save model.state_dict()")
    odd = [name for name, value in state.items() if not (isinstance(name, str) and _is_dense(value))]
    if odd:
        raise InputError(f"{path}: expected tensors of numbers by name, found another value under {odd[0]!r}")
    prefix = PARALLEL if all(name.startswith(PARALLEL) for name in state) else ""
    return {name.removeprefix(prefix): value for name, value in state.items()}


def _is_dense(value: Any) -> bool:
    """Whether a value is an ordinary tensor that lies in memory as often as its shape says, not one number repeated."""
    return isinstance(value, Tensor) and value.layout == torch.strided and value.is_contiguous()


def published_npt(maxpool: bool = False) -> PublishedNetwork:
    """Describe the published NPT, or its max-pool variant, whose weights are of the same names and shapes."""
    config = NPTConfig(
        order="norm-relu-conv",
        output="2tanh",
        pose_code="global_max" if maxpool else "per_vertex",
        unnormalised="block",
    )
    with torch.device("meta"):
        model = NPT(config)
    parts = {f"encoder.conv{i + 1}": f"encoder.{i}" for i in range(3)}
    parts |= {f"decoder.conv{i + 1}": f"convs.{i}" for i in range(3)} | {"decoder.conv4": "head"}
    for i in range(3):
        parts |= block_parts(f"decoder.spadain_block{i + 1}", f"blocks.{i}")
    return PublishedNetwork("npt-maxpool" if maxpool else "npt", model, convolution_names(parts))


def block_parts(published: str, ours: str) -> dict[str, str]:
    """Name the convolutions of a SPAdaIN ResBlock: published -> ours."""
    parts = {}
    for unit, (spadain, conv) in UNITS.items():
        parts[f"{published}.{spadain}.conv_weight"] = f"{ours}.{unit}.norm.scale"
        parts[f"{published}.{spadain}.conv_bias"] = f"{ours}.{unit}.norm.shift"
        parts[f"{published}.{conv}"] = f"{ours}.{unit}.conv"
    return parts


def convolution_names(parts: dict[str, str]) -> dict[str, str]:
    """Name the two tensors of each convolution: published -> ours."""
    return {f"{name}.{end}": f"{ours}.{end}" for name, ours in parts.items() for end in ("weight", "bias")}


def check_state(state: dict[str, Tensor], network: PublishedNetwork, path: Path) -> None:
    """Check that a file has exactly the tensors of a network, in their shapes, with finite numbers."""
    expected = network.shapes()
    missing, further = sorted(set(expected) - set(state)), sorted(set(state) - set(expected))
    if missing or further:
        found = f"{', '.join(missing[:LISTED])} missing" if missing else f"also {', '.join(further[:LISTED])}"
        raise InputError(f"{path}: expected the {len(expected)} tensors of {network.kind}, found {found}")
    for name, shape in expected.items():
        tensor = state[name]
        if tuple(tensor.shape) != shape:
            raise InputError(
                f"{path}: expected {name} of {shape_text(shape)} as {network.kind} has it, "
                f"found {shape_text(tensor.shape)}"
            )
        if not tensor.is_floating_point() or not bool(tensor.isfinite().all()):
            raise InputError(f"{path}: expected finite floating-point numbers in {name}, found others")


def shape_text(shape: tuple[int, ...]) -> str:
    """Write a shape as "1027 x 1027 x 1"."""
    return " x ".join(map(str, shape)) or "one number"
