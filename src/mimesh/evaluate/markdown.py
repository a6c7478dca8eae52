"""Summarise figures of single pairs as rows of reports, and format these as Markdown tables.

Every mean has its interval, median, 90th percentile and wins.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ..bodies.joint_names import without_side
from ..methods.find import NETWORK_OF_BODY
from .measure import extra_inputs, training_facts

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
    pairs: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        for count, reason, said in (("not_applicable", "why", "Not applicable"), ("failures", "failed", "Failed")):
            if reason in row:
                share = f"{row[count]} of {_all_pairs(row)} pairs of {row['split']}"
                pairs.setdefault((said, row["method"], row[reason]), []).append(share)
    lines = [f"{said}: `{method}`, {', '.join(shares)} ({why})." for (said, method, why), shares in pairs.items()]
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


DISTRIBUTIONS = {
    **{"pmd_e4": 4, "pmd_public_e4": 4, "mm": 2, "limb_deg": 2, "end_effector": 3},
    **{"joints_pct": 3, "deform_mm": 2},
}
"""Metrics with mean, interval, median, 90th percentile and maximum in a report, and their decimals."""
MEANS = {
    **{"chamfer_e4": 4, "edge_score": 4, "flipped": 5},
    **{"path_mm": 2, "jitter": 4, "liveliness": 3, "still_mm": 4, "skate_cm_s": 3},  # of clips
    **{"sole_height": 3, "touching": 3},  # without a true mesh (`limb_metrics`)
    **{"j2j": 3, "j2b": 3, "b2b": 3, "iou": 2, "weights_l1": 4},  # of rigs
}
"""Metrics with a mean only, over the pairs that have a value, and their decimals."""
DIGITS = 6
"""Significant digits of the figures of single pairs."""


def summary(method: str, kind: str, figures: list[dict[str, Any]], body: str = "human") -> dict[str, Any]:
    """Summarise the figures of all pairs of one kind as a row of a report; `each` has those of every pair.

    A pair that failed has its message there, under "failed".

    Args:
        body: shipped body that the test set shows; `mime` opens the network of that body.
    """
    described = NETWORK_OF_BODY[body] if method == NETWORK_OF_BODY["human"] else method
    measured = [metrics for metrics in figures if not {"why", "failed"} & metrics.keys()]
    # Means are over the measured pairs. A method must not improve them by failing: failures are counted and shown.
    row: dict[str, Any] = {"method": method, "split": kind, "pairs": len(measured)}
    row |= {"given": extra_inputs(described), **training_facts(described)}
    for count, reason in (("not_applicable", "why"), ("failures", "failed")):
        reasons = [metrics[reason] for metrics in figures if reason in metrics]
        if reasons:
            row |= {count: len(reasons), reason: reasons[0]}
    for name, digits in DISTRIBUTIONS.items():
        chosen = [metrics for metrics in measured if metrics.get(name) is not None]
        if chosen:
            each = np.array([metrics[name] for metrics in chosen])
            groups = [[of.get(label, str(k)) for k, of in enumerate(chosen)] for label in ("identity", "driving")]
            row[name] = round(float(each.mean()), digits)
            if len(each) > 1:
                row[f"{name}_ci95"] = round(half_interval(each, *groups), digits)
            for end, value in (("median", np.median(each)), ("p90", np.quantile(each, 0.9)), ("max", each.max())):
                row[f"{name}_{end}"] = round(float(value), digits)
    for name, digits in MEANS.items():
        values = [metrics[name] for metrics in measured if metrics.get(name) is not None]
        if values:
            row[name] = round(float(np.mean(values)), digits)
    if measured and "stretch" in measured[0]:
        row["stretch_max"] = round(max(metrics["stretch"] for metrics in measured), 2)
    if measured:
        row["seconds_per_frame"] = round(float(np.median([metrics["seconds"] for metrics in measured])), 4)
    names = dict.fromkeys(name for metrics in figures for name in metrics if name != "why")
    return row | {"each": {name: [_rounded(metrics.get(name)) for metrics in figures] for name in names}}


def _rounded(value: Any) -> Any:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def half_interval(errors: Float[np.ndarray, " N"], identities: list[str], drivings: list[str]) -> float:
    """Return half of the 95 % confidence interval of the mean.

    Pairs that share a person, in either role, are not independent: the variance of the mean is the sum of the products
    of deviations over all such pairs of pairs (Aronow, Samii and Assenova 2015, dyadic clusters), at least that over
    single pairs. Student's t has one degree of freedom less than there are people in the role with fewer.
    """
    from scipy.stats import t

    if len(errors) < 2:
        return 0.0
    deviations = errors - errors.mean()
    first, second = np.array(identities), np.array(drivings)
    shared = np.zeros((len(errors), len(errors)), bool)
    for one in (first, second):
        for other in (first, second):
            shared |= one[:, None] == other
    variance = max(deviations @ shared @ deviations, deviations @ deviations) / len(errors) ** 2
    people = min(len(set(identities)), len(set(drivings)))
    return float(t.ppf(0.975, max(people - 1, 1)) * np.sqrt(variance))


def win_share(row: dict[str, Any], baseline: dict[str, Any]) -> float | None:
    """Return the share of the pairs measured for both rows in which `row` has the smaller PMD; None without any."""
    errors, others = _errors_by_pair(row), _errors_by_pair(baseline)
    common = errors.keys() & others.keys()
    return sum(errors[pair] < others[pair] for pair in common) / len(common) if common else None


def _errors_by_pair(row: dict[str, Any]) -> dict[str, float]:
    each = row.get("each", {})
    if "pmd_e4" not in each:  # nothing was measured
        return {}
    pairs = zip(each["pair"], each["pmd_e4"], strict=True)
    return {pair: error for pair, error in pairs if error is not None}
