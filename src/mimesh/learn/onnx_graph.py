"""The ONNX graph of a network, with dynamic numbers of vertices."""

from __future__ import annotations

import logging
import warnings

import onnx
import onnxscript.optimizer
import torch

from .tasks.base import OnnxInterface


def to_onnx(interface: OnnxInterface) -> onnx.ModelProto:
    """Export a network; all inputs and outputs are float32."""
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
        # Constants are computed in advance from numbers, not from weights: those keep their names (`exported_weights`).
        onnxscript.optimizer.optimize(program.model, input_size_limit=2, output_size_limit=64)
    return without_traces(program.model_proto)


def without_traces(network: onnx.ModelProto) -> onnx.ModelProto:
    """Remove what the exporter writes about the source files that each operation came from."""
    graph = network.graph
    for thing in (graph, *graph.node, *graph.value_info, *graph.input, *graph.output, *graph.initializer):
        del thing.metadata_props[:]
        thing.ClearField("doc_string")
    return network
