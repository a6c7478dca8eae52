"""Checkpoints: compact copies, averages, and the one that is tracked."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from average_checkpoints import average
from pack_checkpoint import save_compact
from trainings import TINY, losses

from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.core.mesh import Mesh
from mimesh.core.surface_points import SurfacePoints
from mimesh.learn import checkpoint
from mimesh.learn.loop import TrainingRun
from mimesh.learn.mime import MimeNetwork
from mimesh.methods.onnx_runtime import import_onnxruntime

ROOT = Path(__file__).parents[2]
ZOO = ROOT / "src" / "mimesh" / "methods" / "zoo"
CONFIG = dataclasses.replace(TINY, optimizer="muon", precision="fp32")


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A training of three steps and its checkpoint."""
    run = TrainingRun.start(CONFIG, tmp_path_factory.mktemp("none"))
    losses(run, 3)
    path = tmp_path_factory.mktemp("saved") / "last.safetensors"
    run.save(path)
    return run, path


@pytest.mark.slow
def test_a_compact_checkpoint_is_half_as_large_and_continues(saved, tmp_path):
    _, path = saved
    save_compact(path, tmp_path / "last.safetensors")
    whole, compact = (checkpoint.load(where / "last.safetensors") for where in (path.parent, tmp_path))
    size, small = (sum(f.stat().st_size for f in where.glob("last.*")) for where in (path.parent, tmp_path))
    numbers = sum(value.numel() for value in whole.tensors.values() if value.ndim)
    assert size - small > 1.9 * numbers  # two of four bytes each
    assert dataclasses.replace(compact, tensors={}) == dataclasses.replace(whole, tensors={})
    assert checkpoint.read_header(tmp_path / "last.safetensors") == checkpoint.read_header(path)
    for name, value in whole.tensors.items():
        assert compact.tensors[name].dtype == value.dtype
        torch.testing.assert_close(compact.tensors[name], value, rtol=4e-3 if "optimizer" in name else 1e-3, atol=1e-6)
    again, run = TrainingRun.start(CONFIG, tmp_path), TrainingRun.start(CONFIG, path.parent)
    assert again.step == 3
    assert losses(again, 2) == pytest.approx(losses(run, 2), rel=0.05)
    model, _ = checkpoint.load_model(tmp_path / "last.safetensors")
    assert {p.dtype for p in model.parameters()} == {torch.float32}


@pytest.mark.slow
def test_weights_alone_are_a_start_for_another_training(saved, tmp_path):
    _, path = saved
    save_compact(path, tmp_path / "weights.safetensors", weights_only=True)
    alone, whole = (checkpoint.load(file).tensors for file in (tmp_path / "weights.safetensors", path))
    assert set(alone) == {name for name in whole if name.startswith("model.")}
    model, _ = checkpoint.load_model(tmp_path / "weights.safetensors")
    for name, value in model.state_dict().items():
        torch.testing.assert_close(value, whole[f"ema.{name}"], rtol=1e-3, atol=1e-6)


@pytest.mark.slow
def test_a_compact_checkpoint_without_the_average_begins_a_new_one(saved, tmp_path):
    run, path = saved
    save_compact(path, tmp_path / "last.safetensors", average=False)
    again = TrainingRun.start(CONFIG, tmp_path)
    for name, value in again.model.state_dict().items():
        torch.testing.assert_close(again.ema[name], value, rtol=0, atol=0)
        torch.testing.assert_close(value, run.model.state_dict()[name], rtol=1e-3, atol=1e-6)


def test_average_of_checkpoints_is_that_of_their_networks_and_needs_one_network(saved, tmp_path):
    other = TrainingRun.start(dataclasses.replace(CONFIG, seed=2), tmp_path / "none")
    losses(other, 1)
    other.save(tmp_path / "other.safetensors")
    states = [checkpoint.load(saved[1]), checkpoint.load(tmp_path / "other.safetensors")]
    averaged = average(states, [3.0, 1.0])
    for name, value in averaged.weights().items():
        torch.testing.assert_close(value, 0.75 * states[0].weights()[name] + 0.25 * states[1].weights()[name])
    (change,) = averaged.changes
    assert [part["share"] for part in change["averaged"]] == [0.75, 0.25]
    assert [part["pairs"] for part in change["averaged"]] == [state.spent()["pairs"] for state in states]
    assert change["after_pairs"] == states[0].spent()["pairs"]
    checkpoint.save(tmp_path / "average.safetensors", averaged)
    model, again = checkpoint.load_model(tmp_path / "average.safetensors")
    assert again.changes == averaged.changes
    for name, value in model.state_dict().items():
        torch.testing.assert_close(value, averaged.weights()[name])
    alone = average(states[:1], [0.3])
    for name, value in alone.weights().items():
        torch.testing.assert_close(value, states[0].weights()[name])
    wider = dataclasses.replace(CONFIG, model=dataclasses.replace(CONFIG.model, encoder=(8, 16, 24)))
    message = r"one network.*number 2.*model\.encoder \[8, 16, 24\] here, \[8, 16, 16\] there"
    with pytest.raises(InputError, match=message):
        average([states[0], dataclasses.replace(states[1], config=wider)], [1.0, 1.0])


@torch.no_grad()
def test_the_tracked_checkpoint_of_mime_is_the_network_that_is_shipped():
    """Weights of both are the same float16 numbers; what differs is the order of sums."""
    model, trained = checkpoint.load_model(ROOT / "training" / "mime.safetensors")
    card = json.loads((ZOO / "mime.json").read_text())
    assert trained.spent() == {"seconds_trained": card["seconds_trained"], "pairs": card["pairs"]}
    assert [dict(stage) for stage in trained.before] == card["before"]
    body = load_body()
    mesh = Mesh(body.vertices, body.faces)
    samples = SurfacePoints.of(mesh, 512, np.random.default_rng(0))
    arrays = (samples.points(mesh.vertices), samples.normals(mesh.vertices))
    points, normals = (torch.from_numpy(array[None]).float() for array in arrays)
    vertices, vertex_normals = points[:, :300], normals[:, :300]
    inputs = {"points": points, "normals": normals, "vertices": vertices, "vertex_normals": vertex_normals}
    session = import_onnxruntime().InferenceSession(ZOO / "mime.onnx", providers=["CPUExecutionProvider"])
    found = session.run(["rotation", "joints", "scores"], {name: value.numpy() for name, value in inputs.items()})
    assert isinstance(model, MimeNetwork)
    prediction = model.predict_joints(points, normals)
    weights = model.predict_weights(prediction, vertices, vertex_normals).softmax(-1)
    assert np.abs(prediction.rotation.numpy() - found[0]).max() < 2e-4
    assert np.abs(prediction.joints.numpy() - found[1]).max() < 2e-4
    assert np.abs(weights.numpy() - torch.from_numpy(found[2]).softmax(-1).numpy()).max() < 5e-3
