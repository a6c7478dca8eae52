"""Evaluation end to end: rows, provenance, the table, and names that do not exist."""

import json

import pytest
from networks import write_network

from mimesh.evaluate.run import evaluate_command, markdown
from mimesh.mesh import InputError


def test_copy_stands_where_the_protocol_puts_it(tmp_path):
    out, calls = tmp_path / "figures.json", []
    report = evaluate_command(
        "human-npt", ["copy"], out, pairs=6, progress=lambda done, total: calls.append((done, total))
    )
    assert json.loads(out.read_text()) == report
    assert {"seed", "config", "commit", "machine", "date"} <= set(report["provenance"])
    assert [(row["method"], row["split"], row["pairs"]) for row in report["results"]] == [
        ("copy", "seen", 6),
        ("copy", "unseen", 6),
    ]
    assert all(1 < row["pmd_e4_median"] <= row["pmd_e4_max"] < 100 for row in report["results"])
    assert all(row["pmd_mse_e4"] == pytest.approx(row["pmd_e4"] / 3, abs=1e-3) for row in report["results"])
    assert calls[-1] == (12, 12)
    assert "| copy |" in markdown(report)


def test_a_network_is_measured_through_the_pipeline_and_twice_alike(tmp_path):
    network = str(write_network(tmp_path / "tiny.onnx"))
    first, second = (evaluate_command("human-npt", [network], split="val", pairs=1) for _ in range(2))
    for a, b in zip(first["results"], second["results"], strict=True):
        assert a["pmd_e4"] == b["pmd_e4"] > 0


def test_unknown_names_say_what_there_is():
    with pytest.raises(InputError, match="human-npt"):
        evaluate_command("human-mnist", ["copy"])
    with pytest.raises(InputError, match="train, val, test"):
        evaluate_command("human-npt", ["copy"], split="tset")
