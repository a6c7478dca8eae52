"""NPT and AniFormer of four-legged animals: what they are trained and validated on, what is exported, and its use."""

import json

import numpy as np
import onnx
import pytest
import torch
from animals import BODY
from trainings import assert_steps_are_pure, edge_lengths

from mimesh.__main__ import run
from mimesh.bodies.sampling import sample_shape
from mimesh.core.mesh import Mesh
from mimesh.evaluate.measure import extra_inputs, training_facts
from mimesh.evaluate.metrics import pmd_aligned
from mimesh.evaluate.protocols import QUADRUPED
from mimesh.io import load_mesh, save_mesh
from mimesh.learn import export
from mimesh.learn.aniformer import AniFormerData, WindowSource
from mimesh.learn.config import load_config
from mimesh.learn.data.endless import training_takes
from mimesh.learn.data.people import PairSource
from mimesh.learn.models import find_task
from mimesh.learn.npt import NPTConfig, NPTData, NPTTrainConfig
from mimesh.learn.start import train_command
from mimesh.methods.find import find_model

CPU = torch.device("cpu")
TINY = ["data.body=quadruped", "data.vertices=32", "pairs=8", "batch=4", "validate_every=8", "validation_pairs=1"]
TINY += ["precision=fp32", "warmup=0", "ema=0", "model.encoder=[8,16,16]"]
LAYERS = {"npt": "model.decoder=[19,8,8]", "aniformer": "model.layers=[16,8]"}


@pytest.fixture(scope="module", params=[pytest.param("npt", marks=pytest.mark.slow)])
def trained(request, tmp_path_factory, tiny_exports):
    """A network that was trained for seconds, exported: its name, its file and the folder of the training."""
    folder = tmp_path_factory.mktemp(request.param)
    run_folder = train_command(request.param, "small", folder / "run", None, None, [*TINY, LAYERS[request.param]])
    export.export_command(run_folder / "last.safetensors", folder / "animal.onnx")
    return request.param, folder / "animal.onnx", run_folder


def test_checkpoints_are_chosen_on_animals(trained):
    log = [json.loads(line) for line in (trained[2] / "log.jsonl").read_text().splitlines()]
    figures = next(entry for entry in log if entry["kind"] == "validation")
    assert {*QUADRUPED.kinds, "fresh", "val"} <= set(figures)
    assert not {"seen", "unseen"} & set(figures)
    assert all(np.isfinite(figures[kind]) for kind in QUADRUPED.kinds)


def test_file_card_and_report_say_that_it_is_of_animals(trained):
    network, path, _ = trained
    entries = {entry.key: entry.value for entry in onnx.load(str(path)).metadata_props}
    assert json.loads(entries["mimesh"])["body"] == "quadruped"
    card = json.loads(path.with_suffix(".json").read_text())
    assert "animals of the shipped quadruped" in card["data"]
    assert "people" not in card["data"]
    assert card["config"]["data"]["body"] == export.test_set(card) == "quadruped"
    assert find_model(str(path)).body == "quadruped"
    assert extra_inputs(str(path)) == "trained on our quadruped"
    assert "random animals" in training_facts(str(path))["trained"], network


def test_the_command_moves_animals_whose_axes_are_not_known(trained, tmp_path, capsys):
    """Files say nothing of the axes: a network of animals' joints finds them, where the detector knows people alone."""
    _, path, _ = trained
    shape = sample_shape(BODY, 3, 0)
    z_up = BODY.posed(shape, np.tile(np.eye(3), (len(BODY.parents), 1, 1)))[:, [2, 0, 1]]  # x is the front
    save_mesh(Mesh(z_up, BODY.faces), tmp_path / "identity.obj")
    save_mesh(QUADRUPED.pair("val", "gaits", 0).driving, tmp_path / "driving.obj")
    words = ["transfer", str(tmp_path / "identity.obj"), str(tmp_path / "driving.obj"), "-m", str(path)]
    words += ["-o", str(tmp_path / "out.obj"), "--json"]
    assert run([*words, "--body", "quadruped"]) == 0
    report = json.loads(capsys.readouterr().out)["report"]
    assert (report["identity"]["up"], report["identity"]["front"]) == ("+z", "+x")
    assert report["driving"]["up"] == "+y"
    result = load_mesh(tmp_path / "out.obj")
    assert result.vertices.shape == BODY.vertices.shape
    assert np.isfinite(result.vertices).all()
    assert run([*words, "--body", "human", "-o", str(tmp_path / "other.obj")]) == 2
    assert "--body: expected quadruped with the model animal, found human" in capsys.readouterr().err


@pytest.mark.parametrize(("network", "kind"), list(zip(LAYERS, QUADRUPED.kinds, strict=False)))
def test_a_network_that_changes_nothing_has_the_error_of_the_identity(network, kind, monkeypatch):
    """So pairs are validated with their own truth, by AniFormer as windows that stand still."""
    pair = QUADRUPED.pair("val", kind, 1)
    config = load_config("small", network, [*TINY, LAYERS[network]])
    task = find_task(network)(config, CPU)
    model = task.make_model()

    def unchanged(identity, driving):
        if network == "npt":
            return identity
        assert driving.shape[1] == config.model.frames
        assert torch.equal(driving[:, 0], driving[:, -1])
        return identity[:, None].expand(driving.shape)

    monkeypatch.setattr(model, "forward", unchanged)
    assert task.trial_error(model, pair) == pytest.approx(pmd_aligned(pair.identity.vertices, pair.truth), rel=1e-3)


@pytest.mark.slow
def test_pairs_have_one_order_and_unit_and_are_reproducible():
    source = PairSource(NPTData("wide", 64, "identity", body="quadruped"), BODY, CPU, 0)
    assert_steps_are_pure(source)
    batch = source.batch(16, 0)
    old, new = (edge_lengths(mesh, batch.edges) for mesh in (batch.identity, batch.truth))
    assert (new / old - 1).abs().median() < 0.05
    assert (batch.truth - batch.identity).norm(dim=-1).mean() > 0.05


@pytest.mark.slow
def test_windows_are_of_gaits_and_of_ways_between_poses():
    source = WindowSource(AniFormerData("clips", 64, "identity", body="quadruped"), BODY, CPU, 0, 3)
    assert_steps_are_pure(source)
    batch = source.batch(64, 0)
    steps = batch.truth.diff(dim=1).norm(dim=-1).mean((1, 2))
    assert ((steps > 1e-3).float().mean() > 0.9).item()
    assert steps.max() < 0.5
    takes = training_takes(BODY)
    assert all(take.shape == (60, *BODY.joints.shape) for take in takes)
    assert len(source.people.captured) == sum(map(len, takes))
    # A window at the highest speed ends in the take that it begins in.
    first = source.people.starts.numpy()
    assert (first // 60 == (first + 3 * 2) // 60).all()
    assert len(first) == len(takes) * (60 - 6)


@pytest.mark.parametrize(
    ("network", "config"),
    [("npt", "table"), ("aniformer", "table"), ("mime", "table")],
)
def test_networks_and_data_that_need_people_refuse_animals(network, config, capsys, tmp_path):
    words = ["train", network, "--config", config, "--set", "data.body=quadruped", "-o", str(tmp_path / "run")]
    assert run(words) == 2
    message = capsys.readouterr().err
    assert "expected data.body human" in message or "data, body: expected human" in message
    assert "quadruped" in message
    assert not (tmp_path / "run").exists()


def test_meshes_of_a_folder_may_be_of_animals():
    data = NPTData("meshes", body="quadruped")
    NPTTrainConfig(model=NPTConfig(), data=data).check("here")
