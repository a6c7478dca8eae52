"""The generated tables of the page of formats: measured errors, limits of what is read, memory of long clips."""

from __future__ import annotations

import json
from pathlib import Path

from mimesh.core import budgets
from mimesh.evaluate.markdown import markdown_table

ROOT = Path(__file__).parents[2]


def errors_table() -> str:
    """Return the largest errors of each format in Blender, from docs/formats.json (written by `make clients`)."""
    report = json.loads((ROOT / "docs" / "formats.json").read_text(encoding="utf-8"))
    rows = []
    for suffix, figures in sorted(report["formats"].items()):
        ours = max((error for kind, error in figures.items() if kind.endswith("in Blender")), default=None)
        errors = (ours, figures.get("Blender's, read"))
        rows.append([suffix, *("" if error is None else f"{error:.1g}" for error in errors)])
    made = report["provenance"]
    table = markdown_table(["format", "our files, in Blender", "Blender's files, read here"], rows)
    return f"{table}\n\nMeasured at commit {made['commit']} with {made['client']}."


def limits_table() -> str:
    """Return the largest numbers that are read from one file."""
    found = [value for value in vars(budgets).values() if isinstance(value, budgets.Budget)]
    rows = [[row.things, f"{row.largest:,}", f"{row.per_byte:.3g}" if row.per_byte else ""] for row in found]
    return markdown_table(["one file has at most", "number", "or, if that is more, for each byte of the file"], rows)


def memory_table() -> str:
    """Return the peak memory of converting a long clip and a tenth of it, from benchmarks/long_clip.json."""
    report = json.loads((ROOT / "benchmarks" / "long_clip.json").read_text(encoding="utf-8"))
    short, long = report["frames"] // 10, report["frames"]
    rows = []
    for name, figures in report["formats"].items():
        cells = [figures[str(count)][key] for key in ("write_mib", "read_mib") for count in (short, long)]
        cells.append(figures[str(long)]["size_mib"])
        rows.append([name, *(f"{cell:,.0f}" for cell in cells)])
    head = ["format", f"write {short:,}", f"{long:,}", f"read {short:,}", f"{long:,}", "size"]
    return (
        f"Clips of {report['vertices']:,} vertices, {short:,} or {long:,} frames; peak memory and file size in MiB:\n\n"
        f"{markdown_table(head, rows)}\n\nMeasured at commit {report['commit']}, {report['machine']}."
    )


FORMATS = {"errors": errors_table, "limits": limits_table, "memory": memory_table}
