"""The page of results: figures come from the reports and nowhere else."""

import json
from pathlib import Path

import pytest

from mimesh.evaluate.results import one_page, results_page

DOCS = Path(__file__).parents[2] / "docs"


def report(protocol, rows):
    made = {"config": {"pairs": 2}, "commit": "0123456789abcdef", "machine": "a box", "date": "2026-11-21T00:00"}
    return {"protocol": protocol, "version": 1, "provenance": made, "results": rows}


def row(method, split, pmd):
    return {"method": method, "split": split, "pairs": 2, "pmd_e4": pmd, "seconds_per_frame": 0.5}


NOISE = report(
    "noise", [row("npt", "holes", 1.0), row("npt", "cropped", 2.0), row("npt", "half", 6.0), row("copy", "holes", 1.0)]
)


def test_one_page_means_over_kinds_and_never_over_missing_ones():
    lines = one_page([NOISE]).splitlines()
    cells = {line.split("|")[1].strip(): [c.strip() for c in line.split("|")[2:]] for line in lines[2:]}
    column = [c.strip() for c in lines[0].split("|")[2:]].index("damaged")
    assert cells["`npt`"][column] == "3"
    assert cells["`copy`"][column] == "-"


def test_the_page_quotes_reasons_and_provenance(tmp_path):
    why = {"method": "deformation-transfer-13", "split": "points", "pairs": 0, "why": "no faces", "not_applicable": 2}
    (tmp_path / "cross-topology.json").write_text(json.dumps(report("cross-topology", [why])))
    page = results_page(tmp_path)
    assert "no faces" in page
    assert "0123456789, a box, 2026-11-21" in page
    assert "| DT, 13 control points | `deformation-transfer-13` | 7.7 | 6.7 | not measured |" in page


@pytest.mark.skipif(not (DOCS / "RESULTS.md").exists(), reason="a package without its docs")
def test_the_page_in_the_docs_is_the_generated_one():
    assert (DOCS / "RESULTS.md").read_text() == results_page(DOCS / "results")
