"""One step of every configuration on a GPU against the same step on the CPU. Run with `pytest -m gpu`."""

from __future__ import annotations

import dataclasses
from importlib import resources

import pytest
import torch

from mimesh.learn.config import load_config
from mimesh.learn.data.bodies import copied_to
from mimesh.learn.models import find_task
from mimesh.learn.optimizers import make_optimizers

pytestmark = pytest.mark.gpu
CONFIGS = sorted(path.name.removesuffix(".yaml") for path in (resources.files("mimesh.learn") / "configs").iterdir())
PAIRS, VERTICES = 2, 128
TOLERANCE = {"fp32": (1e-4, 5e-4), "bf16": (5e-2, 5e-2)}
"""Relative difference of losses, and of gradients' norms, between devices: products are summed in another order. Edge
terms divide by short lengths, so their gradients differ more (1.1e-4 in float32 on an H100)."""


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
@pytest.mark.parametrize("precision", ["fp32", "bf16"])
@pytest.mark.parametrize("name", CONFIGS)
def test_a_step_on_the_gpu_is_that_on_the_cpu(name: str, precision: str):
    network, _, config_name = name.partition("-")
    config = load_config(config_name, network)
    if network in ("npt", "aniformer"):
        config = dataclasses.replace(config, data=dataclasses.replace(config.data, vertices=VERTICES))
    cpu, cuda = torch.device("cpu"), torch.device("cuda")
    batch = find_task(network)(config, cpu).source(0).batch(PAIRS, 0)
    start = find_task(network)(config, cpu).make_model().state_dict()
    figures = []
    for device in (cpu, cuda):
        task = find_task(network)(config, device, precision)
        model = task.make_model().to(device)
        model.load_state_dict(start)
        dtype = torch.bfloat16 if precision == "bf16" else torch.float32
        optimizers = make_optimizers(model, config, device, dtype)
        torch.manual_seed(0)
        loss = task.loss(model, copied_to(device, batch), 0)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        for optimizer in optimizers:
            optimizer.step()
        assert all(parameter.isfinite().all() for parameter in model.parameters())
        figures.append((float(loss.detach()), float(norm)))
    for on_cpu, on_gpu, tolerance in zip(*figures, TOLERANCE[precision], strict=True):
        assert on_gpu == pytest.approx(on_cpu, rel=tolerance)
