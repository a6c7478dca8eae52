"""Evaluation end to end: rows, provenance, resuming, tables, files, pictures, and unknown names."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from grouped_options import grouped
from matrix import matrix
from networks import write_network, write_sequence_network

from mimesh.core.errors import InputError, RefusedMeshError
from mimesh.core.normalization import Normalization, bbox_centre, radius
from mimesh.evaluate.clip_protocols import CLIPS_ANIFORMER
from mimesh.evaluate.generate import generate_command
from mimesh.evaluate.markdown import markdown
from mimesh.evaluate.measure import (
    EXTRA_INPUTS,
    Output,
    extra_inputs,
    measure,
    run_on,
)
from mimesh.evaluate.metrics import box_radius, resized
from mimesh.evaluate.protocols import CROSS_TOPOLOGY, HUMAN_NPT, HumanNpt
from mimesh.evaluate.run import dump_worst, evaluate_command, fingerprint
from mimesh.evaluate.tables import TABLES, paper_table, table_command
from mimesh.io import load_mesh
from mimesh.methods.find import INDEX_PAIRED, MODELS, NETWORK_OF_BODY, REDUCED_MODELS, TABLE_MODELS, find_model
from mimesh.methods.onnx_models import hands_path
from mimesh.pipeline import transfer


def test_network_without_a_size_gets_that_of_the_truth(tmp_path):
    """As in the validation of its training."""
    network = str(write_network(tmp_path / "truth.onnx", target_scale="truth"))
    pair = HUMAN_NPT.pair("val", "unseen", 0)
    sized = run_on(pair, network).vertices
    axes = {"up": "+y", "front": "+z", "driving_up": "+y", "driving_front": "+z"}
    free = transfer(pair.identity, pair.driving, network, **grouped(**axes, refine=False))
    assert np.allclose(resized(free.vertices, sized), resized(sized, sized), atol=1e-4)
    same = str(write_network(tmp_path / "identity.onnx", target_scale="identity"))
    sizes = [np.ptp(points, axis=0).max() for points in (sized, run_on(pair, same).vertices)]
    radii = [radius(points - bbox_centre(points)) for points in (pair.truth, pair.identity.vertices)]
    assert np.isclose(sizes[0] / sizes[1], radii[0] / radii[1])
    assert "true size" in extra_inputs(network)
    assert "true size" not in extra_inputs(same)


class Shifted:
    """A session whose results lie 0.1 beside those of another."""

    def __init__(self, session):
        self.session = session

    def run(self, *given):
        return [result + np.float32([0.1, 0, 0]) for result in self.session.run(*given)]


@pytest.mark.parametrize("scale", ["identity", "truth"])
def test_offset_of_a_network_counts_in_equation_7_alone(scale, tmp_path):
    """As in the papers: nothing re-aligns what a network gives."""
    pair = HUMAN_NPT.pair("val", "unseen", 0)
    network = find_model(str(write_network(tmp_path / "net.onnx", target_scale=scale)))
    centred, beside = (
        measure(pair, dataclasses.replace(network, session=session))
        for session in (network.session, Shifted(network.session))
    )
    for name in ("pmd_public_e4", "mm", "edge_score", "flipped"):
        assert beside[name] == pytest.approx(centred[name], rel=1e-4), name
    unit = Normalization.fit(pair.identity, "+y", "+z").radius if scale == "identity" else box_radius(pair.truth)
    result = run_on(pair, network)
    assert np.array_equal(result.origin, np.zeros(3))
    naive = [
        np.square(result.vertices + offset - (pair.truth - bbox_centre(pair.truth))).sum(axis=1).mean()
        for offset in ([0, 0, 0], [0.1 * unit, 0, 0])
    ]
    expected = 1e4 * np.array(naive) / box_radius(pair.truth) ** 2
    assert [centred["pmd_e4"], beside["pmd_e4"]] == pytest.approx(expected, rel=1e-4)


def test_position_of_a_result_that_stands_in_the_world_does_not_count(trial):
    frames, truth = trial.aligned_frames, trial.truth_frames
    path = np.arange(len(frames))[:, None, None] * [1.0, -2, 3]
    assert np.allclose(Output(frames + path).beside(truth), Output(frames).beside(truth), rtol=0, atol=1e-12)
    assert np.allclose(bbox_centre(Output(frames + path).beside(truth)), bbox_centre(truth), rtol=0, atol=1e-12)


def test_other_weights_of_hands_outdate_figures_of_mime_alone(tmp_path, monkeypatch):
    before = {method: fingerprint(method) for method in ("mime", "mime-rigid-fingers", "npt", "copy")}
    other = tmp_path / "hands.onnx"
    other.write_bytes(hands_path().read_bytes() + b"\x32\x01x")  # another description, field 6 of ModelProto
    monkeypatch.setattr("mimesh.methods.onnx_models.hands_path", lambda: other)
    after = {method: fingerprint(method) for method in before}
    assert [method for method in before if before[method] != after[method]] == ["mime"]
    assert before["copy"] == 0


def test_table_of_a_paper_has_its_values_next_to_ours(tmp_path):
    out = tmp_path / "figures.json"
    report = evaluate_command("human-npt", ["copy"], out, split="val", pairs=1)
    for name, table in TABLES.items():
        text = paper_table(name, report)
        assert text.count("\n| ") == len(table.rows) + 2
        assert "not measured" in text
    assert "| 1.1 / 9.3 | not measured |" in paper_table("npt-1", report)
    assert "| 12.1 / 16.9 |" in paper_table("npt-2", report)
    assert "| 2.1 / 12.7 |" in paper_table("npt-7", report)
    # A method that was measured on another protocol has no values here.
    assert paper_table("aniformer-1", report).count("not measured") == 6 * len(TABLES["aniformer-1"].rows)
    with pytest.raises(InputError, match="npt-1, npt-2, npt-7"):
        table_command("npt-3")


def test_every_row_of_a_table_can_be_trained_and_is_reported_if_missing(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    from mimesh.learn.table_rows import ROWS

    assert set(ROWS) == {*TABLE_MODELS, *INDEX_PAIRED.values()}
    methods = {row.method for table in TABLES.values() for row in table.rows}
    assert set(TABLE_MODELS) <= methods <= {*ROWS, *REDUCED_MODELS, *EXTRA_INPUTS, *MODELS, *NETWORK_OF_BODY.values()}
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=r"npt-equal: expected weights in ablations.*mimesh table npt-2 --train"):
        evaluate_command("human-npt", ["copy", "npt-equal"], pairs=1)


def test_generated_point_clouds_have_no_faces_and_no_training_data(tmp_path, monkeypatch):
    points = dataclasses.replace(CROSS_TOPOLOGY, kinds=("points",))
    monkeypatch.setattr("mimesh.evaluate.generate.find_protocol", lambda *_: points)
    generate_command("cross-topology", tmp_path, "test", pairs=1)
    cloud = (tmp_path / "test-points.txt").read_text().split()[1]
    assert len(load_mesh(tmp_path / cloud).faces) == 0
    with pytest.raises(InputError, match="without training data"):
        generate_command("cross-topology", tmp_path, "train")


@dataclasses.dataclass(frozen=True)
class Namesakes(HumanNpt):
    """The protocol with one name for all people."""

    def person(self, split, i):
        return dataclasses.replace(super().person(split, i), label="0")


def test_files_of_one_name_and_other_contents_are_numbered(tmp_path, monkeypatch):
    protocol = Namesakes("human-npt", 1, ("seen",), pairs=1, spread=1.1)
    monkeypatch.setattr("mimesh.evaluate.generate.find_protocol", lambda *_: protocol)
    generate_command("human-npt", tmp_path, "val")
    (line,) = (tmp_path / "val-seen.txt").read_text().splitlines()
    _, driving, truth = line.split()
    assert truth == driving.replace(".obj", "-2.obj")
    pair = protocol.unshuffled_pair("val", "seen", 0, protocol.rng("val", "seen", 0))
    assert np.array_equal(load_mesh(tmp_path / driving).vertices, pair.driving.vertices)
    assert np.array_equal(load_mesh(tmp_path / truth).vertices, pair.truth)


CLIP_COLUMNS = {"path_mm", "jitter", "still_mm", "skate_cm_s"}


@pytest.fixture(scope="module")
def trial():
    """A trial of `val` with few frames and all vertices."""
    return shortened(CLIPS_ANIFORMER.pair("val", "procedural", 0), 4)


def shortened(trial, frames):
    """Return the first frames of a trial."""
    clip = dataclasses.replace(trial.clip, vertices=trial.clip.vertices[:frames])
    return dataclasses.replace(
        trial, clip=clip, truth_frames=trial.truth_frames[:frames], aligned_frames=trial.aligned_frames[:frames]
    )


@pytest.mark.slow
@pytest.mark.parametrize("scale", ["identity", "truth"])
def test_clip_of_a_network_equals_its_single_frames(trial, scale, tmp_path):
    """Prepared once, the network gives each frame the result that it gives that frame alone."""
    network = str(write_network(tmp_path / f"{scale}.onnx", "global_max", scale))
    frames = run_on(trial, network).vertices
    assert frames.shape == trial.truth_frames.shape
    for t in (0, 3):
        alone = run_on(trial.frame(t), network).vertices
        assert np.allclose(resized(frames[t], alone), resized(alone, alone), atol=1e-4)
    assert not np.allclose(resized(frames[0], alone), resized(alone, alone), atol=1e-2)
    figures = measure(trial, network)
    assert figures["still_mm"] == pytest.approx(0, abs=1e-3)
    assert figures["path_mm"] > 0


@pytest.mark.parametrize("write", [write_network, write_sequence_network])
def test_network_without_a_size_gets_that_of_each_true_frame(trial, write, tmp_path):
    network = str(write(tmp_path / "sizeless.onnx", target_scale="truth"))
    growing = dataclasses.replace(trial, truth_frames=trial.truth_frames * 2.0 ** np.arange(4)[:, None, None])
    for t, (frame, grown) in enumerate(
        zip(run_on(trial, network).vertices, run_on(growing, network).vertices, strict=True)
    ):
        sizes = [radius(points - bbox_centre(points)) for points in (frame, grown)]
        assert sizes[1] / sizes[0] == pytest.approx(2.0**t, rel=1e-9)


@matrix("method", ["copy", "deformation-transfer-dense"], quick=["copy"])
def test_methods_without_training_are_measured_on_clips(trial, method):
    figures = measure(shortened(trial, 2), method)
    assert 0 < figures["pmd_e4"] < 100
    assert figures["still_mm"] == pytest.approx(0, abs=1e-3)
    assert figures["jitter"] is None  # of two frames
    point_cloud = dataclasses.replace(trial, driving=dataclasses.replace(trial.driving, faces=trial.driving.faces[:0]))
    assert "found points" in measure(point_cloud, "deformation-transfer-13")["why"]


@pytest.mark.slow
def test_evaluation_of_clips_has_clip_metrics_and_is_continued(tmp_path, monkeypatch):
    out, measured = tmp_path / "figures.json", []

    def counted(trial, method, **options):
        measured.append(trial.truth_name)
        if len(measured) == 3:
            raise KeyboardInterrupt
        return measure(shortened(trial, 3), method, **options)

    monkeypatch.setattr("mimesh.evaluate.run.measure", counted)
    monkeypatch.setattr("mimesh.evaluate.run.commit", lambda: "abc")
    with pytest.raises(KeyboardInterrupt):
        evaluate_command("clips-aniformer", ["copy"], out, pairs=1)
    report = evaluate_command("clips-aniformer", ["copy"], out, pairs=1)
    assert report["version"] == 4
    assert len(measured) == 4
    assert [(row["split"], row["pairs"]) for row in report["results"]] == [
        ("seen", 1), ("unseen", 1), ("procedural", 1)
    ]  # fmt: skip
    assert report["sets"]["unseen"]["role"] == "test"
    assert report["sets"]["seen"]["frozen"] == "part"
    assert set(report["results"][0]) >= CLIP_COLUMNS | {"pmd_e4", "mm", "edge_score", "seconds_per_frame"}
    text = markdown(report)
    assert "jitter, m/s²" in text
    assert "| `copy` | 1 |" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("human-mnist", ["copy"]), "human-npt, human-wide"),
        (("human-npt", ["copies"]), "copy, deformation-transfer-13"),
        (("human-npt", ["gone.onnx"]), "an .onnx file, found neither"),
    ],
)
def test_unknown_names_are_refused_with_the_known_ones(arguments, message):
    with pytest.raises(InputError, match=message):
        evaluate_command(*arguments)
    with pytest.raises(InputError, match="train, val, test"):
        evaluate_command("human-npt", ["copy"], split="tset")
    with pytest.raises(InputError, match="train, val, test"):
        generate_command("human-npt", Path("unused"), "tset")


@pytest.mark.parametrize("error", [RefusedMeshError, pytest.param(InputError, marks=pytest.mark.slow)])
def test_pairs_that_are_refused_are_failures_and_the_measurement_goes_on(error, monkeypatch, tmp_path):
    """A person in an extreme pose may look like no person; the report names the pair, and means are over the rest."""
    message, refused = "x: expected a person, found a chair; give another", HUMAN_NPT.pair("val", "seen", 1)

    def run_or_refuse(pair, method, **options):
        if np.array_equal(pair.driving.vertices, refused.driving.vertices):
            raise error(message)
        return run_on(pair, method, **options)

    monkeypatch.setattr("mimesh.evaluate.measure.run_on", run_or_refuse)
    report = evaluate_command("human-npt", ["copy"], tmp_path / "figures.json", "val", pairs=3)
    seen = next(row for row in report["results"] if row["split"] == "seen")
    assert (seen["pairs"], seen["failures"], seen["failed"]) == (2, 1, message)
    assert seen["each"]["failed"] == [None, message, None]
    assert seen["mm"] == pytest.approx(np.mean([mm for mm in seen["each"]["mm"] if mm is not None]), abs=0.01)
    text = markdown(report)
    assert "| 2 of 3, 1 failed |" in text
    assert f"Failed: `copy`, 1 of 3 pairs of seen ({message})." in text
    assert "Means are over the other pairs" in text


def test_a_set_of_which_every_pair_is_refused_is_reported(monkeypatch):
    def refuse(pair, method, **options):
        raise RefusedMeshError("x: expected a person, found a chair; give another")

    monkeypatch.setattr("mimesh.evaluate.measure.run_on", refuse)
    report = evaluate_command("human-npt", ["copy"], split="val", pairs=1)
    assert {(row["pairs"], row["failures"], len(row["each"]["failed"])) for row in report["results"]} == {(0, 1, 1)}
    assert "Failed: `copy`, 1 of 1 pairs of seen, 1 of 1 pairs of unseen (x: expected" in markdown(report)


def test_worst_pairs_are_drawn(tmp_path):
    (path,) = dump_worst(HUMAN_NPT, "val", "seen", "copy", {}, [{"pmd_e4": 5.0}, {}], tmp_path / "worst")
    assert path.name == "copy-seen-1.png"
    assert path.stat().st_size > 10_000


@pytest.mark.slow
def test_results_without_an_error_are_drawn_too(tmp_path):
    evaluate_command("human-npt", ["truth"], pairs=1, dump=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["truth-seen-1.png", "truth-unseen-1.png"]
