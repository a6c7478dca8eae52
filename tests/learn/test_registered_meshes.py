"""Training on a folder of registered meshes or clips: what batches hold, what is held out, refused and resumed."""

import dataclasses
import json
from typing import get_args, get_type_hints

import numpy as np
import pytest
import torch
from people import person
from registered import FACES, FILE, write_clips, write_meshes
from trainings import TINY, assert_steps_are_pure, losses

from mimesh.__main__ import run
from mimesh.core.errors import InputError
from mimesh.core.geometry import edges
from mimesh.core.mesh import Mesh
from mimesh.core.normalization import bbox_centre, radius
from mimesh.core.options import TrainingFiles
from mimesh.evaluate.measure import TRAINED_ON, training_facts
from mimesh.evaluate.protocols import HUMAN_NPT
from mimesh.io import load_mesh, save_mesh
from mimesh.learn import checkpoint
from mimesh.learn.aniformer import AniFormerConfig, AniFormerData, AniFormerTrainConfig
from mimesh.learn.config import options_of
from mimesh.learn.data.registered import HeldOutMeshes, MeshPairSource, MeshWindowSource, RegisteredMeshes
from mimesh.learn.export import DATA, described_data
from mimesh.learn.loop import TrainingRun
from mimesh.learn.models import NETWORKS, find_task
from mimesh.learn.npt import NPTData
from mimesh.learn.start import train_command
from mimesh.learn.validation import Validation

CPU = torch.device("cpu")
ALL = NPTData("meshes", 0)
MESHES = dataclasses.replace(TINY, data=NPTData("meshes", 64), precision="fp32")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("meshes")


@pytest.fixture(scope="module")
def written(folder):
    """The vertices of the files of a folder, by person and pose."""
    return {who(name): mesh.vertices for name, mesh in write_meshes(folder).items()}


@pytest.fixture(scope="module")
def files(written):
    """The same, normalised."""
    return {name: normalised(points) for name, points in written.items()}


@pytest.fixture(scope="module")
def meshes(folder, written):
    return read(folder)


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    path = tmp_path_factory.mktemp("clips")
    write_clips(path)
    return path


def read(folder, window=1, /, **options):
    """Read the meshes of a folder with options of the data."""
    return RegisteredMeshes.read(folder, NPTData("meshes", **options), window)


def centred(points):
    return points - bbox_centre(points)


def normalised(points):
    return centred(points) / radius(centred(points))


def name_of(points, files):
    """Find the file whose vertices some points are, in any order, and the vertex of each."""
    (found,) = [
        (name, np.linalg.norm(points[:, None] - file[None], axis=-1).argmin(1))
        for name, file in files.items()
        if np.abs(np.sort(points, axis=0) - np.sort(file, axis=0)).max() < 1e-5
    ]
    return found


def who(name):
    i, _, b = name.removeprefix("id").removesuffix(".ply").partition("_")
    return int(i), int(b)


def samples(batch):
    return zip(batch.identity.numpy(), batch.driving.numpy(), batch.truth.numpy(), strict=True)


def test_batches_hold_what_the_files_hold(files, meshes):
    """Truth vertex i is that of identity vertex i, driving meshes are other people in another order of their own."""
    source = MeshPairSource(ALL, meshes, CPU, 0)
    seen = set()
    for step in range(6):
        batch = source.batch(4, step)
        for identity, driving, truth in samples(batch):
            (i, a), order = name_of(identity, files)
            (j, b), other = name_of(driving, files)
            assert i != j
            assert a != b
            assert sorted(order) == sorted(other) == list(range(len(order)))
            assert (order != other).mean() > 0.9
            np.testing.assert_allclose(truth, files[i, b][order], atol=1e-6)
            seen |= {(i, a), (j, b), (i, b)}
    assert {i for i, _ in seen} == {0, 1, 2}  # person 3 and pose 4 are held out
    assert {b for _, b in seen} == {0, 1, 2, 3}


def test_the_truth_may_keep_the_identity_s_unit(written, files, meshes):
    batch = MeshPairSource(dataclasses.replace(ALL, target_scale="identity"), meshes, CPU, 0).batch(3, 0)
    for identity, driving, truth in samples(batch):
        ((i, a), order), ((_, b), _) = name_of(identity, files), name_of(driving, files)
        expected = centred(written[i, b]) / radius(centred(written[i, a]))
        np.testing.assert_allclose(truth, expected[order], atol=1e-5)


def test_subsets_have_edges_of_the_mesh(files, meshes):
    pairs = set(map(tuple, edges(person(0, 0, FACES).faces)))
    batch = MeshPairSource(dataclasses.replace(ALL, vertices=40), meshes, CPU, 0).batch(2, 0)
    assert batch.identity.shape == batch.driving.shape == batch.truth.shape == (2, 40, 3)
    for points, rows in zip(batch.identity.numpy(), batch.edges.numpy(), strict=True):
        near = {name: np.linalg.norm(points[:, None] - file[None], axis=-1) for name, file in files.items()}
        distance = min(near.values(), key=lambda d: d.min(1).max())
        assert distance.min(1).max() < 1e-6
        vertex = distance.argmin(1)
        assert {tuple(sorted(vertex[row])) for row in rows} <= pairs


@pytest.mark.parametrize("vertices", [0, 32])
def test_a_step_is_a_pure_function(meshes, clips, vertices):
    config = NPTData("meshes", vertices, reflect=0.5)
    assert_steps_are_pure(MeshPairSource(config, meshes, CPU, 3))
    assert_steps_are_pure(MeshWindowSource(config, read(clips, 3), CPU, 3))


@pytest.mark.slow
def test_not_every_person_needs_every_pose(files, tmp_path):
    """Person 0 alone has pose 0; person 2 has pose 1 only, which is its own identity."""
    write_meshes(tmp_path, 3, 3, leave_out=[(1, 0), (2, 0), (2, 2)])
    meshes = read(tmp_path)
    assert "seen" not in meshes.pairs  # nothing can be held out of so few
    assert meshes.pairs["training"].truths.tolist() == [[0, 1], [0, 2], [1, 1], [1, 2], [2, 1]]
    assert "validated on `val` of the shipped body" in meshes.described()
    source = MeshPairSource(ALL, meshes, CPU, 0)
    batch = source.batch(300, 0)
    found = {
        (name_of(identity, files)[0], name_of(driving, files)[0])
        for identity, driving in zip(batch.identity.numpy(), batch.driving.numpy(), strict=True)
    }
    assert found == {
        ((0, 0), (1, 1)), ((0, 2), (1, 1)), ((0, 0), (2, 1)), ((0, 2), (2, 1)), ((1, 2), (0, 1)), ((1, 2), (2, 1)),
        ((2, 1), (0, 1)), ((2, 1), (1, 1)), ((0, 0), (1, 2)), ((0, 1), (1, 2)), ((1, 1), (0, 2)),
    }  # fmt: skip


def test_validation_is_on_new_people_in_known_and_new_poses(files, meshes):
    task = find_task("npt")(MESHES, CPU, "fp32", meshes)
    validation = Validation(task)
    for kind, poses in (("seen", {0, 1, 2, 3}), ("unseen", {4})):
        for k in range(8):
            trial = validation.trial(kind, k)
            (i, a), order = name_of(normalised(trial.identity.vertices), files)
            (j, b), _ = name_of(normalised(trial.driving.vertices), files)
            assert (i, b in poses, a < 4, j != i) == (3, True, True, True)
            np.testing.assert_allclose(normalised(trial.truth), files[i, b][order], atol=1e-5)
    assert not np.array_equal(order, np.arange(len(order)))
    model = task.make_model()
    figures = validation.measure(model)
    assert figures is not None
    assert figures["val"] == (figures["unseen"] + figures["fresh"]) / 2


def test_windows_are_the_same_frames_of_two_people(clips):
    named = ((int(name[1]), int(name[7]), clip) for name, clip in write_clips(clips).items())
    files = {(i, m, t): normalised(points) for i, m, clip in named for t, points in enumerate(clip.vertices)}
    meshes = read(clips, 3)
    batch = MeshWindowSource(ALL, meshes, CPU, 0).batch(6, 0)
    for identity, driving, truth in samples(batch):
        (i, motion, _), order = name_of(identity, files)
        named = [name_of(frame, files) for frame in driving]
        (j, other, start), _ = named[0]
        assert (i != j, motion != other) == (True, True)
        assert [name for name, _ in named] == [(j, other, start + t) for t in range(3)]
        assert all(np.array_equal(other_order, named[0][1]) for _, other_order in named)
        for t in range(3):
            np.testing.assert_allclose(truth[t], files[i, other, start + t][order], atol=1e-6)
    config = AniFormerTrainConfig(data=AniFormerData("meshes", 32), validation_pairs=2)
    trial = Validation(find_task("aniformer")(config, CPU, "fp32", meshes)).trial("unseen", 0)
    assert trial.clip.vertices.shape == trial.truth_frames.shape == (3, len(order), 3)
    (i, _, _), order = name_of(normalised(trial.identity.vertices), files)
    (_, motion, start), _ = name_of(normalised(trial.clip.vertices[0]), files)
    assert (i, motion) == (3, 3)
    np.testing.assert_allclose(normalised(trial.truth_frames[2]), files[3, 3, start + 2][order], atol=1e-5)


def test_clips_of_a_motion_must_have_one_length(tmp_path):
    write_clips(tmp_path, 2, 2, lambda i, m: 4 + i if m == 0 else 6)
    with pytest.raises(
        InputError, match=r"walk0.npz: expected the 4 frames .*found 5.*generate_on_body_model.py clips-aniformer"
    ):
        read(tmp_path, 3)
    write_clips(tmp_path, 2, 2)
    with pytest.raises(InputError, match="expected clips of 7 frames or more, found at most 6"):
        read(tmp_path, 7)


def test_meshes_are_turned_to_y_up_by_the_axes_of_the_files(folder, written, tmp_path):
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # y up becomes z up, +z front becomes -y
    for (i, b), points in written.items():
        save_mesh(Mesh(points @ turn.T, person(0, 0, FACES).faces), tmp_path / FILE.format(person=i, pose=b))
    upright, turned = read(folder), read(tmp_path, up="z", front="-y")
    np.testing.assert_allclose(turned.points, upright.points, atol=1e-6)
    assert "up +z, front -y" in turned.described()
    with pytest.raises(InputError, match=r"data\.up: expected one of"):
        read(tmp_path, up="sky")


def test_damaged_files_and_other_topologies_are_refused_by_name(tmp_path):
    write_meshes(tmp_path, 3, 4)
    flat = Mesh(np.zeros_like(person(0, 0, FACES).vertices), person(0, 0, FACES).faces)
    for name, bad, message in (
        ("id2_2.ply", flat, "expected a mesh with some size"),
        ("id1_2.ply", person(1, 2, 2 * FACES), "expected the topology of id0_0.ply"),
    ):
        save_mesh(bad, tmp_path / name)
        with pytest.raises(InputError, match=f"{name}: {message}"):
            read(tmp_path)
    (tmp_path / "id0_1.ply").write_bytes((tmp_path / "id0_1.ply").read_bytes()[:-400])
    with pytest.raises(InputError, match=r"id0_1\.ply"):
        read(tmp_path)


def test_folders_without_a_pair_are_refused(tmp_path):
    (tmp_path / "alone").mkdir()
    write_meshes(tmp_path / "alone", 1, 3)
    found = r"two people in one pose, found none \(id\{person:d\}_\{pose\}: 3 meshes of 1 people in 3 poses\)"
    with pytest.raises(InputError, match=found):
        read(tmp_path / "alone")


def test_resume_continues_with_the_same_meshes_only(meshes, tmp_path):
    first = TrainingRun.start(MESHES, tmp_path / "none", meshes)
    losses(first, 1)
    first.save(tmp_path / "last.safetensors")
    expected = losses(first, 1)
    assert losses(TrainingRun.start(MESHES, tmp_path, meshes), 1) == expected
    other = tmp_path / "other"
    write_meshes(other, 3)
    message = r"expected the meshes of the training so far \(.*20 of 4 people\), found others"
    with pytest.raises(InputError, match=message):
        TrainingRun.start(MESHES, tmp_path, read(other))
    with pytest.raises(InputError, match=r"--meshes: expected the folder of meshes"):
        train_command("npt", "small", None, tmp_path, 0.001)


@pytest.mark.usefixtures("written")
def test_options_that_do_not_go_together_are_refused(folder, tmp_path):
    for model, changes, options, message in (
        ("mime", [], {"meshes": folder}, "--meshes: expected a model that is trained on them, found mime"),
        ("npt", ["data.kind=table6"], {"meshes": folder}, "expected a training on meshes, found one on table6"),
        ("npt", ["data.kind=meshes"], {}, "expected the folder of meshes"),
        ("npt", [], {"pattern": "{person}_{pose}"}, "--pattern {person}_{pose}: expected it with --meshes"),
        ("npt", [], {"meshes": folder, "characters": folder}, "expected it without --characters and --clips"),
        ("aniformer", [], {"meshes": folder}, "expected clips of 3 frames or more, found at most 1"),
    ):
        with pytest.raises(InputError) as error:
            train_command(model, "small", tmp_path / "run", None, 0.001, changes, brought=TrainingFiles(**options))
        assert message in str(error.value)
    assert not (tmp_path / "run").exists()


def test_reports_and_cards_describe_every_kind_of_data():
    kinds = {kind for model in NETWORKS for kind in get_args(get_type_hints(options_of(model))["kind"])}
    assert set(TRAINED_ON) == set(DATA) == kinds


@pytest.mark.slow
def test_what_generate_writes_is_read(tmp_path, monkeypatch):
    few = dataclasses.replace(HUMAN_NPT, people=3, poses=4)
    monkeypatch.setattr("mimesh.evaluate.generate.find_protocol", lambda *_: few)
    assert run(["generate", "human-npt", "--split", "train", "-o", str(tmp_path / "table")]) == 0
    facts = read(tmp_path / "table").facts
    assert (facts["people"], facts["poses"], facts["vertices"]) == (3, 4, 6890)
    assert facts["held_out"] == {"people": ["2"], "poses": ["3"]}


def train_by_command(network, config, data, folder):
    """Train and resume in `folder`/run, and return the checkpoint."""
    values = dataclasses.asdict(config) | {"data": {"vertices": 32}, "pairs": 8, "validate_every": 8}
    (folder / "tiny.yaml").write_text(json.dumps(values))
    out = str(folder / "run")
    assert run(["train", network, "--config", str(folder / "tiny.yaml"), "--meshes", str(data), "-o", out]) == 0
    assert run(["train", network, "--resume", out, "--meshes", str(data), "--set", "pairs=12"]) == 0
    state = checkpoint.load(folder / "run" / "last.safetensors")
    assert state.step * config.batch == 12
    return state


@pytest.mark.slow
@pytest.mark.usefixtures("written", "tiny_exports")
def test_train_export_and_transfer_by_the_command_line(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    state = train_by_command("npt", MESHES, folder, tmp_path)
    assert "meshes 0 pairs: id{person:d}_{pose}: 20 meshes of 4 people in 5 poses" in capsys.readouterr().err
    assert run(["export", "run/last.safetensors", "-o", "mine.onnx"]) == 0
    card = json.loads((tmp_path / "mine.json").read_text())
    assert card["data"] == "registered meshes or clips of a folder (`meshes`)"
    assert card["meshes"] == state.meshes
    assert card["metrics"]["val"].keys() == {"seen_pmd_e4", "unseen_pmd_e4", "fresh_pmd_e4", "val_pmd_e4"}
    assert training_facts("mine.onnx")["trained"].endswith(
        "12 pairs of 32 vertices; registered meshes, 4 people x 5 poses"
    )
    save_mesh(person(5, None, FACES), tmp_path / "hero.obj")
    save_mesh(person(6, 3, FACES), tmp_path / "pose.obj")
    assert run(["transfer", "hero.obj", "pose.obj", "-m", "mine.onnx", "-o", "out.obj", "--no-preview"]) == 0
    assert load_mesh(tmp_path / "out.obj").vertices.shape == person(5, None, FACES).vertices.shape


@pytest.mark.slow
def test_train_aniformer_on_clips_by_the_command_line(clips, tmp_path, capsys):
    small = AniFormerConfig(encoder=(8, 16, 16), layers=(8,), heads=1, attention="frames")
    config = AniFormerTrainConfig(model=small, batch=2, learning_rate=1e-3, validation_pairs=1)
    state = train_by_command("aniformer", config, clips, tmp_path)
    assert "meshes 0 pairs: {person}/{pose}: 16 clips (96 frames) of 4 people in 4 motions" in capsys.readouterr().err
    assert {"seen", "unseen", "fresh", "val"} == set(state.metrics)


HOLD_OUT = [
    (None, None, ("3", "4")),
    (0, 0, ("", "")),
    (2, 0, ("2 3", "")),
    (0, 2, ("", "3 4")),
    (1, 2, ("3", "3 4")),
]


@pytest.mark.parametrize(("people", "poses", "held_out"), HOLD_OUT)
def test_so_many_people_and_poses_are_held_out(folder, files, people, poses, held_out):
    """What is held out is no part of the training and is validated on."""
    meshes = read(folder, held_out_people=people, held_out_poses=poses)
    new, new_poses = (names.split() for names in held_out)
    assert meshes.facts["held_out"] == {"people": new, "poses": new_poses}
    drawn = meshes.pairs["training"].truths.tolist()
    assert len(drawn) == (4 - len(new)) * (5 - len(new_poses))
    assert not [pair for pair in drawn if str(pair[0]) in new or str(pair[1]) in new_poses]
    held = HeldOutMeshes.of(meshes)
    kinds = ("seen",) * bool(new) + ("unseen",) * bool(new_poses)
    assert (() if held is None else held.kinds) == kinds
    for kind in kinds:
        for k in range(6):
            trial = held.unshuffled_pair("val", kind, k, np.random.default_rng(k))
            ((i, a), _), ((j, b), _) = (
                name_of(normalised(mesh.vertices), files) for mesh in (trial.identity, trial.driving)
            )
            assert (not new or str(i) in new, i != j, str(a) in new_poses) == (True, True, False)
            assert (str(b) in new_poses) == (kind == "unseen")
            np.testing.assert_allclose(normalised(trial.truth), files[i, b], atol=1e-5)
    task = find_task("npt")(dataclasses.replace(MESHES, validation_pairs=1), CPU, "fp32", meshes)
    assert task.protocol.kinds == (kinds or ("seen", "unseen"))


@pytest.mark.parametrize(("people", "poses"), [(4, None), (3, 0)])
@pytest.mark.usefixtures("written")
def test_what_cannot_be_held_out_is_refused(folder, people, poses):
    with pytest.raises(InputError, match=rf"held_out_people={people}, .*of 4 people and 5 poses, found a part without"):
        read(folder, held_out_people=people, held_out_poses=poses)


@pytest.mark.usefixtures("written")
def test_animals_are_validated_as_such(folder):
    """What the meshes are is said by data.body; where nothing is held out, the shipped quadruped validates."""
    config = dataclasses.replace(MESHES, data=NPTData("meshes", 64, body="quadruped"))
    config.check("here")
    assert described_data(config.data).endswith("of animals")
    meshes = read(folder, held_out_people=0, held_out_poses=0)
    assert find_task("npt")(config, CPU, "fp32", meshes).protocol.name == "quadruped"
