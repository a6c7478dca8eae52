"""Format reports as Markdown tables: the rows of a protocol, and the papers' tables with their values next to ours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ..core.errors import InputError
from ..core.frame_buffer import Progress
from .run import evaluate_command


class Row(NamedTuple):
    """A row of a paper's table."""

    label: str
    """The paper's name of the row, or ours for rows that the paper does not have."""
    method: str
    """Our method (`measure.result_vertices`)."""
    seen: float | None = None
    """PMD x1e4 on seen poses that the paper prints; None where it prints none."""
    unseen: float | None = None
    """The same on unseen poses."""


class Table(NamedTuple):
    """A table of a paper."""

    title: str
    protocol: str
    """Name of the protocol that it is measured on, with a kind `seen`, and `unseen` or `held-out`."""
    rows: tuple[Row, ...]


LAST_KIND_COLUMNS = {
    "mm": "mm",
    "edge_score": "edge score",
    "flipped": "flipped",
    "path_mm": "path, mm",
    "jitter": "jitter, m/s²",
    "liveliness": "acceleration / truth's",
    "still_mm": "motion while the driving is still, mm",
    "skate_cm_s": "foot skate, cm/s",
    "seconds_per_frame": "s a pair",
}
"""Metric -> heading of the columns that a report has for its last kind of pair only."""
LONGEST = Row("NPT, the paper's 16 people x 400 poses, longest training", "npt-table", 1.1, 9.3)
MIME_TABLE = Row("mime (ours, fits the shipped body), same people, poses and training time", "mime-table")
MIME_TABLE_NETWORK = Row("the same without the body fit: the network alone", "mime-table-network")
SHIPPED = Row("NPT as shipped: random people and poses, none of these 400", "npt", 1.1, 9.3)
MIME = Row("mime (ours, fits the shipped body): random people and poses, none of these 400", "mime")
MIME_NETWORK = Row("the same without the body fit: the network alone", "mime-network")
COPY = Row("the driving vertices, true correspondence and size", "copy")
SAME_TAKES = "random people; poses include frames of the takes of *seen*"
MIME_ON_CLIPS = Row(f"mime (ours, fits the shipped body): {SAME_TAKES}", "mime")
"""Label of the shipped weights in tables of clips. The captured seconds of *seen* are in their training data too."""
DENSE = Row("DT, true dense correspondence", "deformation-transfer-dense")
TABLES = {
    "npt-1": Table(
        "NPT Table 1: against deformation transfer",
        "human-npt",
        (
            Row("DT, 5 control points", "deformation-transfer-5", 7.3, 7.2),
            Row("DT, 13 control points", "deformation-transfer-13", 7.7, 6.7),
            DENSE,
            LONGEST,
            MIME_TABLE,
            MIME_TABLE_NETWORK,
            SHIPPED,
            MIME,
            MIME_NETWORK,
            COPY,
        ),
    ),
    "npt-2": Table(
        "NPT Table 2: ablations",
        "human-npt",
        (
            Row("concat1 (1x1 convolutions, InstanceNorm)", "npt-concat1", 12.1, 16.9),
            Row("without SPAdaIN (InstanceNorm in its place)", "npt-no-spadain", 8.3, 13.7),
            Row("without edge loss", "npt-no-edge", 1.2, 10.1),
            Row("NPT, as long as the rows above", "npt-equal", 1.1, 9.3),
            LONGEST,
            SHIPPED,
            COPY,
        ),
    ),
    "npt-7": Table(
        "NPT Table 7: against other baselines",
        "human-npt",
        (
            Row("skeleton", "skeleton", 27.4, 31.1),
            Row("max-pool, as long as NPT below it", "npt-maxpool-equal", 2.1, 12.7),
            Row("NPT, equal time", "npt-equal", 1.1, 9.3),
            LONGEST,
            Row("max-pool as shipped: random people and poses, none of these 400", "npt-maxpool", 2.1, 12.7),
            SHIPPED,
            MIME,
            COPY,
        ),
    ),
    "aniformer-1": Table(
        "AniFormer Table 1: ablations, narrow, with attention across frames only (the paper prints one figure and does "
        "not say whether it is of seen or unseen motions)",
        "clips-aniformer",
        (
            Row("regression head (vanilla)", "aniformer-regression", 15.31),
            Row("without that head", "aniformer-plain", 3.84),
            Row("with the motion constraint", "aniformer-motion", 1.37),
            Row("with the appearance constraint", "aniformer-appearance", 0.31),
            Row("with both", "aniformer-equal", 0.12),
            MIME_ON_CLIPS,
            COPY,
        ),
    ),
    "aniformer-2": Table(
        "AniFormer Table 2: against other methods, which work frame by frame (LIMP on its 2,100 vertices; the paper's "
        "text gives NPT 1.37 and 11.31)",
        "clips-aniformer",
        (
            Row("LIMP", "limp", 5.44, 7.11),
            Row("NPT-MP (max-pool)", "npt-maxpool-frames", 4.51, 6.69),
            Row("NPT", "npt-frames", 4.37, 5.31),
            Row("AniFormer, narrow, attention across frames only", "aniformer-equal", 0.12, 3.95),
            Row(f"NPT as shipped: {SAME_TAKES}", "npt", 4.37, 5.31),
            Row("AniFormer as shipped: random people; motions include the takes of *seen*", "aniformer", 0.12, 3.95),
            MIME_ON_CLIPS,
            Row("DT, 13 control points", "deformation-transfer-13"),
            DENSE,
            COPY,
        ),
    ),
}


def table_command(
    name: str,
    out: Path | None = None,
    pairs: int = 0,
    progress: Progress | None = None,
    data: Path | None = None,
) -> tuple[dict[str, Any], str]:
    """Measure the rows of a paper's table (`mimesh table`; resumable with `out`) and return the report and the table.

    Raises:
        InputError: no such table, a missing network of a row, or missing data.
    """
    if name not in TABLES:
        raise InputError(f"{name}: expected a table ({', '.join(TABLES)}), found another; check the name")
    methods = list(dict.fromkeys(row.method for row in TABLES[name].rows))
    report = evaluate_command(TABLES[name].protocol, methods, out, pairs=pairs, progress=progress, data=data)
    return report, paper_table(name, report)


def paper_table(name: str, *reports: dict[str, Any]) -> str:
    """Format a paper's table from reports; cells without a measurement say "not measured"."""
    table = TABLES[name]
    chosen = [report for report in reports if report["protocol"] == table.protocol]
    measured = {(row["method"], row["split"]): row for report in chosen for row in report["results"]}
    lines = []
    for row in table.rows:
        seen, unseen = (measured.get((row.method, kind)) for kind in ("seen", "unseen"))
        # Of clips, the counterpart of the papers' unseen motions is `held-out`.
        unseen = measured.get((row.method, "held-out"), unseen)
        means = [_mean_and_interval(seen), _mean_and_interval(unseen)]
        seconds = _cell(unseen, "seconds_per_frame")
        paper = [f"{value:g}" if value is not None else "-" for value in (row.seen, row.unseen)]
        described = [unseen.get("given", "-"), unseen.get("trained", "-")] if unseen else ["-", "-"]
        more = [_cell(unseen, key) for key in ("pmd_e4_median", "mm")]
        lines.append([row.label, f"`{row.method}`", *paper, *means, *more, seconds, *described])
    columns = ("ours", "paper, seen", "paper, unseen", "ours, seen", "ours, unseen", "unseen: median", "unseen: mm")
    head = ["row", *columns, "s a mesh", "given", "trained"]
    title = f"{table.title}. PMD (Eq. 7) x1e-4, mean; the paper's figures on SMPL, ours on the shipped body."
    return f"{title}\n\n" + markdown_table(head, lines)


def markdown(report: dict[str, Any]) -> str:
    """Format a report: one row per method, one column per kind of pair, and further metrics of the last kind.

    A second table has median, 90th percentile and maximum, because a mean alone hides failures.
    """
    rows = report["results"]
    kinds = list(dict.fromkeys(row["split"] for row in rows))
    methods = list(dict.fromkeys(row["method"] for row in rows))
    by_kind = {(row["method"], row["split"]): row for row in rows}
    # Some metrics are defined for clips only.
    measured = [name for name in LAST_KIND_COLUMNS if any(name in row for row in rows)]
    labels = LAST_KIND_COLUMNS | ({"seconds_per_frame": "s a frame"} if "path_mm" in measured else {})
    counts = dict.fromkeys(str(row["pairs"] + row.get("not_applicable", 0)) for row in rows)
    lines = []
    for method in methods:
        of_method = [by_kind[method, kind] for kind in kinds]
        means = [_mean_and_interval(row) for row in of_method]
        of_last_kind = [_cell(of_method[-1], name) for name in measured]
        lines.append([f"`{method}`", *means, *of_last_kind, of_method[-1].get("given", "-")])
    head = ["method", *kinds, *(f"{kinds[-1]}: {labels[name]}" for name in measured), "given"]
    title = f"{report['protocol']} version {report['version']}, PMD (Eq. 7) x1e-4 in the truth's unit sphere"
    tails = [[f"`{method}`", *(_tail(by_kind[method, kind]) for kind in kinds)] for method in methods]
    return (
        f"{title}, {'/'.join(counts)} pairs a column.\n\n{markdown_table(head, lines)}\n\n"
        f"Median, 90th percentile and largest of the pairs:\n\n{markdown_table(['method', *kinds], tails)}"
    )


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a Markdown table from its head and its rows."""
    rule = ["---"] * len(head)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, rule, *rows))


def _mean_and_interval(row: dict[str, Any] | None) -> str:
    """Format the mean PMD and half of its 95 % interval, with the number of pairs where some were not applicable."""
    text = _cell(row, "pmd_e4")
    if row is not None and "pmd_e4_ci95" in row:
        text += f" ± {row['pmd_e4_ci95']:.2g}"
    if row is not None and row.get("not_applicable") and row["pairs"]:
        text += f" ({row['pairs']} of {row['pairs'] + row['not_applicable']})"
    return text


def _tail(row: dict[str, Any]) -> str:
    """Format median, 90th percentile and maximum of the PMD."""
    return " / ".join(_cell(row, f"pmd_e4_{name}") for name in ("median", "p90", "max")) if row["pairs"] else "-"


def _cell(row: dict[str, Any] | None, name: str) -> str:
    """Format one metric of a row with three digits, or say why there is none."""
    if row is None:
        return "not measured"
    if name not in row:
        return "not applicable"
    return f"{row[name]:.3g}" if abs(row[name]) < 100 else f"{row[name]:.0f}"
