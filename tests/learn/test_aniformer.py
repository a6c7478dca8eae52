"""Training windows: aligned truth, one shuffle for all frames, reproducible steps; and an AniFormer trained on them."""

import dataclasses

import pytest
import torch
from matrix import matrix
from trainings import assert_steps_are_pure, length_changes

from mimesh.core.errors import InputError
from mimesh.learn import checkpoint
from mimesh.learn.aniformer import (
    AniFormerConfig,
    AniFormerData,
    AniFormerTrainConfig,
    ClipLossConfig,
    WindowSource,
    aniformer_loss,
)
from mimesh.learn.config import load_config
from mimesh.learn.data import endless
from mimesh.learn.loop import TrainingRun, train
from mimesh.learn.task import shipped_body

CASES = [AniFormerData("clips80", 64), AniFormerData("clips", 64, "identity"), AniFormerData("clips")]
TINY = AniFormerTrainConfig(
    model=AniFormerConfig(encoder=(8, 16, 16), layers=(16, 8), heads=2, keys=16),
    data=AniFormerData("clips80", 32),
    batch=2,
    pairs=8,
    learning_rate=1e-3,
    ema=0.9,
    validation_pairs=1,
    validate_every=4,
)


@pytest.fixture(
    scope="module",
    params=matrix("source", CASES, quick=CASES[1:2]).args[1],
    ids=lambda c: f"{c.kind}-{c.vertices or 'all'}",
)
def source(request):
    return WindowSource(request.param, shipped_body(), torch.device("cpu"), 3, 3)


@pytest.mark.slow
def test_truth_is_aligned_in_every_frame_and_driving_shuffled_on_its_own_alike_in_all(source):
    batch = source.batch(4, 0)
    for t in range(3):
        assert (length_changes(batch.identity, batch.truth[:, t], batch.edges) < 0.05).all()
    assert batch.driving.shape == batch.truth.shape
    assert (batch.driving - batch.truth).norm(dim=-1).median() > 0.2
    # A vertex stays itself: from frame to frame it moves far less than vertices lie apart.
    step = (batch.driving[:, 1] - batch.driving[:, 0]).norm(dim=-1).median()
    assert step < 0.3 * (batch.driving[:, 0] - batch.driving[:, 0].roll(1, 1)).norm(dim=-1).median()


@pytest.mark.slow
def test_frames_are_centred_and_driving_frames_fill_the_unit_sphere():
    whole = WindowSource(CASES[-1], shipped_body(), torch.device("cpu"), 3, 3).batch(2, 1)
    for points in (whole.driving, whole.truth, whole.identity):
        assert (points.amax(-2) + points.amin(-2)).abs().max() < 1e-4
    torch.testing.assert_close(whole.driving.norm(dim=-1).amax(-1), torch.ones(2, 3))


@pytest.mark.slow
def test_appearance_of_the_truth_does_not_depend_on_its_normalisation():
    """Eq. 5 at the truth is what skinning does to edges, and not a change of unit."""
    found, as_given = [], []
    for scale in ("truth", "identity"):
        config = AniFormerData("clips80", target_scale=scale)
        batch = WindowSource(config, shipped_body(), torch.device("cpu"), 3, 3).batch(2, 0)
        given = (batch.truth, batch.truth, batch.identity, batch.driving, batch.edges)
        weights = {"motion": "off", "appearance_weight": 1.0}
        found.append(float(aniformer_loss(*given, batch.unit, **weights)))
        as_given.append(float(aniformer_loss(*given, **weights)))
    assert found[0] == pytest.approx(found[1], rel=1e-4) == as_given[1]
    assert as_given[0] > 1.5 * found[0]


def test_a_still_clip_stays_still(monkeypatch):
    monkeypatch.setattr(endless, "MAX_STEP", 0.0)
    monkeypatch.setattr(endless, "CAPTURED", 0.0)
    batch = WindowSource(CASES[1], shipped_body(), torch.device("cpu"), 3, 3).batch(2, 0)
    assert batch.driving.diff(dim=1).abs().max() < 1e-5


@pytest.mark.slow
def test_a_step_is_a_pure_function(source):
    assert_steps_are_pure(source)


@pytest.mark.slow
def test_the_regression_head_trains_on_the_middle_frame_and_validates_on_clips(tmp_path):
    model = dataclasses.replace(TINY.model, head="regression")
    config = dataclasses.replace(TINY, pairs=2, model=model, losses=ClipLossConfig(motion="off"))
    metrics = checkpoint.load(train(config, tmp_path / "run") / "best.safetensors").metrics
    assert set(metrics) == {"seen", "unseen", "procedural", "fresh", "val"}


@pytest.mark.slow
def test_weights_of_a_vertex_are_trained_where_that_vertex_is_drawn(tmp_path):
    """The public code has norms and an embedding for each vertex; of a batch, those of its vertices are used."""
    count = len(shipped_body().vertices)
    data = AniFormerData("clips80", 32, pairing="order")
    config = dataclasses.replace(TINY, data=data, model=dataclasses.replace(TINY.model, vertices=count))
    run = TrainingRun.start(config, tmp_path)
    model, batch = run.model, run.source.batch(2, 0)
    run.task.loss(model, batch, 0).backward()
    for weight in (model.embedding, model.affine[0].scale):
        used = weight.grad.reshape(-1, count).abs().sum(0) > 0
        assert torch.equal(used.nonzero()[:, 0], batch.index.unique())
    # All vertices in their order are the same as all of them by number.
    whole = WindowSource(dataclasses.replace(data, vertices=0), shipped_body(), torch.device("cpu"), 0, 3).batch(1, 0)
    straight = whole.index[0].argsort()
    with torch.no_grad():
        by_number = model(whole.identity, whole.driving, whole.index)[:, :, straight]
        in_order = model(whole.identity[:, straight], whole.driving[:, :, straight])
    assert torch.allclose(by_number, in_order, atol=1e-5)


@pytest.mark.slow
def test_weights_of_a_vertex_need_the_vertices_of_the_meshes(tmp_path):
    config = load_config("table", "aniformer", ["model.vertices=100", "data.pairing=order"])
    with pytest.raises(InputError, match=r"model.vertices: expected 0 or 6890"):
        train(config, tmp_path)
