"""Format the rows of reports as Markdown tables: every mean with its interval, median, 90th percentile and wins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..bodies.joint_names import without_side
from .summary import summary, win_share

BASELINES = ("copy", "deformation-transfer-13")
"""Methods against which wins are counted."""
CLIP_COLUMNS = {
    "path_mm": "path, mm",
    "jitter": "jitter, m/s²",
    "liveliness": "acceleration / truth's",
    "still_mm": "motion while the driving is still, mm",
    "skate_cm_s": "foot skate, cm/s",
}
"""Metric of clips -> heading."""
RIG_COLUMNS = {
    "joints_pct": "joints, % of height",
    "joints_pct_median": "median",
    "joints_pct_p90": "90 %",
    "j2j": "J2J, %",
    "j2b": "J2B, %",
    "b2b": "B2B, %",
    "iou": "IoU, %",
    "weights_l1": "weights, L1",
    "deform_mm": "in its clips, mm",
    "seconds_per_frame": "s",
}
"""Metric of rigs, beside those of their makers -> heading."""
LIMB_COLUMNS = {"sole_height": "soles, leg lengths", "touching": "contacts that agree"}
"""Metric of results without a true mesh -> heading."""


def markdown(report: dict[str, Any]) -> str:
    """Format a report: for each kind of pair one table, with a row for each method."""
    rows = report["results"]
    kinds = list(dict.fromkeys(row["split"] for row in rows))
    tables = [f"**{kind}**\n\n{kind_table([row for row in rows if row['split'] == kind])}" for kind in kinds]
    config = report["provenance"]["config"]
    if "lists" in config:
        title = f"{report['protocol']}: {config['data']}."
    else:
        title = f"{report['protocol']} version {report['version']}, split {config['split']}."
    for method in dict.fromkeys(row["method"] for row in rows):
        of_method = [row for row in rows if row["method"] == method and "limb_deg" in row]
        if of_method:
            tables += [f"**`{method}` by maker**: median / mean (pairs)", makers_table(of_method)]
        tables += [rigs_of_makers(row) for row in rows if row["method"] == method and "joints_pct" in row]
    left_out = [
        f"Left out: {count} file{'s' * (count != 1)} ({reason})."
        for reason, count in report.get("left_out", {}).items()
    ]
    kinds: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        for count, reason, said in (("not_applicable", "why", "Not applicable"), ("failures", "failed", "Failed")):
            if reason in row:
                share = f"{row[count]} of {_all_pairs(row)} pairs of {row['split']}"
                kinds.setdefault((said, row["method"], row[reason]), []).append(share)
    lines = [f"{said}: `{method}`, {', '.join(shares)} ({why})." for (said, method, why), shares in kinds.items()]
    if any("failures" in row for row in rows):
        lines.append("Means are over the other pairs; the report has the message of each pair that failed.")
    return "\n\n".join([title, *tables, *left_out, *lines])


def kind_table(rows: list[dict[str, Any]]) -> str:
    """Format the rows of all methods on one kind of pair; wins are counted against those of BASELINES among them."""
    measured = [row for row in rows if row["pairs"]]
    if any("joints_pct" in row for row in measured):
        return rig_table([(f"`{row['method']}`", row) for row in measured])
    if measured and not any("pmd_e4" in row for row in measured):
        return _limb_table(measured)
    against = [row for row in rows if row["method"] in BASELINES and "pmd_e4" in row]
    clips = {name: label for name, label in CLIP_COLUMNS.items() if any(name in row for row in measured)}
    head = ["method", "pairs", *(f"PMD: {name}" for name in ("mean", "median", "90 %", "largest", "public formula"))]
    head += ["mm: mean", "mm: median", "mm: 90 %"]
    head += [f"better than `{row['method']}`" for row in against]
    head += ["edge score", "flipped", *clips.values(), "s a frame" if clips else "s a pair", "given"]
    lines = []
    for row in measured:
        cells = [_pairs(row), with_interval(row, "pmd_e4")]
        cells += [cell(row, f"pmd_e4_{end}") for end in ("median", "p90", "max")]
        cells += [cell(row, name) for name in ("pmd_public_e4", "mm", "mm_median", "mm_p90")]
        cells += [wins(row, baseline) for baseline in against]
        cells += [cell(row, name) for name in ("edge_score", "flipped", *clips, "seconds_per_frame")]
        lines.append([f"`{row['method']}`", *cells, row["given"]])
    return markdown_table(head, lines)


def _limb_table(rows: list[dict[str, Any]]) -> str:
    quantities = ("limbs, degrees", "wrists and ankles, limb lengths")
    head = ["method", "pairs", *(f"{name}: {part}" for name in quantities for part in ("mean", "median", "90 %"))]
    head += [*LIMB_COLUMNS.values(), "s a pair", "given"]
    lines = []
    for row in rows:
        cells = [_pairs(row)]
        for name in ("limb_deg", "end_effector"):
            cells += [with_interval(row, name), cell(row, f"{name}_median"), cell(row, f"{name}_p90")]
        cells += [cell(row, name) for name in (*LIMB_COLUMNS, "seconds_per_frame")]
        lines.append([f"`{row['method']}`", *cells, row["given"]])
    return markdown_table(head, lines)


def rig_table(rows: Sequence[tuple[str, dict[str, Any]]], first: str = "method") -> str:
    """Format rows of rigs beside their makers', each with what it is called."""
    head = [first, "characters", *RIG_COLUMNS.values()]
    return markdown_table(head, [[name, _pairs(row), *(cell(row, key) for key in RIG_COLUMNS)] for name, row in rows])


def rigs_of_makers(row: dict[str, Any]) -> str:
    """Format the rigs of a method by maker and pack, and the mean error of each joint for each of them."""
    each = row["each"]
    groups = [": ".join(label.split(": ")[:-1]) for label in each["identity"]]
    rows = []
    for group in sorted(set(groups)):
        figures = [
            {name: values[k] for name, values in each.items() if values[k] is not None}
            for k, found in enumerate(groups)
            if found == group
        ]
        rows.append((group, summary(row["method"], group, figures)))
    errors: dict[str, dict[str, list[float]]] = {}
    for group, joints in zip(groups, each["joints"], strict=True):
        for name, error in (joints or {}).items():
            errors.setdefault(without_side(name), {}).setdefault(group, []).append(error)
    lines = [
        [group, *(f"{np.mean(of[group]):.1f}" if group in of else "-" for of in errors.values())]
        for group in sorted(set(groups))
    ]
    by_joint = markdown_table(["joints, % of height: mean", *errors], lines)
    return f"{rig_table(rows, 'maker: pack')}\n\n{by_joint}"


def makers_table(rows: list[dict[str, Any]]) -> str:
    """Format a method's errors on characters: maker and pack of the identity x kinds, as median / mean (pairs).

    The error is the PMD x1e4 or, where no true mesh is known, the mean angle of the limbs in degrees.
    """
    cells: dict[str, dict[str, list[float]]] = {}
    for row in rows:
        errors = row["each"]["pmd_e4" if "pmd_e4" in row else "limb_deg"]
        for group, error in zip(row["each"]["identity"], errors, strict=True):
            if error is not None:
                cells.setdefault(", ".join(group.split(": ")[:-1]), {}).setdefault(row["split"], []).append(error)
    kinds = [row["split"] for row in rows]
    lines = [[pack, *(_spread(found.get(kind)) for kind in kinds)] for pack, found in sorted(cells.items())]
    units = ["PMD" if "pmd_e4" in row else "degrees" for row in rows]
    heads = [f"{kind}, {unit}" for kind, unit in zip(kinds, units, strict=True)]
    return markdown_table(["maker, pack", *heads], lines)


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format a Markdown table from its head and its rows."""
    rule = ["---"] * len(head)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, rule, *rows))


def with_interval(row: dict[str, Any] | None, name: str) -> str:
    """Format a mean and half of its 95 % interval."""
    text, half = cell(row, name), (row or {}).get(f"{name}_ci95")
    return text if half is None else f"{text} ± {half:.2g}" if half < 99.5 else f"{text} ± {half:.0f}"


def cell(row: dict[str, Any] | None, name: str) -> str:
    """Format one figure of a row with three digits, or say why there is none."""
    if row is None:
        return "not measured"
    if not row["pairs"]:
        return "failed" if row.get("failures") else "not applicable"
    return _number(row[name]) if name in row else "-"


def _number(value: float | np.floating) -> str:
    return f"{value:.3g}" if abs(value) < 999.5 else f"{value:.0f}"


def _spread(errors: list[float] | None) -> str:
    return f"{_number(np.median(errors))} / {_number(np.mean(errors))} ({len(errors)})" if errors else "-"


def _pairs(row: dict[str, Any]) -> str:
    failed, count = row.get("failures", 0), _all_pairs(row)
    text = f"{row['pairs']} of {count}" if count > row["pairs"] else str(row["pairs"])
    return f"{text}, {failed} failed" if failed else text


def _all_pairs(row: dict[str, Any]) -> int:
    return row["pairs"] + row.get("not_applicable", 0) + row.get("failures", 0)


def wins(row: dict[str, Any], baseline: dict[str, Any]) -> str:
    """Format the share of pairs on which a method is better than a baseline; none for the baseline itself."""
    share = None if row["method"] == baseline["method"] else win_share(row, baseline)
    return "-" if share is None else f"{100 * share:.0f} %"
