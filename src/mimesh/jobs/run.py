"""`batch`: check all jobs, have worker processes do those that are not finished, and write a summary.

The summary is a table of all jobs as CSV and as JSON.
Beside an output lies a record of what it was made from, so that the same batch again does only what is left: that of
`walk.glb` is `.walk.glb.job.json`. It is removed before a job starts and written after its output.
"""

from __future__ import annotations

import csv
import hashlib
import json
import os
import signal
import sys
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from types import ModuleType
from typing import Any

from ..core.arguments import public
from ..core.errors import InputError, naming_options, option
from ..core.printable import printable
from ..core.system import ctrl_c_held, resident_memory, usable_cores
from ..io.atomic import STEM_LENGTH, together, whole_file, writing
from ..io.child_process import VARIABLES as LIBRARY_THREADS
from ..io.formats import parts_beside
from ..io.joint_file import side_file
from ..methods.find import weights_path
from ..methods.onnx_models import hands_path
from ..methods.onnx_runtime import THREADS
from ..mime.kept_results import keep_results
from .table import BatchJob, check_jobs, option_values, read_jobs, run_command

STATES = DONE, DONE_BEFORE, FAILED, NOT_RUN = ("done", "done before", "failed", "not run")
"""Of a job, in the order of messages: done now, by an earlier batch, with an error, or stopped before its start."""
COLUMNS = (
    *("number", "command", "identity", "driving", "output"),
    *("state", "seconds", "frames", "vertices", "confidence", "notes", "error"),
)
Report = Callable[[int, int, BatchJob | None, dict[str, Any]], None]
"""Gets the jobs finished, the jobs in all, and the job with its outcome; None for those that were finished before."""
ONE_THREAD = {**LIBRARY_THREADS, THREADS: "1"}
"""Environment variables of a worker: its libraries and networks have one thread."""
FORMAT, VERSION = "mimesh job", 2
"""Of a record."""
WITHOUT_EFFECT = ("threads", "verbose", "no-clobber")
"""Options that do not change what is written."""
TRACEBACK_LINES = 6
LONGEST_NAME = 255
"""Bytes of a file's name in the usual file systems."""


@dataclass(frozen=True)
class BatchTask:
    """A job for a worker."""

    job: BatchJob
    made_from: str
    """Its fingerprint."""


@dataclass(frozen=True, eq=False)
class BatchResult:
    """What became of the jobs of a batch."""

    jobs: Sequence[BatchJob]
    outcomes: Sequence[dict[str, Any]]
    """For each job identity, driving, output, its state (one of STATES) and, as far as they are known, seconds, frames,
    vertices, confidence (the lower one of identity and driving), notes, error."""
    seconds: float
    """Wall time of the whole batch."""
    workers: int
    files: Mapping[str, Path]
    """Paths of the summary (csv, json)."""

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
        files = {kind: str(path) for kind, path in self.files.items()}
        return {**head, "counts": self.counts, "files": files, "each": self.rows()}

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each job."""
        return [
            {"number": number, **asdict(job), "options": dict(job.options), **outcome}
            for number, (job, outcome) in enumerate(zip(self.jobs, self.outcomes, strict=True), 1)
        ]

    def save(self) -> None:
        """Write the summary in both formats."""
        csv_path, json_path = self.files["csv"], self.files["json"]
        with together():
            with (
                writing(csv_path),
                whole_file(csv_path) as temporary,
                temporary.open("w", newline="", encoding="utf-8") as file,
            ):
                table = csv.DictWriter(file, COLUMNS, extrasaction="ignore", restval="")
                table.writeheader()
                for row in self.rows():
                    joined = {"driving": (row["driving"], *row["more"]), "notes": row.get("notes") or ()}
                    cells = row | {key: " | ".join(values) for key, values in joined.items()}
                    table.writerow({key: printable(x) if isinstance(x, str) else x for key, x in cells.items()})
            with writing(json_path), whole_file(json_path) as temporary:
                temporary.write_text(json.dumps(self.facts(), indent=1) + "\n", encoding="utf-8", newline="\n")


class BatchStopped(KeyboardInterrupt):
    """Ctrl-C in a batch, with what was done until then."""

    def __init__(self, result: BatchResult) -> None:
        super().__init__()
        self.result = result


@public
def batch(
    identities: str | Path | Sequence[Mapping[str, Any]] | Sequence[str | Path],
    drivings: str | Path | Sequence[str | Path] | None = None,
    output: str | Path | None = None,
    *,
    command: str = "animate",
    options: Mapping[str, Any] | None = None,
    workers: int | None = None,
    again: bool = False,
    summary: str | Path | None = None,
    report: Report | None = None,
) -> BatchResult:
    """Do many jobs of `mimesh animate`, `transfer`, `rig` or `capture`: of a table, of all pairs of files, or of each.

    All jobs are checked before the first one starts. A job that fails does not stop others. A job that was finished by
    an earlier batch is not done again unless its inputs, its options or the model's file have changed.

    Args:
        identities: with `drivings`, a folder, a pattern with wildcards or a file of meshes, or a list of these;
            without, a table of jobs (a CSV file, or dictionaries): identity, driving, output, command and options by
            their names (`root-bone` or `root_bone`). With "rig" and "capture" also a folder, a pattern or a file of
            meshes, or of clips, or a list of these; rows have an identity or a driving alone.
        drivings: a folder, a pattern or a file of clips, or a list of these; each is combined with each identity.
            Where `output` has {identity} alone, all of them become animations of one file. In a row a list of clips
            does.
        output: where to write each result, with {identity}, {driving} and {number} for the names of its inputs and the
            number of the job. Rows of a table with an output of their own do not need it.
        command: "animate", "transfer", "rig" or "capture", for jobs whose row does not say.
        options: options of the command for all jobs ({"root": "keep", "ground": False}); rows replace them.
        workers: processes, with one thread each; None: one for each core that may be used.
        again: do finished jobs again.
        summary: folder for batch.csv and batch.json; None: the one that all outputs lie below.
        report: is called at the start and after each job.

    Returns:
        The outcomes of all jobs, in their order.

    Raises:
        InputError: a job cannot be done; none was started.
        BatchStopped: Ctrl-C, a KeyboardInterrupt; all files are complete or absent, the summary is written, and
            `result` has the outcomes.

    Example:
        >>> jobs = [{"identity": "hero.glb", "driving": "walk.npz", "output": "walking.glb", "stop": 2}]
        >>> done = mimesh.batch(jobs, summary="summary")  # doctest: +SKIP
        >>> done.counts["done"], done.failed  # doctest: +SKIP
        (1, 0)
    """
    begin = time.perf_counter()
    if workers is not None and workers < 1:
        raise InputError(f"{option('workers')}: expected 1 or more, found {workers}; leave it out for one a core")
    jobs = read_jobs(identities, drivings, output, options or {}, command)
    folder = Path(summary) if summary is not None else _common_folder(jobs)
    files = {kind: folder / f"batch.{kind}" for kind in ("csv", "json")}
    table = [Path(identities)] if drivings is None and isinstance(identities, (str, Path)) else []
    check_jobs(jobs, table, tuple(files.values()))
    if again:
        for job in jobs:
            record_path(job).unlink(missing_ok=True)
    tasks = [BatchTask(job, fingerprint(job)) for job in jobs]
    outcomes = [recorded(task) or {"state": NOT_RUN} for task in tasks]
    workers = workers or usable_cores()
    count = min(workers, sum(outcome["state"] == NOT_RUN for outcome in outcomes))

    def saved() -> BatchResult:
        told = [
            {"identity": job.identity, "driving": job.driving, "output": job.output, **outcome}
            for job, outcome in zip(jobs, outcomes, strict=True)
        ]
        result = BatchResult(jobs, told, time.perf_counter() - begin, count, files)
        result.save()
        return result

    try:
        _do_tasks(tasks, outcomes, workers, report)
    except KeyboardInterrupt as stop:
        raise BatchStopped(saved()) from stop
    return saved()


def _common_folder(jobs: Sequence[BatchJob]) -> Path:
    try:
        common = Path(os.path.commonpath([Path(job.output).resolve().parent for job in jobs]))
    except ValueError as error:  # several drives
        message = (
            f"{option('summary')}: expected a folder for the summary of outputs on several drives, found none; give one"
        )
        raise InputError(message) from error
    here = Path.cwd()
    return common.relative_to(here) if common.is_relative_to(here) else common


def _do_tasks(tasks: Sequence[BatchTask], outcomes: list[dict[str, Any]], workers: int, report: Report | None) -> None:
    left = {k: task for k, task in enumerate(tasks) if outcomes[k]["state"] == NOT_RUN}
    before = len(tasks) - len(left)
    if report is not None:
        report(before, len(tasks), None, {"workers": min(workers, len(left))})
    # Closed at once if `report` raises an error, so that the workers end.
    with closing(_do_with_workers(left, workers)) as finished:
        for done, (k, outcome) in enumerate(finished, before + 1):
            outcomes[k] = outcome
            if report is not None:
                report(done, len(tasks), tasks[k].job, outcome)


def record_path(job: BatchJob) -> Path:
    """Return the path of a job's record; of a long name it has the beginning and a digest."""
    output = Path(job.output)
    name = output.name
    if len(os.fsencode(f".{name}.job.json")) > LONGEST_NAME:
        name = f"{name[:STEM_LENGTH]}-{hashlib.blake2b(os.fsencode(name), digest_size=16).hexdigest()}"
    return output.with_name(f".{name}.job.json")


def fingerprint(job: BatchJob) -> str:
    """Return a digest of everything that the output of a job depends on, but not of where it is written."""
    options = sorted((name, value) for name, value in job.options if name not in WITHOUT_EFFECT)
    facts: dict[str, Any] = {"command": job.command, "options": options}
    facts["inputs"] = {name: _contents(path) for name, path in job.inputs().items()}
    facts["joints"] = [_contents(side_file(Path(path))) for path in job.files]
    model = weights_path(option_values(job.command, job.options)["model"])
    facts["weights"] = [_contents(model), _contents(hands_path().parent)]
    return hashlib.blake2b(json.dumps(facts).encode(), digest_size=16).hexdigest()


def _contents(path: Path) -> list[str]:
    """Return digests of a file and of the files that it consists of, or of all files of a folder but hidden ones.

    There are none of what does not exist or may not be read; the latter's job says so when it is done.
    """
    try:
        if path.is_dir():
            files = [file for file in sorted(path.iterdir()) if not file.name.startswith(".")]
        else:
            files = [path, *_parts(*_state(path))] if path.is_file() else []
        return [_digest(*_state(file)) for file in files if file.is_file()]
    except OSError:
        return []


def _state(path: Path) -> tuple[Path, int, int, int]:
    """Return what tells whether a file has changed."""
    facts = path.stat()
    return path.resolve(), facts.st_mtime_ns, facts.st_ctime_ns, facts.st_size


@lru_cache(maxsize=2**16)
def _parts(path: Path, *_: int) -> list[Path]:
    """List the files beside a file that belong to it; it is read once while it does not change."""
    return parts_beside(path)


@lru_cache(maxsize=2**16)
def _digest(path: Path, *_: int) -> str:
    """Return a digest of the name and contents of a file, which is read once while it does not change."""
    digest = hashlib.blake2b(path.name.encode("utf-8", "surrogateescape"), digest_size=16)
    with path.open("rb") as file:
        while chunk := file.read(2**20):
            digest.update(chunk)
    return digest.hexdigest()


def _written(job: BatchJob, more: Iterable[str]) -> dict[str, list[str]]:
    """Return the contents of the outputs of a job; only the job itself knows the previews of several clips."""
    return {path: _contents(Path(path)) for path in sorted({*map(str, job.outputs()), *more})}


def _record(job: BatchJob) -> dict[str, Any]:
    """Return the record of a job whose outputs are those that it wrote, else nothing."""
    try:
        record = json.loads(record_path(job).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    head = {"format": FORMAT, "version": VERSION}
    if not isinstance(record, dict) or not head.items() <= record.items():
        return {}
    outputs = record.get("outputs")
    return record if isinstance(outputs, dict) and outputs == _written(job, outputs) else {}


def recorded(task: BatchTask) -> dict[str, Any] | None:
    """Return the recorded outcome of a job whose outputs are as it wrote them, made from the same, else None."""
    record = _record(task.job)
    outcome = record.get("outcome")
    if not isinstance(outcome, dict) or record.get("made_from") != task.made_from:
        return None
    return {**outcome, "state": DONE_BEFORE}


def do_task(task: BatchTask) -> dict[str, Any]:
    """Do a job and return its outcome. Errors are outcomes; a signal to stop is not caught."""
    job, begin = task.job, time.perf_counter()
    failed: dict[str, Any] = {"state": FAILED}
    try:
        return _do_job(task, begin)
    except InputError as error:
        failed["error"] = " ".join(str(error).split())
    except MemoryError:
        failed["error"] = f"{job.name}: expected enough memory, found too little; use fewer {option('workers')}"
    except Exception as error:
        kind = f"{type(error).__name__}: {error}".splitlines()[0]
        failed["error"] = f"{kind} (a bug of mimesh; please report it)"
        failed["traceback"] = "".join(traceback.format_exception(error)[-TRACEBACK_LINES:])
    return {**failed, "seconds": round(time.perf_counter() - begin, 3), "memory_mib": resident_memory()}


def _do_job(task: BatchTask, begin: float) -> dict[str, Any]:
    path, job = record_path(task.job), task.job
    if "no-clobber" in dict(job.options) and _record(job):  # what this batch has made may be replaced
        job = replace(job, options=tuple(option for option in job.options if option[0] != "no-clobber"))
    path.unlink(missing_ok=True)
    with naming_options():
        facts = run_command(job)
    reports = [clip["report"] for clip in facts.get("clips", ())] or [facts["report"]]
    about = [report.get(which, report) for report in reports for which in ("identity", "driving")]
    found = [mesh.get("confidence") for mesh in about]
    outcome = {
        "state": DONE,
        "seconds": round(time.perf_counter() - begin, 3),
        "frames": facts.get("frames", 1),
        "vertices": facts.get("vertices"),
        "confidence": min((confidence for confidence in found if confidence is not None), default=None),
        "steps": facts["seconds"],
        "notes": facts["report"]["notes"],
        "error": None,
    }
    head = {"format": FORMAT, "version": VERSION, "made_from": task.made_from}
    previews = [path for of in reports for path in (*of.get("pictures", ()), of.get("page")) if path]
    record = {**head, "outputs": _written(job, previews), "outcome": outcome}
    with writing(path), whole_file(path) as temporary:
        temporary.write_text(json.dumps(record) + "\n", encoding="utf-8", newline="\n")
    return {**outcome, "memory_mib": resident_memory()}


def _do_with_workers(tasks: Mapping[int, BatchTask], workers: int) -> Generator[tuple[int, dict[str, Any]], None, None]:
    """Have worker processes do numbered tasks; yield numbers and outcomes as they come.

    If this generator is closed, or Ctrl-C ends it, the workers end at once and delete their temporary files.
    """
    waiting: dict[str, deque[int]] = {}
    for number, task in tasks.items():
        waiting.setdefault(task.job.identity, deque()).append(number)
    begun: set[str] = set()
    # Workers wait for the end of this pipe, which comes with the end of `line`, also when this process is killed.
    lifeline, line = SpawnContext().Pipe(duplex=False)
    pools, running = [_Worker(lifeline) for _ in range(min(workers, len(tasks)))], {}

    def start(worker: _Worker) -> None:
        worker.identity, number = next_job(waiting, begun, worker.identity)
        running[worker.submit(_do_or_exit, tasks[number])] = worker, number

    try:
        for worker in pools:
            start(worker)
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                worker, number = running.pop(future)
                try:
                    outcome = future.result()
                except BrokenProcessPool:
                    outcome = {"state": FAILED, "error": worker.ending()}
                    pools.append(worker := _Worker(lifeline))
                if waiting:
                    start(worker)
                yield number, outcome
    finally:
        if running:
            line.close()
        for worker in pools:
            worker.shutdown()
        lifeline.close()
        line.close()


def next_job(waiting: dict[str, deque[int]], begun: set[str], identity: str | None) -> tuple[str, int]:
    """Take a job for a worker: of the identity it has, else of one that no worker has begun, else where most are left.

    Args:
        waiting: identity -> numbers of its jobs; the job is removed.
        begun: identities that workers have begun; that of the job is added.
        identity: what the worker has done last.
    """
    if identity not in waiting:
        new = next((name for name in waiting if name not in begun), None)
        identity = new or max(waiting, key=lambda name: len(waiting[name]))
    begun.add(identity)
    number = waiting[identity].popleft()
    if not waiting[identity]:
        del waiting[identity]
    return identity, number


class _Worker(ProcessPoolExecutor):
    """A pool of one process: so it can stay with an identity, and costs its own job alone if it ends."""

    def __init__(self, lifeline: Connection) -> None:
        super().__init__(1, _Context(), _begin_worker, (lifeline,))
        self.identity: str | None = None
        """Of its last job."""

    def ending(self) -> str:
        """Return the error of a job whose process has ended: a crash of a library, or too little memory."""
        (process,) = self._processes.values()
        self.shutdown()  # waits for the exit code
        code = process.exitcode or 0
        ending = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        hint = f"; if the system ran out of memory, use fewer {option('workers')}" if "KILL" in ending else ""
        return f"expected a result, found that the worker ended ({ending}){hint}"


class _Process(SpawnProcess):
    """A process with ONE_THREAD, which does not run the script that has called `batch`.

    Spawned processes run the script of their parent; without `if __name__ == "__main__"` each would start the batch
    anew. They need nothing of it, so it is hidden while they are started.
    """

    def start(self) -> None:
        script, before = sys.modules["__main__"], {name: os.environ.get(name) for name in ONE_THREAD}
        sys.modules["__main__"] = ModuleType("__main__")
        os.environ.update(ONE_THREAD)
        try:
            with ctrl_c_held():  # it reaches the whole group of processes; the batch itself ends its workers
                super().start()
        finally:
            sys.modules["__main__"] = script
            for name, value in before.items():
                os.environ.pop(name)
                if value is not None:
                    os.environ[name] = value


class _Context(SpawnContext):
    """Has a pool start such processes."""

    Process = _Process


def _begin_worker(lifeline: Connection) -> None:
    """Prepare a worker process: when `lifeline` ends, so does the worker, after it has deleted its temporary files."""
    os.dup2(2, 1)  # what libraries print must not come between what the command prints, such as one JSON object

    def follow() -> None:
        with suppress(EOFError):
            lifeline.recv()
        os.kill(os.getpid(), signal.SIGTERM)

    keep_results()
    threading.Thread(target=follow, daemon=True).start()
    # Last: a signal before ends the process without a word, where a pool would print what its preparation raises.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


def _do_or_exit(task: BatchTask) -> dict[str, Any]:
    """Do a task in a worker process; a signal to stop ends the process, where the pool would go on."""
    try:
        return do_task(task)
    except SystemExit:
        os._exit(1)
