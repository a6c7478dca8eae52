"""Summarise the figures of single pairs as rows of a report, and compare methods pair by pair."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from ..methods.find import NETWORK_OF_BODY
from .measure import extra_inputs, training_facts

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
