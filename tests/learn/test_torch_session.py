"""Networks run by PyTorch give what onnxruntime gives."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from zoo import grid

from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip
from mimesh.evaluate.run import evaluate_command
from mimesh.learn import torch_session
from mimesh.learn.torch_session import in_torch
from mimesh.methods import find_model


@pytest.mark.slow
@pytest.mark.parametrize(
    ("network", "precision", "tolerance"),
    [
        ("npt", "fp32", 1e-5),
        ("npt", "bf16", 0.2),  # a maximum over all points decides, so rounding may choose another one
        ("aniformer", "fp32", 1e-5),
        ("aniformer", "bf16", 0.1),
    ],
)
def test_results_are_those_of_onnxruntime(network, precision, tolerance, exported, tmp_path, monkeypatch):
    monkeypatch.setattr(torch_session, "choose_precision", lambda *_: (precision, ""))
    # Networks are kept by their path.
    path = Path(shutil.copytree(exported(network)[2].parent, tmp_path / "copy")) / "net.onnx"
    mesh = grid(6)
    frames = mesh.vertices + np.random.default_rng(0).normal(0.0, 0.1, (4, *mesh.vertices.shape))
    method = find_model(str(path))
    results = [
        np.stack(list(each.prepare(mesh, Clip(mesh, frames, 24.0))(iter(frames))))
        for each in (method, in_torch(method, path))
    ]
    difference = np.abs(results[0] - results[1]).max()
    assert difference < tolerance * np.ptp(results[0])
    assert (difference > 1e-4) == (precision == "bf16")


@pytest.mark.slow
def test_a_report_says_what_ran_the_network(exported):
    path = exported("npt")[2]
    report = evaluate_command("human-npt", [str(path)], split="val", pairs=1, runtime=in_torch, runtime_name="a name")
    assert report["provenance"]["config"]["runtime"] == "a name"
    assert report["results"][0]["pmd_e4"] == pytest.approx(
        evaluate_command("human-npt", [str(path)], split="val", pairs=1)["results"][0]["pmd_e4"], rel=0.02
    )


def test_other_networks_are_refused():
    with pytest.raises(InputError, match="expected networks of npt and aniformer, found mime"):
        evaluate_command("human-npt", ["mime"], split="val", pairs=1, runtime=in_torch)
