"""Characters in mime's training pairs: exact transfers, random proportions, and props."""

import dataclasses
import json
from contextlib import nullcontext

import pytest
import torch
from motion_files import write_bvh
from pools import write_character

from mimesh.core.errors import InputError
from mimesh.core.options import TrainingFiles
from mimesh.learn import checkpoint
from mimesh.learn.config import load_config
from mimesh.learn.data.bodies import posed_joints, skinned
from mimesh.learn.data.characters import TrainingCharacters
from mimesh.learn.data.figures import FigureSampler
from mimesh.learn.data.surfaces import repeat_visible
from mimesh.learn.mime import MimeData, SurfaceSource, mime_loss
from mimesh.learn.start import new_config, read_user_data, train_command
from mimesh.learn.task import shipped_body
from mimesh.motions.procedural import walk_motion

BODY = shipped_body()
CPU = torch.device("cpu")
TINY = ["data.characters=0.5", "pairs=64", "batch=8", "validate_every=1000", "validation_pairs=1"]
TINY += ["compile=false", "data.vertices=32", "model.width=32", "precision=fp32"]


@pytest.fixture(scope="module")
def source(pool):
    config = MimeData("wide", 200, "identity", heading=180.0, characters=1.0)
    return SurfaceSource(config, BODY, CPU, 0, TrainingCharacters.read(pool, BODY))


@pytest.mark.slow
@pytest.mark.parametrize("low_poly", [0.0, 1.0])
def test_an_identity_at_rest_is_moved_to_the_truth_exactly(pool, source, low_poly, monkeypatch):
    """By linear blend skinning with its own joints and weights, whatever its proportions, props and missing joints."""
    monkeypatch.setattr("mimesh.learn.data.figures.OWN_REST", 1.0)
    characters = TrainingCharacters.read(pool, BODY, low_poly=True)
    batch = SurfaceSource(dataclasses.replace(source.config, low_poly=low_poly), BODY, CPU, 0, characters).batch(12, 0)
    own, driving, truth = batch.identity, batch.driving, batch.truth
    joints = posed_joints(own.rotation, own.joints, driving.rotation, truth.joints[:, 0], BODY.parents)
    moved = skinned(own.points, own.weights, own.rotation, own.joints, driving.rotation, joints)
    assert (moved - truth.points).norm(dim=-1).max() < 1e-5
    assert torch.allclose(own.weights.sum(-1), torch.ones(12, 200), atol=1e-5)
    # Low-poly versions that are not drawn change nothing.
    assert torch.equal(own.points, source.batch(12, 0).identity.points) == (low_poly == 0.0)


@pytest.mark.slow
def test_joints_that_are_not_known_have_no_loss(source):
    from mimesh.learn.mime import MimeNetwork

    config = load_config("small", "mime", ["model.width=32"])
    batch = source.batch(6, 0)
    torch.manual_seed(0)
    model = MimeNetwork(config.model, BODY)
    loss = mime_loss(model, batch, config.structure)
    unknown = ~batch.identity.turning
    assert unknown.any()
    changed = batch.identity.rotation.clone()
    changed[unknown] = torch.eye(3)[[1, 2, 0]]
    other = dataclasses.replace(batch, identity=dataclasses.replace(batch.identity, rotation=changed))
    assert torch.equal(loss, mime_loss(model, other, config.structure))
    changed[~unknown] = torch.eye(3)[[1, 2, 0]]
    other = dataclasses.replace(batch, identity=dataclasses.replace(batch.identity, rotation=changed))
    assert not torch.equal(loss, mime_loss(model, other, config.structure))


def test_packs_take_turns(pool):
    surfaces = [*TrainingCharacters.read(pool, BODY).surfaces]
    surfaces += [dataclasses.replace(surfaces[0], pack="many")] * 18
    sampler = FigureSampler(surfaces, BODY, CPU)
    drawn = sampler.draw(3000, torch.Generator().manual_seed(0)).which
    share = torch.bincount(drawn, minlength=20) / 3000
    assert abs(share[0] - 1 / 3) < 0.05
    assert abs(share[1] - 1 / 3) < 0.05
    assert share[2:].min() > 0


@pytest.mark.slow
def test_large_heads_have_more_of_the_points(source):
    figures = source.figures.figures.draw(64, torch.Generator().manual_seed(1))
    head = BODY.joint("Head")
    one = torch.ones_like(figures.length)
    large = one.clone()
    large[:, head] = 3.0
    share = []
    for scale in (one, large):
        some = dataclasses.replace(figures, length=scale, girth=scale, lacking=torch.zeros_like(figures.lacking))
        index = source.figures.bank.choose(some, 200, torch.Generator().manual_seed(2), 0.0)
        share.append(posed(source, some, index).weights[..., head].mean())
    assert share[1] > 1.5 * share[0]


def posed(source, figures, index):
    """Points of figures at rest."""
    bank = source.figures.bank
    return bank.posed(figures, bank.shaped(figures, index), bank.alignment[figures.which])


@pytest.mark.slow
def test_missing_hands_have_no_points(source):
    figures = source.figures.figures.draw(32, torch.Generator().manual_seed(1))
    ends = source.figures.figures.ends[0]
    bare = dataclasses.replace(figures.props, there=torch.zeros_like(figures.props.there))
    some = dataclasses.replace(figures, lacking=ends.expand(32, -1), props=bare)
    index = source.figures.bank.choose(some, 200, torch.Generator().manual_seed(2), 0.0)
    found = posed(source, some, index)
    assert not ends[found.weights.argmax(-1)].any()
    assert not found.turning[:, ends].any()


def test_props_are_moved_by_one_joint(source, monkeypatch):
    monkeypatch.setattr("mimesh.learn.data.figures.PROP_SHARE", 1.0)
    figures = source.figures.figures.draw(16, torch.Generator().manual_seed(3))
    total = source.figures.bank.points.shape[1]
    index = torch.arange(total, total + figures.props.there.shape[1]).expand(16, -1)
    assert ((posed(source, figures, index).weights == 1).sum(-1) == 1).all()
    assert figures.props.there.float().mean(1).min() > 0


def test_characters_are_for_some_networks_and_wide_data_only(pool):
    with pytest.raises(InputError, match=r"expected data.characters with data.kind wide only"):
        load_config("table", "mime", ["data.characters=0.5"])
    with pytest.raises(InputError, match=r"--characters: expected a model that is trained on them, found aniformer"):
        train_command("aniformer", "small", None, None, None, [], None, TrainingFiles(pool))


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walks")
    write_bvh(folder / "walk.bvh", BODY, walk_motion(BODY, 0, 0))
    return folder


@pytest.mark.slow
def test_a_training_on_characters_says_whose_they_are_and_resumes_with_the_same(pool, clips, tmp_path):
    """Augmentations and clips may begin where it is resumed."""
    out, other = tmp_path / "run", tmp_path / "other"
    train_command("mime", "small", out, None, 0.001, TINY, None, TrainingFiles(pool))
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    told = next(line["text"] for line in lines if line["kind"] == "characters")
    assert told.startswith("1 of we: people (CC0-1.0), 1 of we: toys (CC0-1.0); 6 poses of their clips")
    before = checkpoint.load(out / "last.safetensors")
    assert before.characters["makers"] == {"we: people (CC0-1.0)": 1, "we: toys (CC0-1.0)": 1}

    def resume(changes=(), *brought):
        train_command("mime", "small", None, out, 0.001, list(changes), None, TrainingFiles(*brought))
        return checkpoint.load(out / "last.safetensors")

    with pytest.raises(InputError, match=r"--characters: expected a folder with data.characters 0.5, found none"):
        resume()
    other.mkdir()
    write_character(other, "one", split="train")
    with pytest.raises(InputError, match="expected the characters of the training so far"):
        resume((), other)
    same = resume((), pool)
    assert (same.config, same.changes) == (before.config, ())
    assert same.step > before.step
    state = resume(["data.low_poly=0.5"], pool, clips)
    assert state.config.data.low_poly == 0.5
    assert [set(change) for change in state.changes] == [{"after_pairs", "data.low_poly", "clips", "was"}]
    assert state.characters["sha256"] == before.characters["sha256"]
    assert list(state.characters["clips"]["makers"].values()) == [1]
    for changes, brought, message in (
        ((), (pool,), "expected the characters and clips of the training so far"),
        (["batch=4"], (pool, clips), r"--set batch=4: expected no changes with --resume but --set seed, pairs"),
        ((), (pool, clips, ["toys"]), r"--leave-out toys: expected no changes with --resume"),
    ):
        with pytest.raises(InputError, match=message):
            resume(changes, *brought)


def test_a_pack_is_left_out_by_one_option(pool, tmp_path, monkeypatch):
    """A folder alone gives characters half of every batch."""
    monkeypatch.chdir(tmp_path)
    config, out = new_config("mime", "small", None, TINY[1:], TrainingFiles(pool, leave_out=["toys"]))
    assert out.name.endswith("-without-toys")
    assert (config.data.characters, config.data.leave_out) == (0.5, ("toys",))
    found = read_user_data(config, TrainingFiles(pool), lambda _: nullcontext())
    assert found.facts["left_out"] == {"toys": 1}
    with pytest.raises(InputError, match=r"--leave-out toys: expected it with --characters"):
        train_command(
            "mime", "small", tmp_path / "other", None, 0.001, TINY[1:], None, TrainingFiles(leave_out=["toys"])
        )


@pytest.mark.slow
def test_clips_alone_join_the_poses_of_people(clips, tmp_path):
    out = train_command("mime", "small", tmp_path / "run", None, 0.001, TINY[1:], None, TrainingFiles(clips=clips))
    state = checkpoint.load(out / "last.safetensors")
    assert state.characters.keys() == {"clips"}
    assert state.config.data.characters == 0
    with pytest.raises(InputError, match=r"--clips: expected a model that is trained on them, found npt"):
        train_command("npt", "small", tmp_path / "npt", None, None, [], None, TrainingFiles(clips=clips))


def test_low_poly_people_have_few_normals():
    source = SurfaceSource(MimeData("wide", 1500, "identity", low_poly=1.0), BODY, CPU, 0)
    people = source.dressed.draw(3, torch.Generator().manual_seed(0), 1.0)
    plain = torch.ones_like(people.length)
    skin = (torch.arange(people.worn.shape[1]) < 1).expand(3, -1)
    people = dataclasses.replace(people, length=plain, girth=plain, worn=skin, level=torch.tensor([1, 3, 0]))
    index = source.surface.choose(people, 1500, torch.Generator().manual_seed(1))
    rest = torch.eye(3).expand(3, len(BODY.parents), 3, 3)
    normals = source.surface.posed(people, rest, index).normals
    counts = [len(torch.unique(mesh.round(decimals=4), dim=0)) for mesh in normals]
    assert counts[0] < 250 < counts[1] < counts[2]


def test_what_is_visible_is_repeated():
    hidden = torch.zeros(1, 5, dtype=torch.bool)
    hidden[0, :3] = True
    assert repeat_visible(hidden)[0].tolist() == [3, 4, 3, 4, 3]
