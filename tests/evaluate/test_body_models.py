"""`scripts/generate_on_body_model.py`: people and poses of the papers on a model in SMPL's layout; recorded motions."""

from __future__ import annotations

import json

import numpy as np
import pytest
from generate_on_body_model import COMPONENTS, on_body_model, write
from motion_files import Z_UP
from scipy.spatial.transform import Rotation
from smpl_files import loop_vertices, small_arrays, write_model

from mimesh.__main__ import run
from mimesh.bodies.sampling import TABLE_6
from mimesh.core.errors import InputError
from mimesh.evaluate.measure import measure
from mimesh.io import load_clip, load_mesh

FRAMES = 30


def write_takes(folder, joints=24, names=("a/walk_poses", "b/hips_poses"), frames=40):
    """Write motions in the layout of AMASS, z up, and an archive of a shape beside them."""
    for seed, name in enumerate(names):
        rng = np.random.default_rng(seed)
        pose = 0.2 * rng.standard_normal((frames, joints, 3))
        pose[:, 0] = (Rotation.from_matrix(Z_UP) * Rotation.from_rotvec(pose[:, 0])).as_rotvec()
        path = folder / f"{name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, poses=pose.reshape(frames, -1), trans=rng.random((frames, 3)), betas=rng.random(16))
        np.savez(path.with_name("shape.npz"), betas=rng.random(16))
    return folder


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return write_model(tmp_path_factory.mktemp("model") / "SMPL.npz", small_arrays(24, 30, COMPONENTS))


@pytest.mark.parametrize("joints", [24, 52])
def test_people_and_poses_are_those_of_table_6_in_smpl_s_order(joints, tmp_path):
    """Plain loops over the equations give the files; joint k of SMPL is row k + 1 of the table."""
    arrays = small_arrays(joints, 30, 12)
    protocol = on_body_model("human-npt", write_model(tmp_path / "m.npz", arrays))
    shared = 24 if joints == 24 else 22
    for i in (0, 7):
        person, pose = protocol.person("train", i), protocol.pose("train", 3 * i)
        assert person.shape.shape == (COMPONENTS,)
        rotvec = Rotation.from_matrix(pose.rotmat).as_rotvec()
        assert (rotvec[shared:] == 0).all()
        low, high = np.radians(np.array(list(TABLE_6.values()))[:shared]).transpose(2, 0, 1)
        assert ((low - 1e-9 <= rotvec[:shared]) & (rotvec[:shared] <= high + 1e-9)).all()
        expected = loop_vertices(arrays, person.shape, rotvec, np.zeros(3))
        np.testing.assert_allclose(person.posed_mesh(pose).vertices, expected, atol=1e-9)


def test_training_data_has_the_public_names_and_a_stopped_run_goes_on(model, tmp_path):
    protocol = on_body_model("human-npt", model)
    assert write(protocol, tmp_path / "out", "train", 3) == {"files": 48, "kept": 0}
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {f"id{i}_{b}.obj" for i in range(16) for b in range(3)}
    first, lost = tmp_path / "out" / "id0_0.obj", tmp_path / "out" / "id15_2.obj"
    before, content = first.stat().st_mtime_ns, lost.read_bytes()
    lost.unlink()
    assert write(protocol, tmp_path / "out", "train", 3) == {"files": 48, "kept": 47}
    assert (first.stat().st_mtime_ns, lost.read_bytes()) == (before, content)


@pytest.mark.slow
def test_pairs_are_new_people_and_can_be_measured(model, tmp_path, capsys):
    protocol = on_body_model("human-npt", model)
    assert write(protocol, tmp_path, "test", 2)["files"] == len(list(tmp_path.rglob("*.*")))
    for kind in protocol.kinds:
        for line in (tmp_path / f"test-{kind}.txt").read_text().splitlines():
            words = line.split()
            identity, _, truth = (load_mesh(tmp_path / word) for word in words)
            person, pose = truth.name.removeprefix("id").split("_")
            expected = protocol.person("test", int(person)).posed_mesh(
                protocol.pose("train" if kind == "seen" else "test", int(pose))
            )
            np.testing.assert_allclose(truth.vertices, expected.vertices, atol=1e-6)
            assert identity.name.split("_")[0] == f"id{person}"
    heights = json.loads((tmp_path / "test-seen.heights.json").read_text())
    assert all(height > 0 for height in heights.values())
    capsys.readouterr()
    assert run(["evaluate", str(tmp_path), "-m", "copy,identity", "--json"]) == 0
    assert_same_figures(json.loads(capsys.readouterr().out), protocol, "test-")


def assert_same_figures(report, protocol, prefix):
    """Assert that a report on the generated files has the figures of the protocol, whose vertices have other orders."""
    assert report["results"]
    for row in report["results"]:
        assert row["pairs"] > 0
        for i in range(row["pairs"]):
            trial = protocol.pair("test", row["split"].removeprefix(prefix), i)
            expected = measure(trial, row["method"]) | dict(zip(("identity", "driving"), trial.groups, strict=True))
            assert {"seconds", "pmd_e4", "pmd_public_e4", "mm"} < expected.keys()
            for metric in expected.keys() - {"seconds", "still_mm"}:
                value = row["each"][metric][i]
                if metric in ("identity", "driving") or value is None:
                    assert value == expected[metric]
                else:
                    assert value == pytest.approx(expected[metric], rel=1e-4, abs=1e-6), metric


def test_an_animal_is_posed_at_random_but_for_its_root(tmp_path):
    arrays = small_arrays(33, 40, 3)
    path = write_model(tmp_path / "SMAL.pkl", arrays)
    protocol = on_body_model("quadruped", path)
    assert write(protocol, tmp_path / "out", "train", 2)["files"] == 32
    pose = protocol.pose("train", 1)
    rotvec = Rotation.from_matrix(pose.rotmat).as_rotvec()
    assert (rotvec[0] == 0).all()
    assert 0.1 < rotvec[1:].std() < 0.3
    expected = loop_vertices(arrays, protocol.person("train", 2).shape, rotvec, np.zeros(3))
    np.testing.assert_allclose(load_mesh(tmp_path / "out" / "id2_1.obj").vertices, expected, atol=1e-6)


def test_every_person_makes_every_recorded_motion(model, tmp_path):
    takes = write_takes(tmp_path / "takes")
    protocol = on_body_model("clips-aniformer", model, takes)
    assert write(protocol, tmp_path / "out", "train")["files"] == 32
    assert {path.name for path in (tmp_path / "out").iterdir()} == set(map(str, range(16)))
    clip = load_clip(tmp_path / "out" / "3" / "hips_poses.npz")
    assert len(clip) == FRAMES
    expected = protocol.clip(protocol.person("train", 3), takes / "b" / "hips_poses.npz")
    np.testing.assert_array_equal(clip.vertices, expected.vertices)
    other = load_clip(tmp_path / "out" / "4" / "hips_poses.npz")
    assert not np.allclose(other.vertices, clip.vertices)


@pytest.mark.slow
def test_pairs_of_clips_have_the_truth_of_another_person(model, tmp_path, capsys):
    takes = write_takes(tmp_path / "takes")
    protocol = on_body_model("clips-aniformer", model, takes)
    written = write(protocol, tmp_path / "out", "test")
    assert written["files"] == sum(path.is_file() for path in (tmp_path / "out").rglob("*"))
    lines = (tmp_path / "out" / "test-takes.txt").read_text().splitlines()
    assert len(lines) == 2
    for line, take in zip(lines, protocol.takes, strict=True):
        identity, driving, truth = (tmp_path / "out" / word for word in line.split())
        person = identity.stem.split("_")[0].removeprefix("id")
        assert truth.stem == f"id{person}_{take.stem}"
        assert driving.stem.endswith(take.stem)
        assert not driving.stem.startswith(f"id{person}_")
        expected = protocol.clip(protocol.person("test", int(person)), take)
        np.testing.assert_array_equal(load_clip(truth).vertices, expected.vertices)
    assert run(["evaluate", str(tmp_path / "out"), "-m", "copy,identity", "--json"]) == 0
    assert_same_figures(json.loads(capsys.readouterr().out), protocol, "test-")


def test_what_does_not_go_together_is_refused(model, tmp_path):
    animal = write_model(tmp_path / "SMAL.npz", small_arrays(33, 40))
    twins = write_takes(tmp_path / "twins", names=("a/walk", "b/walk"))
    (tmp_path / "empty").mkdir()
    for name, path, data, message in (
        ("noise", model, None, "noise: expected human-npt, clips-aniformer or quadruped, found another"),
        ("human-npt", animal, None, r"expected a model of people for human-npt, found 33 joints .*take quadruped"),
        ("quadruped", model, None, r"expected a model of animals for quadruped, found 24 joints .*human-npt"),
        ("clips-aniformer", model, None, "expected a folder of AMASS motions, found none"),
        ("clips-aniformer", model, tmp_path / "empty", r"expected AMASS motions \(.npz with poses\), found none"),
        ("clips-aniformer", model, twins, "expected motions with names of their own"),
    ):
        with pytest.raises(InputError, match=message):
            on_body_model(name, path, data)
