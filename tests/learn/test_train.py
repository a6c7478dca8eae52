"""Training: resume continues exactly, configurations are checked, checkpoints carry their provenance."""

import dataclasses
import json

import pytest
import torch

from mimesh.core.errors import InputError
from mimesh.learn import checkpoint
from mimesh.learn.batches import DataConfig
from mimesh.learn.config import TrainConfig, load_config
from mimesh.learn.npt import NPTConfig
from mimesh.learn.train import Run, schedule, train, train_command

TINY = TrainConfig(
    model=NPTConfig(encoder=(8, 16, 16), decoder=(16, 8, 8)),
    data=DataConfig("table6", 64),
    batch=2,
    pairs=16,
    learning_rate=1e-3,
    decay=0.5,
    ema=0.9,
    clip=1.0,
    validation_pairs=1,
    validate_every=8,
)


def losses(run: Run, steps: int) -> list[float]:
    return [float(run.advance()) for _ in range(steps)]


@pytest.mark.parametrize("optimizer", ["adam", "muon"])
def test_resume_continues_exactly(tmp_path, optimizer):
    config = dataclasses.replace(TINY, optimizer=optimizer)
    whole = Run.start(config, tmp_path / "none")
    expected = losses(whole, 6)
    first = Run.start(config, tmp_path / "none")
    start = losses(first, 3)
    first.save(tmp_path / "last.safetensors")
    second = Run.start(config, tmp_path)
    assert second.step == 3
    assert start + losses(second, 3) == expected
    for a, b in zip(whole.ema.values(), second.ema.values(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


def test_train_writes_best_last_and_logs(tmp_path):
    folder = train(TINY, tmp_path / "run")
    state = checkpoint.load(folder / "best.safetensors")
    header = checkpoint.read_header(folder / "last.safetensors")
    assert state.config == TINY
    assert state.metrics["val"] == state.best
    assert {"config", "state", "commit", "hardware"} <= set(header)
    assert header["state"]["step"] == 8
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    assert {"seen", "unseen", "fresh"} <= set(next(line for line in lines if line["kind"] == "validation"))
    assert {"loss", "pairs_per_s", "tflops"} <= set(next(line for line in lines if line["kind"] == "training"))
    assert list(folder.glob("events.out.tfevents.*"))
    model, _ = checkpoint.load_model(folder / "best.safetensors")
    for name, weight in model.state_dict().items():
        torch.testing.assert_close(weight, state.tensors[f"ema.{name}"])


def test_a_time_limit_stops_and_saves(tmp_path):
    endless = dataclasses.replace(TINY, pairs=10**9, validate_every=10**9)
    folder = train(endless, tmp_path / "run", max_minutes=0.02)
    state = checkpoint.load(folder / "last.safetensors")
    assert 0 < state.step < 10**6
    assert (folder / "best.safetensors").exists()


def test_an_existing_training_is_not_overwritten(tmp_path):
    (tmp_path / "last.safetensors").write_bytes(b"somebody's weights")
    with pytest.raises(InputError, match="--resume"):
        train_command("npt", "small", tmp_path, None, 0.01)
    assert (tmp_path / "last.safetensors").read_bytes() == b"somebody's weights"


def test_schedule():
    config = dataclasses.replace(TINY, pairs=1000, warmup=100, decay=0.5)
    assert schedule(config, 0, 0.0) < 0.05
    assert schedule(config, 300, 0.3) == 1.0
    assert schedule(config, 750, 0.75) == pytest.approx(0.5)
    assert schedule(config, 1100, 1.1) == 0.0
    assert schedule(TrainConfig(), 799_999, 0.999) == 1.0


def test_a_training_may_last_for_minutes_instead_of_pairs(tmp_path):
    config = dataclasses.replace(TINY, minutes=0.05, pairs=1, validate_every=10**9)
    state = checkpoint.load(train(config, tmp_path / "run") / "last.safetensors")
    assert state.step > 1
    assert 3.0 <= state.seconds < 10
    again = Run.start(config, tmp_path / "run")
    assert again.share() >= 1.0


def test_configurations_take_changes():
    config = load_config("table", changes=["model.blocks=conv", "edge=off", "seed=3", "learning_rate=1e-3"])
    assert (config.model.blocks, config.edge, config.seed, config.learning_rate) == ("conv", "off", 3, 1e-3)
    assert config.model.encoder == load_config("table").model.encoder
    for wrong, message in (
        ("edge", "KEY=VALUE"),
        ("batch.size=3", "batch to hold keys"),
        ("bacth=3", "bacth"),
    ):
        with pytest.raises(InputError, match=message):
            load_config("table", changes=[wrong])


def test_resuming_takes_no_changes(tmp_path):
    folder = train(TINY, tmp_path / "run")
    with pytest.raises(InputError, match="--resume"):
        train_command("npt", "small", None, folder, None, ["seed=1"])


def test_a_training_may_begin_with_the_network_of_another(tmp_path):
    first = train(TINY, tmp_path / "first")
    other = dataclasses.replace(TINY, seed=5, learning_rate=0.0001, ema=0.0)
    (tmp_path / "other.yaml").write_text(json.dumps(dataclasses.asdict(other)))
    arguments = (str(tmp_path / "other.yaml"), tmp_path / "second", None, None, [], first / "last.safetensors")
    second = checkpoint.load(train_command("npt", *arguments) / "last.safetensors")
    for name, weight in checkpoint.load(first / "last.safetensors").weights().items():
        torch.testing.assert_close(second.weights()[name], weight, atol=1e-3, rtol=0)
    assert second.config.seed == 5
    assert [dict(stage) for stage in second.before] == [checkpoint.load(first / "last.safetensors").spent()]
    with pytest.raises(InputError, match=r"--weights .*: expected no changes with --resume"):
        train_command("npt", "small", None, first, None, [], first / "last.safetensors")
    with pytest.raises(InputError, match="expected the network of the configuration"):
        train_command("npt", "small", tmp_path / "third", None, None, [], first / "last.safetensors")
    assert not (tmp_path / "third").exists()


def test_paper_configuration_is_the_papers():
    config = load_config("paper")
    assert config.model == NPTConfig()
    assert (config.batch, config.learning_rate, config.pairs) == (8, 5e-5, 200 * 4000)
    assert (config.data.kind, config.data.vertices, config.data.target_scale) == ("table6", 0, "truth")
    assert (config.edge, config.edge_weight) == ("paper", 5e-4)


@pytest.mark.parametrize("name", ["small", "base", "table"])
def test_configurations_of_mime_load(name):
    config = load_config(name, "mime")
    assert config.data.target_scale == "identity"
    assert config.data.vertices >= config.model.near


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("data.kind=clips", "expected data.kind table6 or wide with mime, found clips"),
        ("data.target_scale=truth", "expected data.target_scale identity"),
        ("model.heads=3", "expected heads that divide width 128, found 3"),
    ],
)
def test_mime_refuses_what_it_cannot_train_on(change, message):
    with pytest.raises(InputError, match=message):
        load_config("small", "mime", [change])


@pytest.mark.parametrize("name", ["paper", "small", "maxpool-small", "table"])
def test_shipped_configurations_load(name):
    assert load_config(name).pairs > 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("batches: 8", "found batches; remove it"),
        ("batch: many", "batch: expected int, found 'many'"),
        ("model: {blocks: magic}", "found 'magic'"),
        ("model: 3", "expected keys and values"),
        ("compile: 1", "expected bool"),
    ],
)
def test_configurations_are_checked(tmp_path, text, message):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        load_config(str(path))


def test_unknown_names_say_what_there_is(tmp_path):
    with pytest.raises(InputError, match=r"paper.*small"):
        load_config("enormous")
    with pytest.raises(InputError, match=r"last\.safetensors"):
        train_command("npt", "small", None, tmp_path, None)
    broken = tmp_path / "last.safetensors"
    broken.write_bytes(b"")
    with pytest.raises(InputError, match="expected a checkpoint"):
        train_command("npt", "small", None, tmp_path, None)
