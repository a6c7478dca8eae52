"""Characters in NPT's training pairs: truths of the identity's points, driving meshes of characters and people."""

import dataclasses
import json

import pytest
import torch
from trainings import TINY, assert_steps_are_pure, edge_lengths, length_changes

from mimesh.__main__ import run
from mimesh.core.errors import InputError
from mimesh.core.options import TrainingFiles
from mimesh.learn import checkpoint
from mimesh.learn.data.bodies import numbers_of_step
from mimesh.learn.data.characters import TrainingCharacters
from mimesh.learn.data.figures import CharacterPairSource
from mimesh.learn.data.people import PairSource
from mimesh.learn.export import described_data
from mimesh.learn.npt import NPTData
from mimesh.learn.start import train_command
from mimesh.learn.task import shipped_body

BODY = shipped_body()
CPU = torch.device("cpu")
CONFIG = NPTData("wide", 256, "identity", heading=180.0, characters=1.0)


def source(pool, **changes):
    config = dataclasses.replace(CONFIG, **changes)
    return CharacterPairSource(config, BODY, CPU, 0, TrainingCharacters.read(pool, BODY))


@pytest.mark.parametrize("scale", ["identity", "truth"])
def test_truths_have_the_points_of_their_identities(pool, scale):
    """Lengths between neighbours change little in any pose; were rows mixed up, they would change wildly."""
    batch = source(pool, target_scale=scale).batch(12, 0)
    assert (length_changes(batch.identity, batch.truth, batch.edges) < 0.15).all()
    assert (length_changes(batch.identity, batch.truth.roll(1, dims=1), batch.edges) > 0.3).all()
    old, new = (edge_lengths(mesh, batch.edges) for mesh in (batch.identity, batch.truth))
    assert (old.median() < 0.1).item()
    if scale == "identity":
        assert (((new / old).median(dim=1).values - 1).abs() < 0.05).all()
    else:
        assert ((batch.truth.norm(dim=-1).amax(1) - 1).abs() < 0.1).all()


def test_driving_meshes_have_the_pose_of_the_truth(pool):
    """Of characters and of people: each lies nearer to its own truth than to the others, most of the time."""
    batch = source(pool, target_scale="truth").batch(16, 0)
    distance = torch.stack([torch.cdist(batch.driving, truth[None]).amin(2).mean(1) for truth in batch.truth], 1)
    own = distance.argmin(1) == torch.arange(16)
    assert own[:8].sum() >= 6
    assert own[8:].sum() >= 6
    apart = (batch.driving - batch.truth).norm(dim=-1).median()
    assert apart > 0.3  # rows are in another order


def test_identities_and_driving_meshes_are_in_the_unit_sphere(pool):
    batch = source(pool).batch(16, 1)
    for mesh in (batch.identity, batch.driving):
        radius = mesh.norm(dim=-1).amax(1)
        assert (radius < 1.03).all()
        assert (radius > 0.8).all()


def test_characters_are_a_share_of_every_batch(pool):
    """The others are the people that there would be without characters; steps are pure."""
    mixed = source(pool, characters=0.25, vertices=32)
    assert_steps_are_pure(mixed)
    alone = PairSource(dataclasses.replace(CONFIG, vertices=32), BODY, CPU, 0)
    alone.people.motion_frames = mixed.people.motion_frames
    people = alone.pairs(6, numbers_of_step(0, 4, alone.device))
    batch = mixed.batch(8, 4)
    assert torch.equal(batch.truth[:6], people.truth)
    assert batch.edges.shape == (8, 16, 2)


@pytest.mark.slow
def test_train_npt_on_characters_by_the_command_line(pool, tmp_path, capsys):
    data = {"kind": "wide", "vertices": 32, "target_scale": "identity"}
    values = dataclasses.asdict(TINY) | {"data": data, "pairs": 8, "batch": 4, "precision": "fp32"}
    (tmp_path / "tiny.yaml").write_text(json.dumps(values))
    out = tmp_path / "run"
    assert (
        run(["train", "npt", "--config", str(tmp_path / "tiny.yaml"), "--characters", str(pool), "-o", str(out)]) == 0
    )
    assert "characters 0 pairs: 1 of we: people (CC0-1.0), 1 of we: toys (CC0-1.0)" in capsys.readouterr().err
    state = checkpoint.load(out / "last.safetensors")
    assert (state.step, state.config.data.characters) == (2, 0.5)
    assert state.characters["makers"] == {"we: people (CC0-1.0)": 1, "we: toys (CC0-1.0)": 1}
    assert run(["train", "npt", "--resume", str(out), "--characters", str(pool), "--set", "pairs=12"]) == 0
    assert checkpoint.load(out / "last.safetensors").step == 3
    words = "characters of others (`characters`) in these poses and those of their clips"
    assert described_data(state.config.data).endswith(words)


def test_tables_and_whole_meshes_take_no_characters(pool):
    for changes, found in (
        ([], "0.5 with table6 and 128"),
        (["data.kind=wide", "data.vertices=0"], "0.5 with wide and all"),
    ):
        with pytest.raises(InputError, match=f"up to 1024 data.vertices, found {found}"):
            train_command("npt", "table", None, None, None, changes, None, TrainingFiles(pool))
