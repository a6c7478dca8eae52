"""Write the tables of docs/results.md, docs/papers.md and README.md, and docs/results/rows.csv, from stored reports.

python scripts/write_results.py
python scripts/write_results.py --curves FOLDER    # takes the curves of trainings by scripts/train_on_gpu.py first
"""

from __future__ import annotations

import argparse
import csv
import io
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mimesh.core.errors import InputError
from mimesh.evaluate.frozen_sets import role
from mimesh.evaluate.markdown import cell, markdown_table, wins, with_interval
from mimesh.evaluate.metrics import VERSION
from mimesh.io.atomic import whole_file

DOCS = Path(__file__).parents[1] / "docs"
RESULTS, CURVES = DOCS / "results", DOCS / "curves.json"
Key = tuple[str, str]
"""Name of a protocol and kind of pair."""


class PageTable(NamedTuple):
    """A table of docs/results.md: some methods on some test sets. What else was measured is in rows.csv."""

    sets: dict[str, Key]
    """Name in the table -> test set."""
    methods: tuple[str, ...]
    baseline: str
    """Method against which wins are counted."""


TABLES = {
    "characters": PageTable(
        {
            "Table 6": ("characters", "table6"),
            "joint limits": ("characters", "limits"),
            "frames of clips": ("characters", "clips"),
        },
        ("mime", "mime-network", "npt", "deformation-transfer-13", "identity"),
        "deformation-transfer-13",
    ),
    "papers": PageTable(
        {
            "random pairs, seen": ("human-npt", "seen"),
            "random pairs, unseen": ("human-npt", "unseen"),
            "one vertex order, seen": ("clips-ordered", "seen"),
            "one vertex order, unseen": ("clips-ordered", "unseen"),
        },
        (
            *("npt-full", "npt-full-mixed", "npt", "aniformer-ordered", "aniformer-ordered-mixed", "mime"),
            *("deformation-transfer-13", "copy"),
        ),
        "copy",
    ),
    "animals": PageTable(
        {
            "gaits": ("quadruped", "gaits"),
            "everyday poses": ("quadruped", "usual"),
            "joint limits": ("quadruped", "limits"),
        },
        ("mime-quadruped", "deformation-transfer-13", "copy", "identity"),
        "deformation-transfer-13",
    ),
    "disturbed": PageTable(
        {
            "noise of up to 2 %": ("noise", "noise-2"),
            "noise of up to 5 %": ("noise", "noise-5"),
            "holes": ("noise", "holes"),
            "a limb is missing": ("noise", "cropped"),
            "seen from one side": ("noise", "half"),
            "decimated": ("cross-topology", "decimated"),
            "retriangulated": ("cross-topology", "retriangulated"),
            "points without faces": ("cross-topology", "points"),
            "joint limits": ("human-wide", "limits"),
        },
        ("mime", "npt", "deformation-transfer-dense", "deformation-transfer-13", "copy"),
        "copy",
    ),
}
"""Name of its place in docs/results.md -> table."""
ACROSS = {"Table 6": "across-table6", "joint limits": "across-limits", "frames of clips": "across-clips"}
"""Heading -> kind of `characters` whose pairs have two skeletons, and so no true mesh."""
BAD_E4, GOOD_E4 = 50.0, 10.0
"""PMD x1e4 above which a result is bad, and below which it is good, where warnings are measured."""
README_METHODS = {
    "deformation-transfer-13": "deformation transfer, with a third mesh and 13 markers",
    "mime": "`mime`, our default, with the two meshes alone",
    "npt": "`npt`, NPT (CVPR 2020) in a narrow network, trained on other data than its paper's",
    "identity": "the identity, not moved",
}
"""Method -> its name in the README's table."""


def main(arguments: list[str] | None = None) -> None:
    """Write the tables between their marks, and the CSV file.

    Args:
        arguments: those of the command line; None: of this process.
    """
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--curves", type=Path, metavar="FOLDER", help="with NAME.json and NAME-log.jsonl of networks")
    folder = parser.parse_args(arguments).curves
    curves = json.loads(CURVES.read_text(encoding="utf-8")) if folder is None else read_curves(folder)
    reports = read_reports(RESULTS)
    tables = {
        DOCS / "results.md": page_tables(reports),
        DOCS / "papers.md": {"curves": curve_table(curves)},
        DOCS.parent / "README.md": {"results": readme_table(reports)},
    }
    texts = {page: with_tables(page.read_text(encoding="utf-8"), of_page) for page, of_page in tables.items()}
    texts |= {RESULTS / "rows.csv": rows_csv(reports), CURVES: json.dumps(curves, indent=1) + "\n"}
    for path, text in texts.items():
        with whole_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
        print(f"{path}: written")


def page_tables(reports: dict[str, dict[str, Any]]) -> dict[str, str]:
    """Format the tables of docs/results.md by the names of their places."""
    rows = rows_by_set(reports)
    tables = {name: main_table(table, rows) for name, table in TABLES.items()}
    return tables | {"skeletons": _skeletons(rows), "warnings": _warnings(rows)}


def main_table(table: PageTable, rows: dict[Key, list[dict[str, Any]]]) -> str:
    """Format a table; methods that were not measured on a set, or not possible, have no row there."""
    lines = []
    for name, key in table.sets.items():
        by_method = {row["method"]: row for row in rows.get(key, []) if row["pairs"]}
        title = name if (used := role(key[0], "test", key[1])) == "test" else f"{name} ({used})"
        for method in (method for method in table.methods if method in by_method):
            row, baseline = by_method[method], by_method.get(table.baseline)
            failed = f", {row['failures']} failed" if row.get("failures") else ""
            cells = [f"{row['pairs']}{failed}", cell(row, "mm"), cell(row, "mm_median"), with_interval(row, "pmd_e4")]
            beside = (wins(row, baseline), common_mean(baseline, row)) if baseline else ("-", "-")
            lines.append([title, f"`{method}`", *cells, cell(row, "pmd_public_e4"), *beside, row["given"]])
    head = ["set", "method", "pairs", "mm: mean", "mm: median", "PMD", "public formula"]
    head += [f"better than `{table.baseline}`", "its mean on these pairs", "given"]
    return markdown_table(head, lines) if lines else "Not measured."


def common_mean(row: dict[str, Any], *others: dict[str, Any]) -> str:
    """Format the mean distance (mm) of a method on the pairs that others have figures of, too."""
    if not all("mm" in of["each"] for of in (row, *others)):
        return "-"
    assert all(other["each"]["pair"] == row["each"]["pair"] for other in others)
    figures = np.array([of["each"]["mm"] for of in (row, *others)], float)  # None is NaN
    common = figures[0, np.isfinite(figures).all(axis=0)]
    return cell({"pairs": len(common), "mm": round(float(common.mean()), 2)}, "mm")


def rows_csv(reports: dict[str, dict[str, Any]]) -> str:
    """Format all rows of all reports as CSV, one line each: every figure, and where and when it was measured."""
    lines = []
    for stem, report in reports.items():
        origin = {name: report["provenance"][name] for name in ("commit", "date", "machine")}
        for row in report["results"]:
            start = {"report": stem, "protocol": report["protocol"], "kind": row["split"]}
            start["role"] = role(report["protocol"], "test", row["split"])
            figures = {k: v for k, v in row.items() if k not in ("split", "each", "origin")}
            lines.append(start | figures | origin | row.get("origin", {}))
    text = io.StringIO()
    writer = csv.DictWriter(text, dict.fromkeys(name for line in lines for name in line), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()


def read_reports(folder: Path) -> dict[str, dict[str, Any]]:
    """Read the reports of a folder by file name without suffix.

    Raises:
        InputError: a report of another version of the metrics, of another split than `test` or of other pairs than the
            frozen ones, or a method that two reports have on the same pairs.
    """
    reports = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))}
    found: dict[tuple[str, str, str], str] = {}
    for stem, report in reports.items():
        if (version := report.get("metrics", 1)) != VERSION:
            raise InputError(
                f"{stem}.json: expected figures of version {VERSION} of the metrics, found version {version}; "
                "measure it again"
            )
        if report["provenance"]["config"].get("split") != "test":
            raise InputError(f"{stem}.json: expected figures of the split test, found others; measure it again")
        for kind, facts in report.get("sets", {}).items():
            if facts["frozen"] not in ("same", "unknown"):
                raise InputError(
                    f"{stem}.json: expected all pairs of the frozen set {report['protocol']} {kind}, found others; "
                    "measure it again"
                )
        for row in report["results"]:
            key = (report["protocol"], row["split"], row["method"])
            if key in found:
                raise InputError(
                    f"{stem}.json: expected figures that no other report has, found {' '.join(key)} in "
                    f"{found[key]}.json too; remove one"
                )
            found[key] = stem
    return reports


def read_curves(folder: Path) -> list[dict[str, Any]]:
    """Read what trainings had on `val` as they went on: from their cards, and their logs beside these."""
    curves = []
    for log in sorted(folder.glob("*-log.jsonl")):
        card = json.loads(log.with_name(log.name.replace("-log.jsonl", ".json")).read_text(encoding="utf-8"))
        before = card.get("before", ())
        done = {key: sum(stage[key] for stage in before) for key in ("operations", "pairs", "seconds_trained")}
        points = []
        for line in map(json.loads, log.read_text(encoding="utf-8").splitlines()):
            if line["kind"] == "validation":
                operations = done["operations"] + card["operations"] * line["pairs"] / card["pairs"]
                figures = {f"{kind}_pmd_e4": round(line[kind], 3) for kind in ("seen", "unseen", "fresh")}
                pairs, seconds = done["pairs"] + line["pairs"], round(done["seconds_trained"] + line["seconds"], 1)
                points.append({"pairs": pairs, "pflop": round(operations / 1e15, 2), "seconds": seconds, **figures})
        kept = {key: card[key] for key in ("name", "data", "seed", "commit", "hardware", "precision", "config")}
        curves.append({**kept, "metrics": card["metrics"]["version"], "points": points})
    return curves


def curve_table(curves: list[dict[str, Any]]) -> str:
    """Format the curves: Eq. 7 on `val` after so many pairs."""
    lines = [
        [
            f"`{curve['name']}`" if k == 0 else "",
            f"{point['pairs']:,}",
            f"{point['pflop']:.1f}",
            f"{point['seconds']:.0f} s",
            *(f"{point[f'{kind}_pmd_e4']:.1f}" for kind in ("seen", "unseen", "fresh")),
        ]
        for curve in curves
        for k, point in enumerate(curve["points"])
    ]
    return markdown_table(["network", "pairs", "PFLOP", "training", "seen", "unseen", "fresh"], lines)


def rows_by_set(reports: dict[str, dict[str, Any]]) -> dict[Key, list[dict[str, Any]]]:
    """Collect the rows of all reports by protocol and kind of pair."""
    rows: dict[Key, list[dict[str, Any]]] = {}
    for report in reports.values():
        for row in report["results"]:
            rows.setdefault((report["protocol"], row["split"]), []).append(row)
    return rows


def readme_table(reports: dict[str, dict[str, Any]]) -> str:
    """Format the README's table: the mean distance on characters of other makers, in frames of clips.

    It is over the pairs that all of its methods have.
    """
    found = {row["method"]: row for row in rows_by_set(reports).get(("characters", "clips"), [])}
    shown = [found[method] for method in README_METHODS if method in found]
    lines = [
        [label, f"{common_mean(found[method], *shown)} mm" if method in found else "not measured"]
        for method, label in README_METHODS.items()
    ]
    return markdown_table(["method", "people of other makers, in frames of motions, without rigs"], lines)


def with_tables(text: str, tables: dict[str, str]) -> str:
    """Return a page with what stands between the marks `<!-- NAME:begin -->` and `<!-- NAME:end -->` replaced.

    Raises:
        ValueError: a mark is missing, or there are two of one.
    """
    for name, table in tables.items():
        begin, end = f"<!-- {name}:begin -->", f"<!-- {name}:end -->"
        if text.count(begin) != 1 or text.count(end) != 1:
            raise ValueError(
                f"expected {begin} and {end} once, found {text.count(begin)} and {text.count(end)} of them"
            )
        text = f"{text.split(begin)[0]}{begin}\n\n{table}\n\n{end}{text.split(end)[1]}"
    return text


def _skeletons(rows: dict[Key, list[dict[str, Any]]]) -> str:
    """Say how far the limbs are off between characters of two skeletons (degrees, medians)."""
    sentences = []
    for name, kind in ACROSS.items():
        found = {row["method"]: row for row in rows.get(("characters", kind), []) if "limb_deg" in row}
        figures = [f"`{method}` {cell(row, 'limb_deg_median')}" for method, row in found.items()]
        sentences += [f"{name}: {', '.join(figures)}."] if figures else []
    return " ".join(sentences) or "Not measured."


def _warnings(rows: dict[Key, list[dict[str, Any]]]) -> str:
    """Say how many bad and good results of `mime` came with a warning, apart for test sets and others."""
    found: dict[str, list[dict[str, Any]]] = {"Test": [], "Other": []}
    for (protocol, kind), of_kind in rows.items():
        name = "Test" if role(protocol, "test", kind) == "test" else "Other"
        found[name] += [row for row in of_kind if row["method"] == "mime"]
    lines = [
        f"{name} sets, {counts['pairs']} pairs: {counts['bad_warned']} of {counts['bad']} bad results had a warning, "
        f"and {counts['good_warned']} of {counts['good']} good ones."
        for name, of_role in found.items()
        if (counts := warnings_count(of_role)) is not None
    ]
    return "\n".join(lines) or "Not measured."


def warnings_count(rows: list[dict[str, Any]]) -> dict[str, int] | None:
    """Count bad and good results, and how many of each came with a warning; None if the method gives no confidence."""
    figures = confidence_figures(rows)
    if not len(figures):
        return None
    error, _, warned = figures.T
    bad, good = error > BAD_E4, error < GOOD_E4
    counts = {"pairs": len(figures), "bad": bad.sum(), "bad_warned": (bad & (warned > 0)).sum()}
    counts |= {"good": good.sum(), "good_warned": (good & (warned > 0)).sum()}
    return {name: int(count) for name, count in counts.items()}


def confidence_figures(rows: list[dict[str, Any]]) -> Float[np.ndarray, "N 3"]:
    """Return PMD x1e4, uncertainty and whether there was a warning, of all pairs of rows that have them."""
    found = []
    for row in rows:
        each = row.get("each", {})
        columns = [each.get(name, ()) for name in ("pmd_e4", "uncertainty", "warned")]
        found += [line for line in zip(*columns, strict=False) if None not in line]
    return np.array(found, dtype=float).reshape(-1, 3)


if __name__ == "__main__":
    main()
