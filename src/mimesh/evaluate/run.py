"""Run methods over a protocol and say how far they are from the truth, with provenance."""

from __future__ import annotations

import datetime
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np

from ..bodies import load_body
from ..io.atomic import whole_file
from ..mesh import InputError
from ..pipeline import transfer
from ..provenance import commit, machine
from .metrics import in_unit_sphere_of, mean_error_mm, pmd, pmd_of_pair, resized
from .protocols import HUMAN_NPT, Pair, Split

PROTOCOLS = {"human-npt": HUMAN_NPT}
PAPER_E4 = {"npt": (1.1, 9.3), "npt-maxpool": (2.1, 12.7)}
"""PMD x1e4 on seen and unseen poses in NPT's Tables 1 and 7 (SMPL bodies)."""
Progress = Callable[[int, int], None]


def evaluate_command(
    protocol: str,
    methods: list[str],
    out: Path | None = None,
    split: str = "test",
    pairs: int = 0,
    ensemble: int = 1,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """What `mimesh evaluate` does: one result row a method and kind of pose; written to `out` as JSON if given."""
    if protocol not in PROTOCOLS:
        raise InputError(f"{protocol}: expected a protocol ({', '.join(PROTOCOLS)}), found another; check the name")
    if split not in get_args(Split):
        raise InputError(f"{split}: expected a split ({', '.join(get_args(Split))}), found another; check the name")
    chosen, part = PROTOCOLS[protocol], cast(Split, split)
    total, done, rows = 2 * (pairs or chosen.pairs) * len(methods), 0, []
    for method in methods:
        for poses in ("seen", "unseen"):
            figures = []
            for pair in chosen.trials(load_body(), part, poses, pairs):
                figures.append(measure(pair, method, ensemble))
                done += 1
                if progress is not None:
                    progress(done, total)
            rows.append(summary(method, poses, figures))
    report = {
        "protocol": chosen.name,
        "version": chosen.version,
        "provenance": provenance({"split": split, "pairs": pairs or chosen.pairs, "ensemble": ensemble}),
        "results": rows,
    }
    if out is not None:
        with whole_file(out) as temporary:
            temporary.write_text(json.dumps(report, indent=2) + "\n")
    return report


def measure(pair: Pair, method: str, ensemble: int) -> dict[str, float]:
    """Figures of one pair. `copy` alone is given the true correspondence and the truth's radius."""
    started = time.perf_counter()
    if method == "copy":
        result = resized(pair.aligned, pair.truth)
    else:
        moved = transfer(pair.identity, pair.driving, method, up="+y", front="+z", driving_up="+y", driving_front="+z",
                         ensemble=ensemble)  # fmt: skip
        result = moved.vertices
    seconds = time.perf_counter() - started
    sphere = in_unit_sphere_of(pair.truth, result, pair.truth)
    return {
        "pmd_e4": 1e4 * pmd_of_pair(result, pair.truth),
        "pmd_mse_e4": 1e4 * float(pmd(*sphere)) / 3,
        "mm": mean_error_mm(result, pair.truth, pair.height),
        "seconds": seconds,
    }


def summary(method: str, poses: Literal["seen", "unseen"], figures: list[dict[str, float]]) -> dict[str, Any]:
    """Means, and the tail of the errors, where users live."""
    errors = np.array([f["pmd_e4"] for f in figures])
    return {
        "method": method,
        "split": poses,
        "pairs": len(figures),
        "pmd_e4": round(float(errors.mean()), 4),
        "pmd_e4_median": round(float(np.median(errors)), 4),
        "pmd_e4_p90": round(float(np.quantile(errors, 0.9)), 4),
        "pmd_e4_max": round(float(errors.max()), 4),
        "pmd_mse_e4": round(float(np.mean([f["pmd_mse_e4"] for f in figures])), 4),
        "mm": round(float(np.mean([f["mm"] for f in figures])), 2),
        "seconds_per_frame": round(float(np.median([f["seconds"] for f in figures])), 4),
    }


def provenance(config: dict[str, Any]) -> dict[str, Any]:
    """Where and when figures were made: seed, configuration, commit, machine, date."""
    return {
        "seed": 0,
        "config": config,
        "commit": commit(),
        "machine": machine(),
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    }


def markdown(report: dict[str, Any]) -> str:
    """The report as a table, the paper's figures beside ours."""
    lines = [
        f"{report['protocol']} version {report['version']}, PMD (Eq. 7) x1e-4 in the truth's unit sphere, "
        f"{report['results'][0]['pairs']} pairs a column",
        "",
        "| method | seen poses | unseen poses | mm seen / unseen | s a pair | paper (SMPL) seen / unseen |",
        "|---|---|---|---|---|---|",
    ]
    rows = report["results"]
    for seen, unseen in zip(rows[::2], rows[1::2], strict=True):
        paper = PAPER_E4.get(seen["method"])
        cells = [
            seen["method"],
            f"{seen['pmd_e4']:.2f}",
            f"{unseen['pmd_e4']:.2f}",
            f"{seen['mm']:.0f} / {unseen['mm']:.0f}",
        ]
        cells += [f"{unseen['seconds_per_frame']:.2f}", f"{paper[0]} / {paper[1]}" if paper else "-"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)
