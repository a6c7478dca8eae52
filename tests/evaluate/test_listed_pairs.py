"""Measuring on lists of files: the figures of a protocol again from its files, and files that do not fit together."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from deepmimic_files import write_folder
from matrix import matrix
from networks import write_sequence_network
from people import person

from mimesh.cli import run
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.normalization import bbox_centre
from mimesh.evaluate.clip_protocols import ClipPair, clips_aniformer
from mimesh.evaluate.listed_pairs import HEIGHT, ListedClips, listed_pairs
from mimesh.evaluate.markdown import markdown
from mimesh.evaluate.measure import measure, measure_clip
from mimesh.evaluate.run import evaluate_command, measure_trial
from mimesh.io import save_clip, save_mesh

ROOT = Path(__file__).parents[2]
RNG = np.random.default_rng(0)
"""Not used where pairs are read from files."""


def assert_same_figures(row, expected):
    """Assert that a row of a report has the figures of pairs of a protocol; their vertices were in other orders."""
    assert row["pairs"] == len(expected) > 0
    for metric in expected[0].keys() - {"pair", "seconds", "still_mm"}:
        values = [figures[metric] for figures in expected]
        if metric in ("identity", "driving") or None in values:
            assert row["each"][metric] == values
        else:
            assert row["each"][metric] == pytest.approx(values, rel=1e-4, abs=1e-6), metric


@pytest.mark.slow
def test_generated_pairs_have_the_figures_of_their_protocol(tmp_path):
    assert run(["generate", "human-npt", "-o", str(tmp_path / "meshes"), "--pairs", "1", "-q"]) == 0
    out = tmp_path / "figures.json"
    assert run(["evaluate", str(tmp_path / "meshes"), "-m", "copy,npt", "-o", str(out), "-q"]) == 0
    report, protocol = json.loads(out.read_text()), evaluate_command("human-npt", ["copy", "npt"], pairs=1)
    rows = {(row["method"], row["split"]): row for row in report["results"]}
    assert report["protocol"] == "meshes/"
    assert {facts["role"] for facts in report["sets"].values()} == {"own files"}
    for named in protocol["results"]:
        row = rows.pop((named["method"], f"test-{named['split']}"))
        assert_same_figures(row, [{name: column[0] for name, column in named["each"].items()}])
    assert not rows


@pytest.fixture(scope="module")
def motions(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("motions"))


@matrix("frames_as", [None, "obj"], quick=[None])
def test_generated_clips_are_those_of_the_protocol(motions, tmp_path, monkeypatch, frames_as):
    protocol = dataclasses.replace(clips_aniformer(motions), kinds=("seen",))
    monkeypatch.setattr("mimesh.evaluate.generate.find_protocol", lambda *_: protocol)
    option = [] if frames_as is None else ["--frames-as", frames_as]
    given = ["generate", "clips-aniformer", "--split", "val", "--data", str(motions), "--pairs", "1"]
    assert run([*given, "-o", str(tmp_path), *option, "-q"]) == 0
    trial = protocol.unshuffled_pair("val", "seen", 0, protocol.rng("val", "seen", 0))
    files = listed_pairs(tmp_path)
    read = files.unshuffled_pair("test", "val-seen", 0, files.rng("test", "val-seen", 0))
    assert read.clip.fps == trial.clip.fps == 30.0
    assert (read.height, read.groups) == (trial.height, trial.groups)
    np.testing.assert_array_equal(read.identity.faces, trial.identity.faces)
    for name in ("truth_frames", "aligned_frames"):
        np.testing.assert_array_equal(getattr(read, name), getattr(trial, name))
    np.testing.assert_array_equal(read.clip.vertices, trial.clip.vertices)


def figure(seed=0, faces=True):
    """A mesh of few vertices, about as tall as a person."""
    rng = np.random.default_rng(seed)
    vertices = rng.uniform(-1, 1, (12, 3)) * [0.4, 0.9, 0.3]
    triangles = np.array([[i, (i + 1) % 12, (i + 5) % 12] for i in range(12)])
    return Mesh(vertices, triangles if faces else triangles[:0])


@pytest.fixture
def folder(tmp_path):
    """Three pairs in the layout of the public data, as `seen.txt`."""
    for k, name in enumerate(("id0_0", "id0_1", "id0_2", "id0_3", "id1_1", "id1_2", "id2_3")):
        save_mesh(figure(k), tmp_path / f"{name}.obj")
    lines = ("id0_0 id1_1 id0_1", "id0_0.obj id1_2.obj id0_2.obj", "id0_0 id2_3.obj id0_3")
    (tmp_path / "seen.txt").write_text("\r\n".join(lines) + "\r\n")
    return tmp_path


def one_pair(folder, *meshes):
    """Write a list of one pair and return its protocol."""
    for name, mesh in zip(("a", "b", "c"), meshes, strict=True):
        save_mesh(mesh, folder / (f"{name}.obj" if len(mesh.faces) else f"{name}.ply"))
    (folder / "one.txt").write_text("a b c")
    return listed_pairs(folder / "one.txt")


def test_report_has_every_pair_and_where_the_files_come_from(folder, tmp_path, capsys):
    out = tmp_path / "figures.json"
    assert run(["evaluate", str(folder / "seen.txt"), "-m", "identity,copy,truth", "-o", str(out)]) == 0
    assert "seen.txt: 7 files, sha256 " in capsys.readouterr().out
    report = json.loads(out.read_text())
    config = report["provenance"]["config"]
    assert (report["protocol"], config["pairs"]) == ("seen.txt", 3)
    assert config["lists"].keys() == {"seen"}
    assert "split" not in config
    rows = {row["method"]: row for row in report["results"]}
    assert {row["split"] for row in rows.values()} == {"seen"}
    expected = [measure(listed_pairs(folder / "seen.txt").unshuffled_pair("", "seen", i, RNG), "copy") for i in (0, 2)]
    assert [rows["copy"]["each"]["pmd_e4"][i] for i in (0, 2)] == pytest.approx([e["pmd_e4"] for e in expected], 1e-5)
    assert rows["truth"]["pmd_e4_max"] == 0 < rows["copy"]["pmd_e4_median"] < rows["identity"]["pmd_e4_max"] * 9
    assert rows["copy"]["each"]["identity"] == ["0"] * 3
    assert rows["copy"]["each"]["driving"] == ["1", "1", "2"]
    fewer = evaluate_command(str(folder / "seen.txt"), ["copy"], pairs=2)
    assert fewer["results"][0]["each"]["pmd_e4"] == rows["copy"]["each"]["pmd_e4"][:2]
    assert evaluate_command(str(folder / "seen.txt"), ["copy"], pairs=50)["results"][0]["pairs"] == 3


UPS = [
    ("", None),
    ("identity", "identity +z, driving +y, truth +y"),
    ("driving truth", "identity +y, driving +z, truth +z"),
    ("identity driving truth", "identity +z, driving +z, truth +z"),
]


@matrix(("turned", "found"), UPS, quick=[UPS[0], UPS[2]])
def test_files_with_z_up_get_a_note(turned, found, tmp_path, capsys):
    for k in range(3):
        for role, mesh in (("identity", person(k)), ("driving", person(k + 1, k)), ("truth", person(k, k))):
            x, y, z = mesh.vertices.T
            vertices = np.stack([x, -z, y], axis=1) if role in turned.split() else mesh.vertices
            save_mesh(dataclasses.replace(mesh, vertices=vertices), tmp_path / f"{role}{k}.obj")
    (tmp_path / "mine.txt").write_text("\n".join(f"identity{k} driving{k} truth{k}" for k in range(3)))
    assert run(["evaluate", str(tmp_path / "mine.txt"), "-m", "copy", "-o", str(tmp_path / "out.json")]) == 0
    notes = json.loads((tmp_path / "out.json").read_text())["notes"]
    assert [f"note: {note}" for note in notes] == [
        line for line in capsys.readouterr().out.splitlines() if line.startswith("note: ")
    ]
    assert len(notes) == (found is not None)
    assert found is None or f"mine: by the shapes of most files up is {found}, but lists are" in notes[0]


def test_one_person_who_lies_among_three_gets_no_note(tmp_path):
    for k in range(3):
        lying = Mesh(person(k, k).vertices[:, [0, 2, 1]] * [1, -1, 1], person(k).faces)
        for name, mesh in (("a", person(k)), ("b", lying if k == 0 else person(k, k)), ("c", lying)):
            save_mesh(mesh, tmp_path / f"{name}{k}.obj")
    (tmp_path / "b.txt").write_text("a0 b0 b0\na1 b1 b1\na2 b2 b2")
    (tmp_path / "c.txt").write_text("a0 c0 c0\na1 c1 c1\na2 c2 c2")
    (note,) = evaluate_command(str(tmp_path), ["truth"])["notes"]
    assert note.startswith("c: by the shapes of most files up is identity +y, driving ")


def test_interrupted_list_is_continued_until_a_file_changes(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("mimesh.evaluate.run.commit", lambda: "abc")
    out, measured = tmp_path / "out" / "figures.json", []
    out.parent.mkdir()

    def counted(pair, method, **options):
        measured.append(pair.truth_name)
        if len(measured) in (3, 5):
            raise KeyboardInterrupt
        return measure(pair, method, **options)

    monkeypatch.setattr("mimesh.evaluate.run.measure", counted)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            evaluate_command(str(folder / "seen.txt"), ["copy", "identity"], out)
    assert measured == ["id0_1", "id0_2", "id0_3", "id0_3", "id0_1"]
    save_mesh(figure(20), folder / "id0_1.obj")
    evaluate_command(str(folder / "seen.txt"), ["copy", "identity"], out)
    assert measured[5:] == ["id0_1", "id0_2", "id0_3"] * 2
    assert out.with_name("figures.json.partial.old").exists()


def test_methods_get_shuffled_vertices_and_the_truth_follows_the_identity(folder):
    protocol = listed_pairs(folder / "seen.txt")
    plain, pair = protocol.unshuffled_pair("", "seen", 1, RNG), protocol.pair("", "seen", 1)
    order = [np.flatnonzero((plain.identity.vertices == point).all(axis=1))[0] for point in pair.identity.vertices]
    assert order != sorted(order)
    np.testing.assert_array_equal(pair.truth, plain.truth[order])
    np.testing.assert_array_equal(pair.aligned, plain.aligned[order])
    # Another list beside it changes nothing.
    (folder / "more.txt").write_text((folder / "seen.txt").read_text())
    again = listed_pairs(folder).pair("", "seen", 1)
    np.testing.assert_array_equal(again.identity.vertices, pair.identity.vertices)


def test_methods_that_need_a_correspondence_are_not_applicable_without_one(folder, tmp_path):
    other = dataclasses.replace(figure(5), faces=figure(5).faces[::-1])
    one_pair(tmp_path, figure(0), other, figure(1))
    methods = ["copy", "deformation-transfer-dense", "deformation-transfer-13", "truth"]
    report = evaluate_command(str(tmp_path / "one.txt"), methods)
    assert [row["pairs"] for row in report["results"]] == [0, 0, 0, 1]
    assert "Not applicable: `copy`, 1 of 1 pairs of one" in markdown(report)
    (tmp_path / "b.obj").unlink()
    cloud = one_pair(tmp_path, figure(0), figure(5, faces=False), figure(1))
    assert cloud.pair("", "one", 0).aligned is None


@pytest.mark.parametrize(
    ("truth", "message"),
    [
        (person(0), "with the 12 vertices of the identity a, found"),
        (dataclasses.replace(figure(1), faces=figure(1).faces[:, [1, 2, 0]]), "with the triangles of the identity a"),
        (dataclasses.replace(figure(1), faces=figure(1).faces[:11]), "with the triangles of the identity a"),
    ],
    ids=["count", "order", "fewer"],
)
def test_truth_of_another_mesh_is_refused_with_list_and_line(tmp_path, truth, message):
    protocol = one_pair(tmp_path, figure(0), figure(2), truth)
    with pytest.raises(InputError, match=rf"one\.txt, line 1: expected the truth c {message}"):
        protocol.pair("", "one", 0)


def test_truth_may_be_points(tmp_path):
    pair = one_pair(tmp_path, figure(0), figure(2), figure(1, faces=False)).unshuffled_pair("", "one", 0, RNG)
    np.testing.assert_allclose(pair.truth, figure(1).vertices, atol=1e-6)


def test_damaged_files_are_refused_with_list_and_line(folder, capsys):
    (folder / "id0_2.obj").write_text("v 0 0 zero\n")
    assert run(["evaluate", str(folder / "seen.txt"), "-m", "copy"]) == 2
    error = capsys.readouterr().err
    assert "seen.txt, line 2: " in error
    assert "id0_2.obj" in error
    assert error.count("\n") == 1


def test_millimetres_are_of_the_given_heights(folder, tmp_path):
    pair = listed_pairs(folder / "seen.txt").pair("", "seen", 0)
    assert pair.height == HEIGHT
    figures = measure(pair, "copy")
    distance = figures["mm"]
    assert distance == pytest.approx(
        1e3 * np.linalg.norm(_centred(pair.aligned, pair.truth) - _centred(pair.truth, pair.truth), axis=1).mean()
    )
    given = listed_pairs(folder / "seen.txt", height=3.4).pair("", "seen", 0)
    halved = measure(given, "copy")
    assert halved["mm"] == pytest.approx(distance / 2)
    assert halved["pmd_public_e4"] == figures["pmd_public_e4"]  # 3.4 can be metres
    centimetres = measure(listed_pairs(folder / "seen.txt", height=170.0).pair("", "seen", 0), "copy")
    assert centimetres["pmd_public_e4"] == pytest.approx(figures["pmd_public_e4"] * 1e-4)
    assert halved["pmd_e4"] == pytest.approx(figures["pmd_e4"])
    (folder / "seen.heights.json").write_text('{"id0_0": 0.85}')
    known = listed_pairs(folder / "seen.txt")
    assert measure(known.pair("", "seen", 0), "copy")["mm"] == pytest.approx(distance * 2)
    with pytest.raises(InputError, match=r"line 2: expected the height of id0_0\.obj"):
        known.pair("", "seen", 1)
    assert listed_pairs(folder / "seen.txt", height=3.4).pair("", "seen", 1).height == 3.4


def _centred(points, truth):
    """Centre points and give them the truth's radius, as the row `copy` is measured."""
    points, true = points - bbox_centre(points), truth - bbox_centre(truth)
    return points * np.linalg.norm(true, axis=1).max() / np.linalg.norm(points, axis=1).max()


def test_files_in_centimetres_need_a_height(tmp_path, capsys):
    meshes = [dataclasses.replace(figure(k), vertices=100 * figure(k).vertices) for k in range(3)]
    one_pair(tmp_path, *meshes)
    path = str(tmp_path / "one.txt")
    assert run(["evaluate", path, "-m", "copy"]) == 2
    assert "one.txt, line 1: expected a figure in metres" in capsys.readouterr().err
    assert run(["evaluate", path, "-m", "copy", "--height", "170", "--json"]) == 0
    centimetres = json.loads(capsys.readouterr().out)["results"][0]
    one_pair(tmp_path, *(figure(k) for k in range(3)))
    metres = evaluate_command(path, ["copy"])["results"][0]
    assert centimetres["mm"] == pytest.approx(metres["mm"], abs=0.011)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "gone.txt"], "or the path of a list, found neither"),
        (["evaluate", "seen.txt", "--split", "val"], "--split: expected none with the list seen.txt"),
        (["evaluate", "seen.txt", "--height", "0"], "--height: expected a positive number"),
        (["evaluate", "human-npt", "--height", "1.7"], "--height: expected it with a list"),
        (["evaluate", "seen.txt", "--data", "gone"], "expected the file 'id0_0' in gone"),
        (["generate", "seen.txt", "-o", "out"], "expected a protocol by its name"),
        (["generate", "human-npt", "-o", "out", "--frames-as", "glb"], "--frames-as: expected .obj or .ply"),
    ],
)
def test_options_that_do_not_fit_are_refused(folder, arguments, message, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert run(arguments) == 2
    assert message in capsys.readouterr().err
    assert not (folder / "out").exists()


def test_a_protocol_goes_before_a_folder_of_its_name(folder, monkeypatch):
    monkeypatch.chdir(folder.parent)
    folder.rename("contact")
    assert evaluate_command("contact", ["copy"], pairs=1)["version"] == 1
    assert evaluate_command("./contact", ["copy"], pairs=1)["protocol"] == "contact/"


@pytest.fixture
def clips(tmp_path):
    """Two clips as `own.txt`: one as archives, one as folders of frames; the identity is in neither."""
    save_mesh(figure(0), tmp_path / "identity.obj")
    for k, (name, motion) in enumerate((("walk", 1), ("walk-truth", 2), ("run", 3), ("run-truth", 4))):
        vertices = figure(motion).vertices + 0.01 * np.arange(5)[:, None, None] ** 2
        clip = Clip(figure(motion), vertices, 60.0)
        save_clip(clip, tmp_path / (name if k > 1 else f"{name}.npz"))
    (tmp_path / "own.txt").write_text("identity walk walk-truth.npz\nidentity run run-truth\n")
    return tmp_path


def test_clips_are_measured_as_clips(clips, tmp_path):
    protocol = listed_pairs(clips / "own.txt")
    assert isinstance(protocol, ListedClips)
    trials = [protocol.pair("", "own", i) for i in range(2)]
    assert all(isinstance(trial, ClipPair) and trial.clip.vertices.shape == (5, 12, 3) for trial in trials)
    assert [trial.clip.fps for trial in trials] == [60.0, 30.0], "archives have a rate, folders have none"
    row = evaluate_command(str(clips / "own.txt"), ["copy"])["results"][0]
    assert row["pairs"] == 2
    assert {"path_mm", "jitter", "liveliness", "still_mm"} <= row.keys()
    assert evaluate_command(str(clips), ["copy"], fps=60.0)["results"][0]["each"]["jitter"] == pytest.approx(
        [row["each"]["jitter"][0], 4 * row["each"]["jitter"][1]],
        rel=1e-5,  # reports have six digits
    )


def test_clips_in_one_vertex_order_are_shuffled_frame_by_frame_alike(clips):
    trial = listed_pairs(clips / "own.txt").pair("", "own", 0)
    steps = np.diff(trial.truth_frames, axis=0)
    np.testing.assert_allclose(steps, np.broadcast_to(steps[:, :1], steps.shape), atol=1e-12)
    plain = listed_pairs(clips / "own.txt").unshuffled_pair("", "own", 0, RNG)
    order = [np.flatnonzero((plain.identity.vertices == p).all(axis=1))[0] for p in trial.identity.vertices]
    np.testing.assert_array_equal(trial.truth_frames, plain.truth_frames[:, order])
    assert not np.array_equal(trial.clip.vertices, plain.clip.vertices)


@pytest.mark.parametrize(
    ("vertices", "fps", "message"),
    [
        (np.zeros((4, 1, 1)), 60.0, "with the 5 frames at 60 a second of walk, found 4 frames at 60 a second"),
        (np.zeros((5, 1, 1)), 30.0, "found 5 frames at 30 a second"),
    ],
    ids=["frames", "rate"],
)
def test_truth_with_other_frames_is_refused(clips, vertices, fps, message):
    save_clip(Clip(figure(2), figure(2).vertices + vertices, fps), clips / "walk-truth.npz")
    with pytest.raises(InputError, match=rf"own\.txt, line 1: .*{message}"):
        listed_pairs(clips / "own.txt").pair("", "own", 0)


def test_meshes_and_clips_are_not_mixed(clips, folder):
    with pytest.raises(InputError, match="found seen with meshes and own with clips"):
        listed_pairs(clips)
    (clips / "seen.txt").write_text("id0_0 id1_1 id0_1\nid0_0 walk id0_1")
    meshes = listed_pairs(clips / "seen.txt")
    with pytest.raises(InputError, match=r"line 2: .*expected one mesh, found a clip of 5 frames"):
        meshes.pair("", "seen", 1)


def test_a_network_of_a_template_is_not_applicable_to_clips_of_other_bodies(clips, monkeypatch):
    if not (ROOT / "ablations" / "limp.onnx").exists():
        pytest.skip("a package without the networks of the tables")
    monkeypatch.chdir(ROOT)
    trial = listed_pairs(clips / "own.txt").pair("", "own", 0)
    assert "template" in measure_clip(trial, "limp")["why"]
    save_clip(Clip(figure(1, faces=False), trial.clip.vertices, 60.0), clips / "walk.npz")
    assert measure_clip(listed_pairs(clips / "own.txt").pair("", "own", 0), "copy").keys() == {"why"}


@pytest.mark.slow
def test_generated_clips_have_the_figures_of_their_protocol(motions, tmp_path, capsys):
    """In kind `seen`, driving people and identities are both counted from 0, and have motions of one name."""
    clips = tmp_path / "clips"
    given = ["generate", "clips-aniformer", "--split", "val", "--data", str(motions), "--pairs", "1"]
    assert run([*given, "-o", str(clips), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["files"] == sum(path.is_file() for path in clips.rglob("*"))
    out, network = tmp_path / "figures.json", str(write_sequence_network(tmp_path / "tiny.onnx"))
    assert run(["evaluate", str(clips / "val-seen.txt"), "-m", f"copy,{network}", "-o", str(out), "-q"]) == 0
    protocol, options = clips_aniformer(motions), {"ensemble": 1, "refine": False}
    report = json.loads(out.read_text())
    for row in report["results"]:
        expected = measure_trial(protocol, protocol.pair("val", "seen", 0), row["method"], options)
        assert_same_figures(row, [expected])
    assert {"path_mm", "jitter", "liveliness", "still_mm", "pmd_e4_p90", "mm_median"} <= row.keys()
    assert "jitter, m/s²" in markdown(report)
