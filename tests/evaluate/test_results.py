"""The tables of results: all their numbers come from the reports."""

import csv
import io
import json
import zlib
from pathlib import Path

import pytest
from write_results import TABLES, page_tables, read_reports, readme_table, rows_csv, with_tables

from mimesh.core.errors import InputError
from mimesh.evaluate.metrics import VERSION
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


def impossible(method, split):
    return {"method": method, "split": split, "given": "-", "pairs": 0, "not_applicable": 2, "why": "no marks"}


def written(folder, *reports):
    for k, content in enumerate(reports):
        (folder / f"{content['protocol']}-{k}.json").write_text(json.dumps(content))
    return read_reports(folder)


def lines_of(table):
    """The cells of a table by set and method."""
    head, _, *lines = [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in table.splitlines()]
    return {(line[0], line[1]): dict(zip(head, line, strict=True)) for line in lines}


def test_wins_are_counted_over_the_reports(tmp_path):
    """The same pairs in two files."""
    ours = report("noise", [row("npt", "holes", 1.0, 5.0, 2.0, 1.0)])
    reports = written(tmp_path, ours, report("noise", [row("copy", "holes", 2.0, 2.0, 3.0, 4.0)]))
    cells = lines_of(page_tables(reports)["disturbed"])
    assert cells["holes (development)", "`npt`"]["better than `copy`"] == "75 %"
    assert cells["holes (development)", "`copy`"]["better than `copy`"] == "-"


def test_table_has_the_chosen_methods_that_were_possible(tmp_path):
    rows = [row("npt", "seen", 12.0), row("npt-concat1", "seen", 9.0), impossible("deformation-transfer-13", "seen")]
    tables = page_tables(written(tmp_path, report("human-npt", rows)))
    assert list(lines_of(tables["papers"])) == [("random pairs, seen", "`npt`")]
    assert tables["animals"] == "Not measured."


def test_failures_are_counted_beside_the_pairs(tmp_path):
    table = page_tables(written(tmp_path, report("characters", [row("mime", "table6", 4.0) | {"failures": 2}])))
    assert lines_of(table["characters"])["Table 6", "`mime`"]["pairs"] == "1, 2 failed"


def test_pairs_of_two_skeletons_have_angles(tmp_path):
    angles = {"limb_deg": 12.0, "limb_deg_median": 11.0}
    rows = [{"method": "mime", "split": "across-clips", "given": "-", "pairs": 1, **angles}]
    table = page_tables(written(tmp_path, report("characters", rows)))["skeletons"]
    assert table == "frames of clips: `mime` 11."


def test_warnings_of_test_sets_and_others_are_not_pooled(tmp_path):
    figures = {"uncertainty": [0.1, 2.5, 1.2], "warned": [False, True, True]}
    rows = [row("mime", "holes", 60.0, 80.0, 5.0, **figures)]
    text = page_tables(written(tmp_path, report("noise", rows)))["warnings"]
    assert text == "Other sets, 3 pairs: 1 of 2 bad results had a warning, and 1 of 1 good ones."


def test_csv_has_every_row_with_its_figures_and_origin(tmp_path):
    rows = [row("npt", "holes", 1.0, 2.0), impossible("copy", "holes")]
    found = list(csv.DictReader(io.StringIO(rows_csv(written(tmp_path, report("noise", rows))))))
    assert [line["method"] for line in found] == ["npt", "copy"]
    assert found[0].items() >= {"kind": "holes", "role": "development", "pmd_e4": "1.5", "commit": "01234567"}.items()
    assert (found[1]["why"], found[1]["pmd_e4"]) == ("no marks", "")
    assert "each" not in found[0]


def test_reports_of_other_pairs_and_rows_that_recur_are_refused(tmp_path):
    ours = report("noise", [row("npt", "holes", 1.0)])
    with pytest.raises(InputError, match=r"noise-1\.json.*noise holes npt in noise-0\.json"):
        written(tmp_path, ours, ours)
    part = ours | {"sets": {"holes": {"role": "development", "frozen": "part"}}}
    (tmp_path / "noise-1.json").unlink()
    with pytest.raises(InputError, match="all pairs of the frozen set noise holes"):
        written(tmp_path, part)


def test_reports_of_another_split_are_refused(tmp_path):
    (tmp_path / "noise.json").write_text(json.dumps(report("noise", [row("npt", "holes", 1.0)], "val")))
    with pytest.raises(InputError, match="split test"):
        read_reports(tmp_path)


def test_reports_of_an_earlier_version_of_the_metrics_are_refused(tmp_path):
    old = report("noise", [row("npt", "holes", 1.0)])
    del old["metrics"]
    with pytest.raises(InputError, match=r"noise-0\.json: expected figures of version 2 .*, found version 1"):
        written(tmp_path, old)


def test_readme_says_what_was_not_measured(tmp_path):
    table = readme_table(written(tmp_path, report("noise", [row("copy", "holes", 2.0)])))
    _, _, *lines = table.splitlines()
    assert lines
    assert all("not measured" in line for line in lines)


def test_tables_are_replaced_between_their_marks():
    table = "| a | b |"
    text = "before <!-- results:begin --> old <!-- results:end --> after"
    page = with_tables(text, {"results": table})
    assert page == f"before <!-- results:begin -->\n\n{table}\n\n<!-- results:end --> after"
    assert with_tables(page, {"results": table}) == page
    with pytest.raises(ValueError, match=r"papers:begin.* once, found 0 and 0"):
        with_tables(text, {"papers": table})


@pytest.mark.skipif(not (DOCS / "results").exists(), reason="a package without its docs")
def test_tables_in_the_docs_are_the_generated_ones():
    page, readme = ((DOCS.parent / name).read_text(encoding="utf-8") for name in ("docs/results.md", "README.md"))
    reports = read_reports(DOCS / "results")
    tables = page_tables(reports)
    assert set(TABLES) < set(tables)
    assert with_tables(page, tables) == page
    assert with_tables(readme, {"results": readme_table(reports)}) == readme
    assert (DOCS / "results" / "rows.csv").read_text(encoding="utf-8") == rows_csv(reports)


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
