"""The papers' tables, with their values next to ours."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from ..core.errors import InputError, did_you_mean
from ..core.frame_buffer import Progress
from ..methods.find import ABLATIONS, REDUCED_MODELS, check_weights, how_to_make, missing_weights
from .markdown import cell, markdown_table, with_interval
from .run import evaluate_command


class Row(NamedTuple):
    """A row of a paper's table."""

    label: str
    """The paper's name of the row, or ours for rows that the paper does not have."""
    method: str
    """Our method (`measure.run_on`)."""
    seen: float | None = None
    """PMD x1e4 on seen poses that the paper prints; None where it prints none."""
    unseen: float | None = None
    """The same on unseen poses."""


class Table(NamedTuple):
    """A table of a paper."""

    title: str
    protocol: str
    """Name of the protocol that it is measured on."""
    rows: tuple[Row, ...]


KINDS = ("seen", "unseen")
"""Kinds of pair of a table's columns, as in the papers."""
NONE_TRAINED: Mapping[str, Sequence[str]] = MappingProxyType({})
LONGEST = Row("NPT, full width", "npt-full", 1.1, 9.3)
LONGEST_MIXED = Row("NPT, full width, mixed people and limbs", "npt-full-mixed", 1.1, 9.3)
MIME_TABLE = Row("mime, same people and poses", "mime-table")
MIME_TABLE_NETWORK = Row("the same without body fit", "mime-table-network")
SHIPPED = Row("NPT as shipped", "npt", 1.1, 9.3)
MIME = Row("mime as shipped", "mime")
MIME_NETWORK = Row("the same without body fit", "mime-network")
COPY = Row("driving vertices", "copy")
DENSE = Row("DT, dense correspondence", "deformation-transfer-dense")
ANIFORMER_ORDERED = Row("AniFormer, full width", "aniformer-ordered", 0.12, 3.95)
ANIFORMER_MIXED = Row("AniFormer, full width, mixed people and limbs", "aniformer-ordered-mixed", 0.12, 3.95)
TABLES = {
    "npt-1": Table(
        "NPT Table 1: against deformation transfer",
        "human-npt",
        (
            Row("DT, 5 control points", "deformation-transfer-5", 7.3, 7.2),
            Row("DT, 13 control points", "deformation-transfer-13", 7.7, 6.7),
            *(DENSE, LONGEST, LONGEST_MIXED, MIME_TABLE, MIME_TABLE_NETWORK, SHIPPED, MIME, MIME_NETWORK, COPY),
        ),
    ),
    "npt-2": Table(
        "NPT Table 2: ablations",
        "human-npt",
        (
            Row("concat1", "npt-concat1", 12.1, 16.9),
            Row("without SPAdaIN", "npt-no-spadain", 8.3, 13.7),
            Row("without edge loss", "npt-no-edge", 1.2, 10.1),
            Row("NPT, equal time", "npt-equal", 1.1, 9.3),
            *(LONGEST, LONGEST_MIXED, SHIPPED, COPY),
        ),
    ),
    "npt-7": Table(
        "NPT Table 7: against other baselines",
        "human-npt",
        (
            Row("max-pool, equal time", "npt-maxpool-equal", 2.1, 12.7),
            Row("NPT, equal time", "npt-equal", 1.1, 9.3),
            *(LONGEST, LONGEST_MIXED),
            Row("max-pool as shipped", "npt-maxpool", 2.1, 12.7),
            *(SHIPPED, MIME, COPY),
        ),
    ),
    "aniformer-1": Table(
        "AniFormer Table 1: ablations, narrow, meshes in one vertex order (the paper prints one figure)",
        "clips-ordered",
        (
            Row("regression head", "aniformer-ordered-vanilla", 15.31),
            Row("without it", "aniformer-ordered-plain", 3.84),
            Row("with motion", "aniformer-ordered-motion", 1.37),
            Row("with appearance", "aniformer-ordered-appearance", 0.31),
            Row("with both", "aniformer-ordered-equal", 0.12),
            Row("both, attention to vertices", "aniformer-ordered-attention-vertices", 0.12),
            Row("both, weights for each vertex", "aniformer-ordered-vertices", 0.12),
            *(ANIFORMER_ORDERED, ANIFORMER_MIXED, MIME, COPY),
        ),
    ),
    "aniformer-2": Table(
        "AniFormer Table 2: against other methods, frame by frame, meshes in one vertex order",
        "clips-ordered",
        (
            Row("NPT-MP, narrow", "npt-maxpool-ordered-equal", 4.51, 6.69),
            Row("NPT, narrow", "npt-ordered-equal", 4.37, 5.31),
            Row("AniFormer, narrow", "aniformer-ordered-equal", 0.12, 3.95),
            Row("NPT, full width", "npt-ordered", 4.37, 5.31),
            Row("NPT, full width, mixed people and limbs", "npt-ordered-mixed", 4.37, 5.31),
            *(ANIFORMER_ORDERED, ANIFORMER_MIXED, MIME),
            Row("DT, 13 control points", "deformation-transfer-13"),
            *(DENSE, COPY),
        ),
    ),
    "aniformer-1-random": Table(
        "AniFormer Table 1 on a harder test: vertices paired at random, new driving people",
        "clips-aniformer",
        (
            Row("regression head", "aniformer-regression", 15.31),
            Row("without it", "aniformer-plain", 3.84),
            Row("with motion", "aniformer-motion", 1.37),
            Row("with appearance", "aniformer-appearance", 0.31),
            Row("with both", "aniformer-equal", 0.12),
            *(MIME, COPY),
        ),
    ),
    "aniformer-2-random": Table(
        "AniFormer Table 2 on a harder test: vertices paired at random, new driving people",
        "clips-aniformer",
        (
            Row("NPT-MP, narrow", "npt-maxpool-frames", 4.51, 6.69),
            Row("NPT, narrow", "npt-frames", 4.37, 5.31),
            Row("AniFormer, narrow", "aniformer-equal", 0.12, 3.95),
            Row("NPT as shipped", "npt", 4.37, 5.31),
            Row("AniFormer as shipped", "aniformer", 0.12, 3.95),
            MIME,
            Row("DT, 13 control points", "deformation-transfer-13"),
            *(DENSE, COPY),
        ),
    ),
}


def find_table(name: str, without: Sequence[str] = ()) -> Table:
    """Look up a table by name.

    Args:
        without: methods whose rows are left out.

    Raises:
        InputError: no such table, no such row, or no rows are left.
    """
    if name not in TABLES:
        close = did_you_mean(name, TABLES) or "; check the name"
        raise InputError(f"{name}: expected a table ({', '.join(TABLES)}), found another{close}")
    table = TABLES[name]
    methods = [row.method for row in table.rows]
    for method in without:
        if method not in methods:
            raise InputError(
                f"--without {method}: expected a row of {name} ({', '.join(methods)}), found none"
                + (did_you_mean(method, methods) or "; check the name")
            )
    rows = tuple(row for row in table.rows if row.method not in without)
    if not rows:
        raise InputError(f"--without: expected a row of {name} that is not left out, found none; leave fewer out")
    return table._replace(rows=rows)


def rows_without_weights(
    name: str, trained: Collection[str] = (), without: Sequence[str] = ()
) -> tuple[tuple[str, ...], str]:
    """Find the rows of a table that cannot be measured here; give their methods, and a note that says how to make them.

    Args:
        trained: networks that will be trained first.
        without: methods whose rows are left out in any case.
    """
    methods = [row.method for row in find_table(name, without).rows]
    missing = missing_weights(*(method for method in methods if REDUCED_MODELS.get(method, method) not in trained))
    if len(missing) == len(methods):
        check_weights(*missing)
    # Elsewhere than in a checkout weights would be trained that it has.
    elsewhere = "" if ABLATIONS.is_dir() else "call this in the root of a checkout, which has some of them, or "
    note = f"{name}: leaves out rows whose weights are not here; {elsewhere}make {how_to_make(missing, name)}"
    return tuple(missing), note if missing else ""


def table_command(
    name: str,
    out: Path | None = None,
    pairs: int = 0,
    progress: Progress | None = None,
    trained: Mapping[str, Sequence[str]] = NONE_TRAINED,
    without: Sequence[str] = (),
) -> tuple[dict[str, Any], str]:
    """Measure the rows of a paper's table (`mimesh table`; resumable with `out`) and return the report and the table.

    Args:
        trained: method of a row -> networks that stand in its place, one a seed (`methods_in`).
        without: methods whose rows are left out, `rows_without_weights` for example.
    """
    table = find_table(name, without)
    methods = list(dict.fromkeys(method for row in table.rows for method in trained.get(row.method, [row.method])))
    check_weights(*methods)
    report = evaluate_command(table.protocol, methods, out, pairs=pairs, progress=progress)
    return report, paper_table(name, report, trained=trained, without=without)


def methods_in(name: str, networks: Collection[str], folders: Sequence[Path]) -> dict[str, list[str]]:
    """Name what is measured for the rows of a table whose networks were trained: those in each of the folders."""
    methods = [row.method for row in find_table(name).rows]
    own = [method for method in methods if REDUCED_MODELS.get(method, method) in networks]
    return {method: [str(folder / method) for folder in folders] for method in own}


def paper_table(
    name: str,
    *reports: dict[str, Any],
    trained: Mapping[str, Sequence[str]] = NONE_TRAINED,
    without: Sequence[str] = (),
) -> str:
    """Format a paper's table from reports; cells without a measurement say "not measured".

    Args:
        trained: as in `table_command`. A row with several networks has the mean of their figures, and behind ± the
            standard deviation between them instead of the interval over people.
        without: methods whose rows are left out.
    """
    table = find_table(name, without)
    chosen = [report for report in reports if report["protocol"] == table.protocol]
    measured = {(row["method"], row["split"]): row for report in chosen for row in report["results"]}
    lines = []
    for row in table.rows:
        networks = trained.get(row.method, [row.method])
        kinds = [
            over_seeds([measured[method, kind] for method in networks if (method, kind) in measured]) for kind in KINDS
        ]
        paper = " / ".join("-" if value is None else f"{value:g}" for value in (row.seen, row.unseen))
        cells = [row.label, paper]
        cells += [with_interval(figures, "pmd_e4") for figures in kinds]
        cells += [cell(figures, "pmd_public_e4") for figures in kinds]
        cells += [cell(kinds[-1], name) for name in ("edge_score", "flipped")]
        seen = [figures["pairs_seen"] for figures in kinds if figures and "pairs_seen" in figures]
        lines.append([*cells, f"{seen[0]:,}" if seen else "-", f"`{row.method}`"])
    head = ["row", "paper, seen / unseen"]
    head += [f"{formula}, {kind}" for formula in ("Eq. 7", "public") for kind in KINDS]
    head += [f"{name}, {KINDS[-1]}" for name in ("edge score", "flipped")] + ["pairs seen", "weights"]
    title = f"{table.title}. Eq. 7 (PMD) and public formula x1e-4, mean; "
    title += "the paper's figures on its own data, ours on the shipped body."
    if (seeds := max(map(len, trained.values()), default=1)) > 1:
        title += f" Trained rows: mean over {seeds} seeds ± their standard deviation."
    return f"{title}\n\n" + markdown_table(head, lines)


def over_seeds(rows: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Combine the rows of one method trained with several seeds: means, and deviations in place of intervals."""
    if len(rows) < 2:
        return rows[0] if rows else None
    combined = dict(rows[0])
    for key, value in rows[0].items():
        if isinstance(value, float) and not key.endswith("_ci95") and all(key in row for row in rows):
            values = [float(row[key]) for row in rows]
            combined[key] = float(np.mean(values))
            if f"{key}_median" in rows[0]:
                combined[f"{key}_ci95"] = float(np.std(values, ddof=1))
    return combined
