"""The command `mimesh batch`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..commands.options import OutputOptions, Without, with_options
from ..commands.terminal import Model, Stop, given_path, print_json, progress
from ..core.options import declared
from ..core.printable import say, shell_line

if TYPE_CHECKING:
    from .run import BatchResult
    from .table import BatchJob

SOME_FAILED = 3
"""Exit code where some jobs failed and all others are done."""
MOST_FAILURES = 10
"""Failed jobs that are printed at the end."""


@dataclass(frozen=True)
class BatchOptions:
    """How jobs are done."""

    workers: int | None = declared(
        None, "Processes of one thread each; by default one a core.", name=("--workers", "-w"), min=1
    )
    again: bool = declared(False, "Do jobs again that are finished and unchanged.", name="--again")
    summary: Path | None = declared(
        None, "Where batch.csv and .json go; by default the folder that all outputs share.", metavar="DIR"
    )


@with_options
def batch(
    jobs: Annotated[
        Path,
        typer.Argument(
            metavar="JOBS",
            parser=given_path,
            help="A table (CSV: identity, driving, output, any option); or with DRIVINGS a folder or 'pattern' of "
            "meshes; or with --rig one of meshes, with --capture one of clips.",
        ),
    ],
    drivings: Annotated[
        Path | None,
        typer.Argument(
            metavar="[DRIVINGS]", parser=given_path, help="A folder or 'pattern' of clips, each for each mesh."
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option(
            "--output",
            "-o",
            metavar="PATTERN",
            help="Outputs: 'out/{identity}/{driving}.glb'; {number}; with {identity} alone one file of all clips.",
        ),
    ] = None,
    model: Model = "mime",
    option: Annotated[
        list[str] | None,
        typer.Option(
            "--option",
            "-O",
            metavar="NAME=VALUE",
            help="Option of the command for all jobs: root=keep, ground=no; several times.",
        ),
    ] = None,
    transfer: Annotated[
        bool, typer.Option("--transfer", help="Transfer poses: run `mimesh transfer`, not animate.")
    ] = False,
    rig: Annotated[bool, typer.Option("--rig", help="Rig meshes: run `mimesh rig` for each of JOBS.")] = False,
    capture: Annotated[
        bool, typer.Option("--capture", help="Capture clips: run `mimesh capture` for each of JOBS.")
    ] = False,
    *,
    running: BatchOptions,
    printed: Annotated[OutputOptions, Without("output", "preview", "open", "no_clobber", "no_limits")],
) -> None:
    """Animate many meshes: a table of jobs, or every mesh of a folder with every clip of another.

    With --rig or --capture, each mesh or clip of one folder is a job. Columns and
    --option have the names of the command's options without dashes; yes or no for
    switches. All jobs are checked before the
    first starts. The same command again does only what is not finished or has changed.
    A job that fails does not stop others: the exit code is then 3.
    """
    from ..core.errors import InputError
    from .run import BatchStopped
    from .run import batch as run_batch

    options = {"model": model} if model != "mime" else {}
    for text in option or ():
        name, _, value = text.partition("=")
        if not name or "=" not in text:
            raise InputError(f"--option: expected NAME=VALUE, found {text!r}; write root=keep or ground=no")
        options[name] = value
    chosen = [name for name, on in (("transfer", transfer), ("rig", rig), ("capture", capture)) if on]
    if len(chosen) > 1:
        raise InputError(f"batch: expected one command, found --{' and --'.join(chosen)}; leave all but one out")
    silent, terminal = printed.silent, sys.stderr.isatty()
    if not silent and not terminal:
        say("checking all jobs", error=True)
    stopped: BatchStopped | None = None
    try:
        # Without a terminal each job has a line of its own.
        with progress("jobs", silent or not terminal) as advance:
            bar = advance and (lambda done, total, job, outcome: advance(done, total))
            result = run_batch(
                str(jobs),
                None if drivings is None else str(drivings),
                output,
                command=chosen[0] if chosen else "animate",
                options=options,
                workers=running.workers,
                again=running.again,
                summary=running.summary,
                report=None if silent else bar or print_lines(),
            )
    except BatchStopped as stop:
        stopped, result = stop, stop.result
    if printed.json:
        print_json(result.facts())
    else:
        print_summary(result, printed.quiet)
    if stopped is not None:
        raise stopped
    if result.failed:
        raise Stop(SOME_FAILED)


def print_lines() -> Callable[..., None]:
    """Return a report that prints a line for each job on stderr, with the time that is left by the mean so far."""
    begin, before = time.perf_counter(), 0

    def report(done: int, total: int, job: BatchJob | None, outcome: dict[str, Any]) -> None:
        nonlocal before
        if job is None:
            before = done
            earlier = f", {done} done before" if done else ""
            say(f"{total} jobs{earlier}, workers: {outcome['workers']}", error=True)
            return
        left = (time.perf_counter() - begin) / (done - before) * (total - done)
        what = outcome.get("error") or f"{outcome['state']}, {outcome.get('seconds', 0.0):.1f} s"
        say(f"[{done}/{total}, {left:.0f} s left] {job.name}: {what}", error=True)

    return report


def print_summary(result: BatchResult, quiet: bool) -> None:
    """Print how many jobs were done, the first failures and the files; if quiet, failures alone."""
    if not quiet:
        counts = ", ".join(f"{count} {state}" for state, count in result.counts.items() if count)
        say(f"{len(result.jobs)} jobs: {counts}; {result.seconds:.1f} s, workers: {result.workers}")
    pairs = zip(result.jobs, result.outcomes, strict=True)
    failed = [f"{job.where}: {outcome['error']}" for job, outcome in pairs if outcome.get("error")]
    if len(failed) > MOST_FAILURES:
        failed[MOST_FAILURES:] = [f"{len(failed) - MOST_FAILURES} more, see {result.files['csv']}"]
    for line in failed:
        say(f"failed: {line}")
    if not quiet:
        table, facts = result.files["csv"], result.files["json"]
        say(f"table: {table}", f"facts: {facts}", f"next: open {shell_line(table)}")
