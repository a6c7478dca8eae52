"""Checkpoint to ONNX (dynamic vertex counts, weights in fewer bits, a card beside it), and back to a network."""

from __future__ import annotations

import dataclasses
import json
import logging
import warnings
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from google.protobuf.message import DecodeError
from torch import Tensor, nn

from ..core.errors import InputError
from ..evaluate.metrics import VERSION
from ..io.atomic import together, whole_file, written
from . import checkpoint
from .checkpoint import Checkpoint
from .config import recorded_config
from .data.characters import CharacterOptions
from .data.endless import PeopleOptions
from .models import find_task
from .task import DataConfig, OnnxInterface

DATA = {
    "table6": "16 people x 400 poses of NPT Table 6",
    "wide": "endless people of the shipped body; rest, Table 6, joint limits, frames of the shipped motions; headings",
    "clips80": "16 people x 80 motions of 30 frames: seconds of the shipped motions, walks and splines",
    "clips": "endless people of the shipped body; windows of the shipped motions at up to 3 times their speed, ways "
    "between poses within the joint limits; headings",
    "meshes": "registered meshes or clips of a folder (`meshes`)",
}
"""Descriptions of `DataConfig.kind` for the card."""
ANIMALS = {
    "wide": "endless animals of the shipped quadruped; at rest, gaits, sitting, lying and eating, everyday poses, "
    "joint limits; headings",
    "clips": "endless animals of the shipped quadruped; windows of gaits and of ways to sit, lie and eat at up to 3 "
    "times their speed, ways between poses within the joint limits; headings",
    "meshes": DATA["meshes"] + " of animals",
}
"""The same where `DataConfig.body` is quadruped."""
RECOMBINED = ", in {share:.0%} of the cases with head, arms and legs each of another of these"
"""What is added to `table6` and `clips80` where poses are recombined."""
MIXED = ", {share:.0%} of the people random mixtures of the 16"
"""What is added to them where people are mixed."""
STORED_BITS = (16, 8)
"""Of a weight, as `mimesh export` writes it."""
FULL_BITS = 32
"""Of a weight as it was trained."""
STORED = ".stored"
"""Behind the name of a weight that is stored in fewer bits."""
ROW_SCALE = ".scale"
"""Behind the name of a matrix stored as int8: its rows' scales."""
INT8_STEPS = 127
"""Steps from zero to the largest number of a row of int8."""
SMALLEST = 256
"""Tensors of fewer numbers are not worth it."""


def export_command(path: Path, out: Path, bits: int = 16) -> dict[str, Any]:
    """Do what `mimesh export` does: write the network and its card (`.json`), and give the card.

    The card holds data, configuration, time, hardware and validation figures; whoever measures adds `metrics.test`.

    Args:
        bits: that each weight is stored in, 16 or 8.
    """
    check_output(out, bits, STORED_BITS)
    model, trained = checkpoint.load_model(path)
    config = trained.config
    data = config.data
    facts = {"target_scale": data.target_scale, "body": data.body, "pairing": data.pairing}
    with together():
        task = find_task(config.network)
        facts = task.onnx_facts(model) | facts | {"config": dataclasses.asdict(config.model)}
        save_network(task.onnx_interface(model), facts, out, bits)
        card = make_card(out, path, trained)
        save_card(card, out)
    return card


def check_output(out: Path, bits: int, allowed: Sequence[int]) -> None:
    """Check where a network is to be written and in how many bits a weight; the first of those allowed is usual."""
    if out.suffix != ".onnx":
        raise InputError(f"{out}: expected an output that ends in .onnx, found {out.suffix or 'none'}; rename it")
    if bits not in allowed:
        named = f"{', '.join(map(str, allowed[:-1]))} or {allowed[-1]}"
        raise InputError(f"--bits: expected {named}, found {bits}; leave it out for {allowed[0]}")


def save_network(interface: OnnxInterface, facts: dict[str, Any], out: Path, bits: int) -> None:
    """Write a network as ONNX, with what `-m` must know of it in the metadata."""
    graph = to_onnx(interface)
    graph = graph if bits == FULL_BITS else compress(graph, bits)
    onnx.helper.set_model_props(graph, {"mimesh": json.dumps(facts)})
    with whole_file(out) as temporary:
        onnx.save(graph, str(temporary))


def save_card(card: dict[str, Any], out: Path) -> None:
    """Write a network's card beside it."""
    with whole_file(out.with_suffix(".json")) as temporary:
        temporary.write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8", newline="\n")


def make_card(out: Path, path: Path, trained: checkpoint.Checkpoint) -> dict[str, Any]:
    """Make the model card: provenance and validation figures of the exported weights."""
    header = checkpoint.read_header(path)
    config = header["config"]
    return {
        "name": out.stem,
        "file": out.name,
        "crc32": zlib.crc32(written(out).read_bytes()),
        "license": "not stated" if trained.config.data.kind == "meshes" else "Apache-2.0",
        "data": described_data(trained.config.data),
        "config": config,
        "seed": config["seed"],
        "commit": header["commit"],
        "hardware": header["hardware"],
        **({"precision": trained.precision} if trained.precision else {}),
        **trained.spent(),
        "pflop": float(f"{trained.operations_spent() / 1e15:.3g}"),
        **({"before": list(trained.before)} if trained.before else {}),
        **({"characters": trained.characters} if trained.characters else {}),
        **({"meshes": trained.meshes} if trained.meshes else {}),
        **({"changes": list(trained.changes)} if trained.changes else {}),
        "metrics": {"version": VERSION, "val": {f"{k}_pmd_e4": round(v, 3) for k, v in trained.metrics.items()}},
    }


def described_data(data: DataConfig) -> str:
    """Say in words what a training had as data."""
    animals = data.body == "quadruped"
    text = data.words.get((data.kind, data.body)) or (ANIMALS if animals else DATA)[data.kind]
    if isinstance(data, PeopleOptions):
        text += RECOMBINED.format(share=data.recombine) if data.recombine else ""
        text += MIXED.format(share=data.mix_people) if data.mix_people else ""
    if isinstance(data, CharacterOptions) and data.characters:
        text += data.words_of_characters.replace("people", "animals") if animals else data.words_of_characters
    return text


def test_set(card: dict[str, Any]) -> str:
    """Give the protocol whose figures belong into a card: clips for networks that are trained on them, else pairs."""
    if card["config"].get("data", {}).get("body") == "quadruped":
        return "quadruped"
    if card["config"].get("data", {}).get("pairing") == "order":
        return "clips-ordered"
    return find_task(card["config"].get("network", "npt")).test_set


def to_onnx(interface: OnnxInterface) -> onnx.ModelProto:
    """Export a network; all inputs and outputs are float32."""
    import onnxscript.optimizer  # loads for a second, which trainings need not wait for

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own deprecations
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # torchvision, which is not needed
        program = torch.onnx.export(
            interface.module.eval(),
            interface.example,
            dynamo=True,
            input_names=list(interface.inputs),
            output_names=list(interface.outputs),
            dynamic_shapes=interface.dynamic,
            verbose=False,
            optimize=False,
        )
        assert program is not None
        # Constants are computed in advance from numbers, not from weights: those keep their names.
        onnxscript.optimizer.optimize(program.model, input_size_limit=2, output_size_limit=64)
    graph = program.model_proto.graph  # without what says from which source files each operation came
    for thing in (graph, *graph.node, *graph.value_info, *graph.input, *graph.output, *graph.initializer):
        del thing.metadata_props[:]
        thing.ClearField("doc_string")
    return program.model_proto


def compress(network: onnx.ModelProto, bits: int = 16) -> onnx.ModelProto:
    """Copy a network with its weights stored in fewer bits; arithmetic stays in float32.

    Args:
        bits: 16 casts to float16; 8 rounds each row of a matrix to int8 with its own scale, and is 16 for the rest.
    """
    network = onnx.ModelProto.FromString(network.SerializeToString())
    nodes = []
    for tensor in list(network.graph.initializer):
        if tensor.data_type != onnx.TensorProto.FLOAT or np.prod(tensor.dims) < SMALLEST:
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
    """Load the network that a training begins with, from a checkpoint or from a file of `mimesh export`."""
    return load_exported(path) if path.suffix == ".onnx" else checkpoint.load_model(path)


def load_exported(path: Path) -> tuple[nn.Module, Checkpoint]:
    """Load an exported network in float32, and from its card how it was trained."""
    card_path = path.with_suffix(".json")
    try:
        card = json.loads(card_path.read_text(encoding="utf-8"))
        config = recorded_config(card["config"], str(card_path))
        pairs, seconds = card["pairs"], float(card["seconds_trained"])
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: expected its card {card_path.name} beside it, found none ({error})") from error
    task = find_task(config.network)(config, torch.device("cpu"))
    model = task.make_model()
    stored = stored_weights(path)
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
        tensors={f"model.{name}": tensor for name, tensor in model.state_dict().items()},
        before=tuple(card.get("before", ())),
        operations=card.get("operations"),
    )
    return model.eval(), trained


def stored_weights(path: Path) -> dict[str, Tensor]:
    """Read the arrays of an exported network in float32, by their names in it."""
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
