"""The page of results: all its numbers come from the reports."""

import json
from pathlib import Path

import pytest

from mimesh.core.errors import InputError
from mimesh.evaluate.results import overview_table, results_page
from mimesh.evaluate.run import fingerprint

DOCS = Path(__file__).parents[2] / "docs"


def report(protocol, rows, split="test"):
    provenance = {
        "config": {"pairs": 2, "split": split},
        "commit": "01234567",
        "machine": "a box",
        "date": "2026-11-21T00:00",
    }
    return {"protocol": protocol, "version": 1, "provenance": provenance, "results": rows}


def row(method, split, pmd):
    figures = {"pairs": 2, "pmd_e4": pmd, "seconds_per_frame": 0.5, "given": "nothing", "trained": "none"}
    return {"method": method, "split": split, **figures}


NOISE = report(
    "noise", [row("npt", "holes", 1.0), row("npt", "cropped", 2.0), row("npt", "half", 6.0), row("copy", "holes", 1.0)]
)


def test_overview_is_the_mean_over_kinds_and_empty_if_one_is_missing():
    lines = overview_table([NOISE]).splitlines()
    cells = {line.split("|")[1].strip(): [c.strip() for c in line.split("|")[2:]] for line in lines[2:]}
    column = [c.strip() for c in lines[0].split("|")[2:]].index("damaged")
    assert cells["`npt`"][column] == "3"
    assert cells["`copy`"][column] == "-"


def test_page_has_reasons_and_provenance(tmp_path):
    why = {**row("deformation-transfer-13", "points", 0), "pairs": 0, "why": "no faces", "not_applicable": 2}
    del why["pmd_e4"]
    (tmp_path / "cross-topology.json").write_text(json.dumps(report("cross-topology", [why])))
    page = results_page(tmp_path)
    assert "`deformation-transfer-13`, 2 of 2 pairs of points (no faces)" in page
    assert "01234567, a box, 2026-11-21" in page
    assert "| DT, 13 control points | `deformation-transfer-13` | 7.7 | 6.7 | not measured |" in page


def test_reports_of_another_split_are_refused(tmp_path):
    (tmp_path / "noise.json").write_text(json.dumps(report("noise", [row("npt", "holes", 1.0)], "val")))
    with pytest.raises(InputError, match="split test"):
        results_page(tmp_path)


def test_overview_is_empty_for_kinds_with_missing_pairs():
    rows = [{**row("npt", kind, 1.0), "not_applicable": 1} for kind in ("holes", "cropped", "half")]
    assert "| 1 |" not in overview_table([report("noise", rows)])


@pytest.mark.skipif(not (DOCS / "RESULTS.md").exists(), reason="a package without its docs")
def test_page_in_the_docs_is_the_generated_one():
    assert (DOCS / "RESULTS.md").read_text() == results_page(DOCS / "results")


@pytest.mark.skipif(not (DOCS / "results").exists(), reason="a package without its docs")
@pytest.mark.parametrize("path", sorted((DOCS / "results").glob("*.json")), ids=lambda path: path.stem)
def test_reports_in_the_docs_are_of_the_current_weights(path, monkeypatch):
    monkeypatch.chdir(DOCS.parent)  # where the folder `ablations` is
    for row_of_report in json.loads(path.read_text())["results"]:
        assert row_of_report["weights"] == fingerprint(row_of_report["method"])
