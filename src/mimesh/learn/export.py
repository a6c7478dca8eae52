"""Checkpoint to ONNX: dynamic vertex counts, weights stored in half precision, a card beside it."""

from __future__ import annotations

import dataclasses
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from jaxtyping import Float
from torch import Tensor, nn

from ..bodies import RiggedBody, load_body
from ..core.errors import InputError
from ..io.atomic import whole_file
from ..methods.onnx_runtime import import_onnxruntime
from . import checkpoint
from .aniformer import AniFormer, AniFormerConfig
from .limp import LIMPConfig
from .mime import POINTS, Mime, MimeConfig
from .npt import NPTConfig

DATA = {
    "table6": "16 people x 400 poses of NPT Table 6",
    "wide": "endless people of the shipped body; rest, Table 6, joint limits, frames of the shipped motions; headings",
    "clips80": "16 people x 80 motions of 30 frames: seconds of the shipped motions, walks and splines",
    "clips": "endless people of the shipped body; windows of the shipped motions at up to 3 times their speed, ways "
    "between poses within the joint limits; headings",
}
"""Kinds of training data as the card says them."""


def export_command(path: Path, out: Path, bits: int = 16) -> dict[str, Any]:
    """What `mimesh export` does: write the network and its card (`.json`: data, config, time, hardware, metrics).

    Weights are stored in so many bits, 16 or 8. `metrics.test` is left out: those who measure fill it. Gives the card.
    """
    if out.suffix != ".onnx":
        raise InputError(f"{out}: expected an output that ends in .onnx, found {out.suffix or 'none'}; rename it")
    if bits not in (8, 16):
        raise InputError(f"--bits: expected 16 or 8, found {bits}; leave it out for 16")
    model, state = checkpoint.load_model(path)
    network = smaller(to_onnx(model), bits)
    describe(network, model.config, state.config.data.target_scale)
    with whole_file(out) as temporary:
        onnx.save(network, str(temporary))
    facts = card(out, path, state)
    with whole_file(out.with_suffix(".json")) as temporary:
        temporary.write_text(json.dumps(facts, indent=2) + "\n")
    return facts


def to_onnx(model: checkpoint.Network) -> onnx.ModelProto:
    """Export with inputs `identity` and `driving` and output `result`, all float32 and of any vertex count.

    NPT: (B, V, 3) and (B, U, 3) give (B, V, 3). AniFormer: (1, V, 3) and (1, T, V, 3) give (1, T, V, 3), or
    (1, 1, V, 3) with its regression head; one window at a time, so that memory stays small. LIMP: (B, V, 3) and
    (B, U, 3) give the W vertices of its template, (B, W, 3). mime is another matter: see `methods/mime.py`.
    """
    inputs, outputs = ["identity", "driving"], ["result"]
    if isinstance(model, Mime):
        example, shapes = _surface()
        inputs, outputs = ["points", "normals", "vertices", "vertex_normals"], ["rotation", "joints", "scores"]
    else:
        example, shapes = _window(model.config) if isinstance(model, AniFormer) else _pair(model.config)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own deprecations
        program = torch.onnx.export(
            ReadAndWeigh(model).eval() if isinstance(model, Mime) else model.eval(),
            example,
            dynamo=True,
            input_names=inputs,
            output_names=outputs,
            dynamic_shapes=shapes,
            verbose=False,
        )
    assert program is not None
    return without_traces(program.model_proto)


def without_traces(network: onnx.ModelProto) -> onnx.ModelProto:
    """The network without what the exporter says of where in whose files each operation came from."""
    graph = network.graph
    for thing in (graph, *graph.node, *graph.value_info, *graph.input, *graph.output, *graph.initializer):
        del thing.metadata_props[:]
        thing.ClearField("doc_string")
    return network


class ReadAndWeigh(nn.Module):
    """All of mime that looks at one mesh; moving it is left to who runs it."""

    def __init__(self, model: Mime) -> None:
        super().__init__()
        self.model = model

    def forward(self, points: Tensor, normals: Tensor, vertices: Tensor, vertex_normals: Tensor):
        reading = self.model.read(points, normals)
        return reading.rotation, reading.place, self.model.weights(reading, vertices, vertex_normals)


def _surface() -> tuple[tuple[Tensor, ...], tuple[dict, ...]]:
    """Example inputs of mime: as many points as are read, any number of vertices."""
    v = torch.export.Dim("vertices", min=1)
    return (*torch.randn(2, 1, POINTS, 3), *torch.randn(2, 1, 300, 3)), ({}, {}, {1: v}, {1: v})


def _pair(config: NPTConfig | LIMPConfig) -> tuple[tuple[Tensor, Tensor], tuple[dict, dict]]:
    """Example inputs of a network of pairs, and which of their axes may have any length."""
    pooled = isinstance(config, LIMPConfig) or config.pose_code == "global_max"
    batch, v = torch.export.Dim("batch", min=1), torch.export.Dim("vertices", min=2)
    u = torch.export.Dim("driving_vertices", min=2) if pooled else v
    return (torch.randn(2, 300, 3), torch.randn(2, 200 if pooled else 300, 3)), ({0: batch, 1: v}, {0: batch, 1: u})


def _window(config: AniFormerConfig) -> tuple[tuple[Tensor, Tensor], tuple[dict, dict]]:
    """The same of AniFormer."""
    v = torch.export.Dim("vertices", min=2)
    return (torch.randn(1, 300, 3), torch.randn(1, config.frames, 300, 3)), ({1: v}, {2: v})


def smaller(network: onnx.ModelProto, bits: int = 16, smallest: int = 256) -> onnx.ModelProto:
    """A copy that stores its weights in fewer bits; arithmetic stays in float32.

    Args:
        bits: 16 casts float16; 8 scales int8 by a number for each row of a matrix, and is 16 for the rest.
        smallest: fewer numbers than these are left alone.
    """
    network = onnx.ModelProto.FromString(network.SerializeToString())
    nodes = []
    for tensor in list(network.graph.initializer):
        if tensor.data_type != onnx.TensorProto.FLOAT or np.prod(tensor.dims) < smallest:
            continue
        name, values = tensor.name, onnx.numpy_helper.to_array(tensor)
        if bits == 8 and values.ndim == 2:
            scale = (np.abs(values).max(axis=1) / 127).clip(1e-12).astype(np.float32)
            stored = np.round(values / scale[:, None]).astype(np.int8)
            network.graph.initializer.append(onnx.numpy_helper.from_array(scale, f"{name}.scale"))
            inputs = [f"{name}.stored", f"{name}.scale"]
            nodes.append(onnx.helper.make_node("DequantizeLinear", inputs, [name], axis=0))
        else:
            stored = values.astype(np.float16)
            nodes.append(onnx.helper.make_node("Cast", [f"{name}.stored"], [name], to=onnx.TensorProto.FLOAT))
        tensor.CopyFrom(onnx.numpy_helper.from_array(stored, f"{name}.stored"))
    nodes += network.graph.node
    del network.graph.node[:]
    network.graph.node.extend(nodes)
    return network


def skeleton(body: RiggedBody) -> dict[str, Any]:
    """Names and parents of the joints that mime reads, and which make a leg."""
    legs = [[body.joint(side + name) for name in ("UpLeg", "Leg", "Foot")] for side in ("Left", "Right")]
    return {"joints": body.joint_names, "parents": body.parents, "legs": legs}


def describe(
    network: onnx.ModelProto, config: NPTConfig | AniFormerConfig | LIMPConfig | MimeConfig, target_scale: str
) -> None:
    """Write into the file what a runner must know."""
    if isinstance(config, AniFormerConfig):
        facts: dict[str, Any] = {"model": "aniformer", "frames": config.frames, "head": config.head}
    elif isinstance(config, LIMPConfig):
        facts = {"model": "limp", "vertices": config.vertices}
    elif isinstance(config, MimeConfig):
        facts = {"model": "mime", "points": POINTS, **skeleton(load_body())}
    else:
        facts = {"model": "npt", "pose_code": config.pose_code}
    facts |= {"target_scale": target_scale, "config": dataclasses.asdict(config)}
    onnx.helper.set_model_props(network, {"mimesh": json.dumps(facts)})


def card(out: Path, path: Path, state: checkpoint.State) -> dict[str, Any]:
    """The model card: provenance and validation figures of the exported weights."""
    header = checkpoint.read_header(path)
    config = header["config"]
    return {
        "name": out.stem,
        "file": out.name,
        "license": "Apache-2.0",
        "data": DATA[config["data"]["kind"]],
        "config": config,
        "seed": config["seed"],
        "commit": header["commit"],
        "hardware": header["hardware"],
        **state.spent(),
        **({"before": list(state.before)} if state.before else {}),
        "metrics": {"val": {f"{k}_pmd_e4": round(v, 3) for k, v in state.metrics.items()}},
    }


def test_set(facts: dict[str, Any]) -> str:
    """The protocol whose figures belong into a card: clips for networks that are trained on them, else pairs."""
    return "clips-aniformer" if facts["config"].get("network", "npt") in ("aniformer", "limp") else "human-npt"


def infer_onnx(
    network: onnx.ModelProto, identity: Float[np.ndarray, "B V 3"], driving: Float[np.ndarray, "B *T U 3"]
) -> Float[np.ndarray, "B *R V 3"]:
    """Run an exported network once, to compare it with torch."""
    session = import_onnxruntime().InferenceSession(network.SerializeToString(), providers=["CPUExecutionProvider"])
    return np.asarray(session.run(["result"], {"identity": identity, "driving": driving})[0])
