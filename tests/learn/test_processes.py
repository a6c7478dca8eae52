"""Trainings whose batches are computed in parts, one after another or in two processes (gloo): the same steps."""

import dataclasses
import json
import os
import subprocess
import sys

import pytest
import torch
from trainings import TINY

from mimesh.core.errors import InputError
from mimesh.learn import checkpoint
from mimesh.learn.data.figures import share_of
from mimesh.learn.data.people import PairSource
from mimesh.learn.loop import TrainingRun, train
from mimesh.learn.npt import NPTTask
from mimesh.learn.processes import is_first_process, joined_processes

PARTS = dataclasses.replace(TINY, batch=4, pairs=16, validate_every=8, precision="fp32", accumulate=2)


def test_parts_give_the_gradient_of_their_pairs_together(tmp_path):
    """Against the loss of all parts in one batch, which the generator would not make by itself."""
    run = TrainingRun.start(dataclasses.replace(PARTS, clip=0.0), tmp_path)
    task = NPTTask(PARTS, torch.device("cpu"))
    model = task.make_model()
    model.load_state_dict(run.model.state_dict())
    parts = [run.source.batch(2, i) for i in (0, 1)]
    (sum(task.loss(model, part, 0) for part in parts) / 2).backward()
    run.advance()
    for mine, expected in zip(run.model.parameters(), model.parameters(), strict=True):
        assert mine.grad is not None
        assert expected.grad is not None
        torch.testing.assert_close(mine.grad, expected.grad)


def test_a_rank_without_other_processes_writes(monkeypatch):
    """Clusters set RANK for other reasons; without WORLD_SIZE this process is alone."""
    monkeypatch.setenv("RANK", "1")
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    assert is_first_process()
    with joined_processes() as processes:
        assert processes.first


def test_more_processes_than_devices_are_refused(monkeypatch):
    for name, value in (("RANK", 1), ("LOCAL_RANK", 1), ("WORLD_SIZE", 2)):
        monkeypatch.setenv(name, str(value))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    with pytest.raises(InputError, match="--nproc-per-node: expected at most 1"), joined_processes():
        pass


@pytest.mark.slow
def test_two_processes_take_the_steps_of_one(tmp_path):
    config = dataclasses.replace(PARTS, pairs=8, optimizer="muon")  # which leaves some weights to Adam
    (tmp_path / "tiny.yaml").write_text(json.dumps(dataclasses.asdict(dataclasses.replace(config, accumulate=1))))
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", "-m", "mimesh"]
    command += ["train", "npt", "--config", str(tmp_path / "tiny.yaml"), "-o", str(tmp_path / "shared")]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    shared, alone = tmp_path / "shared", train(config, tmp_path / "alone")
    states = [checkpoint.load(folder / "last.safetensors") for folder in (shared, alone)]
    for key, value in states[1].tensors.items():
        torch.testing.assert_close(states[0].tensors[key], value, rtol=1e-4, atol=1e-6, msg=key)
    assert states[0].metrics == pytest.approx(states[1].metrics, rel=1e-4)
    logs = [[json.loads(line) for line in (f / "log.jsonl").read_text().splitlines()] for f in (shared, alone)]
    timed = ("pace", "training")  # lines that depend on the speed of the machine
    kinds = [[line["kind"] for line in log if line["kind"] not in timed] for log in logs]
    assert kinds[0] == kinds[1]
    assert done.stdout.count("last.safetensors") == 1


def test_samples_go_on_where_the_number_of_parts_changes(tmp_path, monkeypatch):
    """No sample is drawn twice, and a loss gets the number of the sample."""
    drawn, lost = [], []
    make, loss = PairSource.batch, NPTTask.loss
    monkeypatch.setattr(PairSource, "batch", lambda self, *which: drawn.append(which) or make(self, *which))
    monkeypatch.setattr(NPTTask, "loss", lambda self, *given: lost.append(given[-1]) or loss(self, *given))
    run = TrainingRun.start(dataclasses.replace(PARTS, accumulate=4), tmp_path)
    run.advance()
    run.save(tmp_path / "last.safetensors")
    again = TrainingRun.start(dataclasses.replace(PARTS, accumulate=1), tmp_path)
    assert again.changes[-1] == {"after_pairs": 4, "accumulate": 1, "was": {"accumulate": 4}}
    again.advance()
    again.advance()
    assert drawn == [(1, 0), (1, 1), (1, 2), (1, 3), (4, 4), (4, 5)]
    assert lost == [step for _, step in drawn]
    message = r"batch: expected a multiple of 3 \(most parts of a batch x processes\), found 4"
    with pytest.raises(InputError, match=message):
        TrainingRun.start(dataclasses.replace(PARTS, accumulate=3), tmp_path)


@pytest.mark.parametrize(("size", "share"), [(1, 0.5), (3, 0.5), (4, 0.1), (16, 0.35), (20, 0.55), (8, 1.0), (8, 0.0)])
def test_a_share_of_small_parts_is_right_over_the_steps(size, share):
    counts = [share_of(size, share, step) for step in range(200)]
    assert sum(counts) == round(200 * size * share)
    assert max(counts) - min(counts) <= 1
    if float(size * share).is_integer():
        assert set(counts) == {size * share}
