"""Trainings whose batches are computed in parts, one after another: the same steps."""

import dataclasses

import pytest
import torch
from trainings import TINY

from mimesh.core.errors import InputError
from mimesh.learn.data.figures import share_of
from mimesh.learn.data.people import PairSource
from mimesh.learn.loop import TrainingRun
from mimesh.learn.npt import NPTTask

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
    with pytest.raises(InputError, match="expected accumulate to divide batch, found 3 and 4"):
        TrainingRun.start(dataclasses.replace(PARTS, accumulate=3), tmp_path)


@pytest.mark.parametrize(("size", "share"), [(1, 0.5), (3, 0.5), (4, 0.1), (16, 0.35), (20, 0.55), (8, 1.0), (8, 0.0)])
def test_a_share_of_small_parts_is_right_over_the_steps(size, share):
    counts = [share_of(size, share, step) for step in range(200)]
    assert sum(counts) == round(200 * size * share)
    assert max(counts) - min(counts) <= 1
    if float(size * share).is_integer():
        assert set(counts) == {size * share}
