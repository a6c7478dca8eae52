"""A training of seconds, the losses that it logs, and what all batches of pairs have in common."""

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


def edge_lengths(points: torch.Tensor, edges: torch.Tensor) -> torch.Tensor:
    ends = [points.gather(1, edges[..., k, None].expand(-1, -1, 3)) for k in range(2)]
    return (ends[1] - ends[0]).norm(dim=-1)


def length_changes(identity: torch.Tensor, truth: torch.Tensor, edges: torch.Tensor) -> torch.Tensor:
    """Median over the edges of each pair of how much their lengths change, beside that of the whole mesh.

    The classic bug is a shuffle that misaligns truth: then lengths change wildly.
    """
    ratio = edge_lengths(truth, edges) / edge_lengths(identity, edges)
    return (ratio / ratio.median(dim=1, keepdim=True).values - 1).abs().median(dim=1).values


def assert_steps_are_pure(source):
    """Batches of one step are equal whenever they are made, those of another step differ."""
    first, again, other = source.batch(2, 5), source.batch(2, 5), source.batch(2, 6)
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(again, field.name)
        assert torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b
    assert not torch.equal(first.truth, other.truth)
