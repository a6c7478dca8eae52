"""A training of seconds, and the losses that it logs."""

from mimesh.learn.body_sampler import DataConfig
from mimesh.learn.models.npt import NPTConfig
from mimesh.learn.tasks.npt import NPTTrainConfig
from mimesh.learn.train import TrainingRun

TINY = NPTTrainConfig(
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


def losses(run: TrainingRun, steps: int) -> list[float]:
    return [float(run.advance()) for _ in range(steps)]
