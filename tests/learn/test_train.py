"""Training: exact resuming, time limits and signals, precision, checkpoints and logs."""

import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from trainings import TINY, losses

from mimesh.core.errors import InputError
from mimesh.learn import checkpoint
from mimesh.learn.config import load_config
from mimesh.learn.loop import PACE_STEPS, StopRequest, TrainingRun, expected_end, train
from mimesh.learn.npt import NPTTrainConfig
from mimesh.learn.optimizers import choose_precision, product_rate, schedule
from mimesh.learn.start import train_command
from mimesh.learn.validation import Validation


def log_of(folder):
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


@pytest.mark.parametrize("optimizer", ["adam", pytest.param("muon", marks=pytest.mark.slow)])
def test_resume_continues_exactly(tmp_path, optimizer):
    config = dataclasses.replace(TINY, optimizer=optimizer)
    whole = TrainingRun.start(config, tmp_path / "none")
    expected = losses(whole, 6)
    first = TrainingRun.start(config, tmp_path / "none")
    start = losses(first, 3)
    first.save(tmp_path / "last.safetensors")
    second = TrainingRun.start(config, tmp_path)
    assert second.step == 3
    assert start + losses(second, 3) == expected
    for a, b in zip(whole.ema.values(), second.ema.values(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


@pytest.mark.slow
def test_train_writes_best_last_and_logs_and_tells_what_it_will_reach(trained):
    state = checkpoint.load(trained / "best.safetensors")
    header = checkpoint.read_header(trained / "last.safetensors")
    assert state.config == TINY
    assert state.metrics["val"] == state.best
    assert {"config", "state", "commit", "hardware"} <= set(header)
    assert header["state"]["step"] == 8
    lines = log_of(trained)
    (pace,) = [line for line in lines if line["kind"] == "pace"]
    assert (pace["step"], lines[lines.index(pace) + 1]["kind"]) == (PACE_STEPS, "training")
    assert re.search(r"[\d,]+ pairs an hour .* expected end \d{4}-\d\d-\d\d \d\d:\d\d, ", pace["text"])
    assert "cost" in {line["kind"] for line in lines}
    assert {"seen", "unseen", "fresh"} <= set(next(line for line in lines if line["kind"] == "validation"))
    assert {"loss", "pairs_per_s", "tflops"} <= set(next(line for line in lines if line["kind"] == "training"))
    assert list(trained.glob("events.out.tfevents.*"))
    model, _ = checkpoint.load_model(trained / "best.safetensors")
    for name, weight in model.state_dict().items():
        torch.testing.assert_close(weight, state.tensors[f"ema.{name}"])


def test_a_time_limit_stops_and_saves(tmp_path):
    assert StopRequest(0.0)()
    assert not StopRequest(None)()
    endless = dataclasses.replace(TINY, pairs=10**9, validate_every=10**9)
    folder = train(endless, tmp_path / "run", max_minutes=0.005)
    state = checkpoint.load(folder / "last.safetensors")
    assert 0 < state.step < 10**6
    assert not (folder / "best.safetensors").exists()
    log = (folder / "log.jsonl").read_text()
    assert "time given is over" in log
    assert "the learning rate had not begun to fall" in log
    assert "set minutes" in log


@pytest.mark.slow
@pytest.mark.parametrize("pairs", [10**9, 2])
def test_a_time_limit_is_not_overrun_by_a_validation(tmp_path, pairs):
    """A validation that is due where the time ends is left to the training that is resumed, which does it first."""
    config = dataclasses.replace(TINY, pairs=pairs, validate_every=2)
    folder = train(config, tmp_path / "run", max_minutes=0.0)
    state = checkpoint.load(folder / "last.safetensors")
    assert (state.step, state.validated, state.metrics) == (1, 0, {})
    assert "validation that was due is left" in (folder / "log.jsonl").read_text()
    run = TrainingRun.start(config, folder)
    assert run.validation_due()
    run.validate(Validation(run.task), folder)
    assert not run.validation_due()
    assert not TrainingRun.start(config, folder).validation_due()
    assert checkpoint.load(folder / "best.safetensors").step == 1


@pytest.mark.slow
def test_a_checkpoint_is_written_before_every_validation(tmp_path, monkeypatch):
    steps = []

    def validate(run, validation, folder, stop, progress):
        steps.append((run.step, checkpoint.load(folder / "last.safetensors").step))
        run.metrics, run.validated = {"val": 1.0}, run.step
        return run.metrics

    monkeypatch.setattr(TrainingRun, "validate", validate)
    train(TINY, tmp_path / "run")
    assert steps == [(4, 4), (8, 8)]


@pytest.mark.slow
def test_a_validation_that_lasts_is_told_with_what_is_left(tmp_path, monkeypatch):
    """With no time between lines, one after each trial and batch but the last, by pairs: a batch is 32 of them."""
    monkeypatch.setattr("mimesh.learn.loop.LOG_SECONDS", 0.0)
    config = dataclasses.replace(TINY, pairs=8, validate_every=8, validation_pairs=1)
    lines = log_of(train(config, tmp_path / "run"))
    told = [line["text"].partition(" pairs measured, about ")[0] for line in lines if line["kind"] == "validating"]
    assert told == ["1 of 258", "2 of 258", *(f"{2 + 32 * k} of 258" for k in range(1, 8))]


def test_a_validation_that_is_broken_off_changes_nothing(tmp_path):
    run = TrainingRun.start(TINY, tmp_path)
    run.advance()
    before = {name: value.clone() for name, value in run.model.state_dict().items()}
    answers = iter([False, False, True])
    assert run.validate(Validation(run.task), tmp_path, lambda: next(answers)) is None
    assert next(answers, None) is None
    assert not run.metrics
    assert run.model.training
    assert all(torch.equal(before[name], value) for name, value in run.model.state_dict().items())
    assert not (tmp_path / "best.safetensors").exists()


@pytest.mark.slow
def test_a_signal_ends_a_training_with_a_checkpoint_that_resumes_exactly(tmp_path):
    config = dataclasses.replace(TINY, pairs=10**9, validate_every=10**9, precision="fp32")
    (tmp_path / "tiny.yaml").write_text(json.dumps(dataclasses.asdict(config)))
    folder = tmp_path / "run"
    command = [sys.executable, "-m", "mimesh", "train", "npt", "--config", str(tmp_path / "tiny.yaml"), "-o", folder]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
    assert process.stderr is not None
    assert any(line.startswith("pace ") for line in process.stderr)  # some steps have been taken
    process.send_signal(signal.SIGTERM)
    said = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert f"ended by SIGTERM; --resume {folder} continues" in said
    stopped, whole = TrainingRun.start(config, folder), TrainingRun.start(config, tmp_path / "none")
    assert stopped.step > 0
    losses(whole, stopped.step)
    assert losses(stopped, 2) == losses(whole, 2)


def test_a_second_signal_acts_at_once():
    # A shell without job control starts processes in the background with SIGINT ignored.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        stop = StopRequest(None)
        stop.__enter__()
        with pytest.raises(KeyboardInterrupt):  # nothing is there to save
            signal.raise_signal(signal.SIGINT)
        stop = StopRequest(None)
        stop.__enter__()
        stop.at_once = False
        signal.raise_signal(signal.SIGINT)
        assert stop()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            stop.__exit__(None, None, None)
        stop = StopRequest(None)
        stop.__enter__()
        stop.at_once = False
        signal.raise_signal(signal.SIGINT)
        failure = RuntimeError("the compiler was interrupted, too")
        with pytest.raises(KeyboardInterrupt):
            stop.__exit__(RuntimeError, failure, None)
    finally:
        signal.signal(signal.SIGINT, before)


def test_precision_is_measured_where_it_is_not_given(monkeypatch):
    cpu = torch.device("cpu")
    assert product_rate(torch.float32, cpu, 0.1) > 1e8
    for bf16, before, expected in (
        (0.9, "", "fp32"),
        (70.0, "", "fp32"),
        (170.0, "", "bf16"),
        (100.0, "fp32", "fp32"),
        (170.0, "fp32", "bf16"),
        (70.0, "bf16", "bf16"),
        (0.9, "bf16", "fp32"),
    ):
        rates = {torch.float32: 72e9, torch.bfloat16: 1e9 * bf16}
        monkeypatch.setattr("mimesh.learn.optimizers.product_rate", lambda dtype, device, rates=rates: rates[dtype])
        precision, reason = choose_precision("auto", cpu, before)
        assert precision == expected
        assert reason == f"matrix products in {expected}: GFLOP/s measured are 72 in fp32 and {bf16:.3g} in bf16"
    assert choose_precision("bf16", cpu) == ("bf16", "matrix products in bf16, as configured")


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_checkpoint_and_log_say_the_precision(tmp_path, precision, monkeypatch):
    monkeypatch.setattr("mimesh.learn.loop.choose_precision", lambda *_: (precision, "because"))
    folder = train(dataclasses.replace(TINY, pairs=2, optimizer="muon"), tmp_path / "run", max_minutes=0.0)
    assert checkpoint.load(folder / "last.safetensors").precision == precision
    line = log_of(folder)[0]
    assert (line["kind"], line["precision"], line["text"]) == ("precision", precision, "because")


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
    assert schedule(NPTTrainConfig(), 799_999, 0.999) == 1.0


@pytest.mark.slow
def test_a_training_may_last_for_minutes_instead_of_pairs(tmp_path):
    config = dataclasses.replace(TINY, minutes=0.005, pairs=1, validate_every=10**9)
    state = checkpoint.load(train(config, tmp_path / "run") / "last.safetensors")
    assert state.step > 1
    assert 0.3 <= state.seconds < 10
    again = TrainingRun.start(config, tmp_path / "run")
    assert again.share() >= 1.0


@pytest.mark.slow
def test_resuming_takes_no_changes_but_those_of_the_schedule(trained, tmp_path):
    with pytest.raises(InputError, match="--resume"):
        train_command("npt", "small", None, trained, None, ["model.width=8"])
    with pytest.raises(InputError, match="expected a training of mime, found one of npt; train npt"):
        train_command("mime", "table", None, trained, None)
    folder = Path(shutil.copytree(trained, tmp_path / "run"))
    given = {"seed": 1, "pairs": 2 * TINY.pairs, "decay": 0.25, "learning_rate": 5e-4}
    changes = [f"{key}={value}" for key, value in given.items()]
    state = checkpoint.load(train_command("npt", "small", None, folder, None, changes) / "last.safetensors")
    assert (state.step, state.config.pairs, state.config.decay) == (16, 2 * TINY.pairs, 0.25)
    was = {"seed": 0, "pairs": TINY.pairs, "decay": 0.5, "learning_rate": 1e-3}
    assert state.changes == ({**given, "after_pairs": TINY.pairs, "was": was},)


@pytest.mark.slow
def test_a_training_may_begin_with_the_network_of_another(trained, tmp_path):
    first = trained
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
    with pytest.raises(
        InputError, match=r"the network of the configuration, found another \(model\.encoder \[.*\] here"
    ):
        train_command("npt", "small", tmp_path / "third", None, None, [], first / "last.safetensors")
    assert not (tmp_path / "third").exists()


def test_unknown_names_say_what_there_is(tmp_path):
    with pytest.raises(InputError, match=r"paper.*small"):
        load_config("enormous")
    with pytest.raises(InputError, match=r"last\.safetensors"):
        train_command("npt", "small", None, tmp_path, None)
    broken = tmp_path / "last.safetensors"
    broken.write_bytes(b"")
    with pytest.raises(InputError, match="expected a checkpoint"):
        train_command("npt", "small", None, tmp_path, None)


def test_the_expected_end_of_a_training(tmp_path):
    run = TrainingRun.start(TINY, tmp_path)  # 16 pairs in 8 steps
    run.step = 2
    told = expected_end(run, 1, 10.0, 1 / 8)
    assert told.startswith("720 pairs an hour")
    assert "after 1 minutes more (validations not counted) and 16 pairs" in told
    assert "in more than a year" in expected_end(run, 1, 10.0, 1e-9)
    limited = expected_end(run, 1, 10.0, 1 / 8, given=30.0)
    assert " with the time given, at 62% of the training, after " in limited
    assert "and 10 pairs" in limited
    assert "time given" not in expected_end(run, 1, 10.0, 1 / 8, given=61.0)
