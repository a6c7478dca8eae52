"""Recordings of a body model become the recorded surface: vertices of plain loops, y up, with betas and frame rate."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from matrix import matrix
from motion_files import Z_UP
from scipy.spatial.transform import Rotation
from smpl_files import Ch, chumpy_modules, loop_vertices, small_arrays, smpl_arrays, write_model

from mimesh.__main__ import run
from mimesh.core.errors import InputError
from mimesh.io import load_clip, load_mesh, load_recorded_clip
from mimesh.motions.amass import parse_betas
from mimesh.motions.smpl_clip import fitted_pose

FRAMES, FACES = 3, 600


def recording(joints: int, betas: int = 16, frames: int = FRAMES, seed: int = 3) -> dict:
    """The arrays of an AMASS archive with z up: a person who stands and moves every joint."""
    rng = np.random.default_rng(seed)
    pose = 0.2 * rng.standard_normal((frames, joints, 3))
    pose[:, 0] = (Rotation.from_matrix(Z_UP) * Rotation.from_rotvec(pose[:, 0])).as_rotvec()
    return {
        "poses": pose.reshape(frames, -1),
        "trans": rng.random((frames, 3)),
        "betas": rng.standard_normal(betas),
        "mocap_framerate": 120.0,
        "gender": "female",
        "dmpls": np.zeros((frames, 8)),
    }


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A tiny body model of 24 joints."""
    return write_model(tmp_path_factory.mktemp("model") / "m.npz", small_arrays(24, 30))


def write_take(path, **arrays):
    np.savez(path, **arrays)
    return path


def surface(arrays: dict, take: dict, joints: int) -> np.ndarray:
    """The vertices of a recording on a model with as many joints, by loops, turned from z up to y up by hand."""
    betas = take["betas"][: arrays["shapedirs"].shape[2]]
    poses = take["poses"].reshape(len(take["poses"]), joints, 3)
    frames = [loop_vertices(arrays, betas, *frame) for frame in zip(poses, take["trans"], strict=True)]
    x, y, z = np.moveaxis(np.array(frames), -1, 0)
    return np.stack([x, z, -y], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize(("joints", "shapes"), [(24, 10), (52, 16)])
def test_an_archive_becomes_the_recorded_surface(joints, shapes, tmp_path, capsys):
    arrays, take = smpl_arrays(joints, shapes, faces=FACES), recording(joints)
    model = write_model(tmp_path / "model.pkl", arrays, chumpy=True)
    path = write_take(tmp_path / "take.npz", **take)
    assert run(["convert", str(path), str(tmp_path / "mesh.npz"), "--body-model", str(model), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["frames"], facts["fps"], facts["vertices"]) == (FRAMES, 120.0, len(arrays["v_template"]))
    assert any("recorded with the female model" in note for note in facts["notes"])
    assert any("the first 10 of 16 betas" in note for note in facts["notes"]) == (shapes == 10)
    with np.load(tmp_path / "mesh.npz") as written:
        np.testing.assert_allclose(written["vertices"], surface(arrays, take, joints), atol=1e-5)
        np.testing.assert_array_equal(written["faces"], arrays["f"])
    clip, _ = load_recorded_clip(path, model)
    height = np.ptp(clip.vertices[0], axis=0)
    assert height.argmax() in (0, 1)  # upright: arms or body, not depth
    assert (clip.mesh.up, clip.mesh.name) == ("+y", "take")
    np.testing.assert_allclose(np.linalg.norm(clip.headings, axis=1), 1.0)
    assert (clip.headings[:, 2] > 0.5).all()


def test_an_archive_with_y_up_keeps_its_axes(tmp_path):
    arrays, take = small_arrays(24, 30), recording(24)
    take["poses"][:, :3] = 0.1
    frames = [
        loop_vertices(arrays, take["betas"][:3], pose.reshape(24, 3), trans)
        for pose, trans in zip(take["poses"], take["trans"], strict=True)
    ]
    clip, _ = load_recorded_clip(write_take(tmp_path / "a.npz", **take), write_model(tmp_path / "m.npz", arrays))
    np.testing.assert_allclose(clip.vertices, frames, atol=1e-5)


def test_poses_stored_in_parts_are_joined(tmp_path):
    model = write_model(tmp_path / "m.npz", small_arrays(55, 30))
    take = recording(55)
    whole, _ = load_recorded_clip(write_take(tmp_path / "a.npz", **take), model)
    poses = take.pop("poses")
    parts = {"root_orient": 3, "pose_body": 63, "pose_jaw": 3, "pose_eye": 6, "pose_hand": 90}
    ends = np.cumsum(list(parts.values()))[:-1]
    split = dict(zip(parts, np.split(poses, ends, axis=1), strict=True))
    joined, notes = load_recorded_clip(write_take(tmp_path / "b.npz", **take, **split), model)
    np.testing.assert_array_equal(joined.vertices, whole.vertices)
    assert not any("joints" in note for note in notes)


def test_another_frame_rate_keeps_the_duration(small, tmp_path):
    path = write_take(tmp_path / "a.npz", **recording(24, frames=9))
    clip, _ = load_recorded_clip(path, small)
    half, _ = load_recorded_clip(path, small, fps=60.0)
    assert (half.fps, len(half)) == (60.0, 5)
    np.testing.assert_allclose(half.vertices, clip.vertices[::2], atol=1e-6)


@pytest.mark.parametrize(
    ("poses", "model", "shared", "fingers", "words"),
    [
        (52, 24, 22, False, "the first 22 are taken"),  # SMPL's hands are not SMPL+H's first fingers
        (24, 52, 22, False, "the first 22 are taken"),
        (52, 55, 22, True, "the first 22 and the fingers are taken"),
        (55, 52, 22, True, "the first 22 and the fingers are taken"),
        (22, 52, 22, False, "the first 22 are taken"),
        (24, 33, 24, False, "the first 24 are taken"),
        (52, 5, 5, False, "the first 5 are taken"),
    ],
)
def test_poses_of_another_model_are_cut_or_padded(poses, model, shared, fingers, words):
    rotvec = np.random.default_rng(0).random((2, poses, 3)) + 1
    fitted, notes = fitted_pose(rotvec, model)
    assert fitted.shape == (2, model, 3)
    np.testing.assert_array_equal(fitted[:, :shared], rotvec[:, :shared])
    last = model - 30 if fingers else model
    assert (fitted[:, shared:last] == 0).all()
    np.testing.assert_array_equal(fitted[:, last:], rotvec[:, poses - (model - last) :])
    assert f"poses of {poses} joints on a model of {model}: {words}" in notes[0]
    assert fitted_pose(rotvec, poses)[1] == ()


@pytest.mark.parametrize("frames", [None, 4])
def test_a_registration_gives_the_registered_surface(frames, tmp_path, capsys):
    """As in MG-dataset: a pickle with pose, betas and trans; axes are the file's."""
    arrays, rng = small_arrays(24, 30), np.random.default_rng(0)
    pose, trans = rng.random((frames or 1, 72)), rng.random((frames or 1, 3))
    entries = {"pose": pose, "betas": rng.random(10), "trans": trans, "gender": "male"}
    if frames is None:
        entries |= {"pose": pose[0], "trans": trans[0]}
    with chumpy_modules():
        entries["betas"] = Ch(entries["betas"])
        (tmp_path / "registration.pkl").write_bytes(pickle.dumps(entries, 2))
    model = write_model(tmp_path / "m.pkl", arrays)
    paths = (tmp_path / "registration.pkl", tmp_path / "person.obj")
    assert run(["convert", *map(str, paths), "--body-model", str(model), "--frame", "0"]) == 0
    betas = np.asarray(getattr(entries["betas"], "x", entries["betas"]))[:3]
    expected = [loop_vertices(arrays, betas, p.reshape(24, 3), t) for p, t in zip(pose, trans, strict=True)]
    np.testing.assert_allclose(load_mesh(tmp_path / "person.obj").vertices, expected[0], atol=1e-5)
    clip, _ = load_recorded_clip(paths[0], model)
    np.testing.assert_allclose(clip.vertices, expected, atol=1e-5)
    assert run(["look", str(paths[0])]) == 2  # alone it is no mesh
    assert "--body-model" in capsys.readouterr().err


def test_missing_betas_are_noted(tmp_path):
    take = recording(24)
    del take["betas"], take["gender"]
    arrays = small_arrays(24, 30)
    clip, notes = load_recorded_clip(write_take(tmp_path / "a.npz", **take), write_model(tmp_path / "m.npz", arrays))
    assert notes == ("a.npz: no betas: the model's mean shape is taken",)
    zero = surface(arrays, {**take, "betas": np.zeros(1)}, 24)
    np.testing.assert_allclose(clip.vertices, zero, atol=1e-5)


def test_betas_of_every_frame_must_be_one_persons(small, tmp_path):
    take = recording(24)
    once, _ = load_recorded_clip(write_take(tmp_path / "a.npz", **take), small)
    many = {**take, "betas": np.tile(take["betas"], (FRAMES, 1))}
    again, _ = load_recorded_clip(write_take(tmp_path / "b.npz", **many), small)
    np.testing.assert_array_equal(once.vertices, again.vertices)
    many["betas"][1, 2] += 1
    with pytest.raises(InputError, match="expected one person in 'betas', found 3 rows that differ"):
        load_recorded_clip(write_take(tmp_path / "c.npz", **many), small)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"poses": np.zeros((FRAMES, 73))}, "expected three numbers for each joint in 'poses', found 73"),
        ({"poses": np.zeros((FRAMES, 9))}, r"'poses' to be numbers of shape \(T, 66\) or wider"),
        ({"betas": np.array([np.inf])}, "NaN or infinity in frame 0 of 'betas'"),
        ({"betas": np.array(["x"])}, "'betas' to be numbers"),
    ],
)
def test_wrong_archives_give_one_line(changes, message, small, tmp_path):
    arrays = {name: value for name, value in {**recording(24), **changes}.items() if value is not None}
    with pytest.raises(InputError, match=message) as error:
        load_recorded_clip(write_take(tmp_path / "a.npz", **arrays), small)
    assert "\n" not in str(error.value)


def test_wrong_pickles_give_one_line(small, tmp_path):
    good = {"pose": np.zeros(72), "betas": np.zeros(10), "trans": np.zeros(3)}
    for changes, message in [
        ({"pose": np.zeros(71)}, "three numbers for each joint in 'pose', found 71"),
        ({"trans": np.zeros(6)}, "expected three numbers of 'trans' for each of 1 poses, found 6"),
        ({"pose": "standing"}, "expected 'pose' to be an array of numbers"),
        ({"betas": None}, "expected 'betas' to be an array of numbers"),
    ]:
        (tmp_path / "r.pkl").write_bytes(pickle.dumps({**good, **changes}))
        with pytest.raises(InputError, match=message):
            load_recorded_clip(tmp_path / "r.pkl", small)
    with pytest.raises(InputError, match="expected the arrays pose, betas and trans, found no pose; "):
        load_recorded_clip(write_model(tmp_path / "n.pkl", small_arrays()), small)


def test_other_files_take_no_body_model(small, tmp_path, capsys):
    np.savez(tmp_path / "mesh.npz", vertices=np.eye(3), faces=[[0, 1, 2]])
    (tmp_path / "mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    obj, given = str(tmp_path / "mesh.obj"), ["--body-model", str(small)]
    for words in (["convert", str(tmp_path / "mesh.npz")], ["convert", obj], ["transfer", obj, obj, "-o"]):
        assert run([*words, str(tmp_path / "out.obj"), *given]) == 2
        assert "expected an AMASS archive" in capsys.readouterr().err
    take = write_take(tmp_path / "a.npz", **recording(24))
    assert run(["convert", str(take), str(tmp_path / "out.npz"), "--body-model", str(tmp_path / "none.pkl")]) == 2
    assert "none.pkl: expected a file or folder, found nothing of that name" in capsys.readouterr().err
    assert run(["convert", str(take), str(small), "--body-model", str(small)]) == 2
    assert "expected an output apart from the inputs" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".pkl", ".npz"])
def test_a_body_model_is_a_mesh_at_rest(suffix, tmp_path, capsys):
    arrays = smpl_arrays(faces=FACES)
    path = write_model(tmp_path / f"SMPL{suffix}", arrays)
    assert run(["look", str(path)]) == 0
    assert "its mean shape at rest" in capsys.readouterr().out
    for target in ("body.obj", "body.npz"):
        assert run(["convert", str(path), str(tmp_path / target)]) == 0
        mesh = load_mesh(tmp_path / target)
        np.testing.assert_allclose(mesh.vertices, arrays["v_template"], atol=1e-5)
        np.testing.assert_array_equal(mesh.faces, arrays["f"])


def test_a_registration_beside_its_frames_is_no_frame(tmp_path):
    for k in range(3):
        points = "\n".join(f"v {x} {k} 0" for x in range(3))
        (tmp_path / f"{k:05d}.obj").write_text(f"{points}\nv 0 5 0\nf 1 2 4\n")
        (tmp_path / f"{k:05d}.pkl").write_bytes(pickle.dumps({"pose": np.zeros(72)}))
    assert len(load_clip(tmp_path)) == 3


def same_up_to_one_scale(moved: np.ndarray, true: np.ndarray) -> None:
    """Check distances from each vertex to the next in all frames: `copy` gives the driving's own vertices back."""
    lengths, true_lengths = (np.linalg.norm(np.diff(v, axis=-2), axis=-1) for v in (moved, true))
    np.testing.assert_allclose(lengths, lengths.sum() / true_lengths.sum() * true_lengths, atol=1e-4)


def test_animate_and_transfer_drive_with_the_recorded_surface(tmp_path, capsys):
    """With an archive, and with the pose of a registration."""
    arrays, take = smpl_arrays(faces=FACES), recording(24)
    model, hero, source = (tmp_path / name for name in ("m.pkl", "hero.obj", "registration.pkl"))
    write_model(model, arrays)
    path, true = write_take(tmp_path / "take.npz", **take), surface(arrays, take, 24)
    pose = take["poses"][0].copy()
    pose[:3] = (Rotation.from_matrix(Z_UP).inv() * Rotation.from_rotvec(pose[:3])).as_rotvec()
    source.write_bytes(pickle.dumps({"pose": pose, "betas": take["betas"], "trans": np.zeros(3)}))
    assert run(["convert", str(model), str(hero)]) == 0
    options = ["-m", "copy", "--no-preview", "--body-model", str(model)]
    for verb, driving, out, expected in (("animate", path, "out.npz", true), ("transfer", source, "out.obj", true[0])):
        capsys.readouterr()
        assert run([verb, str(hero), str(driving), *options, "-o", str(tmp_path / out), "--json"]) == 0
        facts = json.loads(capsys.readouterr().out.splitlines()[-1])
        assert any("the first 10 of 16 betas" in note for note in facts["report"]["notes"])
        moved = load_clip(tmp_path / out).vertices if verb == "animate" else load_mesh(tmp_path / out).vertices
        same_up_to_one_scale(moved, expected)
        assert verb == "transfer" or facts["fps"] == 120.0
    assert run(["transfer", str(hero), str(source), *options, "-o", str(model)]) == 2
    assert "expected an output apart from the inputs" in capsys.readouterr().err


def test_the_first_frame_alone_is_that_of_the_clip(small, tmp_path):
    """A person who lies in the first frame and stands in the others: the up axis is that of the whole recording."""
    take = recording(24, frames=6)
    take["poses"][0, :3] = 0.0
    path = write_take(tmp_path / "take.npz", **take)
    first, notes = load_recorded_clip(path, small, count=1)
    mesh = first.mesh
    clip, of_clip = load_recorded_clip(path, small)
    np.testing.assert_array_equal(mesh.vertices, clip.vertices[0])
    assert (mesh.up, notes) == (clip.mesh.up, of_clip)


MADE_WITH = [
    ({}, "female", "16", "120 per second"),
    ({"gender": np.array(b"male"), "betas": np.ones((1, 10))}, "male", "10", "120 per second"),
    ({"gender": None, "betas": None, "mocap_framerate": None}, *["not in the file"] * 3),
    ({"gender": np.array([{}]), "betas": np.array([{}, 1])}, *["not in the file"] * 2, "120 per second"),
    ({"gender": np.array(b"m\xff\x1b[2J")}, "m\ufffd[2J", "16", "120 per second"),
]


@pytest.mark.slow
@matrix(
    ("changes", "gender", "betas", "rate"), MADE_WITH, quick=lambda case: not case[0] or "mocap_framerate" in case[0]
)
def test_look_shows_what_a_recording_was_made_with(changes, gender, betas, rate, tmp_path, capsys):
    arrays = {name: array for name, array in (recording(24, frames=1) | changes).items() if array is not None}
    path = write_take(tmp_path / "take.npz", **arrays)
    if not changes:
        assert run(["look", str(path)]) == 0
        lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines()[1:] if "  " in line)
        assert (lines["gender"], lines["betas"]) == (gender, betas)
        assert lines["frame"].removeprefix("rate").strip().startswith(rate)
    assert run(["look", str(path), "--json"]) == 0
    details = dict(json.loads(capsys.readouterr().out)["files"][0]["details"])
    assert (details["gender"], details["betas"]) == (gender, betas)
    assert details["frame rate"].startswith(rate)


def test_another_person_makes_the_recorded_motion(tmp_path):
    """With the betas of another, given as numbers or as that take, the surface is theirs in the recorded poses."""
    arrays, take = small_arrays(24, 30), recording(24, betas=3, seed=1)
    other = recording(24, betas=3, seed=5)
    model = write_model(tmp_path / "m.npz", arrays)
    path = write_take(tmp_path / "take.npz", **take)
    write_take(tmp_path / "other.npz", **other)
    expected = surface(arrays, {**take, "betas": other["betas"]}, 24)
    out = tmp_path / "out.npz"
    for betas in (",".join(map(repr, other["betas"].tolist())), str(tmp_path / "other.npz")):
        given = ["convert", str(path), str(out), "--body-model", str(model), "--betas", betas, "-q"]
        assert run(given) == 0
        np.testing.assert_allclose(load_clip(out).vertices, expected, atol=1e-5)
    _, notes = load_recorded_clip(path, model, betas=other["betas"])
    assert not any("recorded with the" in note for note in notes)  # the betas are not that model's


@pytest.mark.parametrize(
    ("betas", "message"),
    [
        ("tall", r"--betas tall: expected numbers with commas between, or an \.npz with betas, found neither"),
        ("1,nan", "expected numbers with commas"),
        ("missing.npz", "expected numbers with commas"),
        ("bare.npz", "expected the array betas, found none"),
    ],
)
def test_betas_that_are_none_are_refused(betas, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez("bare.npz", trans=np.zeros((2, 3)))
    with pytest.raises(InputError, match=message):
        parse_betas(betas)


def test_evenly_spread_frames_of_a_take(small, tmp_path):
    """The first and the last are among them, and the duration stays."""
    path = write_take(tmp_path / "take.npz", **recording(24, frames=11))
    whole, _ = load_recorded_clip(path, small)
    few, _ = load_recorded_clip(path, small, count=6)
    assert few.fps == 60.0
    np.testing.assert_array_equal(few.vertices, whole.vertices[::2])
    with pytest.raises(InputError, match="expected 12 frames or more, found 11"):
        load_recorded_clip(path, small, count=12)
