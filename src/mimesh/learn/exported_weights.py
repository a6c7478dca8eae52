"""Weights in `.onnx` files of `mimesh export`: stored in fewer bits, and read back as a start for other trainings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnx
import torch
from google.protobuf.message import DecodeError
from torch import Tensor, nn

from ..core.errors import InputError
from . import checkpoint
from .checkpoint import Checkpoint
from .config import config_from
from .onnx_graph import to_onnx
from .tasks.base import Task
from .tasks.find import find_task

STORED = ".stored"
"""Behind the name of a weight that is stored in fewer bits."""
ROW_SCALE = ".scale"
"""Behind the name of a matrix stored as int8: its rows' scales."""
INT8_STEPS = 127
"""Steps from zero to the largest number of a row of int8."""
SMALLEST = 256
"""Tensors of fewer numbers are not worth it."""


def compress(network: onnx.ModelProto, bits: int = 16, smallest: int = SMALLEST) -> onnx.ModelProto:
    """Copy a network with its weights stored in fewer bits; arithmetic stays in float32.

    Args:
        bits: 16 casts to float16; 8 rounds each row of a matrix to int8 with its own scale, and is 16 for the rest.
        smallest: tensors of fewer numbers than these are left alone.
    """
    network = onnx.ModelProto.FromString(network.SerializeToString())
    nodes = []
    for tensor in list(network.graph.initializer):
        if tensor.data_type != onnx.TensorProto.FLOAT or np.prod(tensor.dims) < smallest:
            continue
        name, values = tensor.name, onnx.numpy_helper.to_array(tensor)
        if bits == 8 and values.ndim == 2:
            scale = (np.abs(values).max(axis=1) / INT8_STEPS).clip(1e-12).astype(np.float32)
            stored = np.round(values / scale[:, None]).astype(np.int8)
            network.graph.initializer.append(onnx.numpy_helper.from_array(scale, f"{name}{ROW_SCALE}"))
            inputs = [f"{name}{STORED}", f"{name}{ROW_SCALE}"]
            nodes.append(onnx.helper.make_node("DequantizeLinear", inputs, [name], axis=0))
        else:
            stored = values.astype(np.float16)
            nodes.append(onnx.helper.make_node("Cast", [f"{name}{STORED}"], [name], to=onnx.TensorProto.FLOAT))
        tensor.CopyFrom(onnx.numpy_helper.from_array(stored, f"{name}{STORED}"))
    # Nodes are in the order of execution: the stored weights are unpacked first.
    nodes += network.graph.node
    del network.graph.node[:]
    network.graph.node.extend(nodes)
    return network


def load_start(path: Path) -> tuple[nn.Module, Checkpoint]:
    """Load the network that a training begins with, from a checkpoint or from a file of `mimesh export`.

    Raises:
        InputError: the file is neither, or lacks its card or weights.
    """
    return load_exported(path) if path.suffix == ".onnx" else checkpoint.load_model(path)


def load_exported(path: Path) -> tuple[nn.Module, Checkpoint]:
    """Load an exported network in float32, and from its card how it was trained.

    Raises:
        InputError: not a file of `mimesh export`, no card beside it, or weights that are not found in it.
    """
    card_path = path.with_suffix(".json")
    try:
        card = json.loads(card_path.read_text(encoding="utf-8"))
        config = config_from(card["config"], str(card_path))
        pairs, seconds = card["pairs"], float(card["seconds_trained"])
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: expected its card {card_path.name} beside it, found none ({error})") from error
    task = find_task(config.network)(config, torch.device("cpu"))
    model = task.make_model()
    stored = stored_weights(path)
    if set(model.state_dict()) - set(stored):
        stored |= renamed_weights(stored, task.make_model(), type(task))
    missing = sorted(set(model.state_dict()) - set(stored))
    if missing:
        raise InputError(
            f"{path}: expected all weights of {config.network} by name, found {len(missing)} missing "
            f"({missing[0]} ...); begin with a checkpoint"
        )
    model.load_state_dict({name: stored[name] for name in model.state_dict()})
    trained = Checkpoint(
        config,
        step=pairs // config.batch,
        seconds=seconds,
        best=float("inf"),
        metrics={},
        tensors={f"model.{name}": tensor for name, tensor in model.state_dict().items()},
        before=tuple(card.get("before", ())),
        operations=card.get("operations"),
    )
    return model.eval(), trained


def renamed_weights(stored: dict[str, Tensor], twin: nn.Module, task: type[Task]) -> dict[str, Tensor]:
    """Find the weights that the export transposed and gave numbers for names, as it does for most of mime and hands.

    A network of random weights is exported, too. Where one of its weights comes out, the file has the trained one.

    Args:
        stored: the arrays of the file, by their names in it.
        twin: a network of the same configuration, whose weights are overwritten.

    Returns:
        The trained weights that were found, by their names in the network.
    """
    generator = torch.Generator().manual_seed(0)
    for weight in twin.parameters():
        weight.data.normal_(generator=generator)
    graph = to_onnx(task.onnx_interface(twin)).graph
    names = {onnx.numpy_helper.to_array(tensor).tobytes(): tensor.name for tensor in graph.initializer}
    found = {}
    for name, weight in twin.state_dict().items():
        as_is, turned = (names.get(values.tobytes()) for values in (weight.numpy(), weight.numpy().T.copy()))
        if as_is in stored and stored[as_is].numel() == weight.numel():
            found[name] = stored[as_is].reshape(weight.shape)
        elif turned in stored and stored[turned].shape == weight.shape[::-1]:
            found[name] = stored[turned].mT.contiguous()
    return found


def stored_weights(path: Path) -> dict[str, Tensor]:
    """Read the arrays of an exported network in float32, by their names in it.

    Raises:
        InputError: the file is missing or damaged.
    """
    try:
        stored = {tensor.name: onnx.numpy_helper.to_array(tensor) for tensor in onnx.load(str(path)).graph.initializer}
    except (OSError, DecodeError, ValueError) as error:
        raise InputError(f"{path}: expected a file of `mimesh export`, found none ({error})") from error
    weights = {}
    for name, values in stored.items():
        whole = name.removesuffix(STORED)
        scale = stored.get(f"{whole}{ROW_SCALE}") if values.dtype == np.int8 else None
        weights[whole] = values.astype(np.float32) * (1.0 if scale is None else scale[:, None])
    return {name: torch.from_numpy(np.asarray(values, np.float32)) for name, values in weights.items()}
