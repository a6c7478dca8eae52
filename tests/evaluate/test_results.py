"""The page of results: all its numbers come from the reports."""

import json
import zlib
from pathlib import Path

import pytest

from mimesh.core.errors import InputError
from mimesh.evaluate.metrics import VERSION
from mimesh.evaluate.results import README_MARKS, readme_table, results_page, with_readme_table
from mimesh.evaluate.run import fingerprint
from mimesh.methods.find import is_table_model, weights_path

DOCS = Path(__file__).parents[2] / "docs"


def report(protocol, rows, split="test"):
    provenance = {
        "config": {"pairs": 2, "split": split},
        "commit": "01234567",
        "machine": "a box",
        "date": "2026-11-21T00:00",
    }
    return {"protocol": protocol, "version": 1, "metrics": VERSION, "provenance": provenance, "results": rows}


def row(method, split, *errors, given="nothing", **more):
    """A row of a report with the figures of pairs 0, 1, ..."""
    each = {"pair": list(map(str, range(len(errors)))), "pmd_e4": list(errors), **more}
    mean = sum(errors) / len(errors)
    figures = {"pairs": len(errors), "pmd_e4": mean, "pmd_e4_median": mean, "seconds_per_frame": 0.5, "mm": 5.0}
    return {"method": method, "split": split, "given": given, "trained": "none", **figures, "each": each}


def written(folder, *reports):
    for k, content in enumerate(reports):
        (folder / f"{content['protocol']}-{k}.json").write_text(json.dumps(content))
    return folder


def table_after(page, heading):
    """The cells of the first table after a heading, by method."""
    lines = page[page.index(heading) :].split("\n\n| ")[1].split("\n\n")[0].splitlines()
    head = [cell.strip() for cell in lines[0].strip("| ").split(" | ")]
    cells = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in lines[2:]]
    return {line[0]: dict(zip(head, line, strict=True)) for line in cells}


def test_wins_are_counted_over_the_reports(tmp_path):
    """The same pairs in two files."""
    ours = report("noise", [row("npt", "holes", 1.0, 5.0, 2.0, 1.0)])
    page = results_page(written(tmp_path, ours, report("noise", [row("copy", "holes", 2.0, 2.0, 3.0, 4.0)])))
    cells = table_after(page, "### holes")
    assert cells["`npt`"]["better than `copy`"] == "75 %"
    assert cells["`copy`"]["better than `copy`"] == "-"


def test_rows_of_the_papers_tables_stand_apart_from_what_users_get(tmp_path):
    rows = [row("npt-full", "seen", 7.0), row("npt", "seen", 12.0), row("mime-table-network", "seen", 3.0)]
    fits = row("mime", "seen", 0.3, given="trained on our body, which it fits")
    page = results_page(written(tmp_path, report("human-npt", [*rows, fits])))
    ours, papers = page.split("## The papers' tables")
    assert "`npt-full`" not in ours
    assert "`mime-table-network`" not in ours
    assert set(table_after(ours, "### Table 6, the papers' training poses")) == {"`npt`"}
    assert set(table_after(ours, "With the shipped body's model:")) == {"`mime`"}
    assert "| NPT, full width | 1.1 / 9.3 | 7 |" in papers


def test_mirror_images_stand_beside_their_pairs(tmp_path):
    rows = [row(method, kind, 4.0) for method in ("npt", "copy") for kind in ("seen", "unseen")]
    mirrored = [row("npt", "seen, mirrored", 90.0), row("npt", "unseen, mirrored", 80.0)]
    plain = results_page(written(tmp_path, report("human-npt", rows)))
    assert "### Mirror images" not in plain
    page = results_page(written(tmp_path, report("human-npt", rows), report("human-npt", mirrored)))
    assert "| `npt` | 4 | 90 | 4 | 80 |" in page.split("### Mirror images")[1]
    assert page.split("### Table 6, the papers' training poses")[1].split("###")[0].count("| `npt` |") == 1


def test_warnings_have_their_share_and_curve(tmp_path):
    figures = {"uncertainty": [0.1, 2.5, 1.2], "warned": [False, True, True]}
    page = results_page(written(tmp_path, report("noise", [row("mime", "holes", 60.0, 80.0, 5.0, **figures)])))
    cells = table_after(page, "## Warnings")
    development = "all development and stress sets"
    assert list(cells[development].values()) == [development, "3", "2", "1 (50 %)", "1", "1 (100 %)"]
    assert "all test sets" not in cells, "sets of different roles are not pooled"
    assert set(table_after(page, "All development and stress sets:")) == {"0 to 0.25", "1 to 1.5", "2 to inf"}


def test_reports_of_other_pairs_and_rows_that_recur_are_refused(tmp_path):
    ours = report("noise", [row("npt", "holes", 1.0)])
    with pytest.raises(InputError, match=r"noise-1\.json.*noise holes npt in noise-0\.json"):
        results_page(written(tmp_path, ours, ours))
    part = ours | {"sets": {"holes": {"role": "development", "frozen": "part"}}}
    (tmp_path / "noise-1.json").unlink()
    with pytest.raises(InputError, match="all pairs of the frozen set noise holes"):
        results_page(written(tmp_path, part))


def test_errors_on_characters_are_shown_by_maker(tmp_path):
    names = {"identity": ["We: ours: a", "We: ours: b", "They: others: c"]}
    page = results_page(written(tmp_path, report("characters", [row("mime", "table6", 4.0, 8.0, 20.0, **names)])))
    cells = table_after(page, "### By maker")
    assert cells["We, ours"] == {"maker, pack": "We, ours", "table6, PMD": "6 / 6 (2)"}
    assert cells["They, others"]["table6, PMD"] == "20 / 20 (1)"


def test_table_of_the_readme_is_replaced_between_its_marks(tmp_path):
    table = readme_table(written(tmp_path, report("characters", [row("mime", "clips", 0.28)])))
    lines = {line.split(" | ")[0]: line for line in table.splitlines()}
    assert next(line for name, line in lines.items() if "`mime`" in name).endswith("| 5 mm |")
    assert next(line for name, line in lines.items() if "`npt`" in name).endswith("| not measured |")
    text = f"before {README_MARKS[0]} old {README_MARKS[1]} after"
    assert with_readme_table(text, table) == f"before {README_MARKS[0]}\n\n{table}\n\n{README_MARKS[1]} after"


def test_page_has_reasons_and_provenance(tmp_path):
    why = {**row("deformation-transfer-13", "points", 0), "pairs": 0, "why": "no faces", "not_applicable": 2}
    del why["pmd_e4"], why["each"]
    (tmp_path / "cross-topology.json").write_text(json.dumps(report("cross-topology", [why])))
    page = results_page(tmp_path)
    assert "`deformation-transfer-13`, 2 of 2 pairs of points (no faces)" in page
    assert "01234567, a box, 2026-11-21" in page
    assert "| DT, 13 control points | 7.7 / 6.7 | not measured |" in page


def test_reports_of_another_split_are_refused(tmp_path):
    (tmp_path / "noise.json").write_text(json.dumps(report("noise", [row("npt", "holes", 1.0)], "val")))
    with pytest.raises(InputError, match="split test"):
        results_page(tmp_path)


def test_reports_of_an_earlier_version_of_the_metrics_are_refused(tmp_path):
    old = report("noise", [row("npt", "holes", 1.0)])
    del old["metrics"]
    with pytest.raises(InputError, match=r"noise-0\.json: expected figures of version 2 .*, found version 1"):
        results_page(written(tmp_path, old))


@pytest.mark.skipif(not (DOCS / "RESULTS.md").exists(), reason="a package without its docs")
def test_page_in_the_docs_is_the_generated_one():
    assert (DOCS / "RESULTS.md").read_text() == results_page(DOCS / "results")
    readme = (DOCS.parent / "README.md").read_text()
    assert with_readme_table(readme, readme_table(DOCS / "results")) == readme


@pytest.mark.skipif(not (DOCS / "results").exists(), reason="a package without its docs")
@pytest.mark.parametrize("path", sorted((DOCS / "results").glob("*.json")), ids=lambda path: path.stem)
def test_reports_in_the_docs_are_of_the_current_weights(path, monkeypatch):
    monkeypatch.chdir(DOCS.parent)  # where the folder `ablations` is
    for row_of_report in json.loads(path.read_text())["results"]:
        method, weights = row_of_report["method"], weights_path(row_of_report["method"])
        if is_table_model(method) and not weights.exists():  # a row of a table: its card tells its weights
            card = weights.with_suffix(".json")
            assert not card.exists() or row_of_report["weights"] == json.loads(card.read_text())["crc32"]
            continue
        # Reports from before there was a network of hands have the checksum of the model's file alone.
        alone = zlib.crc32(weights.read_bytes()) if weights.suffix == ".onnx" else 0
        assert row_of_report["weights"] == alone or row_of_report["weights"] == fingerprint(method)


def test_fingers_have_a_section_with_columns_of_their_own(tmp_path):
    figures = {"fingertip_mm": 9.0, "fingertip_mm_median": 8.0, "finger_deg": 12.0}
    given = "trained on our body, which it fits"
    rows = [{**row("identity", "rest", 3.0), **figures}, {**row("mime", "rest", 1.0, given=given), **figures}]
    page = results_page(written(tmp_path, report("fingers", rows)))
    section = page[page.index("## Fingers") : page.index("## Four-legged animals")]
    assert section.count("Not measured.") == 3
    for table in (section, section[section.index("With the shipped body's model:") :]):
        cells = next(iter(table_after(table, table[:9]).values()))
        assert (cells["fingertips, mm"], cells["finger joints, degrees"]) == ("9", "12")
