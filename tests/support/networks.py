"""Writes tiny networks with the inputs, outputs and metadata of the real ones, for tests without trained weights."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np


def write_network(
    path: Path, pose_code: str = "per_vertex", target_scale: str = "identity", metadata: bool = True, **facts: str
) -> Path:
    """Write a tiny NPT: 1x1 convolutions and instance norm of the driving, times a gate, added to the identity.

    `facts` are added to the metadata.
    """
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    rng = np.random.default_rng(0)
    weights = {
        "w1": rng.normal(size=(8, 3, 1)) / 2,
        "w2": rng.normal(size=(3, 8, 1)) / 4,
        "one": np.ones(8),
        "zero": np.zeros(8),
        "gate": rng.normal(size=(3, 3, 1)) / 4,
    }
    node = helper.make_node
    nodes = [
        node("Transpose", ["identity"], ["i"], perm=[0, 2, 1]),
        node("Transpose", ["driving"], ["d"], perm=[0, 2, 1]),
        node("Conv", ["d", "w1"], ["h1"]),
        node("InstanceNormalization", ["h1", "one", "zero"], ["h2"]),
        node("Relu", ["h2"], ["h3"]),
        *([node("GlobalMaxPool", ["h3"], ["h4"])] if pose_code == "global_max" else [node("Identity", ["h3"], ["h4"])]),
        node("Conv", ["h4", "w2"], ["pose"]),
        node("Conv", ["i", "gate"], ["g"]),
        node("Mul", ["pose", "g"], ["step"]),
        node("Add", ["i", "step"], ["r"]),
        node("Transpose", ["r"], ["result"], perm=[0, 2, 1]),
    ]
    points = "V" if pose_code == "per_vertex" else "U"
    value = helper.make_tensor_value_info
    graph = helper.make_graph(
        nodes,
        "tiny",
        [value("identity", TensorProto.FLOAT, ["B", "V", 3]), value("driving", TensorProto.FLOAT, ["B", points, 3])],
        [value("result", TensorProto.FLOAT, ["B", "V", 3])],
        [numpy_helper.from_array(array.astype(np.float32), name) for name, array in weights.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    if metadata:
        card = {"model": "npt", "pose_code": pose_code, "target_scale": target_scale, "config": {}, **facts}
        helper.set_model_props(model, {"mimesh": json.dumps(card)})
    onnx.save(model, str(path))
    return path


def write_sequence_network(
    path: Path, frames: int = 3, head: str = "frames", target_scale: str = "identity", metadata: dict | None = None
) -> Path:
    """Write a tiny AniFormer: frames mixed by fixed weights, then as `write_network`; `metadata` overrides the card."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    rng = np.random.default_rng(0)
    output_frames = 1 if head == "regression" else frames
    weights = {
        "mix": rng.uniform(0.1, 1.0, size=(output_frames, frames)),
        "w1": rng.normal(size=(3, 8)) / 2,
        "w2": rng.normal(size=(8, 3)) / 4,
        "gate": rng.normal(size=(3, 3)) / 4,
    }
    weights["mix"] /= weights["mix"].sum(axis=1, keepdims=True)
    node = helper.make_node
    nodes = [
        node("Transpose", ["driving"], ["d"], perm=[0, 2, 1, 3]),
        node("MatMul", ["mix", "d"], ["mixed"]),
        node("Transpose", ["mixed"], ["m"], perm=[0, 2, 1, 3]),
        node("MatMul", ["m", "w1"], ["h1"]),
        node("Relu", ["h1"], ["h2"]),
        node("MatMul", ["h2", "w2"], ["pose"]),
        node("Unsqueeze", ["identity", "axis"], ["i"]),
        node("MatMul", ["i", "gate"], ["g"]),
        node("Mul", ["pose", "g"], ["step"]),
        node("Add", ["i", "step"], ["result"]),
    ]
    value = helper.make_tensor_value_info
    graph = helper.make_graph(
        nodes,
        "tiny",
        [value("identity", TensorProto.FLOAT, [1, "V", 3]), value("driving", TensorProto.FLOAT, [1, frames, "V", 3])],
        [value("result", TensorProto.FLOAT, [1, output_frames, "V", 3])],
        [numpy_helper.from_array(array.astype(np.float32), name) for name, array in weights.items()]
        + [numpy_helper.from_array(np.array([1]), "axis")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    card = {"model": "aniformer", "frames": frames, "head": head, "target_scale": target_scale, "config": {}}
    card |= metadata or {}
    helper.set_model_props(model, {"mimesh": json.dumps(card)})
    onnx.save(model, str(path))
    return path


def write_mime_network(path: Path, points: int = 64) -> Path:
    """Write a tiny mime network with three joints.

    Two joints rotate by the mean distance of the points from their centroid; the skinning scores depend on x, so the
    left joint moves the left side.
    """
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    identity, cosine, sine = np.zeros((3, 1, 3, 3, 3))
    identity[0, :, 2, 2] = identity[0, 0, 0, 0] = identity[0, 0, 1, 1] = 1
    cosine[0, 1:, 0, 0] = cosine[0, 1:, 1, 1] = 1
    for joint, sign in ((1, 1), (2, -1)):
        sine[0, joint, 0, 1], sine[0, joint, 1, 0] = -sign, sign
    weights = {
        "constant": identity,
        "cosine": cosine,
        "sine": sine,
        "offsets": np.array([[[0, 0, 0], [0.2, 0.4, 0], [-0.2, 0.4, 0]]]),
        "sides": np.array([[0, 9, -9], [0, 2, 2], [0, 0, 0]]),
    }
    node = helper.make_node
    nodes = [
        node("ReduceMean", ["points"], ["centroid"], axes=[1], keepdims=1),
        node("Add", ["centroid", "offsets"], ["joints"]),
        node("Sub", ["points", "centroid"], ["centred"]),
        node("Abs", ["centred"], ["distance"]),
        node("ReduceMean", ["distance"], ["angle"], keepdims=0),
        node("Cos", ["angle"], ["c"]),
        node("Sin", ["angle"], ["s"]),
        node("Mul", ["cosine", "c"], ["turned1"]),
        node("Mul", ["sine", "s"], ["turned2"]),
        node("Add", ["turned1", "turned2"], ["turned"]),
        node("Add", ["turned", "constant"], ["rotation"]),
        node("MatMul", ["vertices", "sides"], ["scores1"]),
        # Normals are inputs of the real network; here they count with a factor of 0 so that the graph uses them.
        node("ReduceSum", ["normals"], ["zero1"], keepdims=0),
        node("ReduceSum", ["vertex_normals"], ["zero2"], keepdims=0),
        node("Mul", ["zero1", "none"], ["zero3"]),
        node("Mul", ["zero2", "none"], ["zero4"]),
        node("Add", ["scores1", "zero3"], ["scores2"]),
        node("Add", ["scores2", "zero4"], ["scores"]),
    ]
    value = helper.make_tensor_value_info
    inputs = {"points": points, "normals": points, "vertices": "V", "vertex_normals": "V"}
    outputs = {"rotation": [1, 3, 3, 3], "joints": [1, 3, 3], "scores": [1, "V", 3]}
    graph = helper.make_graph(
        nodes,
        "tiny",
        [value(name, TensorProto.FLOAT, [1, count, 3]) for name, count in inputs.items()],
        [value(name, TensorProto.FLOAT, shape) for name, shape in outputs.items()],
        [numpy_helper.from_array(np.asarray(array, np.float32), name) for name, array in weights.items()]
        + [numpy_helper.from_array(np.float32(0).reshape(()), "none")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    card = {"model": "mime", "points": points, "joints": ["Hips", "Left", "Right"], "parents": [-1, 0, 0], "config": {}}
    card["legs"] = [[0, 1], [0, 2]]
    helper.set_model_props(model, {"mimesh": json.dumps(card)})
    onnx.save(model, str(path))
    return path
