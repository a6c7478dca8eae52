"""Arithmetic and memory of trainings, counted before they run."""

import dataclasses

import pytest
import torch
from trainings import TINY

from mimesh.learn import checkpoint
from mimesh.learn.loop import TrainingRun, activation_bytes, described_cost
from mimesh.learn.npt import NPTConfig, NPTTask
from mimesh.learn.start import begin_with
from mimesh.learn.task import training_operations


def kept(vertices, precision="fp32", **changes):
    config = dataclasses.replace(TINY, data=dataclasses.replace(TINY.data, vertices=vertices), **changes)
    task = NPTTask(config, torch.device("cpu"), precision)
    return activation_bytes(task, task.make_model(), task.source(0))


def spend(config, folder):
    """Take all steps of a training, from where that in the folder ended; give its checkpoint."""
    run = TrainingRun.start(config, folder)
    while run.share() < 1.0:
        run.advance()
    run.save(folder / "last.safetensors")
    return checkpoint.load(folder / "last.safetensors")


@pytest.mark.slow
def test_activations_grow_with_vertices_and_not_with_weights():
    assert kept(512) / kept(128) == pytest.approx(4.0, rel=0.1)
    widths = sum([3, *TINY.model.encoder, *TINY.model.decoder])
    assert 4 * 128 * widths < kept(128) < 4 * 128 * widths * 20


@pytest.mark.slow
def test_copies_of_weights_in_16_bits_are_not_counted_for_every_pair():
    """A wide network on 16 vertices: most of what one pair keeps are its weights in bfloat16."""
    wide = NPTConfig(encoder=(64, 256, 512), decoder=(515, 256, 128))
    full, half = (kept(16, precision, model=wide) for precision in ("fp32", "bf16"))
    assert half < full


@pytest.mark.slow
def test_operations_add_up_over_changes_and_earlier_trainings(tmp_path):
    """Meshes of more vertices towards the end count as such; so do the pairs of a training that this one began with."""
    short = dataclasses.replace(TINY, pairs=4)
    spend(short, tmp_path)
    dense = dataclasses.replace(short, pairs=8, data=dataclasses.replace(TINY.data, vertices=128))
    state = spend(dense, tmp_path)
    task = NPTTask(short, torch.device("cpu"))
    first = training_operations(task, task.make_model(), 4)
    assert state.operations == pytest.approx(3 * first)
    assert state.changes[-1]["was"]["data.vertices"] == 64
    follower = dataclasses.replace(state, before=({"pairs": 4, "seconds_trained": 1, "operations": 7.0},))
    assert follower.operations_spent() == pytest.approx(3 * first + 7.0)


@pytest.mark.slow
def test_a_training_from_an_older_checkpoint_counts_with_the_configuration_of_that(tmp_path):
    """Which may have had fewer vertices; it does not say what it has spent."""
    old = dataclasses.replace(TINY, pairs=4)
    path = tmp_path / "last.safetensors"
    checkpoint.save(path, dataclasses.replace(spend(old, tmp_path), operations=None))
    dense = dataclasses.replace(TINY, pairs=4, data=dataclasses.replace(TINY.data, vertices=128))
    begin_with(dense, path, tmp_path / "new")
    state = spend(dense, tmp_path / "new")
    task = NPTTask(old, torch.device("cpu"))
    first = training_operations(task, task.make_model(), 4)
    assert state.operations_spent() == pytest.approx(3 * first)


@pytest.mark.slow
def test_what_the_log_says_before_is_what_is_spent(tmp_path):
    config = dataclasses.replace(TINY, batch=4)
    task = NPTTask(config, torch.device("cpu"))
    expected = training_operations(task, task.make_model(), config.pairs)
    said = described_cost(TrainingRun.start(config, tmp_path))
    for words in ("a step of 4 pairs is", f"{expected / 1e15:.3g} PFLOP in all", "GiB for its gradient"):
        assert words in said
    assert spend(config, tmp_path).operations == pytest.approx(expected)
