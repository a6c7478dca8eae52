"""Training windows: aligned truth, one shuffle for all frames, reproducible steps; and an AniFormer trained on them."""

import dataclasses

import pytest
import torch

from mimesh.bodies import load_body
from mimesh.core.errors import InputError
from mimesh.evaluate.clip_protocols import on_template
from mimesh.learn import clip_batches
from mimesh.learn.aniformer import AniFormerConfig
from mimesh.learn.batches import DataConfig
from mimesh.learn.checkpoint import make_model
from mimesh.learn.clip_batches import ClipSource
from mimesh.learn.clip_losses import aniformer_loss, middle_of
from mimesh.learn.config import ClipLossConfig, TrainConfig, load_config
from mimesh.learn.limp import LIMPConfig
from mimesh.learn.npt import NPTConfig
from mimesh.learn.train import Run, train
from mimesh.learn.validation import make_validation

CASES = [DataConfig("clips80", 64), DataConfig("clips", 64, "identity"), DataConfig("clips")]
TINY = TrainConfig(
    network="aniformer",
    model=AniFormerConfig(encoder=(8, 16, 16), layers=(16, 16, 8, 8), heads=2, keys=16),
    data=DataConfig("clips80", 32),
    batch=2,
    pairs=8,
    learning_rate=1e-3,
    ema=0.9,
    validation_pairs=1,
    validate_every=4,
)


@pytest.fixture(scope="module", params=CASES, ids=lambda c: f"{c.kind}-{c.vertices or 'all'}")
def source(request):
    return ClipSource(request.param, 3, load_body(), torch.device("cpu"), seed=3)


def test_truth_is_aligned_with_the_identity_in_every_frame(source):
    """The classic bug is a shuffle that misaligns truth: then edges would change length wildly."""
    batch = source.batch(3, 0)
    for t in range(3):
        old, new = (edge_lengths(m, batch.edges) for m in (batch.identity, batch.truth[:, t]))
        scale = (new / old).median(dim=1, keepdim=True).values
        assert ((new / old / scale - 1).abs().median(dim=1).values < 0.05).all()


def edge_lengths(points, edges):
    ends = [points.gather(1, edges[..., k, None].expand(-1, -1, 3)) for k in range(2)]
    return (ends[1] - ends[0]).norm(dim=-1)


def test_driving_is_shuffled_on_its_own_and_alike_in_all_frames(source):
    batch = source.batch(4, 0)
    assert batch.driving.shape == batch.truth.shape
    assert (batch.driving - batch.truth).norm(dim=-1).median() > 0.2
    # A vertex stays itself: from frame to frame it moves far less than vertices lie apart.
    step = (batch.driving[:, 1] - batch.driving[:, 0]).norm(dim=-1).median()
    assert step < 0.3 * (batch.driving[:, 0] - batch.driving[:, 0].roll(1, 1)).norm(dim=-1).median()


def test_frames_are_centred_and_driving_frames_fill_the_unit_sphere():
    whole = ClipSource(CASES[-1], 3, load_body(), torch.device("cpu"), seed=3).batch(2, 1)
    for points in (whole.driving, whole.truth, whole.identity):
        assert (points.amax(-2) + points.amin(-2)).abs().max() < 1e-4
    torch.testing.assert_close(whole.driving.norm(dim=-1).amax(-1), torch.ones(2, 3))


def test_the_truth_keeps_the_identitys_edges_however_it_is_normalised():
    """Eq. 5 at the truth is what skinning does to edges, and not a change of unit."""
    found, as_given = [], []
    for scale in ("truth", "identity"):
        config = DataConfig("clips80", target_scale=scale)
        batch = ClipSource(config, 3, load_body(), torch.device("cpu"), seed=3).batch(2, 0)
        given = (batch.truth, batch.truth, batch.identity, batch.driving, batch.edges)
        weights = {"motion": "off", "appearance_weight": 1.0}
        found.append(float(aniformer_loss(*given, batch.unit, **weights)))
        as_given.append(float(aniformer_loss(*given, **weights)))
    assert found[0] == pytest.approx(found[1], rel=1e-4) == as_given[1]
    assert as_given[0] > 1.5 * found[0]


def test_a_still_clip_stays_still(monkeypatch):
    monkeypatch.setattr(clip_batches, "REACH", 0.0)
    monkeypatch.setattr(clip_batches, "CAPTURED", 0.0)
    batch = ClipSource(CASES[1], 3, load_body(), torch.device("cpu"), seed=3).batch(2, 0)
    assert batch.driving.diff(dim=1).abs().max() < 1e-5


def test_a_step_is_a_pure_function(source):
    first, again, other = source.batch(2, 5), source.batch(2, 5), source.batch(2, 6)
    for field in dataclasses.fields(first):
        a, b = getattr(first, field.name), getattr(again, field.name)
        assert torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b
    assert not torch.equal(first.truth, other.truth)


def test_training_goes_on_exactly_where_it_stopped(tmp_path):
    whole = Run.start(TINY, tmp_path / "none")
    expected = [float(whole.advance()) for _ in range(4)]
    first = Run.start(TINY, tmp_path / "none")
    begun = [float(first.advance()) for _ in range(2)]
    first.save(tmp_path / "last.safetensors")
    second = Run.start(TINY, tmp_path)
    assert begun + [float(second.advance()) for _ in range(2)] == expected


def test_a_training_validates_on_clips(tmp_path):
    folder = train(TINY, tmp_path / "run")
    log = (folder / "log.jsonl").read_text()
    for kind in ("seen", "unseen", "procedural", "fresh", "val"):
        assert f'"{kind}"' in log
    assert (folder / "best.safetensors").exists()


def test_the_vanilla_head_trains_on_the_middle_frame(tmp_path):
    model = dataclasses.replace(TINY.model, head="regression")
    config = dataclasses.replace(TINY, model=model, losses=ClipLossConfig(motion="off"))
    assert Run.start(config, tmp_path).advance().isfinite()
    truth = torch.arange(6.0).view(1, 3, 2, 1).expand(1, 3, 2, 3)
    assert torch.equal(middle_of(truth, 1), truth[:, 1:2])
    assert middle_of(truth, 3) is truth
    with pytest.raises(InputError, match=r"losses\.motion"):
        load_config("table", "aniformer", ["model.head=regression"])


@pytest.mark.parametrize("name", ["paper", "small", "table"])
def test_shipped_configurations_load(name):
    config = load_config(name, "aniformer")
    assert isinstance(config.model, AniFormerConfig)
    assert config.data.kind.startswith("clips")


@pytest.mark.parametrize("network", ["npt", "aniformer", "regression", "limp"])
def test_validation_holds_each_frame_to_its_own_truth(network, monkeypatch):
    """A network that knows the truth makes no error, and one that is a frame late makes some."""
    models = {"npt": NPTConfig(), "limp": LIMPConfig(), "aniformer": AniFormerConfig()}
    model = models.get(network, AniFormerConfig(head="regression"))
    config = TrainConfig(model=model, data=DataConfig("clips80", 2100), validation_pairs=1)
    validation = make_validation(config, load_body(), torch.device("cpu"))
    trial = validation.trials["unseen"][0]
    known = on_template(trial) if network == "limp" else trial
    first = (len(trial.clip) - 3) // 2

    def spheres(frames, start):
        return torch.stack([validation._sphere(v.astype(float))[0] for v in frames[start : start + 3]])

    def knows(late):
        def infer(model, identity, driving):
            assert torch.equal(driving.view(3, -1, 3), spheres(known.clip.vertices, first))
            answer = spheres(known.truth_frames, first - late)
            return {"aniformer": answer[None], "regression": answer[None, 1:2]}.get(network, answer)

        return infer

    errors = []
    for late in (0, 1):
        monkeypatch.setattr(validation, "_infer", knows(late))
        errors.append(validation.pmd(make_model(config), trial))
    assert errors[0] < 1e-9 < 1e-6 < errors[1]
