"""Lists of files, as people write them: lines, names, heights, figures, and files that do not fit together."""

import dataclasses
import json
import os
from pathlib import Path

import numpy as np
import pytest
from people import person

from mimesh.__main__ import run
from mimesh.core.errors import InputError
from mimesh.core.mesh import Clip, Mesh
from mimesh.core.normalization import bbox_centre
from mimesh.core.options import MeasureOptions
from mimesh.evaluate.clip_protocols import ClipPair
from mimesh.evaluate.listed_pairs import (
    HEIGHT,
    ListedClips,
    find_lists,
    listed_pairs,
    read_heights,
    read_list,
    write_list,
)
from mimesh.evaluate.markdown import markdown
from mimesh.evaluate.measure import measure
from mimesh.evaluate.protocols import CONTACT
from mimesh.evaluate.run import evaluate_command, find_protocol
from mimesh.io import save_clip, save_mesh

ROOT = Path(__file__).parents[2]
RNG = np.random.default_rng(0)
"""Not used where pairs are read from files."""


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
    save_mesh(figure(20), folder / "id0_1.obj")  # figures of other files are not continued: their question is another
    changed = evaluate_command(str(folder / "seen.txt"), ["identity"])["provenance"]["config"]
    assert changed["lists"] == config["lists"]
    assert changed["data"] != config["data"]


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
    assert report["results"][0]["not_applicable"] == 1
    assert "found none in this test set" in report["results"][0]["why"]
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
    assert find_protocol("contact") is CONTACT
    assert find_protocol("./contact").name == "contact/"


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
    doubled = evaluate_command(str(clips), ["copy"], measuring=MeasureOptions(fps=60.0))["results"][0]
    assert doubled["each"]["jitter"] == pytest.approx(
        [row["each"]["jitter"][0], 4 * row["each"]["jitter"][1]],
        rel=1e-5,  # reports have six digits
    )


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


def test_copy_is_not_applicable_to_clips_without_triangles(clips):
    trial = listed_pairs(clips / "own.txt").pair("", "own", 0)
    save_clip(Clip(figure(1, faces=False), trial.clip.vertices, 60.0), clips / "walk.npz")
    assert measure(listed_pairs(clips / "own.txt").pair("", "own", 0), "copy").keys() == {"why"}


@pytest.fixture
def files(tmp_path):
    """A folder with three meshes; nothing reads them."""
    for name in ("id0_0.obj", "id1_3.obj", "id0_3.obj"):
        (tmp_path / name).touch()
    return tmp_path


def listed(files, content):
    """Write a list and return its triples."""
    path = files / "seen.txt"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_list(path)


def names(triples):
    return [tuple(path.name for path in triple.paths) for triple in triples]


PUBLIC = ("id0_0.obj", "id1_3.obj", "id0_3.obj")


@pytest.mark.parametrize(
    "content",
    [
        "id0_0.obj id1_3.obj id0_3.obj\n",
        "id0_0 id1_3 id0_3",
        "  id0_0.obj\tid1_3\t id0_3.obj  \r\n",
        "# people\n\n   \nid0_0.obj id1_3.obj id0_3.obj # the first\n\n",
        "# people\r\n\r\nid0_0.obj id1_3.obj id0_3.obj\r\n",
        "# people\rid0_0.obj id1_3.obj id0_3.obj\r",
        b"\xef\xbb\xbfid0_0.obj id1_3.obj id0_3.obj\n",
        '"id0_0.obj" id1_3.obj "id0_3"\n',
        ".\\id0_0.obj ./id1_3 .\\id0_3\n",
        b"# M\xfcller, in Latin-1\nid0_0.obj id1_3.obj id0_3.obj\n",
    ],
    ids=["plain", "no-suffix", "tabs", "comments", "windows", "old-mac", "mark", "quotes", "backslashes", "latin-1"],
)
def test_a_line_names_three_files(files, content):
    triples = listed(files, content)
    assert names(triples) == [PUBLIC]
    assert all(path.is_file() for path in triples[0].paths)


def test_names_may_have_blanks_quotes_folders_and_other_letters(files):
    (files / "set one").mkdir()
    for name in ("set one/a person.obj", "bob's.obj", "Jürgen#2.obj"):
        (files / name).touch()
    line = '"set one/a person" bob\'s.obj Jürgen#2.obj\n'
    for encoding in ("utf-8", "latin-1"):
        assert names(listed(files, line.encode(encoding))) == [("a person.obj", "bob's.obj", "Jürgen#2.obj")]


def test_names_are_absolute_or_relative_to_the_folder_that_is_given(files, tmp_path_factory):
    elsewhere = tmp_path_factory.mktemp("lists")
    absolute = " ".join(str(files / name) for name in PUBLIC)
    assert names(listed(elsewhere, absolute)) == [PUBLIC]
    (elsewhere / "seen.txt").write_text(" ".join(PUBLIC))
    assert names(read_list(elsewhere / "seen.txt", files)) == [PUBLIC]
    with pytest.raises(InputError, match=r"seen\.txt, line 1: expected the file 'id0_0\.obj' in .*--data"):
        read_list(elsewhere / "seen.txt")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "expected lines of identity, driving and truth, found none"),
        ("# nothing\n\n", "expected lines of identity, driving and truth, found none"),
        ("\nid0_0.obj id1_3.obj\n", "line 2: expected three names .*, found 2 in 'id0_0.obj id1_3.obj'"),
        ("id0_0 id1_3 id0_3\r\na person.obj id1_3 id0_3\r\n", "line 2: expected three names .* double quotes"),
        ("id0_0 id1_3 id0_3\nid0_0 id1_3 id0_4\n", "line 2: expected the file 'id0_4'"),
        ('id0_0 "" id0_3', "line 1: expected the file ''"),
        (f"id0_0 {'x' * 5000} id0_3", "line 1: expected the file 'xxx"),
        ("id0_0 id1_3 id0_3".encode("utf-16"), "found binary data or UTF-16; save it as UTF-8"),
    ],
    ids=["empty", "comments", "two", "blanks", "missing", "no-name", "long", "utf-16"],
)
def test_damaged_lists_are_refused_with_the_line(files, content, message):
    with pytest.raises(InputError, match=rf"seen\.txt.*{message}"):
        listed(files, content)


def test_a_name_without_suffix_must_fit_one_file(files):
    (files / "id0_0.ply").touch()
    with pytest.raises(InputError, match=r"line 1: expected one file called 'id0_0', found .*write the suffix"):
        listed(files, "id0_0 id1_3 id0_3")
    assert names(listed(files, "id0_0.ply id1_3 id0_3")) == [("id0_0.ply", *PUBLIC[1:])]


def test_lists_of_a_folder_are_found(tmp_path):
    with pytest.raises(InputError, match="found nothing"):
        find_lists(tmp_path / "gone.txt")
    with pytest.raises(InputError, match="found none in the folder"):
        find_lists(tmp_path)
    for name in ("unseen.txt", "seen.txt", ".hidden.txt", "seen.heights.json"):
        (tmp_path / name).touch()
    assert [path.name for path in find_lists(tmp_path)] == ["seen.txt", "unseen.txt"]
    assert find_lists(tmp_path / "seen.txt") == [tmp_path / "seen.txt"]


def test_written_lists_are_read_again(files):
    (files / "a b.obj").touch()
    (files / "#3.obj").touch()
    triples = [PUBLIC, ("a b.obj", "#3.obj", "id0_3.obj")]
    heights = {"id0_0.obj": 1.71234567890123, "a b.obj": 1.5}
    write_list(files / "seen.txt", triples, heights)
    assert [triple.names for triple in read_list(files / "seen.txt")] == triples
    assert read_heights(files / "seen.txt") == heights
    assert read_heights(files / "unseen.txt") is None
    assert sorted(os.listdir(files))[-2:] == ["seen.heights.json", "seen.txt"]


@pytest.mark.parametrize(
    "content",
    [
        "{",
        "[1.7]",
        "1.7",
        '{"id0_0.obj": "tall"}',
        '{"id0_0.obj": -1}',
        '{"id0_0.obj": true}',
        '{"id0_0.obj": 1' + "0" * 400 + "}",
        "\0",
    ],
)
def test_damaged_heights_are_refused(tmp_path, content):
    (tmp_path / "seen.heights.json").write_text(content)
    with pytest.raises(InputError, match=r"seen\.heights\.json: expected"):
        read_heights(tmp_path / "seen.txt")


@pytest.mark.parametrize(("commit", "again"), [("abc", 1), ("abc-dirty", 6)])
def test_interrupted_run_is_continued_with_the_same_commit(commit, again, folder, tmp_path, monkeypatch):
    def counted(pair, method, **options):
        measured.append(method)
        if len(measured) == 3:
            raise KeyboardInterrupt
        return measure(pair, method, **options)

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("mimesh.evaluate.run.commit", lambda: commit)
    given, out, measured = str(folder / "seen.txt"), tmp_path / "out" / "figures.json", []
    out.parent.mkdir()
    uninterrupted = evaluate_command(given, ["copy"])
    monkeypatch.setattr("mimesh.evaluate.run.measure", counted)
    with pytest.raises(KeyboardInterrupt):
        evaluate_command(given, ["copy"], out)
    assert not out.exists()
    with (out.parent / "figures.json.partial").open("a") as file:
        file.write('[["copy", 0, "seen", 2], {"pmd')  # a line cut off when the process was killed
    with monkeypatch.context() as patch:
        patch.setattr("mimesh.evaluate.run.summary", interrupted)
        with pytest.raises(KeyboardInterrupt):
            evaluate_command(given, ["copy"], out)
    resumed = evaluate_command(given, ["copy"], out)
    assert len(measured) == 3 + again
    assert resumed["results"][0]["pmd_e4"] == uninterrupted["results"][0]["pmd_e4"]
    assert {path.name for path in out.parent.iterdir()} - {"figures.json.partial.old"} == {out.name}
    assert (out.parent / "figures.json.partial.old").exists() == (commit == "abc-dirty")


def test_a_report_of_another_question_is_not_replaced_and_its_figures_are_not_used(folder, tmp_path):
    given, out = str(folder / "seen.txt"), tmp_path / "out" / "figures.json"
    out.parent.mkdir()
    kept = json.dumps([["copy", 0, "seen", 0], {"pmd_e4": 0.0}])
    (out.parent / "figures.json.partial").write_text(f'{{"split": "test"}}\n{kept}\n')
    assert evaluate_command(given, ["copy"], out)["results"][0]["pmd_e4"] > 0
    assert (out.parent / "figures.json.partial.old").exists()
    of_copy = json.loads(out.read_text())
    evaluate_command(given, ["identity"], out)  # of the same pairs: more methods
    rows = json.loads(out.read_text())["results"]
    assert [row["method"] for row in rows] == ["identity", "copy"]
    origin = {name: of_copy["provenance"][name] for name in ("commit", "machine", "date")}
    assert rows[1] == {"origin": origin, **of_copy["results"][0]}
    for other in ({"pairs": 2}, {"measuring": MeasureOptions(ensemble=2)}):
        with pytest.raises(InputError, match="expected no file, or a report of the same test set"):
            evaluate_command(given, ["copy"], out, **other)
    out.write_text("notes of mine")
    with pytest.raises(InputError, match="choose another name"):
        evaluate_command(given, ["copy"], out)
    assert out.read_text() == "notes of mine"
