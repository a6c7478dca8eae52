"""`batch`: check all jobs, do those that are not finished with several processes, and write a summary."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..core.arguments import described, public
from ..core.errors import InputError
from ..core.system import usable_cores
from ..io import mesh_suffixes
from ..io.formats import ANIMATED, CLIP_READERS, COLLECTIONS
from .check import check_jobs
from .pool import run_calls
from .records import fingerprint, finished, record_path
from .sheet import drawn_jobs, save_sheet
from .summary import BatchResult
from .table import (
    COMMANDS,
    DONE_BEFORE,
    FAILED,
    NOT_RUN,
    BatchJob,
    all_pairs,
    find_files,
    numbered_rows,
    read_rows,
    read_table,
)

Report = Callable[[int, int, BatchJob | None, dict[str, Any]], None]
"""Gets the jobs finished, the jobs in all, and the job with its outcome; None for those that were finished before."""
NAME = "batch"
"""Name of the summary's files without suffix."""


@public()
def batch(
    identities: str | Path | Sequence[Mapping[str, Any]],
    drivings: str | Path | None = None,
    output: str | Path | None = None,
    *,
    command: str = "animate",
    options: Mapping[str, Any] | None = None,
    workers: int | None = None,
    again: bool = False,
    summary: str | Path | None = None,
    sheet: bool = True,
    cluster: str | None = None,
    report: Report | None = None,
) -> BatchResult:
    """Do many jobs of `mimesh animate` or `mimesh transfer`: those of a table, or all pairs of two sets of files.

    All jobs are checked before the first one starts. A job that fails does not stop others. A job that was finished by
    an earlier batch is not done again unless its inputs, its options or the model's file have changed.

    Args:
        identities: with `drivings`, a folder, a pattern with wildcards, or a file of meshes; without, a table of jobs
            (a CSV file, or dictionaries): identity, driving, output, command and options by their names (`root-bone`
            or `root_bone`).
        drivings: a folder, a pattern or a file of clips; each is combined with each identity.
        output: where to write each result, with {identity}, {driving} and {number} for the names of its inputs and the
            number of the job. Rows of a table with an output of their own do not need it.
        command: "animate" or "transfer", for jobs whose row does not say.
        options: options of the command for all jobs ({"root": "keep", "ground": False}); rows replace them.
        workers: processes, with one thread each; None: one for each core that may be used.
        again: do finished jobs again.
        summary: folder for batch.csv, batch.json and batch.png; None: the one that all outputs lie below.
        sheet: draw the contact sheet, batch.png.
        cluster: address of a Ray cluster that does the jobs, or "local" to start one here (the extra `cluster`); all
            its machines must have all files at the same paths.
        report: is called at the start and after each job.

    Returns:
        The outcomes of all jobs, in their order.

    Raises:
        InputError: a job cannot be done; none was started.
        KeyboardInterrupt: Ctrl-C; all files are complete or absent, and the summary is written.

    Example:
        >>> jobs = [{"identity": "hero.glb", "driving": "walk.npz", "output": "walking.glb", "stop": 2}]
        >>> done = mimesh.batch(jobs, summary="summary", sheet=False)  # doctest: +SKIP
        >>> done.counts["done"], done.failed  # doctest: +SKIP
        (1, 0)
    """
    begin = time.perf_counter()
    if workers is not None and workers < 1:
        raise InputError(f"--workers: expected 1 or more, found {workers}; leave it out for one a core")
    jobs = _jobs(identities, drivings, output, options or {}, command)
    folder = Path(summary) if summary is not None else _common_folder(jobs)
    files = {kind: folder / f"{NAME}.{kind}" for kind in ("csv", "json", "png")}
    table = [] if drivings is not None or not isinstance(identities, (str, Path)) else [Path(identities)]
    check_jobs(jobs, table, tuple(files.values()))
    run = _Run(jobs, [fingerprint(job) for job in jobs], drawn_jobs(len(jobs)) if sheet else [], again, report)
    workers = workers or usable_cores()
    count = min(workers, len(run.left))

    def saved(written: Mapping[str, Path]) -> BatchResult:
        paths = {kind: str(path) for kind, path in written.items()}
        result = BatchResult(jobs, run.outcomes, time.perf_counter() - begin, count, paths)
        result.save(files["csv"], files["json"])
        return result

    tables = {kind: files[kind] for kind in ("csv", "json")}
    try:
        run.do(count, cluster)
    except KeyboardInterrupt:
        saved(tables)
        raise
    if not sheet:
        return saved(tables)
    run.draw_sheet(files["png"], workers)
    return saved(files)


class _Run:
    """The jobs of a batch with their outcomes so far."""

    def __init__(
        self,
        jobs: Sequence[BatchJob],
        made_from: Sequence[str],
        shown: Sequence[int],
        again: bool,
        report: Report | None,
    ) -> None:
        """Take the outcomes of earlier batches, or with `again` remove their records; `shown` jobs are drawn."""
        if again:
            for job in jobs:
                record_path(job).unlink(missing_ok=True)
        self.jobs, self.made_from, self.report = jobs, made_from, report
        self.outcomes = [_earlier(*pair) for pair in zip(jobs, made_from, strict=True)]
        self.left = [k for k, outcome in enumerate(self.outcomes) if outcome["state"] == NOT_RUN]
        self.tiles: dict[int, str | None] = dict.fromkeys(shown)
        self.done = len(jobs) - len(self.left)

    def do(self, workers: int, cluster: str | None) -> None:
        """Have the jobs done that are left, by processes of this machine or by a cluster."""
        if self.report is not None:
            self.report(self.done, len(self.jobs), None, {"workers": workers})
        if not self.left:
            return
        numbers = list(self.left)
        calls = [
            {"job": self.jobs[k].as_dict(), "made_from": self.made_from[k], "draw": k in self.tiles} for k in numbers
        ]
        groups = [self.jobs[k].identity for k in numbers]

        def answered(number: int, answer: dict[str, Any]) -> None:
            self._answered(numbers[number], answer)

        if cluster is None:
            run_calls(calls, groups, workers, answered, _lost)
        else:
            from .cluster import run_on_cluster

            run_on_cluster(calls, groups, cluster, answered)

    def draw_sheet(self, path: Path, workers: int) -> None:
        """Write the sheet; results of earlier batches are drawn now."""
        earlier = [k for k in self.tiles if self.outcomes[k]["state"] == DONE_BEFORE and self.tiles[k] is None]

        def drawn(number: int, answer: dict[str, Any]) -> None:
            self.tiles[earlier[number]] = answer["tile"]

        if earlier:
            calls = [{"job": self.jobs[k].as_dict(), "draw": True} for k in earlier]
            run_calls(calls, list(range(len(calls))), workers, drawn, lambda number, ending: {"tile": None})
        states = [self.outcomes[k].get("error") or self.outcomes[k]["state"] for k in self.tiles]
        save_sheet([self.jobs[k] for k in self.tiles], states, list(self.tiles.values()), path)

    def _answered(self, k: int, answer: dict[str, Any]) -> None:
        """Take the outcome of a job."""
        tile = answer.pop("tile", None)
        if k in self.tiles:
            self.tiles[k] = tile
        self.outcomes[k] = answer
        self.done += 1
        if self.report is not None:
            self.report(self.done, len(self.jobs), self.jobs[k], answer)


def _jobs(
    identities: str | Path | Sequence[Mapping[str, Any]],
    drivings: str | Path | None,
    output: str | Path | None,
    options: Mapping[str, Any],
    command: str,
) -> list[BatchJob]:
    """Return the jobs of a table, or of two sets of files."""
    if command not in COMMANDS:
        raise InputError(f"batch: expected the command animate or transfer, found {command!r}; name one of them")
    if not isinstance(options, Mapping):
        raise InputError(f'options: expected a dictionary, found {described(options)}; give for example {{"stop": 10}}')
    ((_, named),) = numbered_rows([options])
    texts = {
        name: ("yes" if value else "no") if isinstance(value, bool) else str(value) for name, value in named.items()
    }
    pattern = None if output is None else str(output)
    if drivings is None:
        if isinstance(identities, (str, Path)):
            if Path(identities).is_dir():
                raise InputError(
                    f"{identities}: expected a table of jobs (CSV), or a second folder: DRIVINGS; give one of them"
                )
            return read_table(Path(identities), texts, pattern, command)
        _check_rows(identities)
        return read_rows(numbered_rows(identities), texts, pattern, command)
    if not isinstance(identities, (str, Path)):
        raise InputError("batch: expected no drivings beside rows of jobs, found both; put them in the rows")
    if pattern is None:
        raise InputError(
            "--output: expected a pattern for the outputs of all pairs, found none; "
            "give one: -o 'out/{identity}/{driving}.glb'"
        )
    moving = (*CLIP_READERS, *ANIMATED, *COLLECTIONS) if command == "animate" else mesh_suffixes()
    found = find_files(str(identities), mesh_suffixes(), "meshes"), find_files(str(drivings), moving, "driving files")
    return all_pairs(*found, texts, pattern, command)


def _check_rows(rows: Sequence[Mapping[str, Any]]) -> None:
    """Raise InputError for jobs that are no list of dictionaries."""
    if isinstance(rows, Mapping) or not isinstance(rows, Sequence):
        raise InputError(f"identities: expected a list of dictionaries, or a path, found {described(rows)}; give [job]")
    for row in rows:
        if not isinstance(row, Mapping):
            raise InputError(
                f"identities: expected dictionaries as jobs, found {described(row)}; give for example "
                '{"identity": "hero.glb", "driving": "walk.bvh", "output": "out.glb"}'
            )


def _earlier(job: BatchJob, made_from: str) -> dict[str, Any]:
    """Return the outcome of a job by an earlier batch; "not run" if there is none that counts."""
    outcome = finished(job, made_from)
    return {"state": NOT_RUN} if outcome is None else {**outcome, "state": DONE_BEFORE}


def _lost(number: int, ending: str) -> dict[str, Any]:
    """Return the outcome of a job whose worker has ended: a crash of a library, or too little memory."""
    hint = "; if the system ran out of memory, use fewer --workers" if "KILL" in ending else ""
    return {"state": FAILED, "error": f"expected a result, found that the worker ended ({ending}){hint}"}


def _common_folder(jobs: Sequence[BatchJob]) -> Path:
    """Return the folder that all outputs lie below."""
    folders = [str(Path(job.output).resolve().parent) for job in jobs]
    try:
        common = Path(os.path.commonpath(folders))
    except ValueError as error:  # several drives
        raise InputError("--summary: expected a folder for the summary of outputs on several drives, found none; "
                         "give one") from error  # fmt: skip
    here = Path.cwd()
    return common.relative_to(here) if common.is_relative_to(here) else common
