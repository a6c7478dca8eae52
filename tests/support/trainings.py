"""A training of seconds, and the losses that it logs."""

import dataclasses

import torch

from mimesh.learn.loop import TrainingRun
from mimesh.learn.npt import NPTConfig, NPTData, NPTTrainConfig

TINY = NPTTrainConfig(
    model=NPTConfig(encoder=(8, 16, 16), decoder=(16, 8, 8)),
    data=NPTData("table6", 64),
    batch=2,
    pairs=16,
    learning_rate=1e-3,
    decay=0.5,
    ema=0.9,
    clip=1.0,
    validation_pairs=1,
    validate_every=8,
)


def losses(run: TrainingRun, steps: int) -> list[float]:
    return [float(run.advance()) for _ in range(steps)]


def assert_steps_are_pure(source):
    """Batches of one step are equal whenever they are made, those of another step differ."""
    first, again, other = source.batch(2, 5), source.batch(2, 5), source.batch(2, 6)
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(again, field.name)
        assert torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b
    assert not torch.equal(first.truth, other.truth)
