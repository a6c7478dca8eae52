"""The summary of a batch: a table of all jobs as CSV and as JSON, and a sheet with a picture of each result."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.errors import InputError
from ..core.printable import printable
from ..io import load_clip
from ..io.atomic import together, whole_file, writing
from ..render.camera import fit
from ..render.raster import render_mesh
from ..render.shading import BACKGROUND
from ..render.sheet import captioned, page
from ..tools.preview import save_picture
from .table import BatchJob, stem

if TYPE_CHECKING:
    from PIL import Image

STATES = DONE, DONE_BEFORE, FAILED, NOT_RUN = ("done", "done before", "failed", "not run")
"""Of a job, in the order of messages: done now, by an earlier batch, with an error, or stopped before its start."""
COLUMNS = (
    *("number", "command", "identity", "driving", "output"),
    *("state", "seconds", "frames", "vertices", "confidence", "notes", "error"),
)
TILE = (180, 220)
"""Width and height of a picture in pixels."""
MOST_TILES = 240
"""Largest number of results on a sheet; of more, as many evenly spread."""
MOST_COLUMNS = 16


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
            {"number": number, **asdict(job), "options": dict(job.options), **outcome}
            for number, (job, outcome) in enumerate(zip(self.jobs, self.outcomes, strict=True), 1)
        ]

    def save(self, csv_path: Path, json_path: Path) -> None:
        """Write the summary in both formats."""
        with together():
            with (
                writing(csv_path),
                whole_file(csv_path) as temporary,
                temporary.open("w", newline="", encoding="utf-8") as file,
            ):
                table = csv.DictWriter(file, COLUMNS, extrasaction="ignore", restval="")
                table.writeheader()
                for row in self.rows():
                    cells = {**row, "notes": " | ".join(row.get("notes") or ())}
                    table.writerow({key: printable(x) if isinstance(x, str) else x for key, x in cells.items()})
            with writing(json_path), whole_file(json_path) as temporary:
                temporary.write_text(json.dumps(self.facts(), indent=1) + "\n", encoding="utf-8", newline="\n")


def shown_jobs(count: int) -> list[int]:
    """Return the numbers of the jobs that a sheet shows."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_TILES)).round().astype(int)).tolist()


def draw_tile(job: BatchJob) -> bytes | None:
    """Draw the middle frame of a result as a PNG; None where its format cannot be read or drawn."""
    try:
        clip = load_clip(Path(job.output), fps=1.0 if Path(job.output).is_dir() else None)
        mesh = clip.mesh.with_vertices(clip.vertices[len(clip) // 2].astype(np.float64))
        picture = render_mesh(mesh, TILE, fit(mesh.vertices, TILE, "three-quarter"), background=BACKGROUND)
    except InputError:
        return None
    data = io.BytesIO()
    captioned(picture, job.name).save(data, "PNG")
    return data.getvalue()


def save_sheet(
    jobs: Sequence[BatchJob], outcomes: Sequence[dict[str, Any]], tiles: Mapping[int, bytes | None], path: Path
) -> None:
    """Write a sheet of `shown_jobs`: a row for each identity if all have as many jobs, else rows of one length.

    Args:
        jobs: all jobs of the batch.
        outcomes: of all jobs; a job without a picture has its outcome as text.
        tiles: pictures by the number of the job.
        path: where to write the PNG.
    """
    from PIL import Image

    def picture(k: int) -> Image.Image:
        if tile := tiles.get(k):
            return Image.open(io.BytesIO(tile))
        color = (np.array(BACKGROUND) * 255).round().astype(np.uint8)
        label = f"{jobs[k].name}: {outcomes[k].get('error') or outcomes[k]['state']}"
        return captioned(np.broadcast_to(color, (TILE[1], TILE[0], 3)).copy(), label)

    shown = shown_jobs(len(jobs))
    save_picture(page([picture(k) for k in shown], _columns([stem(jobs[k].identity) for k in shown])), path)


def _columns(identities: Sequence[str]) -> int:
    """Return the number of pictures in a row."""
    count = len(identities)
    row = next((k for k, name in enumerate(identities) if name != identities[0]), count)
    even = count % row == 0 and all(len(set(identities[k : k + row])) == 1 for k in range(0, count, row))
    if even and row <= MOST_COLUMNS and count > row:
        return row
    return min(count, MOST_COLUMNS, int(np.ceil(np.sqrt(1.6 * count))))
