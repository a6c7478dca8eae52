"""Networks run by PyTorch give what onnxruntime gives."""

import dataclasses
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from trainings import TINY, losses
from zoo import grid

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.evaluate.run import evaluate_command
from mimesh.learn import torch_session
from mimesh.learn.config import config_from
from mimesh.learn.export import export_command
from mimesh.learn.loop import TrainingRun
from mimesh.learn.npt import NPTConfig
from mimesh.learn.torch_session import in_torch
from mimesh.methods import find_method

ANIFORMER = {
    "network": "aniformer",
    "model": {"encoder": [16, 16, 32], "layers": [32, 32, 16, 16], "attention": "frames"},
    "data": {"kind": "clips80", "vertices": 16},
    "batch": 2,
    "precision": "fp32",
}
CONFIGS = {
    "npt": dataclasses.replace(TINY, model=NPTConfig((16, 32, 32), (35, 16, 16)), precision="fp32"),
    "aniformer": config_from(ANIFORMER, "test"),
}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A function that trains a network for two steps, exports it and returns the file: once for each network."""

    @cache
    def export(network):
        folder = tmp_path_factory.mktemp(network)
        run = TrainingRun.start(CONFIGS[network], folder / "none")
        losses(run, 2)
        run.save(folder / "last.safetensors")
        export_command(folder / "last.safetensors", folder / "net.onnx", 16)
        return folder / "net.onnx"

    return export


@pytest.mark.slow
@pytest.mark.parametrize(("precision", "tolerance"), [("fp32", 1e-5), ("bf16", 0.1)])
@pytest.mark.parametrize("network", CONFIGS)
def test_results_are_those_of_onnxruntime(network, precision, tolerance, exported, tmp_path, monkeypatch):
    monkeypatch.setattr(torch_session, "choose_precision", lambda *_: (precision, ""))
    # Networks are kept by their path.
    path = Path(shutil.copytree(exported(network).parent, tmp_path / "copy")) / "net.onnx"
    mesh = grid(6)
    frames = mesh.vertices + np.random.default_rng(0).normal(0.0, 0.1, (4, *mesh.vertices.shape))
    method = find_method(str(path))
    results = [
        np.stack(list(each.prepare(mesh, Clip(mesh, frames, 24.0))(iter(frames))))
        for each in (method, in_torch(method, path))
    ]
    difference = np.abs(results[0] - results[1]).max()
    assert difference < tolerance * np.ptp(results[0])
    assert (difference > 1e-4) == (precision == "bf16")


def test_a_report_says_what_ran_the_network(exported):
    path = exported("npt")
    report = evaluate_command("human-npt", [str(path)], split="val", pairs=1, runtime=in_torch, runtime_name="a name")
    assert report["provenance"]["config"]["runtime"] == "a name"
    assert report["results"][0]["pmd_e4"] == pytest.approx(
        evaluate_command("human-npt", [str(path)], split="val", pairs=1)["results"][0]["pmd_e4"], rel=0.02
    )


def test_other_networks_and_test_sets_are_refused():
    with pytest.raises(InputError, match="expected networks of npt and aniformer, found mime"):
        evaluate_command("human-npt", ["mime"], split="val", pairs=1, runtime=in_torch)
    with pytest.raises(InputError, match="expected a test set of meshes or clips, found fingers"):
        evaluate_command("fingers", ["mime"], runtime=in_torch)
