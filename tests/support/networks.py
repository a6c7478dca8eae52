"""Writes tiny networks with the inputs, outputs and metadata of the real ones, for tests without trained weights."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mimesh.methods.onnx_runtime import import_onnxruntime

Shapes = dict[str, list[int | str]]
"""Name of an input or output -> its shape; names of axes for those of any length."""


def _save(
    path: Path,
    nodes: list[tuple[Any, ...]],
    inputs: Shapes,
    outputs: Shapes,
    weights: dict[str, Any],
    card: dict | None,
) -> Path:
    """Write a network of nodes (kind, "names of inputs", "name of its output", attributes) with a card of metadata."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    infos = [
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in shapes.items()]
        for shapes in (inputs, outputs)
    ]
    arrays = {name: np.asarray(array) for name, array in weights.items()}
    graph = helper.make_graph(
        [
            helper.make_node(kind, names.split(), [output], **(more[0] if more else {}))
            for kind, names, output, *more in nodes
        ],
        "tiny",
        *infos,
        [numpy_helper.from_array(a if a.dtype.kind == "i" else a.astype(np.float32), n) for n, a in arrays.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if card is not None:
        helper.set_model_props(model, {"mimesh": json.dumps(card)})
    onnx.save(model, str(path))
    return path


def infer_onnx(network: Any, identity: np.ndarray, driving: np.ndarray) -> np.ndarray:
    """Run an exported network once."""
    session = import_onnxruntime().InferenceSession(network.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(["result"], {"identity": identity, "driving": driving})[0]


def write_network(
    path: Path,
    pose_code: str = "per_vertex",
    target_scale: str = "identity",
    metadata: bool = True,
    seed: int = 0,
    **facts: str,
) -> Path:
    """Write a tiny NPT: 1x1 convolutions and instance norm of the driving, times a gate, added to the identity.

    `facts` are added to the metadata.
    """
    rng = np.random.default_rng(seed)
    weights = {
        "w1": rng.normal(size=(8, 3, 1)) / 2,
        "w2": rng.normal(size=(3, 8, 1)) / 4,
        "one": np.ones(8),
        "zero": np.zeros(8),
        "gate": rng.normal(size=(3, 3, 1)) / 4,
    }
    nodes = [
        ("Transpose", "identity", "i", {"perm": [0, 2, 1]}),
        ("Transpose", "driving", "d", {"perm": [0, 2, 1]}),
        ("Conv", "d w1", "h1"),
        ("InstanceNormalization", "h1 one zero", "h2"),
        ("Relu", "h2", "h3"),
        ("GlobalMaxPool" if pose_code == "global_max" else "Identity", "h3", "h4"),
        ("Conv", "h4 w2", "pose"),
        ("Conv", "i gate", "g"),
        ("Mul", "pose g", "step"),
        ("Add", "i step", "r"),
        ("Transpose", "r", "result", {"perm": [0, 2, 1]}),
    ]
    inputs = {"identity": ["B", "V", 3], "driving": ["B", "V" if pose_code == "per_vertex" else "U", 3]}
    card = {"model": "npt", "pose_code": pose_code, "target_scale": target_scale, "config": {}, **facts}
    return _save(path, nodes, inputs, {"result": ["B", "V", 3]}, weights, card if metadata else None)


def stand_in(folder: Path) -> Callable[[Any], Any]:
    """Return a function in the place of `to_onnx` that gives a tiny NPT, whose numbers depend on the weights given."""

    def to_onnx(interface: Any) -> Any:
        import onnx

        weights = sum(float(parameter.detach().abs().sum()) for parameter in interface.module.parameters())
        return onnx.load(str(write_network(folder / "stand_in.onnx", metadata=False, seed=int(1e6 * weights))))

    return to_onnx


def write_sequence_network(
    path: Path, frames: int = 3, head: str = "frames", target_scale: str = "identity", metadata: dict | None = None
) -> Path:
    """Write a tiny AniFormer: frames mixed by fixed weights, then as `write_network`; `metadata` overrides the card."""
    rng = np.random.default_rng(0)
    output_frames = 1 if head == "regression" else frames
    weights = {
        "mix": rng.uniform(0.1, 1.0, size=(output_frames, frames)),
        "w1": rng.normal(size=(3, 8)) / 2,
        "w2": rng.normal(size=(8, 3)) / 4,
        "gate": rng.normal(size=(3, 3)) / 4,
        "axis": np.array([1]),
    }
    weights["mix"] /= weights["mix"].sum(axis=1, keepdims=True)
    nodes = [
        ("Transpose", "driving", "d", {"perm": [0, 2, 1, 3]}),
        ("MatMul", "mix d", "mixed"),
        ("Transpose", "mixed", "m", {"perm": [0, 2, 1, 3]}),
        ("MatMul", "m w1", "h1"),
        ("Relu", "h1", "h2"),
        ("MatMul", "h2 w2", "pose"),
        ("Unsqueeze", "identity axis", "i"),
        ("MatMul", "i gate", "g"),
        ("Mul", "pose g", "step"),
        ("Add", "i step", "result"),
    ]
    inputs = {"identity": [1, "V", 3], "driving": [1, frames, "V", 3]}
    card = {"model": "aniformer", "frames": frames, "head": head, "target_scale": target_scale, "config": {}}
    return _save(path, nodes, inputs, {"result": [1, output_frames, "V", 3]}, weights, card | (metadata or {}))


def write_mime_network(path: Path, points: int = 64) -> Path:
    """Write a tiny mime network with three joints.

    Two joints rotate by the mean distance of the points from their centroid; the skinning scores depend on x, so the
    left joint moves the left side.
    """
    identity, cosine, sine = np.zeros((3, 1, 3, 3, 3))
    identity[0, :, 2, 2] = identity[0, 0, 0, 0] = identity[0, 0, 1, 1] = 1
    cosine[0, 1:, 0, 0] = cosine[0, 1:, 1, 1] = 1
    for joint, sign in ((1, 1), (2, -1)):
        sine[0, joint, 0, 1], sine[0, joint, 1, 0] = -sign, sign
    weights = {
        "constant": identity,
        "cosine": cosine,
        "sine": sine,
        "offsets": np.array([[[0.0, 0, 0], [0.2, 0.4, 0], [-0.2, 0.4, 0]]]),
        "sides": np.array([[0.0, 9, -9], [0, 2, 2], [0, 0, 0]]),
        "none": np.zeros(()),
    }
    nodes = [
        ("ReduceMean", "points", "centroid", {"axes": [1], "keepdims": 1}),
        ("Add", "centroid offsets", "joints"),
        ("Sub", "points centroid", "centred"),
        ("Abs", "centred", "distance"),
        ("ReduceMean", "distance", "angle", {"keepdims": 0}),
        ("Cos", "angle", "c"),
        ("Sin", "angle", "s"),
        ("Mul", "cosine c", "turned1"),
        ("Mul", "sine s", "turned2"),
        ("Add", "turned1 turned2", "turned"),
        ("Add", "turned constant", "rotation"),
        ("MatMul", "vertices sides", "scores1"),
        # Normals are inputs of the real network; here they count with a factor of 0 so that the graph uses them.
        ("ReduceSum", "normals", "zero1", {"keepdims": 0}),
        ("ReduceSum", "vertex_normals", "zero2", {"keepdims": 0}),
        ("Mul", "zero1 none", "zero3"),
        ("Mul", "zero2 none", "zero4"),
        ("Add", "scores1 zero3", "scores2"),
        ("Add", "scores2 zero4", "scores"),
    ]
    inputs = {name: [1, points, 3] for name in ("points", "normals")}
    inputs |= {name: [1, "V", 3] for name in ("vertices", "vertex_normals")}
    outputs = {"rotation": [1, 3, 3, 3], "joints": [1, 3, 3], "scores": [1, "V", 3]}
    card = {"model": "mime", "points": points, "joints": ["Hips", "Left", "Right"], "parents": [-1, 0, 0], "config": {}}
    return _save(path, nodes, inputs, outputs, weights, card | {"legs": [[0, 1], [0, 2]]})
