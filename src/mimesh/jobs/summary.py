"""The summary of a batch: a table of all jobs as CSV and as JSON."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..core.printable import printable
from ..io.atomic import together, whole_file, writing
from .table import FAILED, STATES, BatchJob

COLUMNS = (
    *("number", "command", "identity", "driving", "output"),
    *("state", "seconds", "frames", "vertices", "confidence", "notes", "error"),
)


@dataclass(frozen=True, eq=False)
class BatchResult:
    """What became of the jobs of a batch."""

    jobs: Sequence[BatchJob]
    outcomes: Sequence[dict[str, Any]]
    """For each job its state (one of STATES) and, as far as they are known, seconds, frames, vertices, confidence (the
    lower one of identity and driving), notes, error."""
    seconds: float
    """Wall time of the whole batch."""
    workers: int
    files: dict[str, str] = field(default_factory=dict)
    """Paths of the summary (csv, json) and of the contact sheet, as far as they were written."""

    @property
    def counts(self) -> dict[str, int]:
        """Number of jobs in each state."""
        counted = Counter(outcome["state"] for outcome in self.outcomes)
        return {state: counted[state] for state in STATES}

    @property
    def failed(self) -> int:
        """Number of jobs that failed."""
        return self.counts[FAILED]

    def facts(self) -> dict[str, Any]:
        """Return everything for JSON."""
        head = {"jobs": len(self.jobs), "seconds": round(self.seconds, 2), "workers": self.workers}
        return {**head, "counts": self.counts, "files": self.files, "each": self.rows()}

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each job."""
        return [
            {"number": number, **job.as_dict(), "options": dict(job.options), **outcome}
            for number, (job, outcome) in enumerate(zip(self.jobs, self.outcomes, strict=True), 1)
        ]

    def save(self, csv_path: Path, json_path: Path) -> None:
        """Write the summary in both formats."""
        with together():
            with writing(csv_path), whole_file(csv_path) as temporary:
                self._write_table(temporary)
            with writing(json_path), whole_file(json_path) as temporary:
                temporary.write_text(json.dumps(self.facts(), indent=1) + "\n", encoding="utf-8", newline="\n")

    def _write_table(self, path: Path) -> None:
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, COLUMNS, extrasaction="ignore", restval="")
            writer.writeheader()
            for row in self.rows():
                cells = {**row, "notes": " | ".join(row.get("notes") or ())}
                writer.writerow({key: printable(x) if isinstance(x, str) else x for key, x in cells.items()})
